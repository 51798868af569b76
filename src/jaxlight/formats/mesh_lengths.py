"""Do ply and stl files hold what they announce? trimesh reads what there is of some files that were cut off.

It knows the colours of a ply by one name only.
"""

from __future__ import annotations

import itertools
import re
from pathlib import Path

from .errors import SceneFileError

_STL_HEADER, _STL_TRIANGLE = 84, 50
"""Bytes of a binary stl."""
_NUMBER = rb"[ \t]+[-+]?(?:\d+(?:\.\d*)?|\.\d+|inf|nan)(?:e[-+]?\d+)?"
_STL_VERTEX = re.compile(rb"vertex" + 3 * _NUMBER + rb"[ \t\r]*\n")
_STL_NAME = re.compile(rb"solid\b.*")
_PLY_COLORS = (b"red", b"green", b"blue", b"alpha")
_OTHER_COLORS = ((b"diffuse_red", b"diffuse_green", b"diffuse_blue", b"diffuse_alpha"), (b"r", b"g", b"b", b"a"))
"""What else programs call them."""
_PLY_HEADER = re.compile(rb"\A(.*?^end_header)[ \t]*\r?\n", re.MULTILINE | re.DOTALL)


def checked_ply(path: Path, data: bytes) -> bytes:
    """A ply whose colours have their usual names.

    Raises:
        SceneFileError: an ascii ply has not the rows that its header announces, or rows have not their numbers.
    """
    header = _PLY_HEADER.match(data)
    if header is None:
        return data
    _check_rows(path, data, header)
    elements = re.split(rb"^(?=element\b)", header[1], flags=re.MULTILINE)
    return b"".join([*map(_with_usual_colors, elements), data[header.end(1) :]])


def _with_usual_colors(element: bytes) -> bytes:
    """The part of a header that describes an element, with `red` for what means it, unless that is there."""
    names = set(re.findall(rb"^property[ \t]+\S+[ \t]+(\S+)", element, re.MULTILINE))
    for others in _OTHER_COLORS:
        if names.issuperset(others[:3]) and names.isdisjoint(_PLY_COLORS):
            for other, usual in zip(others, _PLY_COLORS, strict=True):
                named = rb"^(property[ \t]+\S+[ \t]+)" + other + rb"(?=\s)"
                element = re.sub(named, rb"\g<1>" + usual, element, flags=re.MULTILINE)
            break
    return element


def _check_rows(path: Path, data: bytes, header: re.Match[bytes]) -> None:
    """Check that an ascii ply has the rows that its header announces, and rows their numbers; others pass."""
    if not re.search(rb"^format[ \t]+ascii", header[1], re.MULTILINE):
        return
    elements: list[tuple[str, int, list[bool]]] = []  # name, rows, and whether each property is a list
    for line in header[1].splitlines():
        match line.split():
            case [b"element", name, count]:
                elements.append((name.decode(errors="replace"), int(count), []))
            case [b"property", kind, *_] if elements:
                elements[-1][2].append(kind == b"list")
    rows = data[header.end() :].rstrip().splitlines()
    announced = sum(count for _, count, _ in elements)
    if len(rows) != announced:
        kinds = ", ".join(f"{count} {name}" for name, count, _ in elements)
        raise SceneFileError(path, None, f"announces {announced} rows ({kinds}), but holds {len(rows)}: truncated?")
    line, whole = data.count(b"\n", 0, header.end()), iter(rows)
    for name, count, lists in elements:
        for row in itertools.islice(whole, count):
            line += 1
            if not _is_whole(row, lists):
                raise SceneFileError(path, line, f"a {name} has not all of its {len(lists)} properties: truncated?")


def _is_whole(row: bytes, lists: list[bool]) -> bool:
    """True if a row has a number for each property, and for each entry of those that are lists."""
    try:
        values, needed = [float(word) for word in row.split()], 0
        for is_list in lists:
            needed += 1 + (int(values[needed]) if is_list else 0)
        return needed <= len(values)
    except (ValueError, IndexError, OverflowError):
        return False


def checked_stl(path: Path, data: bytes) -> bytes:
    """An stl that holds what it announces, without the names of its solids (trimesh takes words in them for vertices).

    Raises:
        SceneFileError: it ends too early or too late, or a facet has not three vertices of three numbers.
    """
    triangles = int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little")
    expected = _STL_HEADER + triangles * _STL_TRIANGLE
    if len(data) == expected:
        return data
    if b"\0" in data:
        message = f"announces {triangles} triangles, which take {expected} bytes, but has {len(data)}: truncated?"
        raise SceneFileError(path, None, message)
    data = _STL_NAME.sub(b"solid", data.lower())
    count = {word: data.count(word.encode()) for word in ("endsolid", "endfacet", "solid", "facet")}
    solids, facets = count["solid"] - count["endsolid"], count["facet"] - count["endfacet"]
    vertices = len(_STL_VERTEX.findall(data))
    if (count["endsolid"], count["endfacet"], vertices) != (solids, facets, 3 * facets):
        found = f"{solids} solid, {count['endsolid']} endsolid, {facets} facet, {count['endfacet']} endfacet"
        message = "each solid needs an endsolid, each facet an endfacet and 3 vertex lines of 3 numbers"
        raise SceneFileError(path, None, f"not a stl file, or truncated: {message}; found: {found}, {vertices} vertex")
    return data
