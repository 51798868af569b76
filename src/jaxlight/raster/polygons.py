"""Faces given by index lists, their normals, and how they are cut into triangles."""

from __future__ import annotations

import dataclasses

import numpy as np

MAX_CONCAVE_CORNERS = 10_000
"""Corners of one concave face; cutting takes time proportional to their square."""


@dataclasses.dataclass(frozen=True, eq=False)
class Faces:
    """Polygons as slices of a flat list of corners."""

    slot: np.ndarray
    """[C], place of each corner in the index list that it was read from (the -1 that end faces left out)."""
    face: np.ndarray
    """[C], which face each corner belongs to, in the order of the index list."""
    start: np.ndarray
    """[F], first corner of each face."""
    count: np.ndarray
    """[F], corners of each face."""

    @classmethod
    def read(cls, index: np.ndarray) -> Faces:
        """Faces of an index list in which -1 ends a face (the last one may go without)."""
        slot = np.flatnonzero(index >= 0)
        face = np.cumsum(index < 0)[slot]
        count = np.bincount(face, minlength=int(np.sum(index < 0)) + bool(len(index) and index[-1] >= 0))
        return cls(slot, face, np.cumsum(count) - count, count)

    @classmethod
    def triangles(cls, count: int) -> Faces:
        """`count` triangles of three consecutive corners each."""
        corner = np.arange(3 * count)
        return cls(corner, corner // 3, 3 * np.arange(count), np.full(count, 3))

    @property
    def following(self) -> np.ndarray:
        """[C], the next corner around the face."""
        following = np.arange(1, len(self.slot) + 1)
        last = (self.start + self.count - 1)[self.count > 0]
        following[last] = self.start[self.count > 0]
        return following

    @property
    def preceding(self) -> np.ndarray:
        """[C], the previous corner around the face."""
        preceding = np.empty(len(self.slot), dtype=np.int64)
        preceding[self.following] = np.arange(len(self.slot))
        return preceding


def face_normals(faces: Faces, points: np.ndarray) -> np.ndarray:
    """[F, 3], twice the vector area of each face by Newell's sum, counterclockwise in front; points: [C, 3]."""
    relative = points - points[np.repeat(faces.start, faces.count)] if len(points) else points
    sums = np.zeros((len(faces.count), 3))
    products = np.cross(relative, relative[faces.following])
    for axis in range(3):
        sums[:, axis] = np.bincount(faces.face, products[:, axis], len(faces.count))
    return sums


def split_fans(faces: Faces) -> np.ndarray:
    """[T, 3] corners: each face as a fan around its first corner, which is right for convex faces."""
    fans = np.maximum(faces.count - 2, 0)
    first = np.repeat(faces.start, fans)
    step = np.arange(fans.sum()) - np.repeat(np.cumsum(fans) - fans, fans)
    return np.stack([first, first + step + 1, first + step + 2], axis=1)


def split_concave(faces: Faces, points: np.ndarray, where: str) -> np.ndarray:
    """[T, 3] corners: convex faces as fans, the others by cutting ears in the plane of the face (X3D 13.3.6 `convex`).

    Raises:
        ValueError: a concave face of more than MAX_CONCAVE_CORNERS corners.
    """
    normals = face_normals(faces, points)
    incoming, outgoing = points - points[faces.preceding], points[faces.following] - points
    turn = np.einsum("ij,ij->i", np.cross(incoming, outgoing), normals[faces.face])
    concave = np.zeros(len(faces.count), dtype=bool)
    concave[faces.face[turn < 0]] = True
    fans = split_fans(dataclasses.replace(faces, count=np.where(concave, 0, faces.count)))
    cut = [fans]
    for face in np.flatnonzero(concave):
        count = int(faces.count[face])
        if count > MAX_CONCAVE_CORNERS:
            raise ValueError(
                f"{where}: face {face} is concave and has {count} corners; at most {MAX_CONCAVE_CORNERS} are cut"
            )
        corners = faces.start[face] + np.arange(count)
        cut.append(corners[_cut_ears(_in_plane(points[corners], normals[face]))])
    return np.concatenate(cut)


def _in_plane(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Points [n, 3] seen along `normal`, [n, 2], keeping their winding: the largest component is dropped."""
    axis = int(np.argmax(np.abs(normal)))
    u, v = ((1, 2), (2, 0), (0, 1))[axis]
    return points[:, [u, v]] if normal[axis] > 0 else points[:, [v, u]]


def _cut_ears(points: np.ndarray) -> np.ndarray:
    """[n - 2, 3] triangles of a simple polygon [n, 2] that runs counterclockwise.

    A corner is an ear when it turns left and no other corner lies in its triangle. A polygon that is not simple has
    no ear at some point; the next corner in turn is then cut off, so that the result is finite (X3D: undefined).
    """
    ring = list(range(len(points)))
    triangles = []
    at = 0
    misses = 0
    while len(ring) > 3:
        at %= len(ring)
        a, b, c = ring[at - 1], ring[at], ring[(at + 1) % len(ring)]
        if misses < len(ring) and not _is_ear(points, a, b, c, ring):
            misses += 1
            at += 1
            continue
        triangles.append((a, b, c))
        ring.pop(at)
        misses = 0
        at += 1  # every other corner first: fewer slivers than cutting along one side
    triangles.append(tuple(ring))
    return np.array(triangles, dtype=np.int64)


def _is_ear(points: np.ndarray, a: int, b: int, c: int, ring: list[int]) -> bool:
    pa, pb, pc = points[a], points[b], points[c]

    def left_of(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        return (q[0] - p[0]) * (r[..., 1] - p[1]) - (q[1] - p[1]) * (r[..., 0] - p[0])

    if left_of(pa, pb, pc) <= 0:
        # A corner without a turn may go once nothing is lost: its triangle has no area.
        return bool(left_of(pa, pb, pc) == 0 and np.dot(pb - pa, pc - pb) >= 0)
    others = points[ring]
    inside = (left_of(pa, pb, others) >= 0) & (left_of(pb, pc, others) >= 0) & (left_of(pc, pa, others) >= 0)
    # Corners of the ear itself, and corners that coincide with one (a bridge to a hole), do not count.
    own = np.any(np.all(others[:, None] == np.stack([pa, pb, pc]), axis=2), axis=1)
    return not np.any(inside & ~own)
