"""The text of an OBJ file, made ready for trimesh: its indices checked and absolute, the faces of a material alike.

trimesh counts relative indices from the end of the file, takes the form of all faces of a material from one of them,
and drops texture coordinates or normals of all of them where one face has none.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from trimesh.util import decode_text

from .errors import SceneFileError
from .notes import ReadNotes

_LISTS = ("v", "vt", "vn")
"""What the three indices of a corner point into."""
_NEEDED = {"v": 3, "vt": 1, "vn": 3}
"""Numbers that an entry must have; a `vt` with one has 0 as its second."""
_SKIPPED = ("l", "p", "curv", "curv2", "surf")
"""Statements that draw something else than flat faces."""
_AFTER_LIBRARY = re.compile(r"(?<=\.mtl)[ \t]+", re.IGNORECASE)
"""What stands between the names of material files in one statement; a name may have spaces in it."""
BETWEEN_LIBRARIES = "\t"
"""What stands between them in the only statement that is left, of which trimesh asks for all in one."""
_FILLED = "obj face without vt beside some with, now at vt 0 0"
_MOST_LIBRARIES = 1000
_CONTINUED = re.compile(r"^(?![ \t]*#)(?:.*\\\n)+.*", re.MULTILINE)
_CORNER = re.compile(r"(\d+)(?:/(\d*)(?:/(\d*))?)?", re.ASCII)
_Corner = tuple[int, int, int]
"""Indices into the three lists; 0 where there is none."""


def checked_obj(path: Path, data: bytes, notes: ReadNotes) -> bytes:
    """Vertices, materials and faces of an OBJ file, one statement a line, the faces in order of their materials.

    Where some faces of a material have texture coordinates, the others get 0 0; normals that not all of them have are
    left out. Both are noted. Material files that several statements name stand in one.

    Raises:
        SceneFileError: a face has less than three corners, or an index that is no number, 0, or out of range; a vertex,
            normal or texture coordinate has too few numbers; more than 1000 material files are named.
    """
    counts: dict[str, int] = dict.fromkeys(_LISTS, 0)
    vertices: list[str] = []
    faces: dict[str, list[str]] = {}
    first_line: dict[str, dict[str, int]] = {}  # by material and corner
    sizes: dict[str, set[int]] = {name: set() for name in _LISTS}
    libraries: dict[str, None] = {}  # without what is named twice
    material = ""
    for line, statement in enumerate(_lines(decode_text(data)), 1):
        keyword, *words = statement.split(None, 1) or ("",)
        rest = words[0].rstrip() if words else ""
        if "#" in rest and keyword not in ("usemtl", "mtllib"):  # a name may have a # in it
            rest = rest.partition("#")[0].rstrip()
        if keyword in counts:
            counts[keyword] += 1
            size = len(rest.split())
            sizes[keyword].add(size)
            if size < _NEEDED[keyword]:
                message = f"a {keyword} has {size} numbers, expected {_NEEDED[keyword]} or more"
                raise SceneFileError(path, line, message)
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
            material = rest
        elif keyword == "mtllib":
            libraries |= dict.fromkeys(_AFTER_LIBRARY.split(rest))
            if len(libraries) > _MOST_LIBRARIES:
                raise SceneFileError(path, line, f"names more than {_MOST_LIBRARIES} material files")
        elif keyword in _SKIPPED:
            notes.skipped[f"obj {keyword}"] += 1
    if sizes["v"] and min(sizes["v"]) < 6 <= max(sizes["v"]):
        notes.unused["obj colours of vertices, as not all have some"] += 1
    texts: list[str] = []
    for name, corners_of in faces.items():
        parsed = {corner: _parsed(path, line, corner, counts) for corner, line in first_line[name].items()}
        texts += [f"usemtl {name}"] if name else []
        texts += _alike(corners_of, parsed, counts["vt"] + 1, name, notes)
    origin = ["vt 0 0"] if notes.simplified[_FILLED] else []
    named = [f"mtllib {BETWEEN_LIBRARIES.join(libraries)}"] if libraries else []
    return "\n".join([*named, *vertices, *origin, *texts]).encode()


def _lines(text: str) -> list[str]:
    """The lines of a text; those that a backslash continues stand in the first of them, and leave empty ones."""
    text = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    if "\\\n" in text:
        text = _CONTINUED.sub(lambda found: found[0].replace("\\\n", " ") + "\n" * found[0].count("\\\n"), text)
    return text.split("\n")


def _absolute(path: Path, line: int, corner: str, counts: dict[str, int]) -> str:
    """The corner with relative indices replaced: -1 is the last entry before the face."""
    fields = corner.split("/")
    for place, (name, field) in enumerate(zip(_LISTS, fields, strict=False)):
        if field.startswith("-") and field[1:].isdecimal():
            index = counts[name] + 1 + int(field)
            if not 1 <= index <= counts[name]:
                message = f"a face has the {name} index {field}, but {counts[name]} {name} stand before it"
                raise SceneFileError(path, line, message)
            fields[place] = str(index)
    return "/".join(fields)


def _parsed(path: Path, line: int, corner: str, counts: dict[str, int]) -> _Corner:
    found = _CORNER.fullmatch(corner)
    if found is None:
        raise SceneFileError(path, line, f"a face has the corner {corner[:60]!r}; allowed are v, v/vt, v//vn, v/vt/vn")
    v, vt, vn = (int(field) if field else 0 for field in found.groups())
    for name, field, index in zip(_LISTS, found.groups(), (v, vt, vn), strict=True):
        if field and not 0 < index <= counts[name]:
            out = f"an index is out of range: a face has the {name} index {field}, the file {counts[name]} {name}"
            zero = f"a face has the index 0 ({name}); they count from 1"
            raise SceneFileError(path, line, out if index else zero)
    return v, vt, vn


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
