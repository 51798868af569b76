"""Do the indices of a geometry fit the lists that they point into? (X3D Rendering and 13.3.6)"""

from __future__ import annotations

import numpy as np

from . import nodes


def check_indices(geometry: nodes.Node, where: str = "") -> None:
    """Check what is drawn of a geometry node: one or two corners too many of triangles are ignored, and so are indices
    beyond the last face. Nodes of other kinds pass, and so do those without coordinates.

    Raises:
        ValueError: an index beyond the end of its list, or a list that is too short; says which field of the geometry
            (`where`; empty: its label) and numbers.
    """
    if getattr(geometry, "coord", None) is None:
        return
    where = where or geometry.label
    if isinstance(geometry, nodes.IndexedFaceSet):
        _check_face_set(geometry, where)
    elif isinstance(geometry, nodes.IndexedTriangleSet):
        if np.any(geometry.index < 0):
            raise ValueError(f"{where}.index: expected indices >= 0, got {geometry.index.min()}")
        triangles = len(geometry.index) // 3
        _check_triangles(geometry, where, "index", geometry.index[: 3 * triangles], triangles)
    elif isinstance(geometry, nodes.TriangleSet):
        triangles = 0 if geometry.coord is None else len(geometry.coord.point) // 3
        _check_triangles(geometry, where, "coord", np.arange(3 * triangles), triangles)


def _check_triangles(
    geometry: nodes.IndexedTriangleSet | nodes.TriangleSet, where: str, field: str, corners: np.ndarray, triangles: int
) -> None:
    """Vertex data is taken by the same index as the coordinates; normals may be one a triangle."""
    for name, values, per_vertex in _lists(geometry):
        if per_vertex:
            _check_within(f"{where}.{field}", corners, len(values), name)
        else:
            _check_enough(where, triangles, "triangles", len(values), name)


def _check_face_set(geometry: nodes.IndexedFaceSet, where: str) -> None:
    """Each list of vertex data has an index of its own; without one the coordinates' is used, or one a face."""
    corners = geometry.coord_index
    ends = corners == -1
    open_end = int(len(corners) > 0 and not ends[-1])
    faces = int(np.count_nonzero(ends)) + open_end
    for name, values, per_vertex in _lists(geometry):
        if name == "coord":
            _check_within(f"{where}.coord_index", corners, len(values), name)
            continue
        field = f"{name}_index"
        index = getattr(geometry, field)
        if per_vertex:
            own = len(index) > 0
            used = f"{where}.{field if own else 'coord_index'}"
            _check_within(used, index if own else corners, len(values), name)
            if own and not _same_faces(corners, index):
                raise ValueError(f"{where}.{field}: expected -1 in the same places as in coord_index")
        elif len(index) > 0:
            if len(index) < faces or np.any(index[:faces] < 0):
                raise ValueError(f"{where}.{field}: expected an index >= 0 for each of {faces} faces, got {len(index)}")
            _check_within(f"{where}.{field}", index[:faces], len(values), name)
        else:
            _check_enough(where, faces, "faces", len(values), name)


def _same_faces(corners: np.ndarray, index: np.ndarray) -> bool:
    """True if the index ends its faces where `corners` does; the last -1 may be left out, more may follow."""
    corners = corners[:-1] if len(corners) and corners[-1] == -1 else corners
    return len(index) >= len(corners) and np.array_equal(index[: len(corners)] < 0, corners < 0)


def _lists(geometry: nodes.Node) -> list[tuple[str, np.ndarray, bool]]:
    """(field, values, one a vertex?) of the lists that a geometry has; an empty list counts as absent.

    Colours of triangle sets belong to vertices, whatever `color_per_vertex` says (X3D IndexedTriangleSet).
    """
    triangles, found = not isinstance(geometry, nodes.IndexedFaceSet), []
    for name, values_name, switch in (
        ("coord", "point", None),
        ("color", "color", "color_per_vertex"),
        ("normal", "vector", "normal_per_vertex"),
        ("tex_coord", "point", None),
    ):
        node = getattr(geometry, name)
        if node is not None and (name == "coord" or len(getattr(node, values_name))):
            per_vertex = switch is None or getattr(geometry, switch) or (triangles and name == "color")
            found.append((name, getattr(node, values_name), per_vertex))
    return found


def _check_within(where: str, index: np.ndarray, length: int, name: str) -> None:
    if len(index) and index.max() >= length:
        raise ValueError(f"{where}: index {index.max()}, but {name} has {length} entries")


def _check_enough(where: str, needed: int, what: str, length: int, name: str) -> None:
    if length < needed:
        raise ValueError(f"{where}.{name}: {length} entries for {needed} {what}")
