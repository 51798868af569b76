"""Ray casting by brute force, float64: every ray against every triangle (Moeller and Trumbore)."""

from __future__ import annotations

import numpy as np


def first_hits(origin: np.ndarray, directions: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which triangle [N] (-1: none) and how far along [N] each ray first meets; corners: [T, 3, 3], both faces."""
    best, which = np.full(len(directions), np.inf), np.full(len(directions), -1)
    for number, (a, b, c) in enumerate(corners):
        edge_b, edge_c = b - a, c - a
        p = np.cross(directions, edge_c)
        det = p @ edge_b
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (p @ (origin - a)) / det
            q = np.cross(origin - a, edge_b)
            t = directions @ q / det
            along = q @ edge_c / det
            nearer = (s >= 0) & (t >= 0) & (s + t <= 1) & (along > 0) & (along < best)
        best[nearer], which[nearer] = along[nearer], number
    return which, best


def margin(origin: np.ndarray, directions: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """[N], least angle (radians, small ones only) between each ray and an edge of any triangle: where it is large, no
    rounding can change which triangles a ray meets."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    least = np.full(len(directions), np.inf)
    for triangle in corners - origin:
        for start, end in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
            plane = np.cross(start, end)
            size = np.linalg.norm(plane)
            if size > 0:
                least = np.minimum(least, np.abs(unit @ plane) / size)
    return least
