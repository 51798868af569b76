"""What a glTF header says that trimesh would take wrongly, leave out or stumble over: refused, or noted."""

from __future__ import annotations

import collections
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .errors import SceneFileError
from .folder import ResourceFolder
from .gltf_schema import COMPONENT_BYTES, COMPONENTS, LIGHTS, TRANSFORM, UNLIT, check_types
from .limits import MAX_FILE_BYTES
from .mesh_materials import SPECULAR_GLOSSINESS
from .notes import ROUNDED, ReadNotes

READ_EXTENSIONS = (UNLIT, SPECULAR_GLOSSINESS, TRANSFORM, "EXT_texture_webp")
_SHARED = 4
"""Entries of accessors a byte of the file."""
_MOST_ENTRIES = 2**24
"""Of all primitives together, where primitives share accessors."""
_TRIANGLES, _TRIANGLE_STRIP = 4, 5
_OTHER_MODES = {0: "POINTS", 1: "LINES", 2: "LINE_LOOP", 3: "LINE_STRIP", 6: "TRIANGLE_FAN"}
"""Of primitives; they are not read."""
_TYPES = {"POSITION": ("VEC3",), "NORMAL": ("VEC3",), "TEXCOORD": ("VEC2",), "COLOR": ("VEC3", "VEC4")}
"""Of attributes, by their names without the number of the set."""
FLOAT = 5126
_ROWS = {
    "accessors": {"bufferView": "bufferViews"},
    "bufferViews": {"buffer": "buffers"},
    "images": {"bufferView": "bufferViews"},
    "nodes": {"mesh": "meshes"},
    "textures": {"sampler": "samplers", "source": "images"},
}
"""What the entries of a list name by its number in another list."""
_UNIT_FACTORS = {
    "baseColorFactor", "diffuseFactor", "emissiveFactor", "glossinessFactor", "metallicFactor", "roughnessFactor",
    "specularFactor",
}  # fmt: skip


def check_header(path: Path, header: dict[str, Any], size: int, held: int, notes: ReadNotes) -> None:
    """Refuse what cannot be read, and note what is not.

    Args:
        path: of the file.
        header: of which factors are clamped here, and primitives without triangles, nodes scaled to nothing and cameras
            are taken out.
        size: bytes of the file.
        held: those of them that stand behind the header.
        notes: gets what is not read.

    Raises:
        SceneFileError: a version or an extension is needed that is not read; values of other types than glTF states;
            numbers that stand nowhere in the file, or somewhere else than is said; names of what the file has not.
    """
    check_types(path, header)
    _check_version(path, header.get("asset", {}))
    for name in header.get("extensionsRequired", []):
        if name not in READ_EXTENSIONS:
            message = f"needs the glTF extension {name}, which jaxlight does not read; it reads"
            raise SceneFileError(path, None, f"{message} {', '.join(READ_EXTENSIONS)}")
    size += sum(min(own["byteLength"], MAX_FILE_BYTES) for own in header.get("buffers", []) if _is_beside(own))
    # An entry takes a byte or more; what several accessors read may be the same.
    entries = sum(accessor["count"] for accessor in header.get("accessors", []))
    if entries > _SHARED * size:
        raise SceneFileError(path, None, f"announces {entries} entries, far more than its {size} bytes can hold")
    for kind, fields in _ROWS.items():
        for row, entry in enumerate(header.get(kind, [])):
            for field, named in fields.items():
                check_rows(path, f"{kind[:-1]} {row}", [entry[field]] if field in entry else [], header, named)
    _check_buffers(path, header, held)
    for row, accessor in enumerate(header.get("accessors", [])):
        _check_accessor(path, header, row, accessor)
    _check_meshes(path, header, size, notes)
    for row, node in enumerate(header.get("nodes", [])):
        _check_node(path, header, row, node, notes)
    _check_parents(path, header.get("nodes", []))
    for row, scene in enumerate(header.get("scenes", [])):
        check_rows(path, f"scene {row}", scene.get("nodes", []), header, "nodes")
    if not header.get("scenes"):
        raise SceneFileError(path, None, "glTF without scenes: nothing says which of its nodes are shown")
    check_rows(path, "header", [header.get("scene", 0)], header, "scenes")
    _mend_materials(header, notes)
    _note_others(header, notes)


def _check_version(path: Path, asset: dict[str, Any]) -> None:
    """A later version 2.x may be read by what reads 2.0, unless it says otherwise."""
    version, needed = asset.get("version", "2.0"), asset.get("minVersion", "2.0")
    if not re.fullmatch(r"2\.\d+", version):
        raise SceneFileError(path, None, f"glTF of version {version:.40}; jaxlight reads 2.0")
    if needed != "2.0":
        raise SceneFileError(path, None, f"needs a reader of glTF {needed:.40}; jaxlight reads 2.0")


def _is_beside(buffer: dict[str, Any]) -> bool:
    """Whether a buffer has a file of its own."""
    return not buffer.get("uri", "data:").startswith("data:")


def _check_buffers(path: Path, header: dict[str, Any], held: int) -> None:
    """Whether buffers are as long as they say, and views lie in them; the first may stand behind the header."""
    buffers = header.get("buffers", [])
    for row, buffer in enumerate(buffers):
        if row and "uri" not in buffer:
            raise SceneFileError(path, None, f"glTF buffer {row} has no uri; only buffer 0 may stand in a glb file")
        there = _bytes_at(path, buffer["uri"]) if "uri" in buffer else held
        if there is not None and buffer["byteLength"] > there:
            file = f"{buffer['uri']!r:.60}" if _is_beside(buffer) else "the file"
            message = f"glTF buffer {row} has {buffer['byteLength']} bytes, {file} holds {there} of them: truncated?"
            raise SceneFileError(path, None, message)
    for row, view in enumerate(header.get("bufferViews", [])):
        end, whole = view.get("byteOffset", 0) + view["byteLength"], buffers[view["buffer"]]["byteLength"]
        if end > whole:
            raise SceneFileError(path, None, f"glTF bufferView {row} ends after {end} bytes; its buffer has {whole}")


def _bytes_at(path: Path, uri: str) -> int | None:
    """How many bytes a buffer's uri gives, at most; None: none can be had, as is said where they are read."""
    _, mark, encoded = uri.partition("base64,")
    if mark:
        return len(encoded.rstrip("=")) * 3 // 4
    try:
        return ResourceFolder(path).find(uri).stat().st_size
    except (OSError, ValueError):
        return None


def _check_accessor(path: Path, header: dict[str, Any], row: int, accessor: dict[str, Any]) -> None:
    """Whether all of its numbers lie within its view of the buffer, one entry behind the other."""
    if "bufferView" not in accessor:
        return
    view = header["bufferViews"][accessor["bufferView"]]
    entry = COMPONENT_BYTES[accessor["componentType"]] * COMPONENTS[accessor["type"]]
    count, stride = accessor["count"], view.get("byteStride", entry)
    if stride < entry:
        message = f"glTF accessor {row} has entries of {entry} bytes; its bufferView has a byteStride of {stride}"
        raise SceneFileError(path, None, message)
    needed = accessor.get("byteOffset", 0) + (count - 1) * stride + entry if count else 0
    if needed > view["byteLength"]:
        message = f"glTF accessor {row} has {count} entries of {entry} bytes, which end after {needed} bytes; its"
        raise SceneFileError(path, None, f"{message} bufferView has {view['byteLength']}")


def _with_triangles(primitives: list[dict[str, Any]], notes: ReadNotes) -> Iterator[tuple[int, dict[str, Any]]]:
    """The primitives that are read, and their numbers; notes get the others."""
    for number, primitive in enumerate(primitives):
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _TRIANGLE_STRIP):
            notes.skipped[f"glTF {_OTHER_MODES.get(mode, f'mode {mode}')}"] += 1
        elif "POSITION" not in primitive["attributes"]:
            notes.skipped["glTF primitive without POSITION"] += 1
        else:
            yield number, primitive


def _check_meshes(path: Path, header: dict[str, Any], size: int, notes: ReadNotes) -> None:
    """Primitives that are not read are left out. A file has `size` bytes, and so have those beside it."""
    meshes = header.get("meshes", [])
    for row, mesh in enumerate(meshes):
        read = dict(_with_triangles(mesh["primitives"], notes))
        mesh["primitives"] = list(read.values())
        _check_mesh(path, header, row, mesh, notes)
        for number, primitive in read.items():
            _check_triangles(path, header, f"glTF mesh {row}", number, primitive)
    # A primitive becomes a mesh with numbers of its own, whatever it shares with others.
    used = [accessor for mesh in meshes for primitive in mesh["primitives"] for accessor in _used(primitive)]
    entries = sum(header["accessors"][accessor]["count"] for accessor in used)
    if entries > max(_SHARED * size, _MOST_ENTRIES):
        message = f"its primitives have {entries} entries of accessors; of {size} bytes at most"
        raise SceneFileError(path, None, f"{message} {_MOST_ENTRIES} are read")


def _check_mesh(path: Path, header: dict[str, Any], row: int, mesh: dict[str, Any], notes: ReadNotes) -> None:
    for primitive in mesh["primitives"]:
        used = _used(primitive)
        check_rows(path, f"mesh {row}", used, header, "accessors")
        material = [primitive["material"]] if "material" in primitive else []
        check_rows(path, f"mesh {row}", material, header, "materials")
        for accessor in used:
            if "sparse" in header["accessors"][accessor]:
                raise SceneFileError(path, None, f"glTF accessor {accessor} is sparse; jaxlight reads dense ones")
    if any(mesh.get("weights", ())):
        notes.unused["glTF weights of morph targets (read as 0)"] += 1


def _check_triangles(path: Path, header: dict[str, Any], owner: str, number: int, primitive: dict[str, Any]) -> None:
    """Whether the accessors of a primitive are of the kinds that their use asks for, those of vertices of one size
    (glTF 2.0, 3.7.2.1), and triangles have all corners."""
    corners = header["accessors"][primitive["attributes"]["POSITION"]]
    if corners["type"] in _TYPES["POSITION"] and corners["count"] == 0:
        raise SceneFileError(path, None, f"{owner} has a POSITION without entries")
    for name, row in primitive["attributes"].items():
        accessor, allowed = header["accessors"][row], _TYPES.get(name.partition("_")[0])
        if allowed is None:
            continue
        if accessor["type"] not in allowed:
            message = f"{owner} has a {name} of {accessor['type']}, expected {' or '.join(allowed)}"
            raise SceneFileError(path, None, message)
        if accessor["count"] != corners["count"]:
            message = f"{owner}, primitive {number}, has {accessor['count']} entries of {name} for {corners['count']}"
            raise SceneFileError(path, None, f"{message} of POSITION")
    if "indices" in primitive:
        corners = header["accessors"][primitive["indices"]]
        if corners["type"] != "SCALAR":
            raise SceneFileError(path, None, f"{owner} has indices of {corners['type']}, expected SCALAR")
        if corners["componentType"] == FLOAT:
            raise SceneFileError(path, None, f"{owner} has indices of floats, expected integers")
    if primitive.get("mode", _TRIANGLES) == _TRIANGLES and corners["count"] % 3:
        raise SceneFileError(path, None, f"{owner} has {corners['count']} corners of triangles; each needs 3")


def _used(primitive: dict[str, Any]) -> list[Any]:
    """The accessors of a primitive."""
    return [*primitive["attributes"].values(), *([primitive["indices"]] if "indices" in primitive else [])]


def _check_node(path: Path, header: dict[str, Any], row: int, node: dict[str, Any], notes: ReadNotes) -> None:
    """What moves to where nothing can be seen is left out, and so are cameras: trimesh skips what else a node has."""
    node.pop("camera", None)
    check_rows(path, f"node {row}", node.get("children", []), header, "nodes")
    if any(node.get("weights", ())):
        notes.unused["glTF weights of morph targets (read as 0)"] += 1
    matrix = np.diag([*node.get("scale", (1, 1, 1)), 1]).astype(np.float64)
    if "matrix" in node:
        matrix = np.asarray(node["matrix"], dtype=np.float64).reshape(4, 4).T
    if np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        notes.simplified["glTF node scaled to nothing, left out with its children"] += 1
        header["nodes"][row] = {}
    elif not np.allclose(matrix[3], (0, 0, 0, 1), rtol=0, atol=ROUNDED):
        message = f"glTF node {row} has a matrix of last row {matrix[3].tolist()}, expected [0, 0, 0, 1]"
        raise SceneFileError(path, None, message)


def _check_parents(path: Path, nodes: list[dict[str, Any]]) -> None:
    """Whether the nodes are trees (glTF 2.0, 3.5.2): their ways from the top are as many as they are."""
    parents: dict[int, int] = {}
    for row, node in enumerate(nodes):
        for child in node.get("children", []):
            if child in parents:
                message = f"glTF node {child} is a child of node {parents[child]} and of node {row}"
                raise SceneFileError(path, None, f"{message}; a node has one parent at most")
            parents[child] = row
    done: set[int] = set()
    for row in parents:
        below: set[int] = set()
        while row in parents and row not in done:
            if row in below:
                raise SceneFileError(path, None, f"glTF node {row} stands below itself")
            below.add(row)
            row = parents[row]
        done |= below


def _mend_materials(header: dict[str, Any], notes: ReadNotes) -> None:
    """Ways of alpha that glTF does not know become its default, and factors are clamped."""
    for row, material in enumerate(header.get("materials", [])):
        if material.get("alphaMode", "OPAQUE") not in ("OPAQUE", "MASK", "BLEND"):
            notes.simplified[f"glTF alphaMode {material.pop('alphaMode'):.40} (read as OPAQUE)"] += 1
        if material.get("alphaMode") == "MASK":
            notes.unused["glTF alphaMode MASK (read as BLEND)"] += 1
        _clamp_factors(f"glTF materials[{row}]", material, notes)


def _note_others(header: dict[str, Any], notes: ReadNotes) -> None:
    """What the whole file has and jaxlight does not read."""
    for kind in ("animations", "skins", "cameras"):
        if header.get(kind):
            notes.skipped[f"glTF {kind}"] += len(header[kind])
    lights = header.get("extensions", {}).get(LIGHTS, {}).get("lights", [])
    if lights:
        notes.skipped["glTF lights"] += len(lights)
    used = collections.Counter(name for m in header.get("materials", []) for name in m.get("extensions", {}))
    used.update(name for name in header.get("extensionsUsed", []) if name not in used)
    for name, count in used.items():
        if name not in (*READ_EXTENSIONS, LIGHTS):
            notes.unused[f"glTF {name}"] += count


def _clamp_factors(where: str, owner: dict[str, Any], notes: ReadNotes) -> None:
    """Bring the factors of a material into [0, 1]."""
    for name, value in owner.items():
        if name in _UNIT_FACTORS:
            owner[name] = np.clip(np.asarray(value, dtype=np.float64), 0.0, 1.0).tolist()
            if not np.allclose(owner[name], value, rtol=0, atol=ROUNDED):
                notes.clamped.append(f"{where}.{name}")
        elif name in ("pbrMetallicRoughness", "extensions", SPECULAR_GLOSSINESS):
            _clamp_factors(f"{where}.{name}", value, notes)


def check_rows(path: Path, owner: str, rows: list[Any], header: dict[str, Any], kind: str) -> None:
    """Whether the file has what these numbers of accessors, meshes or nodes mean."""
    there = len(header.get(kind, []))
    for row in rows:
        if isinstance(row, bool) or not isinstance(row, int) or not 0 <= row < there:
            message = f"an index is out of range: glTF {owner} has {row!r:.40} of the file's {there} {kind}"
            raise SceneFileError(path, None, message)
