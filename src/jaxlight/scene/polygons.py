"""Faces given by index lists, their normals, and how they are cut into triangles."""

from __future__ import annotations

import bisect
import dataclasses
from fractions import Fraction
from typing import Any

import numpy as np

MAX_CONCAVE_CORNERS = 10_000
"""Corners of one concave face; cutting takes time proportional to their square.

The squares of the corners of all concave faces of a shape together are at most that of this number, too.
"""


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

    def without(self, corners: np.ndarray) -> Faces:
        """The same faces without some of their corners ([C], True for those)."""
        slot, face = self.slot[~corners], self.face[~corners]
        count = np.bincount(face, minlength=len(self.count))
        return Faces(slot, face, np.cumsum(count) - count, count)

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


def are_concave(faces: Faces, points: np.ndarray) -> np.ndarray:
    """[F], True for faces that turn to the other side at some corner.

    Args:
        faces: the polygons.
        points: [C, 3], where each corner is.
    """
    return _turned(faces, points, face_normals(faces, points))


def _turned(faces: Faces, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    repeated = np.all(points == points[faces.preceding], axis=1)  # there is no turn at either of two equal corners
    faces, points = faces.without(repeated), points[~repeated]
    incoming, outgoing = points - points[faces.preceding], points[faces.following] - points
    turn = np.einsum("ij,ij->i", np.cross(incoming, outgoing), normals[faces.face])
    concave = np.zeros(len(faces.count), dtype=bool)
    concave[faces.face[turn < 0]] = True
    return concave


def split_concave(faces: Faces, points: np.ndarray, where: str) -> np.ndarray:
    """[T, 3] corners: convex faces as fans, the others by cutting ears in the plane of the face (X3D 13.3.6 `convex`).

    Raises:
        ValueError: a concave face of more than MAX_CONCAVE_CORNERS corners, or too many of them together.
    """
    normals = face_normals(faces, points)
    concave = _turned(faces, points, normals)
    fans = split_fans(dataclasses.replace(faces, count=np.where(concave, 0, faces.count)))
    cut = [fans]
    _check_corners(np.flatnonzero(concave), faces.count, where)
    for face in np.flatnonzero(concave):
        corners = faces.start[face] + np.arange(faces.count[face])
        cut.append(corners[_cut_ears(_in_plane(points[corners], normals[face]))])
    return np.concatenate(cut)


def _check_corners(concave: np.ndarray, count: np.ndarray, where: str) -> None:
    """Refuse more corners than can be cut in a time that one would wait."""
    for face in concave[count[concave] > MAX_CONCAVE_CORNERS][:1]:
        raise ValueError(
            f"{where}: face {face} is concave and has {count[face]} corners; at most {MAX_CONCAVE_CORNERS} are cut"
        )
    if np.sum(count[concave].astype(np.float64) ** 2) > MAX_CONCAVE_CORNERS**2:
        raise ValueError(
            f"{where}: {len(concave)} concave faces have {count[concave].sum()} corners together; the squares of their "
            f"numbers of corners may come to {MAX_CONCAVE_CORNERS**2}"
        )


def _in_plane(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Points [n, 3] seen along `normal`, [n, 2], keeping their winding: the largest component is dropped."""
    axis = int(np.argmax(np.abs(normal)))
    u, v = ((1, 2), (2, 0), (0, 1))[axis]
    return points[:, [u, v]] if normal[axis] > 0 else points[:, [v, u]]


def _cut_ears(points: np.ndarray) -> np.ndarray:
    """[n - 2, 3] triangles of a simple polygon [n, 2] that runs counterclockwise.

    A corner is an ear when it turns left and no other corner lies in its triangle; if one does, so does one that turns
    right. Cutting an ear leaves all corners but its two neighbours what they were, so each is looked at a few times.
    A polygon that is not simple has no ear at some point; the next corner in turn is then cut off, so that the result
    is finite (X3D: undefined).
    """
    ring = _Ring(points)
    triangles = []
    at = 0
    while ring.count > 3:
        at = ring.ear_from(at)
        before, after = ring.preceding[at], ring.following[at]
        triangles.append((before, at, after))
        ring.cut(at)
        at = ring.following[after]  # every other corner first: fewer slivers than cutting along one side
    triangles.append(tuple(sorted((ring.preceding[at], at, ring.following[at]))))
    return np.array(triangles, dtype=np.int64)


_Place = tuple[float, float]


class _Ring:
    """The corners of a polygon [n, 2] that are not cut off yet, and which of them are ears."""

    def __init__(self, points: np.ndarray) -> None:
        self.count = len(points)
        self.following = [*range(1, self.count), 0]
        self.preceding = [self.count - 1, *range(self.count - 1)]
        self._points = points
        self._places: list[_Place] = [(x, y) for x, y in points.tolist()]
        self._left = np.ones(self.count, dtype=bool)
        self._turns_right = np.zeros(self.count, dtype=bool)
        """Also corners without a turn."""
        self._ears: list[int] = []
        """In ascending order."""
        self._looks = 6
        """How often all corners are looked at: again only where some touch one another."""

    def ear_from(self, corner: int) -> int:
        """The first ear from a corner on; the corner itself if there is none."""
        if not self._ears and self._looks > 0:
            self._looks -= 1
            self._look_at(np.flatnonzero(self._left).tolist())
        return self._ears[bisect.bisect_left(self._ears, corner) % len(self._ears)] if self._ears else corner

    def cut(self, corner: int) -> None:
        """Take a corner away."""
        before, after = self.preceding[corner], self.following[corner]
        self.following[before], self.preceding[after] = after, before
        self.count -= 1
        self._left[corner] = self._turns_right[corner] = False
        self._note(corner, is_ear=False)
        self._look_at([before, after])

    def _look_at(self, corners: list[int]) -> None:
        turns = [self._turn(corner) for corner in corners]
        self._turns_right[corners] = [turn <= 0 for turn in turns]
        for corner, turn in zip(corners, turns, strict=True):
            self._note(corner, is_ear=self._may_go(corner) if turn == 0 else turn > 0 and self._is_empty(corner))

    def _note(self, corner: int, *, is_ear: bool) -> None:
        place = bisect.bisect_left(self._ears, corner)
        if (self._ears[place : place + 1] == [corner]) == is_ear:
            return
        if is_ear:
            self._ears.insert(place, corner)
        else:
            self._ears.pop(place)

    def _turn(self, corner: int) -> int:
        """1 to the left, 0 for none, -1 to the right."""
        return _side(*self._triangle(corner))

    def _may_go(self, corner: int) -> bool:
        """A corner without a turn may go once nothing is lost: its triangle has no area."""
        (ax, ay), (bx, by), (cx, cy) = self._triangle(corner)
        return (bx - ax) * (cx - bx) + (by - ay) * (cy - by) >= 0

    def _is_empty(self, corner: int) -> bool:
        """Whether no corner lies in a corner's triangle."""
        a, b, c = self._triangle(corner)
        edges = ((a, b), (b, c), (c, a))
        others = self._points[self._turns_right]
        outside = np.zeros(len(others), dtype=bool)
        for p, q in edges:
            left, error = _left_of(p, q, others[:, 0], others[:, 1])
            outside |= left < -error
        # Corners of the triangle itself, and corners that coincide with one (a bridge to a hole), do not count.
        near = [other for other in map(tuple, others[~outside].tolist()) if other not in (a, b, c)]
        return not any(all(_side(p, q, other) >= 0 for p, q in edges) for other in near)

    def _triangle(self, corner: int) -> tuple[_Place, _Place, _Place]:
        return self._places[self.preceding[corner]], self._places[corner], self._places[self.following[corner]]


def _left_of(p: _Place, q: _Place, x: Any, y: Any) -> tuple[Any, Any]:
    """How far points lie to the left of the line from p to q, times its length, and the most that rounding can do."""
    one, other = (q[0] - p[0]) * (y - p[1]), (q[1] - p[1]) * (x - p[0])
    return one - other, 4 * np.finfo(np.float64).eps * (abs(one) + abs(other))


def _side(p: _Place, q: _Place, point: _Place) -> int:
    """1 for a point to the left of the line from p to q, -1 to the right, 0 on it: exact.

    Corners on one line are common, and rounding puts some of them on the wrong side once the face is turned.
    """
    left, error = _left_of(p, q, *point)
    if not abs(left) > error:
        (px, py), (qx, qy), (x, y) = ((Fraction(u), Fraction(v)) for u, v in (p, q, point))
        left = (qx - px) * (y - py) - (qy - py) * (x - px)
    return (left > 0) - (left < 0)
