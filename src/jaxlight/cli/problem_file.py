"""Problem files: a fit in TOML, read into the dataclasses of `problem`; every mistake with its line and key."""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
import tomllib
import types
from collections.abc import Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from ..formats.errors import SceneFileError
from ..formats.limits import CIRCLE, read_bounded, resolved
from .options import Reading
from .problem import OUTPUT, CameraProblem, FitProblem, MapsProblem, ViewProblem
from .toml_lines import Key, key_lines

_UNQUOTED = ("Invalid value", "Expected '=' after a key in a key/value pair")
"""What the TOML reader says where a text or a path as key stands without quotes."""
_SINGULAR = {float: "a number", int: "a whole number", str: "a text", bool: "true or false", Path: "a path"}
_PLACES = {
    "at the top of the file": FitProblem,
    "in an entry of views": ViewProblem,
    "in the table reading": Reading,
    "in a view's camera": CameraProblem,
    "in a view's maps": MapsProblem,
}
"""The keys of each; one that several have belongs in the first."""
_PLURAL = {float: "numbers", str: "texts"}


class ProblemFile:
    """A problem file and where its keys stand.

    Args:
        path: the .toml file; paths in it are relative to its folder, and stay within it.

    Raises:
        SceneFileError: `path:line: key: what is wrong`; a file that cannot be read, no TOML, an unknown or missing key,
            a value of another type, a path that leads out of the folder or to nothing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            text = read_bounded(path).decode("utf-8-sig").replace("\r\n", "\n")
            content = tomllib.loads(text)
            self._lines = key_lines(text)
        except UnicodeDecodeError as error:
            raise SceneFileError(path, None, f"expected UTF-8: {error.reason} at byte {error.start}") from None
        except tomllib.TOMLDecodeError as error:
            what, _, place = str(error).rpartition(" (at ")
            line = re.match(r"line (\d+)", place)
            hint = " (texts and paths stand in quotes)" if what in _UNQUOTED else ""
            raise SceneFileError(path, int(line[1]) if line else text.count("\n") + 1, what + hint) from None
        except RecursionError:
            raise SceneFileError(path, None, "tables or lists are nested too deep") from None
        except SceneFileError:
            raise
        except ValueError:  # of Python's own limit, not of the TOML reader
            raise SceneFileError(path, None, "a number of too many digits") from None
        self.problem: FitProblem = self._table(FitProblem, content, ())

    def error(self, key: Key, message: str) -> SceneFileError:
        """The error about the entry at `key`, with the line of the nearest that is there."""
        known = next((key[:size] for size in range(len(key), 0, -1) if key[:size] in self._lines), ())
        return SceneFileError(self.path, self._lines.get(known), f"{_written(key)}: {message}" if key else message)

    def _table(self, kind: Any, content: Any, key: Key) -> Any:
        """A dataclass from a table."""
        if not isinstance(content, dict):
            raise self.error(key, f"expected a table, got {_shown(content)}")
        hints = get_type_hints(kind, include_extras=True)
        for name in content:
            if name not in hints:
                raise self.error((*key, name), f"there is no such key here; {_hint(name, hints)}")
        for field in dataclasses.fields(kind):
            if field.default is field.default_factory is dataclasses.MISSING and field.name not in content:
                raise self.error(key, f"the key {field.name!r} is missing")
        return kind(**{name: self._value(hints[name], value, (*key, name)) for name, value in content.items()})

    def _value(self, kind: Any, value: Any, key: Key) -> Any:
        """A value of a type, from what TOML has."""
        if get_origin(kind) is Annotated:
            if OUTPUT in kind.__metadata__:
                return self._path(value, key, must_exist=False)
            return self._value(get_args(kind)[0], value, key)
        if dataclasses.is_dataclass(kind):
            return self._table(kind, value, key)
        if _is_union(kind):
            fitting = [one for one in get_args(kind) if _may_be(one, value)]
            if fitting:
                return self._value(fitting[0], value, key)
        elif _may_be(kind, value):
            return self._parts(kind, value, key)
        raise self.error(key, f"expected {_words(kind)}, got {_shown(value)}")

    def _parts(self, kind: Any, value: Any, key: Key) -> Any:
        origin, args = get_origin(kind), get_args(kind)
        if origin is tuple:
            if args[-1] is not ... and len(value) != len(args):
                raise self.error(key, f"expected {_words(kind)}, got {len(value)}")
            return tuple(self._value(args[0], one, (*key, i)) for i, one in enumerate(value))
        if origin is dict:
            return {name: self._value(args[1], one, (*key, name)) for name, one in value.items()}
        if kind is Path:
            return self._path(value, key, must_exist=True)
        return float(value) if kind is float else value

    def _path(self, value: Any, key: Key, *, must_exist: bool) -> Path:
        if not isinstance(value, str) or not value or "\0" in value:
            raise self.error(key, f"expected a path, got {_shown(value)}")
        folder = self.path.parent
        if PurePosixPath(value).is_absolute() or PureWindowsPath(value).anchor:
            raise self.error(key, f"{value} is outside the folder of the problem file")
        try:
            place = resolved(folder / value)
        except ValueError:
            raise self.error(key, f"{value}: {CIRCLE}") from None
        if not place.is_relative_to(folder.resolve()):
            raise self.error(key, f"{value} is outside the folder of the problem file")
        if must_exist and not (folder / value).is_file():
            raise self.error(key, f"{value}: no such file beside the problem file")
        return folder / value


def _hint(name: str, known: Mapping[str, Any]) -> str:
    """Where a key belongs, or what else may have been meant."""
    for place, kind in _PLACES.items():
        if name in (field.name for field in dataclasses.fields(kind)):
            return f"it belongs {place}"
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else f"known are {', '.join(known)}"


def _is_union(kind: Any) -> bool:
    return get_origin(kind) in (Union, types.UnionType)


def _may_be(kind: Any, value: Any) -> bool:
    """Whether a TOML value is of the sort that a type takes."""
    origin = get_origin(kind)
    if origin is Annotated:
        return _may_be(get_args(kind)[0], value)
    if _is_union(kind):
        return any(_may_be(one, value) for one in get_args(kind))
    if origin is Literal:
        return any(type(value) is type(word) and value == word for word in get_args(kind))
    if origin is tuple:
        return isinstance(value, list)
    if origin is dict or dataclasses.is_dataclass(kind):
        return isinstance(value, dict)
    if kind is float:
        return _is_whole(value) or (isinstance(value, float) and not math.isnan(value))
    if kind is int:
        return _is_whole(value)
    return isinstance(value, str if kind is Path else kind)


def _is_whole(value: Any) -> bool:
    """Whether a value is a whole number of the 64 bits that TOML speaks of."""
    return isinstance(value, int) and not isinstance(value, bool) and -(2**63) <= value < 2**63


def _words(kind: Any) -> str:
    """A type as a person would say it."""
    origin, args = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _words(args[0])
    if _is_union(kind):
        return " or ".join(dict.fromkeys(_words(one) for one in args if one is not type(None)))
    if origin is Literal:
        return " or ".join(repr(word) for word in args)
    if origin is tuple:
        kind = _PLURAL.get(args[0], "entries")
        return f"a list of {kind}" if args[-1] is ... else f"a list of {len(args)} {kind}"
    if origin is dict or dataclasses.is_dataclass(kind):
        return "a table"
    return _SINGULAR[kind]


def _shown(value: Any) -> str:
    if isinstance(value, (dict, list)):
        return "a table" if isinstance(value, dict) else "a list"
    if isinstance(value, int) and not isinstance(value, bool) and not _is_whole(value):
        return "a whole number of more than 64 bits"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _written(key: Key) -> str:
    """`views[1].mask`, as one would write it."""
    text = ""
    for part in key:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            name = part if re.fullmatch(r"[\w-]+", part) else f'"{part}"'
            text += f".{name}" if text else name
    return text
