"""Box, Cone, Cylinder and Sphere with the texture mapping that X3D 13.3 gives each of them.

A box is triangles. The others are exact faces of unit size, which their own size stretches.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..scene import nodes
from .quadrics import Face
from .triangles import Triangles

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


class Primitive(NamedTuple):
    """The exact faces of a curved shape."""

    faces: tuple[Face, ...]
    """In unit coordinates, within [-1, 1]^3."""
    half_size: np.ndarray
    """[3], by which the shape's own coordinates are larger."""

    def unit_to(self, to_other: np.ndarray) -> np.ndarray:
        """[3, 4], from unit coordinates to where `to_other` maps the shape's own."""
        return np.hstack([to_other[:, :3] * self.half_size, to_other[:, 3:]])


def sphere(node: nodes.Sphere) -> Primitive:
    """X3D 13.3.7."""
    return Primitive((_SPHERE,), np.full(3, node.radius))


def cylinder(node: nodes.Cylinder) -> Primitive:
    """Side, top and bottom as asked for (X3D 13.3.3)."""
    asked = (node.side, _CYLINDER), (node.top, _TOP), (node.bottom, _BOTTOM)
    return _stretched(asked, node.radius, node.height)


def cone(node: nodes.Cone) -> Primitive:
    """Side and bottom as asked for (X3D 13.3.2)."""
    return _stretched(((node.side, _CONE), (node.bottom, _BOTTOM)), node.bottom_radius, node.height)


def _stretched(asked: tuple[tuple[bool, Face], ...], radius: float, height: float) -> Primitive:
    faces = tuple(face for is_asked, face in asked if is_asked)
    return Primitive(faces, np.array([radius, height / 2, radius]))


def _around(points: np.ndarray) -> np.ndarray:
    """s from the back (-z), counterclockwise seen from above: 1/4 at -x, 1/2 at +z (X3D 13.3.2)."""
    return np.arctan2(-points[:, 0], -points[:, 2]) / (2 * np.pi) % 1.0


def _on_sphere(points: np.ndarray) -> np.ndarray:
    """t is the angle from the lower pole (X3D 13.3.7)."""
    from_pole = np.arctan2(np.hypot(points[:, 0], points[:, 2]), -points[:, 1])
    return np.stack([_around(points), from_pole / np.pi], axis=1)


def _on_side(points: np.ndarray) -> np.ndarray:
    """t is the height above the lower end (X3D 13.3.2, 13.3.3)."""
    return np.stack([_around(points), (points[:, 1] + 1) / 2], axis=1)


def _on_top(points: np.ndarray) -> np.ndarray:
    """The disc of the texture, upright with -z up (X3D 13.3.3)."""
    return (points[:, [0, 2]] * [1, -1] + 1) / 2


def _on_bottom(points: np.ndarray) -> np.ndarray:
    """The disc of the texture, upright with +z up (X3D 13.3.3)."""
    return (points[:, [0, 2]] + 1) / 2


_APEX = (1.0, (0.0, 0.0, 0.0))
_UPPER, _LOWER = (1.0, (1.0, 0.0, 1.0)), (-1.0, (1.0, 0.0, 1.0))
"""The discs of the ends."""
_SPHERE = Face((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), 1.0, ((0.0, (1.0, 1.0, 1.0)),), _on_sphere)
_CYLINDER = Face((1.0, 0.0, 1.0), (0.0, 0.0, 0.0), 1.0, (_UPPER, _LOWER), _on_side, lowest=-1.0, highest=1.0)
_CONE = Face((1.0, -0.25, 1.0), (0.0, 1.0, 0.0), 0.0, (_APEX, _LOWER), _on_side, lowest=-1.0, highest=1.0)
_TOP = Face((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.0, (_UPPER,), _on_top, tilt=1.0, radius=1.0)
_BOTTOM = Face((0.0, 0.0, 0.0), (0.0, -1.0, 0.0), 0.0, (_LOWER,), _on_bottom, tilt=-1.0, radius=1.0)
