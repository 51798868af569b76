"""The header of a ply: checked, and with the names of properties that trimesh knows."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from .errors import SceneFileError
from .plain_text import text_of

_HEADER = re.compile(rb"\A(.*?^[ \t]*end_header)[ \t]*\r?\n", re.MULTILINE | re.DOTALL)
ByteOrder = Literal["=", "<", ">"]
"""As NumPy writes it."""
_FORMATS: dict[str, ByteOrder] = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_LINES = {
    "format": f"the line format {' or '.join(_FORMATS)} 1.0",
    "element": "element NAME COUNT",
    "property": "property TYPE NAME or property list TYPE TYPE NAME behind an element",
}
_OTHER_WORDS = ("ply", "comment", "obj_info", "end_header")
_INTEGERS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "int8": "i1", "uint8": "u1",
    "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8",
}  # fmt: skip
_TYPES = {**_INTEGERS, "float": "f4", "double": "f8", "float16": "f2", "float32": "f4", "float64": "f8"}
"""As NumPy calls them."""
CORNERS = ("vertex_indices", "vertex_index")
_COLORS = ("red", "green", "blue", "alpha")
_OTHER_COLORS = (("diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"), ("r", "g", "b", "a"))
"""What else programs call them."""


class PlyProperty(NamedTuple):
    """What a header says of one of the numbers, or lists, of a row."""

    type: np.dtype[Any]
    size_type: np.dtype[Any] | None = None
    """Of a list: of the number of its entries."""


class PlyElement(NamedTuple):
    """What a header says of a kind of rows."""

    name: str
    count: int
    line: int
    properties: dict[str, PlyProperty]
    """By their names."""
    lines: dict[str, int]
    """By the names of properties, where they stand."""


class PlyHeader(NamedTuple):
    """What stands before the rows."""

    is_ascii: bool
    byte_order: ByteOrder
    elements: list[PlyElement]
    data: bytes
    """The header as trimesh is to read it."""
    end: int
    """Bytes of the file that it takes."""


def read_ply_header(path: Path, data: bytes) -> PlyHeader:
    """The header of a ply file.

    Raises:
        SceneFileError: it has no end, or a line that is not as ply has them; vertices without x, y and z, or faces
            without corners.
    """
    found = _HEADER.match(data)
    if found is None:
        raise SceneFileError(path, None, "a ply without the line end_header: truncated?")
    lines = text_of(found[1]).split("\n")
    elements: list[PlyElement] = []
    form = ""
    for line, text in enumerate(lines, 1):
        match text.split():
            case ["format", kind, "1.0"] if kind in _FORMATS:
                form = kind
            case ["element", name, _] if name in (element.name for element in elements):
                raise SceneFileError(path, line, f"a second element {name}")
            case ["property", *_, name] if elements and name in elements[-1].properties:
                raise SceneFileError(path, line, f"a second property {name} of the element {elements[-1].name}")
            case ["element", name, count] if re.fullmatch(r"\d{1,18}", count, re.ASCII):
                elements.append(PlyElement(name, int(count), line, {}, {}))
            case ["property", kind, name] if kind in _TYPES and elements:
                own = PlyProperty(np.dtype(_TYPES[kind]))
                elements[-1].properties[name], elements[-1].lines[name] = own, line
            case ["property", "list", size, kind, name] if size in _INTEGERS and kind in _TYPES and elements:
                own = PlyProperty(np.dtype(_TYPES[kind]), np.dtype(_TYPES[size]))
                elements[-1].properties[name], elements[-1].lines[name] = own, line
            case ["format" | "element" | "property" as keyword, *_]:
                raise SceneFileError(path, line, f"expected {_LINES[keyword]}, got {text[:60]!r}")
            case [word, *_] if word not in _OTHER_WORDS:
                raise SceneFileError(path, line, f"expected {', '.join(_LINES)} or comment, got {text[:60]!r}")
    if not form:
        raise SceneFileError(path, None, f"a ply header without {_LINES['format']}")
    for element in elements:
        for name, usual in _usual_names(element).items():
            line = element.lines[name]
            lines[line - 1] = f"{lines[line - 1].rstrip().removesuffix(name)}{usual}"
        _check_element(path, element)
    # Of comments trimesh needs those that name a texture, and takes any with end_header in it for the end.
    rest = [text for text in lines[1:] if not re.match(r"\s*(format\b|comment\b(?!\s+TextureFile)|$)", text)]
    data = "\n".join(["ply", f"format {form} 1.0", *rest, ""]).encode()
    return PlyHeader(form == "ascii", _FORMATS[form], elements, data, found.end())


def _usual_names(element: PlyElement) -> dict[str, str]:
    """By their names, properties that trimesh knows by other ones: the only list of a face, and colours."""
    there = element.properties.keys()
    if element.name == "face" and len(there) == 1 and _lists_of(element):
        return dict.fromkeys(there, CORNERS[0])
    for others in _OTHER_COLORS:
        if there >= set(others[:3]) and there.isdisjoint(_COLORS):
            return {other: usual for other, usual in zip(others, _COLORS, strict=True) if other in there}
    return {}


def _lists_of(element: PlyElement) -> list[str]:
    return [name for name, kind in element.properties.items() if kind.size_type is not None]


def _check_element(path: Path, element: PlyElement) -> None:
    """Whether vertices have places, and faces corners."""
    if not element.count:
        return
    lists = _lists_of(element)
    needed = [name for name in "xyz" if name not in element.properties or name in lists]
    if element.name == "vertex" and needed:
        raise SceneFileError(path, element.line, f"the vertices have no property {needed[0]}")
    if element.name == "face" and len(element.properties) != 1 and not set(lists) & set(CORNERS):
        raise SceneFileError(path, element.line, f"the faces have no list {CORNERS[0]}")
    if element.name == "face" and element.properties.keys() >= set(CORNERS):
        raise SceneFileError(path, element.line, f"the faces have corners twice, {' and '.join(CORNERS)}")
