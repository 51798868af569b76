"""Every geometry node as triangles, ready for the rasteriser."""

from __future__ import annotations

import math

import numpy as np

from ..scene import nodes
from . import facesets, primitives
from .triangles import Triangles

SEGMENTS = 64
"""Segments around a cone, cylinder or sphere when nothing is known of the picture."""
MIN_SEGMENTS, MAX_SEGMENTS = 16, 512


def tessellate(shape: nodes.Shape, segments: int = SEGMENTS) -> Triangles:
    """The triangles of a shape in its own coordinates, texture coordinates transformed as its appearance says.

    Faces are counterclockwise in front, whatever `ccw` says; faces without area are left out. A shape without
    geometry gives no triangles.

    Args:
        shape: the shape.
        segments: straight pieces around a curved primitive; its flat triangles lie inside the true surface by at most
            radius * (1 - cos(pi / segments)), and carry exact normals at their corners.

    Raises:
        ValueError: an index or a number of values that does not fit; names the shape and the field.
    """
    geometry = shape.geometry
    where = f"{shape.label}.geometry"
    match geometry:
        case None:
            empty = np.zeros((0, 3, 3))
            return Triangles(empty, empty, empty[..., :2])
        case nodes.Box():
            triangles = primitives.box(geometry)
        case nodes.Sphere():
            triangles = primitives.sphere(geometry, segments)
        case nodes.Cylinder():
            triangles = primitives.cylinder(geometry, segments)
        case nodes.Cone():
            triangles = primitives.cone(geometry, segments)
        case nodes.IndexedFaceSet():
            triangles = facesets.indexed_face_set(geometry, where)
        case nodes.IndexedTriangleSet() | nodes.TriangleSet():
            triangles = facesets.triangle_set(geometry, where)
        case _:
            raise ValueError(f"{where}: cannot be cut into triangles: {type(geometry).__name__}")
    return _with_texture_transform(triangles.without_degenerate(), shape)


def segments_for(radius_in_pixels: float, tolerance: float = 1 / 16) -> int:
    """Segments that keep the outline of a circle within `tolerance` pixels of the true one; a multiple of 8."""
    if radius_in_pixels <= tolerance:
        return MIN_SEGMENTS
    needed = math.pi / math.acos(max(1 - tolerance / radius_in_pixels, -1.0))
    return 8 * math.ceil(min(max(needed, MIN_SEGMENTS), MAX_SEGMENTS) / 8)


def _with_texture_transform(triangles: Triangles, shape: nodes.Shape) -> Triangles:
    """Texture coordinates through TextureTransform: Tc' = -C S R C T Tc, T first (X3D 18.4.7)."""
    transform = shape.appearance.texture_transform if shape.appearance else None
    if transform is None:
        return triangles
    cosine, sine = math.cos(transform.rotation), math.sin(transform.rotation)
    rotation = np.array([[cosine, -sine], [sine, cosine]])
    center = np.asarray(transform.center)
    turned = (triangles.texcoord + np.asarray(transform.translation) + center) @ rotation.T
    texcoord = turned * np.asarray(transform.scale) - center
    return Triangles(
        triangles.position, triangles.normal, texcoord, triangles.color, triangles.quadric, triangles.curved
    )
