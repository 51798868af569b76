"""The curved surfaces of primitives and their flat ends, exactly: where rays meet them, normals, how far they reach.

A face is a part of axes . (p - center)^2 + tilt (p_y - center_y) = level, in the coordinates of the unit primitive. A
ray start + t d, seen from `center`, meets the whole surface where a t^2 + 2 b t + c = 0. It enters where a t + b is
minus the square root of the discriminant, and leaves where it is plus that, whichever comes first.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

_ROUNDING = 8 * np.finfo(np.float64).eps
"""Of the coordinates of a unit primitive."""


@dataclasses.dataclass(frozen=True, eq=False)
class Face:
    """One face of a primitive, in the coordinates of the unit primitive. The gradient points outwards."""

    axes: tuple[float, float, float]
    center: tuple[float, float, float]
    level: float
    hull: tuple[tuple[float, tuple[float, float, float]], ...]
    """Ellipsoids whose convex hull just holds the face: the y of each one's centre, and its half axes."""
    texcoord: Callable[[np.ndarray], np.ndarray]
    """Points on the face [N, 3] -> texture coordinates [N, 2] (X3D 13.3)."""
    tilt: float = 0.0
    """Of a plane across y; `axes` are 0 then."""
    lowest: float = -np.inf
    highest: float = np.inf
    """How far along y the face reaches."""
    radius: float = np.inf
    """How far from the y axis."""

    def bounds(self, to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest coordinates [3] of the face, mapped by [3, 4]."""
        ends = []
        for y, half_axes in self.hull:
            middle, reach = to_world[:, 3] + to_world[:, 1] * y, np.hypot.reduce(to_world[:, :3] * half_axes, axis=1)
            ends += [middle - reach, middle + reach]
        return np.min(ends, axis=0), np.max(ends, axis=0)

    def gradient(self, points: np.ndarray) -> np.ndarray:
        """Points [N, 3] -> outward normals [N, 3] of any length; along y at the apex of a cone, which has none."""
        gradient = np.asarray(self.axes) * (points - self.center) + np.array([0.0, self.tilt / 2, 0.0])
        at_apex = np.all(np.abs(gradient) <= _ROUNDING, axis=1, keepdims=True)
        return np.where(at_apex, [0.0, 1.0, 0.0], gradient)

    def onto(self, start: np.ndarray, along: np.ndarray, is_back: np.ndarray) -> np.ndarray:
        """Points [N, 3] that lie on the face but for rounding, moved along their rays [N, 3] onto its surface,
        and not out of the unit cube."""
        axes, here = np.asarray(self.axes), start - self.center
        with np.errstate(over="ignore", invalid="ignore"):
            a = (along * axes * along).sum(axis=1)
            b = (along * axes * here).sum(axis=1) + self.tilt / 2 * along[:, 1]
            c = (here * axes * here).sum(axis=1) + self.tilt * here[:, 1] - self.level
            step = root(a, b, c, np.maximum(b * b - a * c, 0.0), is_back)
        return np.clip(start + np.where(np.isfinite(step), step, 0.0)[:, None] * along, -1.0, 1.0)


def root(a: np.ndarray, b: np.ndarray, c: np.ndarray, discriminant: np.ndarray, is_back: np.ndarray) -> np.ndarray:
    """t where a t^2 + 2 b t + c = 0 and a t + b is the root of the discriminant (>= 0), minus that unless `is_back`.

    Without cancellation; infinite or NaN where there is none.
    """
    rise = np.where(is_back, 1.0, -1.0) * np.sqrt(discriminant)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(rise * b <= 0, (rise - b) / a, -c / (rise + b))
