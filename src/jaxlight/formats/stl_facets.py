"""Does an stl hold what it announces? trimesh reads what there is of some files that were cut off."""

from __future__ import annotations

import re
from pathlib import Path

from .errors import SceneFileError

_STL_HEADER, _STL_TRIANGLE = 84, 50
"""Bytes of a binary stl."""
_NUMBER = rb"[ \t]+[-+]?(?:\d+(?:\.\d*)?|\.\d+|inf|nan)(?:e[-+]?\d+)?"
_STL_VERTEX = re.compile(rb"vertex" + 3 * _NUMBER + rb"[ \t\r]*\n")
_STL_NAME = re.compile(rb"solid\b.*")


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
