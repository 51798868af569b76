"""Coordinate systems as 3 x 4 affine matrices (host side, float64): X3D Transform, rotations, composition."""

from __future__ import annotations

import math

import numpy as np

from . import nodes

IDENTITY = np.hstack([np.eye(3), np.zeros((3, 1))])
IDENTITY.setflags(write=False)


def unit(direction: np.ndarray) -> np.ndarray:
    """Of length 1, whose square neither overflows nor underflows on the way; zero stays zero."""
    _, exponent = math.frexp(np.abs(direction).max())
    scaled = np.ldexp(direction, -exponent)
    return scaled / (np.linalg.norm(scaled) or 1.0)


def rotation_matrix(axis_angle: tuple[float, float, float, float]) -> np.ndarray:
    """The 3 x 3 matrix of an axis-angle rotation (x, y, z, radians); a zero axis is no rotation (Rodrigues)."""
    axis, angle = np.asarray(axis_angle[:3], dtype=np.float64), axis_angle[3]
    if not np.any(axis):
        return np.eye(3)
    x, y, z = unit(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)


def transform_matrix(transform: nodes.Transform) -> np.ndarray:
    """Local to parent coordinates, [3, 4]: P' = T C R SR S -SR -C P (X3D Transform)."""
    linear_scale = rotation_matrix(transform.scale_orientation)
    linear = rotation_matrix(transform.rotation) @ linear_scale @ np.diag(transform.scale) @ linear_scale.T
    center = np.asarray(transform.center)
    offset = np.asarray(transform.translation) + center - linear @ center
    return np.hstack([linear, offset[:, None]])


def compose(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """The affine map `outer` after `inner`, both [3, 4]."""
    return np.hstack([outer[:, :3] @ inner[:, :3], outer[:, :3] @ inner[:, 3:] + outer[:, 3:]])


def is_invertible(affine: np.ndarray) -> bool:
    """Whether an affine map is finite and loses no direction, measured by its own scale, however small that is."""
    linear = affine[:, :3]
    scale = np.abs(linear).max()
    return bool(np.all(np.isfinite(affine)) and scale >= 1e-30 and abs(np.linalg.det(linear / scale)) >= 1e-30)


def apply_to_points(affine: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points [n, 3] mapped by an affine matrix [3, 4]."""
    return points @ affine[:, :3].T + affine[:, 3]


def apply_to_normals(affine: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Normals [n, 3] mapped by the inverse transpose (not normalised); a mirroring keeps them pointing outwards."""
    linear = affine[:, :3]
    cofactor = np.linalg.inv(linear).T * abs(np.linalg.det(linear))
    return normals @ cofactor.T


def mirrors(affine: np.ndarray) -> bool:
    """True if the map turns left-handed into right-handed, and so reverses the winding of faces."""
    return float(np.linalg.det(affine[:, :3])) < 0.0


def frame_kind(frames: list[np.ndarray]) -> str:
    """What frames [3, 4] have in common: "identity" (all the world's own), "similarity" (even scale) or "general"."""
    if all(np.array_equal(frame, IDENTITY) for frame in frames):
        return "identity"
    for frame in frames:
        gram = frame[:, :3].T @ frame[:, :3]
        size = np.trace(gram) / 3
        if np.abs(gram - size * np.eye(3)).max() > 64 * np.finfo(np.float64).eps * size:
            return "general"
    return "similarity"
