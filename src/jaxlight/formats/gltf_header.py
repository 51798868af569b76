"""The JSON header of a binary glTF file: checked before trimesh reads the file, and the source of exact factors.

trimesh rounds material colours to 8 bits and drops names that repeat, so materials are given their number as name.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

from .errors import SceneFileError
from .notes import ReadNotes

_JSON_CHUNK = 0x4E4F534A
_SHARED = 4
"""Entries of accessors a byte of the file."""
_KNOWN_EXTENSIONS = ("KHR_materials_", "KHR_texture_transform", "KHR_lights_punctual", "EXT_texture_webp")
_UNUSED_TEXTURES = ("normalTexture", "occlusionTexture", "emissiveTexture")


def numbered_materials(path: Path, data: bytes, notes: ReadNotes) -> tuple[bytes, list[dict[str, Any]]]:
    """The file with each material named by its number, and the materials as they stand in the header.

    Raises:
        SceneFileError: the header cannot be read, announces more numbers than a file can hold, or needs an extension
            that is not read.
    """
    if len(data) < 20:
        raise SceneFileError(path, None, "truncated glb: no header")
    _, version, _, length, kind = struct.unpack_from("<5I", data)
    if version != 2 or kind != _JSON_CHUNK or 20 + length > len(data):
        raise SceneFileError(path, None, "not a glTF 2 binary file, or truncated in its header")
    try:
        header = json.loads(data[20 : 20 + length])
        materials = _materials(path, header, len(data), notes)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        if isinstance(error, SceneFileError):
            raise
        raise SceneFileError(path, None, f"malformed glTF header: {type(error).__name__}: {error}") from None
    if materials:
        header["materials"] = [{**material, "name": str(row)} for row, material in enumerate(materials)]
    chunk = json.dumps(header).encode()
    chunk += b" " * (-len(chunk) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4s4I", b"glTF", 2, 20 + len(chunk) + len(rest), len(chunk), _JSON_CHUNK)
    return head + chunk + rest, materials


def _materials(path: Path, header: dict[str, Any], size: int, notes: ReadNotes) -> list[dict[str, Any]]:
    for name in header.get("extensionsRequired", []):
        if not str(name).startswith(_KNOWN_EXTENSIONS):
            raise SceneFileError(path, None, f"needs the glTF extension {name}, which jaxlight does not read")
    counts = [int(accessor["count"]) for accessor in header.get("accessors", [])]
    for row, count in enumerate(counts):
        if count < 0:
            raise SceneFileError(path, None, f"glTF accessor {row} has {count} entries")
    # An entry takes a byte or more; what several accessors read may be the same.
    if sum(counts) > _SHARED * size:
        raise SceneFileError(path, None, f"announces {sum(counts)} entries, far more than its {size} bytes can hold")
    for kind in ("animations", "skins", "cameras"):
        if header.get(kind):
            notes.skipped[f"glTF {kind}"] += len(header[kind])
    lights = header.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    if lights:
        notes.skipped["glTF lights"] += len(lights)
    materials = list(header.get("materials", []))
    for material in materials:
        pbr = material.get("pbrMetallicRoughness", {})
        for texture in (*_UNUSED_TEXTURES, "metallicRoughnessTexture"):
            if texture in material or texture in pbr:
                notes.unused[f"glTF {texture}"] += 1
    return materials
