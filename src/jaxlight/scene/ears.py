"""Polygons in a plane, cut into triangles by their ears."""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from .flatness import SLIVER


def cut_ears(points: np.ndarray) -> np.ndarray:
    """[n - 2, 3] triangles of a simple polygon [n, 2] that runs counterclockwise.

    A corner is a full ear when it turns left, its triangle has an area, and no other corner lies in or on it; if one
    does, so does one that turns right or is straight. All that is meant but for rounding. Every simple polygon has a
    full ear, and stays one without it (Meisters 1975): so all corners are corners of triangles with an area, straight
    ones too, and none is left on the edge of one. Cutting an ear leaves all corners but its two neighbours what they
    were, so each is looked at a few times.

    A polygon that touches itself, or all but does, may have no full ear at some point. The next corner is then cut off
    whose triangle has no corner in it by the exact rule, or none but corners on its line. One that is not simple may
    have none of these either; the next corner in turn is then cut off, so that the result is finite (X3D: undefined).
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
_FULL, _LESSER, _NONE = range(3)
"""Kinds of ears; lesser ones are cut only where no full one is left."""
_LOOKS = 6
"""How often all corners are looked at again for each kind of ear."""


class _Ring:
    """The corners of a polygon [n, 2] that are not cut off yet, and which of them are ears."""

    def __init__(self, points: np.ndarray) -> None:
        self.count = len(points)
        self.following = [*range(1, self.count), 0]
        self.preceding = [self.count - 1, *range(self.count - 1)]
        self._points = points
        self._places: list[_Place] = [(x, y) for x, y in points.tolist()]
        self._left = np.ones(self.count, dtype=bool)
        self._may_block = np.zeros(self.count, dtype=bool)
        """Corners that turn right, or not at all but for rounding."""
        self._ears: tuple[list[int], list[int]] = ([], [])
        """Full and lesser ones, in ascending order."""
        self._spare = _LOOKS * self.count
        self._looks = 2 * self._spare
        """Corners that may be looked at again: they have to be only where some touch one another."""

    def ear_from(self, corner: int) -> int:
        """The first full ear from a corner on; without any the first lesser one, and without any the corner itself."""
        full, lesser = self._ears
        if not full and self._looks > (self._spare if lesser else 0):
            self._looks -= self.count
            self._look_at(np.flatnonzero(self._left).tolist())
        ears = full or lesser
        return ears[bisect.bisect_left(ears, corner) % len(ears)] if ears else corner

    def cut(self, corner: int) -> None:
        """Take a corner away."""
        before, after = self.preceding[corner], self.following[corner]
        self.following[before], self.preceding[after] = after, before
        self.count -= 1
        self._left[corner] = self._may_block[corner] = False
        self._note(corner, _NONE)
        if self.count > 3:
            self._look_at([before, after])

    def _look_at(self, corners: list[int]) -> None:
        turns = [_turn(*self._triangle(corner)) for corner in corners]
        self._may_block[corners] = [is_thin for _, is_thin in turns]
        for corner, (turn, is_thin) in zip(corners, turns, strict=True):
            self._note(corner, self._kind(corner, turn, is_thin=is_thin))

    def _kind(self, corner: int, turn: int, *, is_thin: bool) -> int:
        """Which kind of an ear a corner is."""
        a, b, c = self._triangle(corner)
        if turn < 0:
            return _NONE
        if b in (a, c):
            return _FULL  # a repeated corner: nothing is lost, and nothing comes to lie on an edge
        if turn == 0:
            # A corner without a turn may go once nothing is lost: its triangle has no area.
            return _LESSER if (b[0] - a[0]) * (c[0] - b[0]) + (b[1] - a[1]) * (c[1] - b[1]) >= 0 else _NONE
        edges = ((a, b), (b, c), (c, a))
        near = self._near(edges)
        first = next(near, None)
        if first is None:
            return _LESSER if is_thin else _FULL
        inside = (all(_side(p, q, other) >= 0 for p, q in edges) for other in itertools.chain([first], near))
        return _NONE if any(inside) else _LESSER

    def _near(self, edges: tuple[tuple[_Place, _Place], ...]) -> Iterator[_Place]:
        """Other corners in a triangle or on it, but for rounding.

        Corners of the triangle itself, and those that coincide with one (a bridge to a hole), do not count.
        """
        others = self._points[self._may_block]
        x, y = others[:, 0], others[:, 1]
        outside = np.zeros(len(others), dtype=bool)
        corners = [p for p, _ in edges]
        room = _room(*corners)
        for p, q in edges:
            left, error = _left_of(p, q, x, y)
            outside |= left < -(error + room)
        near = others[~outside]
        for start in range(0, len(near), 16):  # mostly none or one is asked for
            yield from (other for other in map(tuple, near[start : start + 16].tolist()) if other not in corners)

    def _note(self, corner: int, kind: int) -> None:
        for own, ears in enumerate(self._ears):
            place = bisect.bisect_left(ears, corner)
            if (ears[place : place + 1] == [corner]) == (kind == own):
                continue
            if kind == own:
                ears.insert(place, corner)
            else:
                ears.pop(place)

    def _triangle(self, corner: int) -> tuple[_Place, _Place, _Place]:
        return self._places[self.preceding[corner]], self._places[corner], self._places[self.following[corner]]


def _turn(a: _Place, b: _Place, c: _Place) -> tuple[int, bool]:
    """1 for a turn to the left at b, 0 for none, -1 to the right; and whether it is to the left clear of rounding or
    not."""
    left, _ = _left_of(a, b, *c)
    is_thin = not left > _room(a, b, c)
    return _side(a, b, c) if is_thin else 1, is_thin


def _room(a: _Place, b: _Place, c: _Place) -> float:
    """Twice the area of a triangle of such corners that is nothing but rounding."""
    sides = [(q[0] - p[0], q[1] - p[1]) for p, q in ((a, b), (b, c), (c, a))]
    return SLIVER * max(x * x + y * y for x, y in sides)


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
