"""The text of an OBJ file, made ready for trimesh: its indices checked and absolute, the faces of a material alike.

trimesh counts relative indices from the end of the file, takes the form of all faces of a material from one of them,
drops texture coordinates or normals of all of them where one face has none, and takes every face for a convex one.
"""

from __future__ import annotations

import array
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..scene.polygons import Faces, are_no_fans, split_concave
from .errors import SceneFileError
from .levels import are_bytes
from .notes import ReadNotes
from .plain_text import name_in, text_of

_LISTS = ("v", "vt", "vn")
"""What the three indices of a corner point into."""
_NEEDED = {"v": 3, "vt": 1, "vn": 3}
"""Numbers that an entry must have; a `vt` with one has 0 as its second."""
_USED = {"v": 3, "vt": 2, "vn": 3}
"""Of them, those of places and directions, which have to be finite."""
_SKIPPED = ("l", "p", "curv", "curv2", "surf")
"""Statements that draw something else than flat faces."""
_AFTER_LIBRARY = re.compile(r"(?<=\.mtl)[ \t]+", re.IGNORECASE)
"""What stands between the names of material files in one statement; a name may have spaces in it."""
LIBRARY = "//"
"""By which all of them are asked for at once: the name of no file."""
_FILLED = "obj face without vt beside some with, now at vt 0 0"
_SMOOTHED = "obj s (smoothing groups) of faces without normals, which are smooth up to 60 degrees"
_MOST_LIBRARIES = 1000
_MOST_DIGITS = 18
"""Of an index; no file has as many entries."""
_CONTINUED = re.compile(r"^(?![ \t]*#)(?:.*\\\n)+.*", re.MULTILINE)
_CORNER = re.compile(r"(\d+)(?:/(\d*)(?:/(\d*))?)?", re.ASCII)
_Corner = tuple[int, int, int]
"""Indices into the three lists; 0 where there is none."""


class ObjText(NamedTuple):
    """What trimesh is to read, and the names of materials and of the files that they stand in."""

    data: bytes
    libraries: list[str]
    materials: list[str]
    colored: bool
    """Whether vertices have colours. trimesh keeps all their digits only where faces have a material."""
    bare: str
    """The name that faces without a material have where they need one."""


def checked_obj(path: Path, data: bytes, notes: ReadNotes) -> ObjText:
    """Vertices, materials and faces of an OBJ file, one statement a line, the faces in order of their materials.

    Where some faces of a material have texture coordinates, the others get 0 0; normals that not all of them have are
    left out. Both are noted, and smoothing groups of faces without normals. Concave faces, and those with corners on a
    line, are cut into triangles. All material files stand in one, `LIBRARY`.

    Raises:
        SceneFileError: a face has less than three corners, or an index that is no number, 0, or out of range; a vertex,
            normal or texture coordinate has too few numbers, or one that is none, or not finite where it is used; a
            concave face has too many corners; more than 1000 material files are named.
    """
    counts: dict[str, int] = dict.fromkeys(_LISTS, 0)
    vertices: list[str] = []
    faces: dict[str, list[str]] = {}
    first_line: dict[str, dict[str, int]] = {}  # by material and corner
    endless: dict[tuple[str, int], tuple[int, str]] = {}  # by list and index of what is not finite, its line
    has_groups = False
    sizes: dict[str, set[int]] = {name: set() for name in _LISTS}
    libraries: dict[str, None] = {}  # without what is named twice
    material = ""
    positions = array.array("d")
    brightest = 0.0
    for line, statement in enumerate(_lines(text_of(data)), 1):
        keyword, *words = statement.split(None, 1) or ("",)
        rest = words[0].rstrip() if words else ""
        if "#" in rest:
            rest = name_in(rest) if keyword in ("usemtl", "mtllib") else rest.partition("#")[0].rstrip()
        if keyword in counts:
            counts[keyword] += 1
            numbers = _numbers(path, line, keyword, rest)
            size = len(numbers)
            sizes[keyword].add(size)
            if not all(map(math.isfinite, numbers[: _USED[keyword]])):
                endless[keyword, counts[keyword]] = (line, rest[:60])
            if keyword == "v":
                positions.extend(numbers[:3])
                brightest = max([brightest, *numbers[3:6]])
            vertices.append(f"{keyword} {rest}" if size > 1 else f"{keyword} {rest} 0")
        elif keyword in ("f", "fo"):
            corners = rest.split()
            if len(corners) < 3:
                raise SceneFileError(path, line, f"a face has {len(corners)} corners; it needs 3 or more")
            if "-" in rest:
                corners = [_absolute(path, line, corner, counts) for corner in corners]
            faces.setdefault(material, []).append(" ".join(corners))
            lines = first_line.setdefault(material, {})
            for corner in corners:
                if corner not in lines:
                    lines[corner] = line
        elif keyword == "usemtl":
            material = " ".join(rest.split())
        elif keyword == "mtllib":
            libraries |= dict.fromkeys(_AFTER_LIBRARY.split(rest))
            if len(libraries) > _MOST_LIBRARIES:
                raise SceneFileError(path, line, f"names more than {_MOST_LIBRARIES} material files")
        elif keyword == "s":
            has_groups = True
        elif keyword in _SKIPPED:
            notes.skipped[f"obj {keyword}"] += 1
    colored, bare = min(sizes["v"], default=0) >= 6, LIBRARY
    while bare in faces:
        bare += "/"
    if not colored and max(sizes["v"], default=0) >= 6:
        notes.unused["obj colours of vertices, as not all have some"] += 1
    if colored and are_bytes(brightest):
        notes.simplified["obj colours above 2, read as 0 to 255"] += 1
        vertices = [_in_unit_colors(statement) for statement in vertices]
    texts: list[str] = []
    for name, corners_of in faces.items():
        parsed = {corner: _parsed(path, line, corner, counts) for corner, line in first_line[name].items()}
        normals = all(vn for _, _, vn in parsed.values())
        _check_finite(path, parsed, endless, _LISTS if normals else _LISTS[:2])
        if has_groups and not normals:
            notes.unused[_SMOOTHED] += len(corners_of)
        texts += [f"usemtl {name or bare}"] if name or colored else []
        convex = _cut(path, corners_of, parsed, np.frombuffer(positions).reshape(-1, 3), name)
        texts += _alike(convex, parsed, counts["vt"] + 1, name, notes)
    origin = ["vt 0 0"] if notes.simplified[_FILLED] else []
    named = [f"mtllib {LIBRARY}"] if libraries or colored else []
    data = "\n".join([*named, *vertices, *origin, *texts]).encode()
    return ObjText(data, list(libraries), [name for name in faces if name], colored, bare)


def _lines(text: str) -> list[str]:
    """The lines of a text; those that a backslash continues stand in the first of them, and leave empty ones."""
    if "\\\n" in text:
        text = _CONTINUED.sub(lambda found: found[0].replace("\\\n", " ") + "\n" * found[0].count("\\\n"), text)
    return text.split("\n")


def _numbers(path: Path, line: int, keyword: str, rest: str) -> list[float]:
    """Of a vertex, a normal or a texture coordinate."""
    try:
        if "_" in rest or not rest.isascii():  # Python's own ways to write numbers
            raise ValueError
        numbers = [float(word) for word in rest.split()]
    except ValueError:
        raise SceneFileError(path, line, f"a {keyword} has {rest[:60]!r}, expected numbers") from None
    if len(numbers) < _NEEDED[keyword]:
        message = f"a {keyword} has {len(numbers)} numbers, expected {_NEEDED[keyword]} or more"
        raise SceneFileError(path, line, message)
    return numbers


def _check_finite(
    path: Path, corners: dict[str, _Corner], endless: dict[tuple[str, int], tuple[int, str]], used: tuple[str, ...]
) -> None:
    """Refuse corners whose entries of the lists that are used are not finite."""
    if not endless:
        return
    for corner in corners.values():
        for name, index in zip(used, corner, strict=False):
            if (name, index) in endless:
                line, numbers = endless[name, index]
                raise SceneFileError(path, line, f"a {name} has {numbers!r}, expected finite numbers")


def _in_unit_colors(statement: str) -> str:
    """A vertex whose colour is given in 0 to 255, with one in 0 to 1; other statements stay."""
    keyword, *numbers = statement.split()
    if keyword != "v":
        return statement
    return " ".join([keyword, *numbers[:3], *(repr(float(number) / 255.0) for number in numbers[3:6])])


def _absolute(path: Path, line: int, corner: str, counts: dict[str, int]) -> str:
    """The corner with relative indices replaced: -1 is the last entry before the face."""
    fields = corner.split("/")
    for place, (name, field) in enumerate(zip(_LISTS, fields, strict=False)):
        if field.startswith("-") and field[1:].isdecimal():
            index = counts[name] + 1 + int(field[: 1 + _MOST_DIGITS])
            if not 1 <= index <= counts[name]:
                message = f"a face has the {name} index {field[:40]}, but {counts[name]} {name} stand before it"
                raise SceneFileError(path, line, message)
            fields[place] = str(index)
    return "/".join(fields)


def _parsed(path: Path, line: int, corner: str, counts: dict[str, int]) -> _Corner:
    found = _CORNER.fullmatch(corner)
    if found is None:
        raise SceneFileError(path, line, f"a face has the corner {corner[:60]!r}; allowed are v, v/vt, v//vn, v/vt/vn")
    v, vt, vn = (int(field[:_MOST_DIGITS]) if field else 0 for field in found.groups())
    for name, field, index in zip(_LISTS, found.groups(), (v, vt, vn), strict=True):
        if field and not 0 < index <= counts[name]:
            out = f"an index is out of range: a face has the {name} index {field[:40]}, the file {counts[name]} {name}"
            zero = f"a face has the index 0 ({name}); they count from 1"
            raise SceneFileError(path, line, out if index else zero)
    return v, vt, vn


def _cut(path: Path, faces: list[str], corners: dict[str, _Corner], positions: np.ndarray, material: str) -> list[str]:
    """The faces of a material, those cut into triangles that are not fans of some around their first corner."""
    polygons = [(number, own) for number, face in enumerate(faces) if len(own := face.split()) > 3]
    if not polygons:
        return faces
    flat = [corner for _, own in polygons for corner in own]
    read, points = _faces_of([own for _, own in polygons]), positions[[corners[corner][0] - 1 for corner in flat]]
    wanted = are_no_fans(read, points)
    if not np.any(wanted):
        return faces
    chosen = [own for (_, own), is_wanted in zip(polygons, wanted, strict=True) if is_wanted]
    own_corners = [corner for own in chosen for corner in own]
    places = np.repeat(wanted, read.count)
    try:
        triangles = split_concave(_faces_of(chosen), points[places], f"faces of material {material!r}")
    except ValueError as error:
        raise SceneFileError(path, None, str(error)) from None
    cut = {number for (number, _), is_wanted in zip(polygons, wanted, strict=True) if is_wanted}
    return [face for number, face in enumerate(faces) if number not in cut] + [
        " ".join(own_corners[corner] for corner in triangle) for triangle in triangles.tolist()
    ]


def _faces_of(polygons: list[list[str]]) -> Faces:
    """Polygons whose corners are numbered one after the other."""
    count = np.array([len(own) for own in polygons])
    return Faces(np.arange(count.sum()), np.repeat(np.arange(len(count)), count), np.cumsum(count) - count, count)


def _alike(
    faces: list[str], corners: dict[str, _Corner], origin: int, material: str, notes: ReadNotes
) -> Iterator[str]:
    """The faces of a material, the corners of all in the same form; `origin` is the index of a vt 0 0."""
    textured, normals = any(vt for _, vt, _ in corners.values()), all(vn for _, _, vn in corners.values())
    if not normals and any(vn for _, _, vn in corners.values()):
        notes.unused[f"obj normals of {f'material {material}' if material else 'faces'}, as not all have some"] += 1
    bare = {corner for corner, (_, vt, _) in corners.items() if not vt} if textured else set()
    if bare:
        count = sum(not bare.isdisjoint(face.split()) for face in faces)
        notes.simplified[_FILLED] += count
    written: dict[str, str] = {}
    for corner, (v, vt, vn) in corners.items():
        ends = (str(vt or origin) if textured else "", str(vn) if normals else "")
        written[corner] = f"{v}/{ends[0]}/{ends[1]}".rstrip("/")
    same = all(corner == text for corner, text in written.items())
    for face in faces:
        yield f"f {face}" if same else f"f {' '.join(written[corner] for corner in face.split())}"
