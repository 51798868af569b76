"""Normals for faces that come without: flat, or smooth across edges below the crease angle (X3D 11.2.3, 13.3.6)."""

from __future__ import annotations

import numpy as np

from ..scene.flatness import FLAT
from ..scene.polygons import Faces, face_normals

_MOST_FACES = 32
"""Of the faces that share an edge so many are compared with each: surfaces have two, and few have a fin."""


def crease_normals(faces: Faces, vertex: np.ndarray, points: np.ndarray, crease_angle: float) -> np.ndarray:
    """Normals [C, 3] at the corners: smooth across an edge where the two faces' normals differ by less than the angle.

    The faces around a vertex that are joined by smooth edges share one normal there: the mean of their unit normals
    (the clause leaves the weights open; IndexedTriangleSet and the browsers average). A face without area has none,
    and joins no others.

    Args:
        faces: the polygons.
        vertex: [C], the index of each corner's vertex; faces are neighbours where they share an edge's two vertices.
        points: [C, 3], the corners.
        crease_angle: radians.
    """
    unit = _unit_normals(faces, points)
    if crease_angle <= 0 or len(points) == 0:
        return unit[faces.face]
    return _shared(faces, unit, _smooth_groups(faces, vertex, unit, crease_angle))


def vertex_normals(faces: Faces, vertex: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Normals [C, 3]: at each vertex the mean of the unit normals of all faces that share it (X3D Rendering)."""
    return _shared(faces, _unit_normals(faces, points), vertex)


def _unit_normals(faces: Faces, points: np.ndarray) -> np.ndarray:
    """[F, 3], 0 for faces whose area is nothing but rounding."""
    normals = face_normals(faces, points)
    length = np.linalg.norm(normals, axis=1)
    longest = np.zeros(len(length))
    np.maximum.at(longest, faces.face, np.linalg.norm(points[faces.following] - points, axis=1))
    return normals / np.where(length > FLAT * longest**2, length, np.inf)[:, None]


def _shared(faces: Faces, unit: np.ndarray, group: np.ndarray) -> np.ndarray:
    """[C, 3], the mean of the unit face normals over each group of corners, normalised."""
    own = unit[faces.face]
    # A face counts once, however many of its corners stand at the vertex.
    once = np.zeros(len(group))
    once[np.unique(group.astype(np.int64) * len(unit) + faces.face, return_index=True)[1]] = 1
    sums = np.stack([np.bincount(group, once * own[:, axis]) for axis in range(3)], axis=1)[group]
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    # Faces that cancel out (a sheet folded upon itself) keep their own normals.
    return np.where(length > 1e-9, sums / np.maximum(length, 1e-9), own)


def _smooth_groups(faces: Faces, vertex: np.ndarray, unit: np.ndarray, crease_angle: float) -> np.ndarray:
    """[C], a number for each set of corners that share a normal: same vertex, joined through smooth edges."""
    corner = np.arange(len(vertex))
    low, high = np.minimum(vertex, vertex[faces.following]), np.maximum(vertex, vertex[faces.following])
    order = np.lexsort((corner, high, low))
    a, b = _pairs_of_equals(low[order], high[order])
    a, b = order[a], order[b]
    differ = low[a] != high[a]
    a, b = a[differ], b[differ]
    ua, ub = unit[faces.face[a]], unit[faces.face[b]]
    angle = np.arctan2(np.linalg.norm(np.cross(ua, ub), axis=1), np.einsum("ij,ij->i", ua, ub))
    have_area = np.any(ua != 0, axis=1) & np.any(ub != 0, axis=1)
    smooth = have_area & (angle < crease_angle)
    a, b = a[smooth], b[smooth]
    # Both ends of the edge: corners of the two faces at the edge's low vertex, and at its high vertex.
    next_a, next_b = faces.following[a], faces.following[b]
    same_way = vertex[a] == vertex[b]
    repeated = np.flatnonzero(vertex == vertex[faces.following])
    pairs = np.concatenate(
        [
            np.stack([a, np.where(same_way, b, next_b)]),
            np.stack([next_a, np.where(same_way, next_b, b)]),
            np.stack([repeated, faces.following[repeated]]),
        ],
        axis=1,
    )
    return _components(len(vertex), pairs)


def _pairs_of_equals(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All pairs of places with equal numbers, which stand side by side; at most _MOST_FACES places apart."""
    first, second = [], []
    for apart in range(1, min(len(low), _MOST_FACES + 1)):
        equal = np.flatnonzero((low[apart:] == low[:-apart]) & (high[apart:] == high[:-apart]))
        if len(equal) == 0:
            break
        first.append(equal)
        second.append(equal + apart)
    return np.concatenate([np.zeros(0, int), *first]), np.concatenate([np.zeros(0, int), *second])


def _components(count: int, pairs: np.ndarray) -> np.ndarray:
    """[count], the smallest member of each one's connected set; pairs: [2, P]. Labels fall until nothing changes."""
    label = np.arange(count)
    while True:
        lowest = np.minimum(label[pairs[0]], label[pairs[1]])
        before = label.copy()
        np.minimum.at(label, label[pairs[0]], lowest)
        np.minimum.at(label, label[pairs[1]], lowest)
        label = label[label]
        if np.array_equal(before, label):
            return label
