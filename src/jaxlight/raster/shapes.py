"""Every geometry node as the rasteriser takes it: triangles, or the exact faces of a curved primitive."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from ..scene import nodes
from ..scene.document import PlacedShape
from ..scene.transforms import apply_to_points
from . import facesets, primitives
from .primitives import Primitive
from .triangles import Triangles

FARTHEST = 1e100
"""How far from the origin something may lie: the volumes and squares of what is nearer are finite."""


MAX_TRIANGLES = 1 << 25
"""Triangles and faces of all placed shapes together; a shape used again counts every time."""


def geometries_of(shapes: Sequence[PlacedShape]) -> tuple[Triangles | Primitive, ...]:
    """The geometry of every placed shape, in its own coordinates; shapes that are one node share it.

    Raises:
        ValueError: as `geometry_of`; there are more than MAX_TRIANGLES.
    """
    known: dict[int, Triangles | Primitive] = {}
    total = 0
    for number, placed in enumerate(shapes, start=1):
        key = id(placed.node)
        if key not in known:
            known[key] = geometry_of(placed.node)
        total += numbers_of(known[key])
        if total > MAX_TRIANGLES:
            raise ValueError(
                f"the scene has more than {MAX_TRIANGLES} triangles: {total} up to {placed.node.label}, "
                f"{number} of {len(shapes)} placed shapes (one used again counts every time)"
            )
    return tuple(known[id(placed.node)] for placed in shapes)


def numbers_of(geometry: Triangles | Primitive) -> int:
    """How many triangles or faces a geometry has; from inside a face is one more."""
    return 2 * len(geometry.faces) if isinstance(geometry, Primitive) else len(geometry)


def geometry_of(shape: nodes.Shape) -> Triangles | Primitive:
    """The triangles or faces of a shape in its own coordinates.

    Triangles are counterclockwise in front, whatever `ccw` says, and their texture coordinates are transformed as the
    appearance says; those without area are left out. A shape without geometry or coordinates gives no triangles.

    Raises:
        ValueError: an index or a number of values that does not fit, or coordinates beyond FARTHEST; names the shape
            and the field.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        found = _geometry_of(shape)
    if isinstance(found, Primitive):
        _check_reach(shape, found.half_size.max())
        return found
    _check_reach(shape, np.abs(found.position).max(initial=0.0))
    found = found.without_degenerate()
    return dataclasses.replace(found, texcoord=texture_transformed(found.texcoord, shape))


def _geometry_of(shape: nodes.Shape) -> Triangles | Primitive:
    geometry = shape.geometry
    where = f"{shape.label}.geometry"
    match geometry:
        case None:
            return Triangles.none()
        case nodes.Sphere():
            return primitives.sphere(geometry)
        case nodes.Cylinder():
            return primitives.cylinder(geometry)
        case nodes.Cone():
            return primitives.cone(geometry)
        case nodes.Box():
            return primitives.box(geometry)
        case nodes.IndexedFaceSet():
            return facesets.indexed_face_set(geometry, where)
        case nodes.IndexedTriangleSet() | nodes.TriangleSet():
            return facesets.triangle_set(geometry, where)
        case _:
            raise ValueError(f"{where}: cannot be rasterised: {type(geometry).__name__}")


def texture_transformed(texcoord: np.ndarray, shape: nodes.Shape) -> np.ndarray:
    """Texture coordinates [..., 2] through TextureTransform: Tc' = -C S R C T Tc, T first (X3D 18.4.8)."""
    transform = shape.appearance.texture_transform if shape.appearance else None
    if transform is None:
        return texcoord
    cosine, sine = math.cos(transform.rotation), math.sin(transform.rotation)
    rotation = np.array([[cosine, -sine], [sine, cosine]])
    center = np.asarray(transform.center)
    turned = (texcoord + np.asarray(transform.translation) + center) @ rotation.T
    return turned * np.asarray(transform.scale) - center


def world_bounds(placed: PlacedShape, geometry: Triangles | Primitive) -> tuple[np.ndarray, np.ndarray] | None:
    """Lowest and highest coordinates [3] of a box around a placed shape; None if it has no geometry.

    Raises:
        ValueError: it reaches farther than FARTHEST.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        if isinstance(geometry, Primitive):
            to_world = geometry.unit_to(placed.to_world)
            ends = [end for face in geometry.faces for end in face.bounds(to_world)]
        else:
            ends = apply_to_points(placed.to_world, geometry.position.reshape(-1, 3))
    if not len(ends):
        return None
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    _check_reach(placed.node, np.abs([low, high]).max())
    return low, high


def _check_reach(shape: nodes.Shape, farthest: float) -> None:
    if not farthest <= FARTHEST:
        raise ValueError(f"{shape.label}: lies up to {farthest:.3g} from the origin; at most {FARTHEST:g} is allowed")
