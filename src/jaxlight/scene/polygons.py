"""Faces given by index lists, their normals, and how they are cut into triangles."""

from __future__ import annotations

import dataclasses

import numpy as np

from .ears import cut_ears
from .flatness import SLIVER, are_flat, doubled_areas

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


@np.errstate(over="ignore", invalid="ignore")  # of coordinates that are too large, which is said where they are drawn
def face_normals(faces: Faces, points: np.ndarray) -> np.ndarray:
    """[F, 3], twice the vector area of each face by Newell's sum, counterclockwise in front; points: [C, 3]."""
    relative = points - points[np.repeat(faces.start, faces.count)] if len(points) else points
    sums = np.zeros((len(faces.count), 3))
    products = np.cross(relative, relative[faces.following])
    for axis in range(3):
        sums[:, axis] = np.bincount(faces.face, products[:, axis], len(faces.count))
    return sums


def split_fans(faces: Faces) -> np.ndarray:
    """[T, 3] corners: each face as a fan around its first corner, right for convex ones without corners on a line."""
    fans = np.maximum(faces.count - 2, 0)
    first = np.repeat(faces.start, fans)
    step = np.arange(fans.sum()) - np.repeat(np.cumsum(fans) - fans, fans)
    return np.stack([first, first + step + 1, first + step + 2], axis=1)


def are_no_fans(faces: Faces, points: np.ndarray) -> np.ndarray:
    """[F], True for faces that `split_fans` would not cut right: concave ones, and those of flat triangles.

    Args:
        faces: the polygons.
        points: [C, 3], where each corner is.
    """
    return _turned(faces, points, face_normals(faces, points)) | _have_flat_fans(faces, points)


@np.errstate(over="ignore", invalid="ignore")
def _have_flat_fans(faces: Faces, points: np.ndarray) -> np.ndarray:
    """[F], True where three corners on a line make a triangle of the fan around the first corner of a face with area.

    Such a triangle is not drawn, and the corner in its middle would lie on an edge of the next one, where it is no
    corner: rays slip through between that edge and the faces, or triangles, that share the corner.
    """
    fans = split_fans(_only(faces, faces.count > 3))
    fans = fans[are_flat(points[fans], SLIVER)]
    places = points[fans]
    apart = np.any(places != places[:, [1, 2, 0]], axis=2).all(axis=1)
    found = np.zeros(len(faces.count), dtype=bool)
    found[faces.face[fans[apart, 0]]] = True
    if not np.any(found):
        return found
    of_them = found[faces.face]
    faces, points = faces.without(~of_them), points[of_them]
    longest = np.zeros(len(found))
    np.maximum.at(longest, faces.face, np.linalg.norm(points[faces.following] - points, axis=1))
    return np.linalg.norm(face_normals(faces, points), axis=1) > SLIVER * longest**2


@np.errstate(over="ignore", invalid="ignore")
def _turned(faces: Faces, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    repeated = np.all(points == points[faces.preceding], axis=1)  # there is no turn at either of two equal corners
    faces, points = faces.without(repeated), points[~repeated]
    incoming, outgoing = points - points[faces.preceding], points[faces.following] - points
    turn = np.einsum("ij,ij->i", np.cross(incoming, outgoing), normals[faces.face])
    concave = np.zeros(len(faces.count), dtype=bool)
    concave[faces.face[turn < 0]] = True
    return concave


def split_convex(faces: Faces, points: np.ndarray) -> np.ndarray:
    """[T, 3] corners: each face as a fan, around the first of its corners that leaves no corner on an edge.

    That is the first corner of a face, or another one where corners lie on a line. Faces for which none will do are cut
    by ears, as long as that is quick.

    Args:
        faces: the polygons.
        points: [C, 3], where each corner is.
    """
    every = np.ones(len(faces.count), dtype=bool)
    return _split_convex(faces, points, every, MAX_CONCAVE_CORNERS**2)


def _split_convex(faces: Faces, points: np.ndarray, chosen: np.ndarray, most_squares: float) -> np.ndarray:
    """The chosen faces [F]; at most so many squares of corners are cut by ears, and the rest stays fans."""
    flat = chosen & _have_flat_fans(faces, points)
    if not np.any(flat):
        return split_fans(_only(faces, chosen))
    normals = face_normals(faces, points)
    fans, found = _fans_around_others(faces, points, normals, flat)
    squares = np.where(flat & ~found & (faces.count <= MAX_CONCAVE_CORNERS), faces.count.astype(np.float64) ** 2, 0.0)
    by_ears = (squares > 0) & (np.cumsum(squares) <= most_squares)
    plain = split_fans(_only(faces, chosen & ~found & ~by_ears))
    return np.concatenate([plain, fans, *_split_by_ears(faces, points, normals, by_ears)])


@np.errstate(over="ignore", invalid="ignore")
def _fans_around_others(
    faces: Faces, points: np.ndarray, normals: np.ndarray, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fans [T, 3] of the chosen faces without flat triangles, around whichever corner, and [F] whether there is one.

    A corner of a convex face is on a line with two others that follow one another only if one of its neighbours is
    between two corners. Of the corners of which that is not so the first is taken.
    """
    away = ~chosen[faces.face] | np.all(points == points[faces.preceding], axis=1)
    corner, faces = np.flatnonzero(~away), faces.without(away)
    points = points[corner]
    preceding, following = faces.preceding, faces.following
    between = are_flat(np.stack([points[preceding], points, points[following]], axis=1), SLIVER)
    good = np.flatnonzero(~between[preceding] & ~between[following])
    found, first = np.unique(faces.face[good], return_index=True)
    apex = np.full(len(chosen), -1)
    apex[found] = good[first]
    fans = split_fans(_only(faces, apex >= 0))
    face = faces.face[fans[:, 0]]
    start = faces.start[face, None]
    fans = start + (fans - 2 * start + apex[face, None]) % faces.count[face, None]
    areas, longest = doubled_areas(points[fans])
    unit = normals[face] / np.linalg.norm(normals[face], axis=1, keepdims=True)
    is_right = apex >= 0
    is_right[face[~(np.einsum("ij,ij->i", areas, unit) > SLIVER * longest**2)]] = False
    return corner[fans[is_right[face]]], is_right


def _only(faces: Faces, chosen: np.ndarray) -> Faces:
    """The faces with no corners but for the chosen ones [F], for `split_fans`."""
    return dataclasses.replace(faces, count=np.where(chosen, faces.count, 0))


def split_concave(faces: Faces, points: np.ndarray, where: str) -> np.ndarray:
    """[T, 3] corners: convex faces as fans, the others by cutting ears in the plane of the face (X3D 13.3.6 `convex`).

    Raises:
        ValueError: a concave face of more than MAX_CONCAVE_CORNERS corners, or too many of them together.
    """
    normals = face_normals(faces, points)
    concave = _turned(faces, points, normals)
    squares = _check_corners(np.flatnonzero(concave), faces.count, where)
    fans = _split_convex(faces, points, ~concave, MAX_CONCAVE_CORNERS**2 - squares)
    return np.concatenate([fans, *_split_by_ears(faces, points, normals, concave)])


def _split_by_ears(faces: Faces, points: np.ndarray, normals: np.ndarray, chosen: np.ndarray) -> list[np.ndarray]:
    """Triangles of each of the chosen faces [F]."""
    cut = []
    for face in np.flatnonzero(chosen):
        corners = faces.start[face] + np.arange(faces.count[face])
        cut.append(corners[cut_ears(_in_plane(points[corners], normals[face]))])
    return cut


def _check_corners(concave: np.ndarray, count: np.ndarray, where: str) -> float:
    """Refuse more corners than can be cut in a time that one would wait; the sum of their squares."""
    for face in concave[count[concave] > MAX_CONCAVE_CORNERS][:1]:
        raise ValueError(
            f"{where}: face {face} is concave and has {count[face]} corners; at most {MAX_CONCAVE_CORNERS} are cut"
        )
    squares = float(np.sum(count[concave].astype(np.float64) ** 2))
    if squares > MAX_CONCAVE_CORNERS**2:
        raise ValueError(
            f"{where}: {len(concave)} concave faces have {count[concave].sum()} corners together; the squares of their "
            f"numbers of corners may come to {MAX_CONCAVE_CORNERS**2}"
        )
    return squares


def _in_plane(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Points [n, 3] seen along `normal`, [n, 2], keeping their winding: the largest component is dropped."""
    axis = int(np.argmax(np.abs(normal)))
    u, v = ((1, 2), (2, 0), (0, 1))[axis]
    return points[:, [u, v]] if normal[axis] > 0 else points[:, [v, u]]
