"""Which format a file is in, told by its content; the suffix decides only where the content cannot."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from .errors import SceneFileError

Format = Literal["x3d", "glb", "obj", "ply", "stl"]

READABLE = "X3D in its XML encoding (.x3d), glb, obj, ply, stl"

_TOLD_BY_SUFFIX: dict[str, Format] = {".obj": "obj", ".stl": "stl"}
"""Text without a mark at its start, or bytes of any kind."""

# (pattern at the start of the file, what it is; what to do): formats that are recognised, but not read yet.
_NOT_YET = (
    (rb"\x1f\x8b", "a gzip-compressed file (.gz, .x3dz, .x3dvz, .wrz); unpack it first"),
    (rb"#VRML V2\.0", "VRML97 (.wrl)"),
    (rb"#VRML", "VRML 1.0 (.wrl)"),
    (rb"#X3D", "X3D in its classic VRML encoding (.x3dv)"),
    (rb"\xe0\x00\x00\x01|<\?xml[^>]*encoding=['\"]finf['\"]|\$EXI|PK\x03\x04", "binary X3D (.x3db) or an archive"),
    (rb"(?is)(?:<!--.*?-->|\s|<\?xml[^>]*\?>)*+<(!doctype\s+)?html\b", "X3D inside an HTML page"),
    (rb"\s*\{[^\0]{0,4000}?\"X3D\"", "X3D in its JSON encoding (.x3dj, .json)"),
    (rb"\s*\{[^\0]{0,4000}?\"(asset|scenes|accessors)\"", "glTF with separate files (.gltf); pack it as .glb"),
)

_BYTE_ORDER_MARKS = (b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff")
_XML_STARTS = (b"<", "<".encode("utf-16-le"), "<".encode("utf-16-be"))


def detect_format(path: Path, data: bytes) -> Format:
    """The format of a file.

    Raises:
        SceneFileError: an empty file, an encoding that is not read yet (named), or an unknown one.
    """
    suffix = path.suffix.lower()
    start = data[:8192]
    for mark in _BYTE_ORDER_MARKS:
        start = start.removeprefix(mark)
    if not start.strip():
        raise SceneFileError(path, None, "the file is empty")
    for pattern, name in _NOT_YET:
        if re.match(pattern, start):
            kind, _, advice = name.partition("; ")
            message = f"this is {kind}, which jaxlight does not read yet; it reads {READABLE}"
            raise SceneFileError(path, 1, f"{message}; {advice}" if advice else message)
    if start.lstrip().startswith(_XML_STARTS):
        return "x3d"
    if start.startswith(b"glTF"):
        return "glb"
    if start.startswith((b"ply\n", b"ply\r")):
        return "ply"
    if suffix in _TOLD_BY_SUFFIX:
        return _TOLD_BY_SUFFIX[suffix]
    if suffix in (".glb", ".ply", ".x3d"):
        raise SceneFileError(path, 1, f"the content is not {suffix}: it starts with {start[:16]!r}")
    raise SceneFileError(path, None, f"unknown format; jaxlight reads {READABLE}")
