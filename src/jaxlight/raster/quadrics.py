"""Samples on flat triangles -> on the curved surface that the triangles stand for."""

from __future__ import annotations

import numpy as np

from ..scene.transforms import apply_to_normals, apply_to_points
from .triangles import Quadric


def onto_quadric(
    quadric: Quadric, to_world: np.ndarray, eye: np.ndarray, position: np.ndarray, is_back: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where the rays through `position` enter the quadric, or leave it where its back is seen, and its outward normal.

    With p = eye + t d and q(p) = axes . (p - center)^2 - level, t solves a quadratic; t = 1 is `position`. Rays that
    meet the quadric so only beyond its ends go to the nearer root; those that miss it by rounding go to where they come
    nearest to it.

    Args:
        quadric: in the shape's coordinates.
        to_world: [3, 4], the shape's coordinates to the world.
        eye: [3], world space.
        position: [N, 3], world space.
        is_back: [N], True where the triangle is seen from inside the quadric.

    Returns:
        positions and normals (any length) [N, 3], world space.
    """
    inverse = np.linalg.inv(to_world[:, :3])
    axes, center = np.asarray(quadric.axes), np.asarray(quadric.center)
    start = inverse @ (eye - to_world[:, 3]) - center
    along = (position - eye) @ inverse.T
    # Around t = 1, where the numbers are small: q = a s^2 + 2 b s + c with s = t - 1.
    here = start + along
    a = (along * axes * along).sum(axis=1)
    b = (along * axes * here).sum(axis=1)
    c = (here * axes * here).sum(axis=1) - quadric.level
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    # Both roots without cancellation: c / divisor is the nearer one, where q rises if b does.
    divisor = -(b + np.where(b >= 0, root, -root))
    step = np.divide(c, divisor, out=np.zeros_like(c), where=divisor != 0)
    other = np.divide(divisor, a, out=step.copy(), where=((b >= 0) != is_back) & (root > 0) & (a != 0))
    height = here[:, 1] + other * along[:, 1] + center[1]
    step = np.where((quadric.low <= height) & (height <= quadric.high), other, step)
    local = here + step[:, None] * along + center
    return apply_to_points(to_world, local), apply_to_normals(to_world, (local - center) * axes)
