"""Does a ply hold what it announces? trimesh reads what there is of some files that were cut off, cuts numbers to their
type, and takes all lists of a binary file for as long as the first."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .errors import SceneFileError
from .ply_header import CORNERS, ByteOrder, PlyElement, read_ply_header

_TRUNCATED = "a {} has not all of its {} properties: truncated?"


def checked_ply(path: Path, data: bytes) -> bytes:
    """A ply with the header that trimesh is to read.

    Raises:
        SceneFileError: the header is damaged; an ascii ply has not the rows that it announces, rows have not their
            numbers or some that their types do not hold; lists of a binary ply have several sizes; faces have indices
            that are none, or in an ascii ply not those of vertices.
    """
    header = read_ply_header(path, data)
    if header.is_ascii:
        _check_rows(path, data[header.end :], header.elements, data.count(b"\n", 0, header.end))
    else:
        _check_binary(path, memoryview(data)[header.end :], header.elements, header.byte_order)
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
        corners = _list_of_corners(element)
        for row in itertools.islice(whole, element.count):
            line += 1
            try:
                for name, numbers in _entries(row, element):
                    if name == corners:
                        _check_corners(numbers, vertices)
            except ValueError as error:
                raise SceneFileError(path, line, str(error)) from None


def _list_of_corners(element: PlyElement) -> str | None:
    """Which property of a face has its corners, as trimesh takes it; None of other elements."""
    names = list(element.properties)
    if element.name != "face" or not names:
        return None
    return next((name for name in names if name in CORNERS), names[0] if len(names) == 1 else None)


def _check_corners(indices: list[float], vertices: int) -> None:
    for index in indices:
        if not index.is_integer():
            raise ValueError(f"a face has the index {index:g}, expected a whole number")
        if not 0 <= index < vertices:
            raise ValueError(
                f"an index is out of range: a face has the index {index:.0f}, the file {vertices} vertices"
            )


def _entries(row: bytes, element: PlyElement) -> Iterator[tuple[str, list[float]]]:
    """The numbers of each property of a row, of a list its entries; ValueError if they are not all there, or one is not
    of its type."""
    truncated = ValueError(_TRUNCATED.format(element.name, len(element.properties)))
    try:
        values = [float(word) for word in row.replace(b"_", b"?").split()]
    except ValueError:
        raise truncated from None
    place = 0
    for name, kind in element.properties.items():
        size = 1.0
        if kind.size_type is not None:
            if place == len(values):
                raise truncated
            size, place = values[place], place + 1
            _check_type(element.name, f"a list {name} of the size", [size], kind.size_type)
        entries = values[place : place + int(size)] if size >= 0 else []
        if len(entries) != size:
            raise truncated
        _check_type(element.name, name, entries, kind.type)
        yield name, entries
        place += len(entries)


def _check_type(element: str, name: str, numbers: list[float], kind: np.dtype[Any]) -> None:
    """Raise ValueError for a number that trimesh would cut to an integer type."""
    limits = _limits(kind)
    if limits is None:
        return
    low, high = limits
    for number in numbers:
        if not (low <= number <= high and number.is_integer()):
            allowed = f"expected a whole number from {low} to {high} ({kind.name})"
            raise ValueError(f"a {element} has {name} {number:g}, {allowed}")


@functools.cache
def _limits(kind: np.dtype[Any]) -> tuple[int, int] | None:
    """The least and the largest number of an integer type; None of others."""
    if kind.kind == "f":
        return None
    limits = np.iinfo(kind)
    return int(limits.min), int(limits.max)


def _check_binary(path: Path, body: memoryview, elements: list[PlyElement], byte_order: ByteOrder) -> None:
    """Check the lists of a binary ply, as far as trimesh would read it: what it says of other lengths stands."""
    place = 0
    for element in elements:
        if not element.count:
            continue
        if place == len(body):
            raise SceneFileError(path, None, f"announces {element.count} {element.name}, but holds none: truncated?")
        row = _row_like_first(body[place:], element, byte_order)
        if row is None or place + element.count * row.itemsize > len(body):
            return
        rows = np.frombuffer(body, row, element.count, place)
        for name, kind in element.properties.items():
            if kind.size_type is not None:
                sizes = rows[_size_of(name)]
                if np.any(sizes != sizes[0]):
                    number = int(np.argmax(sizes != sizes[0]))
                    message = (
                        f"the lists {name} are of {sizes[0]} entries and, of {element.name} {number}, of "
                        f"{sizes[number]}: a binary ply may have lists of one size, an ascii ply of several"
                    )
                    raise SceneFileError(path, None, message)
        corners = _list_of_corners(element)
        if corners is not None and np.any(rows[corners] != np.floor(rows[corners])):
            number = rows[corners][rows[corners] != np.floor(rows[corners])][0]
            raise SceneFileError(path, None, f"a face has the index {number:g}, expected a whole number")
        place += element.count * row.itemsize


def _row_like_first(body: memoryview, element: PlyElement, byte_order: ByteOrder) -> np.dtype[Any] | None:
    """What every row of an element is if its lists are as long as those of the first; None if that is not there."""
    fields: list[Any] = []
    for name, kind in element.properties.items():
        shape: tuple[int, ...] = ()
        if kind.size_type is not None:
            fields.append((_size_of(name), kind.size_type.newbyteorder(byte_order)))
            before = np.dtype(fields)
            if len(body) < before.itemsize:
                return None
            size = int(np.frombuffer(body, before, 1)[_size_of(name)][0])
            if not 0 <= size * kind.type.itemsize <= len(body):
                return None
            shape = (size,)
        fields.append((name, kind.type.newbyteorder(byte_order), shape))
    return np.dtype(fields)


def _size_of(name: str) -> str:
    """What the size of a list is called; no property is called so."""
    return f"size of {name}"
