"""X3D field values <-> text of the XML encoding (ISO/IEC 19776-1, clause 5).

Reading is linear in the length of the text; writing gives the shortest digits that read back as the same number.
"""

from __future__ import annotations

import dataclasses
import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from .limits import MAX_PIXELS
from .quantize import quantize

_COMMAS_ARE_BLANKS = bytes.maketrans(b",\t\r\n", b"    ")
_FLOAT = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_INTEGER = re.compile(r"[+-]?\d+|0[xX][0-9a-fA-F]+", re.ASCII)
_QUOTED = re.compile(r'[\s,]*"((?:[^"\\]|\\.)*)"', re.DOTALL)
_LONG = 512
"""From this many characters on the numbers of a text are read by NumPy at once."""


@dataclasses.dataclass(frozen=True)
class FieldType:
    """An X3D field type: text -> value and value -> text. `parse` raises ValueError, saying what came."""

    parse: Callable[[str], Any]
    format: Callable[[Any], str]


def float_text(value: Any) -> str:
    """The shortest digits that read back as the same number in the value's own precision."""
    if not isinstance(value, np.floating):
        value = np.float64(value)
    if np.isinf(value):
        return "1e400" if value > 0 else "-1e400"  # X3D has no word for infinity; every reader overflows to it
    text = str(value)
    if type(value)(float(text)) != value:
        text = repr(float(value))
    return text.removesuffix(".0")


def parse_floats(text: str) -> np.ndarray:
    """All numbers of a text [n], float64."""
    values = _at_once(text, np.float64, b"0123456789+-.eE ") if len(text) >= _LONG else None
    if values is None:
        values = np.array([float(word) for word in _words(text, _FLOAT, "a number")], dtype=np.float64)
    return values


def parse_integers(text: str) -> np.ndarray:
    """All integers of a text [n], int64; hexadecimal ones start with 0x."""
    values = _at_once(text, np.int64, b"0123456789+- ") if len(text) >= _LONG else None
    if values is None:
        words = _words(text, _INTEGER, "an integer")
        values = np.array([_integer(word) for word in words], dtype=np.int64)
    return values


def _words(text: str, pattern: re.Pattern[str], what: str) -> list[str]:
    words = text.replace(",", " ").split()
    for word in words:
        if not pattern.fullmatch(word):
            raise ValueError(f"{_shown(word)} is not {what}")
    return words


def _integer(word: str) -> int:
    if len(word) > 20:
        raise ValueError(f"{_shown(word)} is too large")
    value = int(word, 16 if word[:2] in ("0x", "0X") else 10)
    if not -(2**63) <= value < 2**63:
        raise ValueError(f"{_shown(word)} is too large")
    return value


def _at_once(text: str, dtype: Any, alphabet: bytes) -> np.ndarray | None:
    """The numbers of a long text, or None if anything in it is unusual: then the words are looked at one by one."""
    raw = text.encode("ascii", errors="replace").translate(_COMMAS_ARE_BLANKS)
    if raw.translate(None, alphabet) or not raw.strip():
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # how older NumPy says that a word is no number
            values = np.fromstring(raw, dtype=dtype, sep=" ")
    except (ValueError, DeprecationWarning):
        return None
    inside = np.frombuffer(raw, dtype=np.uint8) != ord(" ")
    words = int(inside[0]) + int(np.count_nonzero(inside[1:] & ~inside[:-1]))
    if len(values) != words or (dtype is np.int64 and np.abs(values.astype(np.float64)).max() >= 2**63):
        return None
    return values


def _shown(text: str) -> str:
    return repr(text if len(text) <= 40 else f"{text[:37]}...")


def _exactly(values: np.ndarray, count: int) -> list[Any]:
    if len(values) != count:
        raise ValueError(f"expected {count} number{'s' if count > 1 else ''}, got {len(values)}")
    return values.tolist()


def _vector(count: int) -> tuple[Callable[[str], Any], Callable[[Any], str]]:
    def parse(text: str) -> tuple[float, ...]:
        return tuple(_exactly(parse_floats(text), count))

    return parse, lambda value: " ".join(float_text(x) for x in value)


def _rows(columns: int) -> tuple[Callable[[str], Any], Callable[[Any], str]]:
    def parse(text: str) -> np.ndarray:
        values = parse_floats(text)
        if len(values) % columns:
            raise ValueError(f"expected groups of {columns} numbers, got {len(values)} numbers")
        return values.reshape(-1, columns)

    def write(value: np.ndarray) -> str:
        rows = np.asarray(value, dtype=np.float64).tolist()
        return ", ".join([" ".join([repr(x).removesuffix(".0") for x in row]) for row in rows])

    return parse, write


def _parse_boolean(text: str) -> bool:
    word = text.strip().lower()
    if word not in ("true", "false"):
        raise ValueError(f"expected true or false, got {_shown(text)}")
    return word == "true"


def _parse_strings(text: str) -> tuple[str, ...]:
    """MFString: strings in double quotes, with \\" and \\\\ inside; a text without quotes is one string."""
    if not text.strip():
        return ()
    if not text.lstrip(" \t\r\n,").startswith('"'):
        return (text.strip(),)
    strings, end = [], 0
    while match := _QUOTED.match(text, end):
        strings.append(re.sub(r"(?s)\\(.)", r"\1", match[1]))
        end = match.end()
    if text[end:].strip(" \t\r\n,"):
        raise ValueError(f"expected strings in double quotes, got {_shown(text[end:].strip())}")
    return tuple(strings)


def _format_strings(value: tuple[str, ...]) -> str:
    return " ".join('"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"' for text in value)


def parse_image(text: str) -> np.ndarray | None:
    """SFImage: width, height, components, then one integer a pixel, rows from the bottom up.

    Returns:
        [height, width, components] in [0, 1], row 0 at the bottom; None for an image without pixels.
    """
    values = parse_integers(text)
    if len(values) == 0:
        return None
    if len(values) < 3:
        raise ValueError(f"expected width, height, components and pixels, got {len(values)} numbers")
    width, height, components = values[:3].tolist()
    pixels = values[3:]
    if width < 0 or height < 0 or not 0 <= components <= 4:
        raise ValueError(f"expected a width and height >= 0 and 0 to 4 components, got {width} {height} {components}")
    if width * height * components == 0:
        return None
    if width * height > MAX_PIXELS:
        raise ValueError(f"{width} x {height} pixels; at most {MAX_PIXELS} are read")
    if len(pixels) != width * height:
        raise ValueError(f"{width} x {height} pixels announced, {len(pixels)} given")
    if pixels.min() < 0 or pixels.max() >= 256**components:
        raise ValueError(f"a pixel of {components} components must lie in 0 to {256**components - 1:#x}")
    shifts = 8 * np.arange(components - 1, -1, -1)
    return ((pixels[:, None] >> shifts) & 255).reshape(height, width, components) / 255.0


def format_image(image: np.ndarray | None) -> str:
    """SFImage text of an image, rounded to 8 bits a component."""
    if image is None:
        return "0 0 0"
    height, width, components = image.shape
    levels = quantize(image).astype(np.int64)
    shifts = 8 * np.arange(components - 1, -1, -1)
    pixels = (levels << shifts).sum(axis=2).ravel().tolist()
    return " ".join([f"{width} {height} {components}", *(f"0x{pixel:0{2 * components}X}" for pixel in pixels)])


SFBool = FieldType(_parse_boolean, lambda value: "true" if value else "false")
SFInt32 = FieldType(lambda text: _exactly(parse_integers(text), 1)[0], str)
SFFloat = FieldType(lambda text: _exactly(parse_floats(text), 1)[0], float_text)
SFString = FieldType(lambda text: text, str)
SFVec2f = FieldType(*_vector(2))
SFVec3f = FieldType(*_vector(3))
SFRotation = FieldType(*_vector(4))
SFImage = FieldType(parse_image, format_image)
MFFloat = FieldType(
    lambda text: tuple(parse_floats(text).tolist()),
    lambda value: " ".join(float_text(x) for x in value),
)
MFString = FieldType(_parse_strings, _format_strings)
MFInt32 = FieldType(parse_integers, lambda value: " ".join(map(str, np.asarray(value).tolist())))
ROWS = {columns: FieldType(*_rows(columns)) for columns in (2, 3, 4)}
"""Fields of many vectors or colours, by their number of columns."""
