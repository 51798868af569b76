"""Box, Cone, Cylinder and Sphere as triangles, with the texture mapping that X3D 13.3 gives each of them.

Curved surfaces are inscribed: corners and corner normals are exact, and between the corners the flat triangles lie
inside by at most radius * (1 - cos(pi / segments)). The quadric beside them lets the rasteriser put that right.
"""

from __future__ import annotations

import numpy as np

from ..scene import nodes
from .triangles import Quadric, Triangles

# Right and up of a texture on each face of a box, seen from outside (X3D 13.3.1).
# Front, back, right, left, top, bottom.
_BOX_RIGHT = np.array([[1, 0, 0], [-1, 0, 0], [0, 0, -1], [0, 0, 1], [1, 0, 0], [1, 0, 0]], dtype=np.float64)
_BOX_UP = np.array([[0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], dtype=np.float64)
_SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
_SPLIT = np.array([[0, 1, 2], [0, 2, 3]])


def box(node: nodes.Box) -> Triangles:
    """Twelve triangles; the texture lies upright on each face (X3D 13.3.1)."""
    signs = 2 * _SQUARE - 1
    outward = np.cross(_BOX_RIGHT, _BOX_UP)
    right, up = signs[None, :, :1] * _BOX_RIGHT[:, None], signs[None, :, 1:] * _BOX_UP[:, None]
    corners = (outward[:, None] + right + up) * np.asarray(node.size) / 2
    return Triangles(
        position=corners[:, _SPLIT].reshape(12, 3, 3),
        normal=np.repeat(outward, 2, axis=0)[:, None].repeat(3, axis=1),
        texcoord=np.tile(_SQUARE[_SPLIT], (6, 1, 1)),
    )


def sphere(node: nodes.Sphere, segments: int) -> Triangles:
    """Segments around, half as many from pole to pole; s from the back (-z), t from the lower pole (X3D 13.3.7)."""
    rows = max(segments // 2, 2)
    s, t = np.linspace(0, 1, segments + 1), np.linspace(0, 1, rows + 1)
    ring, height = np.sin(np.pi * t), -np.cos(np.pi * t)
    ring[[0, -1]] = 0.0
    direction = _around(s)[None] * ring[:, None, None] + height[:, None, None] * np.array([0.0, 1.0, 0.0])
    texcoord = np.stack(np.broadcast_arrays(s[None], t[:, None]), axis=-1)
    unit, st = _grid(direction), _grid(texcoord)
    # At a pole a triangle has the mean s of its two other corners.
    for corner, others in ((0, (1, 2)), (1, (2, 0)), (2, (0, 1))):
        at_pole = (st[:, corner, 1] == 0) | (st[:, corner, 1] == 1)
        st[at_pole, corner, 0] = st[at_pole][:, others, 0].mean(axis=1)
    exact = Quadric((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), node.radius**2)
    return _curved(node.radius * unit, unit, st, exact)


def cylinder(node: nodes.Cylinder, segments: int) -> Triangles:
    """Side, top and bottom as asked for (X3D 13.3.3)."""
    s, half = np.linspace(0, 1, segments + 1), node.height / 2
    around = _around(s)
    parts = []
    if node.side:
        rim = node.radius * around
        lift = np.array([0.0, half, 0.0])
        position = np.stack([rim - lift, rim + lift])
        texcoord = np.stack(np.broadcast_arrays(s[None], np.array([[0.0], [1.0]])), axis=-1)
        normal = np.broadcast_to(around, position.shape)
        exact = Quadric((1.0, 0.0, 1.0), (0.0, 0.0, 0.0), node.radius**2, -half, half)
        parts.append(_curved(_grid(position), _grid(normal), _grid(texcoord), exact))
    if node.top:
        parts.append(_cap(around, node.radius, half, up=True))
    if node.bottom:
        parts.append(_cap(around, node.radius, -half, up=False))
    return _joined(parts)


def cone(node: nodes.Cone, segments: int) -> Triangles:
    """Side and bottom as asked for (X3D 13.3.2)."""
    s, half, radius = np.linspace(0, 1, segments + 1), node.height / 2, node.bottom_radius
    around = _around(s)
    parts = []
    if node.side:
        middle = (s[1:] + s[:-1]) / 2
        apex = np.broadcast_to(np.array([0.0, half, 0.0]), (segments, 3))
        rim = radius * around - [0, half, 0]
        position = np.stack([apex, rim[:-1], rim[1:]], axis=1)
        slope = np.array([0.0, radius, 0.0])
        outward = np.stack([_around(middle), around[:-1], around[1:]], axis=1) * node.height + slope
        texcoord = np.stack(
            [np.stack([middle, s[:-1], s[1:]], axis=1), np.tile([1.0, 0.0, 0.0], (segments, 1))], axis=-1
        )
        exact = Quadric((1.0, -((radius / node.height) ** 2), 1.0), (0.0, half, 0.0), 0.0, -half, half)
        parts.append(_curved(position, outward, texcoord, exact))
    if node.bottom:
        parts.append(_cap(around, radius, -half, up=False))
    return _joined(parts)


def _around(s: np.ndarray) -> np.ndarray:
    """Unit vectors from the back (-z), counterclockwise seen from above: s = 1/4 is -x, 1/2 is +z (X3D 13.3.2)."""
    quarter = 4 * s
    # Exact on the axes, so that the seam closes and quarter points are round numbers.
    sine, cosine = np.sin(np.pi / 2 * quarter), np.cos(np.pi / 2 * quarter)
    on_axis = quarter == np.round(quarter)
    sine, cosine = (np.where(on_axis, np.round(x), x) for x in (sine, cosine))
    return np.stack([-sine, np.zeros_like(s), -cosine], axis=-1)


def _grid(values: np.ndarray) -> np.ndarray:
    """Values [rows, columns, k] at the points of a grid -> its triangles [2 (rows - 1)(columns - 1), 3, k]."""
    a, b, c, d = values[:-1, :-1], values[:-1, 1:], values[1:, 1:], values[1:, :-1]
    both = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2)
    return both.reshape(-1, 3, values.shape[2])


def _cap(around: np.ndarray, radius: float, y: float, *, up: bool) -> Triangles:
    """A disc across the y axis; the texture's disc stands upright when the cap is tilted towards the viewer."""
    rim = radius * around[:-1] + [0, y, 0]
    following = np.roll(rim, -1, axis=0)
    center = np.broadcast_to(np.array([0.0, y, 0.0]), rim.shape)
    position = np.stack([center, rim, following] if up else [center, following, rim], axis=1)
    flip = -1.0 if up else 1.0
    texcoord = np.stack([position[..., 0], flip * position[..., 2]], axis=-1) / (2 * radius) + 0.5
    normal = np.broadcast_to(np.array([0.0, -flip, 0.0]), position.shape)
    return Triangles(position, np.array(normal), texcoord)


def _curved(position: np.ndarray, normal: np.ndarray, texcoord: np.ndarray, exact: Quadric) -> Triangles:
    return Triangles(position, normal, texcoord, None, exact, np.ones(len(position), dtype=bool))


def _joined(parts: list[Triangles]) -> Triangles:
    """Several parts of one primitive; at most the first is curved."""
    if not parts:
        empty = np.zeros((0, 3, 3))
        return Triangles(empty, empty, empty[..., :2])
    curved = np.concatenate([np.zeros(len(p), dtype=bool) if p.curved is None else p.curved for p in parts])
    return Triangles(
        np.concatenate([p.position for p in parts]),
        np.concatenate([p.normal for p in parts]),
        np.concatenate([p.texcoord for p in parts]),
        None,
        parts[0].quadric,
        curved,
    )
