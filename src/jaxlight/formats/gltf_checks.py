"""What a glTF header says that trimesh would take wrongly, leave out or stumble over: refused, or noted."""

from __future__ import annotations

import collections
import math
from pathlib import Path
from typing import Any

import numpy as np

from .errors import SceneFileError
from .mesh_materials import SPECULAR_GLOSSINESS
from .notes import ReadNotes

UNLIT, TRANSFORM = "KHR_materials_unlit", "KHR_texture_transform"
_LIGHTS = "KHR_lights_punctual"
READ_EXTENSIONS = (UNLIT, SPECULAR_GLOSSINESS, TRANSFORM, "EXT_texture_webp")
_SHARED = 4
"""Entries of accessors a byte of the file."""
_MOST_ENTRIES = 2**24
"""Of all primitives together, where primitives share accessors."""
_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_UNREAD_MODES = {2: "LINE_LOOP", 3: "LINE_STRIP", 6: "TRIANGLE_FAN"}
"""Of primitives; others without triangles are noted where they would be placed."""
_MOVES = ("translation", "rotation", "scale", "matrix")


def check_header(path: Path, header: dict[str, Any], size: int, notes: ReadNotes) -> None:
    """Refuse what cannot be read, and note what is not.

    Raises:
        SceneFileError: an extension is needed that is not read; numbers that stand nowhere in the file, or somewhere
            else than is said; a node with a number that is none, or that names what the file has not.
    """
    for name in header.get("extensionsRequired", []):
        if name not in READ_EXTENSIONS:
            message = f"needs the glTF extension {name}, which jaxlight does not read; it reads"
            raise SceneFileError(path, None, f"{message} {', '.join(READ_EXTENSIONS)}")
    counts = [int(accessor["count"]) for accessor in header.get("accessors", [])]
    for row, count in enumerate(counts):
        if count < 0:
            raise SceneFileError(path, None, f"glTF accessor {row} has {count} entries")
    # An entry takes a byte or more; what several accessors read may be the same.
    if sum(counts) > _SHARED * size:
        raise SceneFileError(path, None, f"announces {sum(counts)} entries, far more than its {size} bytes can hold")
    for row, accessor in enumerate(header.get("accessors", [])):
        _check_accessor(path, header, row, accessor)
    for row, mesh in enumerate(header.get("meshes", [])):
        _check_mesh(path, header, row, mesh, notes)
    # A primitive becomes a mesh with numbers of its own, whatever it shares with others.
    primitives = [primitive for mesh in header.get("meshes", []) for primitive in mesh["primitives"]]
    entries = sum(counts[accessor] for primitive in primitives for accessor in _used(primitive))
    if entries > max(_SHARED * size, _MOST_ENTRIES):
        message = (
            f"its primitives have {entries} entries of accessors; of {size} bytes at most {_MOST_ENTRIES} are read"
        )
        raise SceneFileError(path, None, message)
    for row, node in enumerate(header.get("nodes", [])):
        _check_node(path, header, row, node, notes)
    for row, scene in enumerate(header.get("scenes", [])):
        check_rows(path, f"scene {row}", scene.get("nodes", []), header, "nodes")
    for kind in ("animations", "skins", "cameras"):
        if header.get(kind):
            notes.skipped[f"glTF {kind}"] += len(header[kind])
    lights = header.get("extensions", {}).get(_LIGHTS, {}).get("lights", [])
    if lights:
        notes.skipped["glTF lights"] += len(lights)
    used = collections.Counter(name for m in header.get("materials", []) for name in m.get("extensions", {}))
    used.update(name for name in header.get("extensionsUsed", []) if name not in used)
    for name, count in used.items():
        if name not in (*READ_EXTENSIONS, _LIGHTS):
            notes.unused[f"glTF {name}"] += count


def _check_accessor(path: Path, header: dict[str, Any], row: int, accessor: dict[str, Any]) -> None:
    """Whether all of its numbers lie within its view of the buffer."""
    if "bufferView" not in accessor or accessor["componentType"] not in _COMPONENT_BYTES:
        return
    view = header["bufferViews"][accessor["bufferView"]]
    entry = _COMPONENT_BYTES[accessor["componentType"]] * _COMPONENTS[accessor["type"]]
    count, stride = int(accessor["count"]), int(view.get("byteStride", entry))
    needed = int(accessor.get("byteOffset", 0)) + (count - 1) * stride + entry if count else 0
    if needed > int(view["byteLength"]):
        message = f"glTF accessor {row} has {count} entries of {entry} bytes, which end after {needed} bytes; its"
        raise SceneFileError(path, None, f"{message} bufferView has {view['byteLength']}")


def _check_mesh(path: Path, header: dict[str, Any], row: int, mesh: dict[str, Any], notes: ReadNotes) -> None:
    for primitive in mesh["primitives"]:
        mode = primitive.get("mode", 4)
        if mode in _UNREAD_MODES:
            notes.skipped[f"glTF {_UNREAD_MODES[mode]}"] += 1
        used = _used(primitive)
        check_rows(path, f"mesh {row}", used, header, "accessors")
        for accessor in used:
            if "sparse" in header["accessors"][accessor]:
                raise SceneFileError(path, None, f"glTF accessor {accessor} is sparse; jaxlight reads dense ones")
    if any(mesh.get("weights", ())):
        notes.unused["glTF weights of morph targets (read as 0)"] += 1


def _used(primitive: dict[str, Any]) -> list[Any]:
    """The accessors of a primitive."""
    return [*primitive["attributes"].values(), *([primitive["indices"]] if "indices" in primitive else [])]


def _check_node(path: Path, header: dict[str, Any], row: int, node: dict[str, Any], notes: ReadNotes) -> None:
    """What moves to where nothing can be seen is left out."""
    check_rows(path, f"node {row}", node.get("children", []), header, "nodes")
    check_rows(path, f"node {row}", [node["mesh"]] if "mesh" in node else [], header, "meshes")
    if any(node.get("weights", ())):
        notes.unused["glTF weights of morph targets (read as 0)"] += 1
    for field in _MOVES:
        if not all(math.isfinite(number) for number in node.get(field, ())):
            message = f"glTF node {row}: expected finite numbers for its {field}, got {node[field]}"
            raise SceneFileError(path, None, message)
    linear = np.reshape(node["matrix"], (4, 4))[:3, :3] if "matrix" in node else np.diag(node.get("scale", (1, 1, 1)))
    if np.linalg.matrix_rank(linear) < 3:
        notes.simplified["glTF node scaled to nothing, left out with its children"] += 1
        header["nodes"][row] = {}


def check_rows(path: Path, owner: str, rows: list[Any], header: dict[str, Any], kind: str) -> None:
    """Whether the file has what these numbers of accessors, meshes or nodes mean."""
    there = len(header.get(kind, []))
    for row in rows:
        if isinstance(row, bool) or not isinstance(row, int) or not 0 <= row < there:
            message = f"an index is out of range: glTF {owner} has {row!r:.40} of the file's {there} {kind}"
            raise SceneFileError(path, None, message)
