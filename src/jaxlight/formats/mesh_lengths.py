"""Do ply and stl files hold what they announce? trimesh reads what there is of some files that were cut off."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

from .errors import SceneFileError
from .ply_header import CORNERS, PlyElement, read_ply_header

_STL_HEADER, _STL_TRIANGLE = 84, 50
"""Bytes of a binary stl."""
_NUMBER = rb"[ \t]+[-+]?(?:\d+(?:\.\d*)?|\.\d+|inf|nan)(?:e[-+]?\d+)?"
_STL_VERTEX = re.compile(rb"vertex" + 3 * _NUMBER + rb"[ \t\r]*\n")
_STL_NAME = re.compile(rb"solid\b.*")


def checked_ply(path: Path, data: bytes) -> bytes:
    """A ply with the header that trimesh is to read.

    Raises:
        SceneFileError: the header is damaged; an ascii ply has not the rows that it announces, rows have not their
            numbers, or faces have indices that are not those of vertices.
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
    vertices = next((element.count for element in elements if element.name == "vertex"), 0)
    for element in elements:
        lists = list(element.properties.values())
        corners = _list_of_corners(element)
        for row in itertools.islice(whole, element.count):
            line += 1
            entries = _entries(row, lists)
            if entries is None:
                message = f"a {element.name} has not all of its {len(lists)} properties: truncated?"
                raise SceneFileError(path, line, message)
            for index in entries[corners] if corners is not None else ():
                if not index.is_integer():
                    raise SceneFileError(path, line, f"a face has the index {index:g}, expected a whole number")
                if not 0 <= index < vertices:
                    message = (
                        f"an index is out of range: a face has the index {index:.0f}, the file {vertices} vertices"
                    )
                    raise SceneFileError(path, line, message)


def _list_of_corners(element: PlyElement) -> int | None:
    """Which property of a face has its corners, as trimesh takes it; None of other elements."""
    names = list(element.properties)
    if element.name != "face" or not names:
        return None
    return next((row for row, name in enumerate(names) if name in CORNERS), 0 if len(names) == 1 else None)


def _entries(row: bytes, lists: list[bool]) -> list[list[float]] | None:
    """The numbers of each property of a row, of a list its entries; None if they are not all there."""
    try:
        values, place, entries = [float(word) for word in row.split()], 0, []
        for is_list in lists:
            size = values[place] if is_list else 1.0
            if not size.is_integer() or size < 0:
                return None
            place += is_list
            entries.append(values[place : place + int(size)])
            place += int(size)
        return entries if place <= len(values) else None
    except (ValueError, IndexError):
        return None


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
