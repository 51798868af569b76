"""Spheres, cylinders and cones by textbook formulas (X3D 13.3), float64: every ray against every primitive."""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass
class Seen:
    """What rays meet first, N of them; `along` is infinite where that is nothing."""

    along: np.ndarray
    which: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    texcoord: np.ndarray
    margin: np.ndarray
    """How near each ray is to an outline or an end, of unit size; far above rounding what it meets is clear."""


def cast(origin: np.ndarray, rays: np.ndarray, primitives: list[tuple[str, np.ndarray, np.ndarray, bool]]) -> Seen:
    """`primitives`: kind, half size [3], to_world [3, 4], solid. Normals are turned towards the eye."""
    count = len(rays)
    seen = Seen(
        np.full(count, np.inf),
        np.full(count, -1),
        np.zeros((count, 3)),
        np.zeros((count, 3)),
        np.zeros((count, 2)),
        np.full(count, np.inf),
    )
    for number, (kind, half, to_world, solid) in enumerate(primitives):
        linear = to_world[:, :3] @ np.diag(half)
        start = np.linalg.solve(linear, origin - to_world[:, 3])
        ray = np.linalg.solve(linear, rays.T).T
        for t, normal, texcoord, ok, margin in _candidates(kind, start, ray):
            seen.margin = np.minimum(seen.margin, margin)
            outside = np.einsum("ni,ni->n", normal, ray) < 0
            nearer = ok & (t > 0) & (t < seen.along) & (outside | (not solid))
            world = np.linalg.solve(linear.T, normal.T).T
            world = np.where(outside[:, None], world, -world) / np.linalg.norm(world, axis=1, keepdims=True)
            seen.along[nearer], seen.which[nearer] = t[nearer], number
            seen.point[nearer] = origin + t[nearer, None] * rays[nearer]
            seen.normal[nearer], seen.texcoord[nearer] = world[nearer], texcoord[nearer]
    return seen


def _candidates(kind: str, start: np.ndarray, ray: np.ndarray):
    """t, normal, texture coordinates, whether it lies on the unit primitive, and the margin, of each hit."""
    x, y, z = ray.T
    p, q, r = start
    with np.errstate(all="ignore"):
        if kind == "sphere":
            a, b, c = x * x + y * y + z * z, p * x + q * y + r * z, p * p + q * q + r * r - 1
        elif kind == "cylinder":
            a, b, c = x * x + z * z, p * x + r * z, p * p + r * r - 1
        else:  # x^2 + z^2 = ((1 - y) / 2)^2
            a, b = x * x + z * z - y * y / 4, p * x + r * z + (1 - q) * y / 4
            c = p * p + r * r - (1 - q) ** 2 / 4
        discriminant = b * b - a * c
        for sign in (-1, 1):
            t = (-b + sign * np.sqrt(discriminant)) / a
            at = start + t[:, None] * ray
            s = (np.arctan2(-at[:, 0], -at[:, 2]) / (2 * np.pi)) % 1
            if kind == "sphere":
                normal, ok = at, discriminant >= 0
                texcoord = np.stack([s, np.arccos(np.clip(-at[:, 1], -1, 1)) / np.pi], axis=1)
                margin = np.abs(discriminant) / a
            else:
                slope = 0.0 if kind == "cylinder" else (1 - at[:, 1]) / 4
                normal = np.stack([at[:, 0], slope + 0 * s, at[:, 2]], axis=1)
                ok = (discriminant >= 0) & (np.abs(at[:, 1]) <= 1)
                texcoord = np.stack([s, (at[:, 1] + 1) / 2], axis=1)
                margin = np.fmin(np.abs(discriminant) / (b * b), np.abs(np.abs(at[:, 1]) - 1))
            yield t, normal, texcoord, ok, margin
        for end, up in {"sphere": [], "cylinder": [(1.0, 1.0), (-1.0, -1.0)], "cone": [(-1.0, -1.0)]}[kind]:
            t = (end - q) / y
            at = start + t[:, None] * ray
            from_axis = np.hypot(at[:, 0], at[:, 2])
            normal = np.broadcast_to([0.0, up, 0.0], at.shape)
            texcoord = np.stack([at[:, 0], -up * at[:, 2]], axis=1) / 2 + 0.5
            yield t, normal, texcoord, from_axis <= 1, np.abs(from_axis - 1)
