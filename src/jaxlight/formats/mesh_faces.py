"""A mesh that trimesh read -> an IndexedFaceSet: triangles with shared positions, and what its corners have besides."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..scene import nodes
from ..scene.indices import check_indices
from .gltf_header import GltfMaterial
from .levels import are_bytes
from .notes import ROUNDED, ReadNotes

_WHITE = {"u2": 65535, "f2": 1, "f4": 1, "f8": 1}
"""What is white in a ply, by NumPy's names of types; of other integers 255 is."""
CREASE_ANGLE = np.pi / 3
"""Radians. Meshes without normals are smooth up to this angle between faces: curved surfaces are, boxes are not."""


def face_set(mesh: Any, material: GltfMaterial | None, notes: ReadNotes, *, solid: bool) -> nodes.IndexedFaceSet:
    """Triangles with shared positions: where a file repeats a vertex for the sake of texture or normal, one is kept."""
    faces = np.asarray(mesh.faces, dtype=np.int64)
    if faces.min() < 0:
        raise ValueError(f"a face has the index {faces.min()}")
    positions, position_of = _distinct_rows(np.asarray(mesh.vertices, dtype=np.float64))
    repeated = len(positions) < len(position_of)
    corners = _with_ends(faces)
    options: dict[str, Any] = {}

    def per_vertex(field: str, node: nodes.Node) -> None:
        options[field] = node
        if repeated:
            options[f"{field}_index"] = corners

    uv = getattr(mesh.visual, "uv", None)
    if uv is not None and np.shape(uv) == (len(position_of), 2):
        uv = np.asarray(uv, dtype=np.float64)
        per_vertex("tex_coord", nodes.TextureCoordinate(point=uv if material is None else material.texcoord(uv)))
    if "vertex_normals" in mesh._cache:  # only there if the file had them
        per_vertex("normal", nodes.Normal(vector=np.asarray(mesh.vertex_normals, dtype=np.float64)))
    else:
        options["crease_angle"] = CREASE_ANGLE
    _note_lost(mesh, notes)
    colors, on_faces = _colors(mesh, material, notes)
    if colors is not None and on_faces and len(colors.color) != len(faces):
        notes.unused["ply colours of faces that have more than three corners"] += 1
    elif colors is not None and on_faces:
        options |= {"color": colors, "color_per_vertex": False}
    elif colors is not None:
        per_vertex("color", colors)
    geometry = nodes.IndexedFaceSet(
        coord=nodes.Coordinate(point=positions),
        coord_index=_with_ends(position_of[faces]) if repeated else corners,
        solid=solid,
        **options,
    )
    check_indices(geometry)
    return geometry


def _colors(
    mesh: Any, material: GltfMaterial | None, notes: ReadNotes
) -> tuple[nodes.Color | nodes.ColorRGBA | None, bool]:
    """The colours of vertices or faces, and whether they are of faces; RGB if all are opaque, or count as such.

    Those of a glTF scale its material. White ones leave it as it is: they are left out, so that it can be fitted.
    """
    kind = mesh.visual.kind
    on_faces = False
    if kind in ("vertex", "face"):
        on_faces = kind == "face"
        colors = _colors_of_ply(mesh, kind, len(mesh.faces) if on_faces else len(mesh.vertices), notes)
        if colors is None:
            colors = mesh.visual.face_colors if on_faces else mesh.visual.vertex_colors
    else:
        beside = _colors_beside_texture(mesh)
        if len(beside.get("vertices", ())) == len(mesh.vertices):
            colors = beside["vertices"]
        elif len(beside.get("faces", ())) == len(mesh.faces):
            colors, on_faces = beside["faces"], True
        else:
            return None, False
    colors = np.asarray(colors)
    largest = np.iinfo(colors.dtype).max if np.issubdtype(colors.dtype, np.integer) else 1.0
    values = colors.astype(np.float64) / largest
    if np.min(values, initial=0.0) < -ROUNDED or np.max(values, initial=0.0) > 1.0 + ROUNDED:
        notes.clamped.append(f"colours of {'faces' if on_faces else 'vertices'} ({values.min():g} to {values.max():g})")
    values = np.clip(values, 0.0, 1.0)
    if (material is not None and material.is_opaque) or np.all(values[:, 3:] == 1.0):
        values = values[:, :3]
    if material is not None:
        if np.all(values == 1.0):
            return None, on_faces
        values = material.painted(values)
    return (nodes.ColorRGBA if values.shape[1] == 4 else nodes.Color)(color=values), on_faces


def _colors_of_ply(mesh: Any, element: str, count: int, notes: ReadNotes) -> np.ndarray | None:
    """Colours [count, 3 or 4] as the file has them, which trimesh cuts to 8 bits; None if there are not so many."""
    data = mesh.metadata.get("_ply_raw", {}).get(element, {}).get("data")
    if data is None:
        return None
    there = set(data if isinstance(data, dict) else data.dtype.names or ())
    if not {"red", "green", "blue"} <= there:
        return None
    columns = [np.ravel(data[name]) for name in ("red", "green", "blue", "alpha") if name in there]
    if any(column.shape != (count,) for column in columns):
        return None
    largest = [_WHITE.get(column.dtype.str.lstrip("<>|="), 255) for column in columns]
    colors = np.stack([column.astype(np.float64) / own for column, own in zip(columns, largest, strict=True)], axis=1)
    of_floats = [place for place, column in enumerate(columns) if column.dtype.kind == "f"]
    if are_bytes(np.max(colors[:, of_floats], initial=0)):
        notes.simplified["ply colours above 2, read as 0 to 255"] += 1
        colors[:, of_floats] /= 255.0
    return colors


def _colors_beside_texture(mesh: Any) -> dict[str, Any]:
    """Colours of the vertices or faces of a mesh that has texture coordinates too, where trimesh leaves them."""
    found = {
        "vertices": getattr(mesh.visual, "vertex_attributes", {}).get("color", mesh.vertex_attributes.get("color")),
        "faces": mesh.face_attributes.get("color"),
    }
    return {name: colors for name, colors in found.items() if colors is not None}


def _note_lost(mesh: Any, notes: ReadNotes) -> None:
    """Note what a ply has for vertices or faces that trimesh repeated or divided, and which no longer fits them."""
    beside, raw = _colors_beside_texture(mesh), mesh.metadata.get("_ply_raw", {})
    for name, count in (("vertices", len(mesh.vertices)), ("faces", len(mesh.faces))):
        if len(beside.get(name, ())) not in (0, count):
            notes.unused[f"ply colours of {name} beside texture coordinates"] += 1
    if "nx" in raw.get("vertex", {}).get("properties", {}) and "vertex_normals" not in mesh._cache:
        notes.unused["ply normals of vertices beside texture coordinates of faces"] += 1


def _with_ends(triangles: np.ndarray) -> np.ndarray:
    """Index triples [n, 3] as X3D writes faces: -1 after each."""
    return np.hstack([triangles, np.full((len(triangles), 1), -1)]).ravel()


def _distinct_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distinct rows in order of first appearance, and for each row which of them it is."""
    distinct, first, inverse = np.unique(rows + 0.0, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return distinct[order], rank[inverse.ravel()]
