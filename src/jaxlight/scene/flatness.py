"""Which triangles have no area, but for rounding."""

from __future__ import annotations

import numpy as np

FLAT = 1e-14
"""Of the square of its longest edge, twice the area of a face that has none but by rounding."""

SLIVER = 64 * FLAT
"""The same of a triangle that polygons are not cut into while there is a choice: clear of FLAT by any rounding."""


def are_flat(triangles: np.ndarray, most: float = FLAT) -> np.ndarray:
    """[T], True for triangles [T, 3 corners, 3] without area: two corners coincide, or all three lie on a line.

    Args:
        triangles: where the corners are.
        most: twice the area of such triangles, over the square of their longest edge.
    """
    areas, longest = doubled_areas(triangles)
    return ~(np.linalg.norm(areas, axis=1) > most * longest**2)


@np.errstate(over="ignore", invalid="ignore")  # of coordinates that are too large, which is said where they are drawn
def doubled_areas(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twice the vector areas [T, 3] and the longest edges [T] of triangles [T, 3 corners, 3]."""
    edges = triangles[:, [1, 2, 0]] - triangles
    return np.cross(edges[:, 0], edges[:, 1]), np.linalg.norm(edges, axis=2).max(axis=1, initial=0.0)
