"""IndexedFaceSet, IndexedTriangleSet and TriangleSet as triangles (X3D 11.2.3, 13.3.6, Rendering)."""

from __future__ import annotations

import numpy as np

from ..scene import nodes
from ..scene.indices import check_indices
from ..scene.polygons import Faces, split_concave, split_convex, split_fans
from .normals import crease_normals, vertex_normals
from .triangles import Triangles


def indexed_face_set(node: nodes.IndexedFaceSet, where: str) -> Triangles:
    """Polygons with per-vertex or per-face colours and normals (X3D 13.3.6).

    Index lists that are absent default as the clause says: per vertex to `coordIndex`, per face to 0, 1, 2, ...

    Raises:
        ValueError: an index, or a number of indices, that does not fit; says which field of which shape (`where`).
    """
    check_indices(node, where)
    if node.coord is None:
        return Triangles.none()
    points = node.coord.point
    faces = Faces.read(node.coord_index)
    vertex = node.coord_index[faces.slot]
    corner_points = points[vertex]
    split = (
        split_convex(faces, corner_points)
        if node.convex
        else split_concave(faces, corner_points, f"{where}.coord_index")
    )

    color = normal = None
    if node.color is not None and len(node.color.color):
        index = _attribute_index(node, faces, "color_index", node.color_per_vertex)
        color = node.color.color[index]
    if node.normal is not None and len(node.normal.vector):
        index = _attribute_index(node, faces, "normal_index", node.normal_per_vertex)
        normal = node.normal.vector[index]
    else:
        crease = node.crease_angle if node.normal_per_vertex else 0.0
        normal = crease_normals(faces, vertex, corner_points, crease) * (1.0 if node.ccw else -1.0)
    if node.tex_coord is not None and len(node.tex_coord.point):
        index = _attribute_index(node, faces, "tex_coord_index", True)
        texcoord = node.tex_coord.point[index]
    else:
        texcoord = bounding_box_mapping(corner_points)
    return _triangles(split, corner_points, normal, texcoord, color, ccw=node.ccw)


def triangle_set(node: nodes.IndexedTriangleSet | nodes.TriangleSet, where: str) -> Triangles:
    """Triangles from index triples or from consecutive vertices; a remainder of one or two is ignored (X3D Rendering).

    Attributes belong to vertices; `color_per_vertex` FALSE is ignored, as the clause says. Normals may be one a
    triangle.

    Raises:
        ValueError: an index that does not fit, or too few colours, normals or texture coordinates.
    """
    check_indices(node, where)
    if node.coord is None:
        return Triangles.none()
    points = node.coord.point
    if isinstance(node, nodes.IndexedTriangleSet):
        vertex = node.index[: len(node.index) // 3 * 3]
    else:
        vertex = np.arange(len(points) // 3 * 3)
    faces = Faces.triangles(len(vertex) // 3)
    corner_points = points[vertex]

    color = None
    if node.color is not None and len(node.color.color):
        color = node.color.color[vertex]
    if node.normal is not None and len(node.normal.vector):
        index = vertex if node.normal_per_vertex else faces.face
        normal = node.normal.vector[index]
    else:
        smooth = node.normal_per_vertex and isinstance(node, nodes.IndexedTriangleSet)
        flat = crease_normals(faces, vertex, corner_points, 0.0)
        normal = vertex_normals(faces, vertex, corner_points) if smooth else flat
        normal = normal * (1.0 if node.ccw else -1.0)
    if node.tex_coord is not None and len(node.tex_coord.point):
        texcoord = node.tex_coord.point[vertex]
    else:
        texcoord = bounding_box_mapping(corner_points)
    return _triangles(split_fans(faces), corner_points, normal, texcoord, color, ccw=node.ccw)


def bounding_box_mapping(points: np.ndarray) -> np.ndarray:
    """Default texture coordinates [C, 2] of points [C, 3]: s along the box's longest side from 0 to 1, t along the next
    from 0 to the ratio of the two; among equal sides x before y before z (X3D 13.3.6)."""
    if len(points) == 0:
        return np.zeros((0, 2))
    low = points.min(axis=0)
    size = points.max(axis=0) - low
    s, t = np.argsort(-size, kind="stable")[:2]
    return (points[:, [s, t]] - low[[s, t]]) / (size[s] or 1.0)


def _attribute_index(node: nodes.IndexedFaceSet, faces: Faces, field: str, per_vertex: bool) -> np.ndarray:
    """[C], which colour, normal or texture coordinate each corner takes (X3D 13.3.6)."""
    index = getattr(node, field)
    if per_vertex:
        return (index if len(index) else node.coord_index)[faces.slot]
    return index[faces.face] if len(index) else faces.face


def _triangles(
    split: np.ndarray,
    points: np.ndarray,
    normal: np.ndarray,
    texcoord: np.ndarray,
    color: np.ndarray | None,
    *,
    ccw: bool,
) -> Triangles:
    """Corners gathered by triangle; of clockwise faces the corners are turned round."""
    split = split if ccw else split[:, ::-1]
    return Triangles(points[split], normal[split], texcoord[split], None if color is None else color[split])
