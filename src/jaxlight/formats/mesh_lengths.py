"""Do ply and stl files hold what they announce? trimesh reads what there is of some files that were cut off."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

from .errors import SceneFileError
from .ply_header import PlyElement, read_ply_header

_STL_HEADER, _STL_TRIANGLE = 84, 50
"""Bytes of a binary stl."""
_NUMBER = rb"[ \t]+[-+]?(?:\d+(?:\.\d*)?|\.\d+|inf|nan)(?:e[-+]?\d+)?"
_STL_VERTEX = re.compile(rb"vertex" + 3 * _NUMBER + rb"[ \t\r]*\n")
_STL_NAME = re.compile(rb"solid\b.*")


def checked_ply(path: Path, data: bytes) -> bytes:
    """A ply with the header that trimesh is to read.

    Raises:
        SceneFileError: the header is damaged; an ascii ply has not the rows that it announces, or rows have not their
            numbers.
    """
    header = read_ply_header(path, data)
    if header.is_ascii:
        _check_rows(path, data[header.end :], header.elements, data.count(b"\n", 0, header.end))
    return header.data + data[header.end :]


def _check_rows(path: Path, body: bytes, elements: list[PlyElement], line: int) -> None:
    """Check the rows of an ascii ply, which come after so many lines."""
    rows = body.rstrip().splitlines()
    announced = sum(element.count for element in elements)
    if len(rows) != announced:
        kinds = ", ".join(f"{element.count} {element.name}" for element in elements)
        raise SceneFileError(path, None, f"announces {announced} rows ({kinds}), but holds {len(rows)}: truncated?")
    whole = iter(rows)
    for element in elements:
        lists = list(element.properties.values())
        for row in itertools.islice(whole, element.count):
            line += 1
            if not _is_whole(row, lists):
                message = f"a {element.name} has not all of its {len(lists)} properties: truncated?"
                raise SceneFileError(path, line, message)


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
