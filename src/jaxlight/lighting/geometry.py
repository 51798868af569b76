"""Where samples are and what they face: planes [rows, lanes], from arrays that are read where they lie."""

from __future__ import annotations

import operator
from typing import NamedTuple, cast

import jax.numpy as jnp
from jaxtyping import Array, Float

from .stages import Stage
from .unstored import Inlined
from .vectors import Vector, inverse_length, inverse_length_in_range, normalised, unit_planes


class Geometry(NamedTuple):
    """What a tile of samples knows of itself and the viewer; planes [rows, lanes]."""

    position: Vector
    eye: Vector
    """The viewer's position, [1, 1] each."""
    normal: Vector
    """Unit normal."""
    to_viewer: Vector
    """Unit vector to the viewer."""
    distance: Array
    """Distance to the viewer."""


class Unread(NamedTuple):
    """Vectors or colours of samples where they lie in memory, in the two forms that XLA reads at full speed."""

    components: tuple[Array, ...]
    """For loops over samples."""
    planes: Float[Array, "components rows lanes"] | None
    """For loops over samples and components; None: not read in such loops."""

    @property
    def vector(self) -> Vector:
        """Three components."""
        return Vector(*self.components)

    def stacked(self) -> Float[Array, "components rows lanes"]:
        """All components in one."""
        return jnp.stack(self.components) if self.planes is None else self.planes


def directions(
    stage: Stage, position: Unread, normal: Unread, eye: Float[Array, "3 1 1"]
) -> tuple[Vector, Vector, Array]:
    """The unit normal, the unit vector to the viewer, and the distance to it."""
    viewer = _components(eye)
    inverse = stage.each(inverse_distance, viewer, position.vector, has_forms=True)
    to_viewer = stage.each(_directions, eye, position.stacked(), derived=(inverse,))
    distance = stage.each(_distance, viewer, position.vector, derived=(inverse,), has_forms=True)
    unit_normal = stage.each(unit_planes, normal.stacked(), derived=(stage.each(inverse_length, normal.vector),))
    return _components(unit_normal), _components(to_viewer), distance


def inverse_distance(end: Vector, start: Vector, *, ordinary: bool) -> Array:
    return (inverse_length_in_range if ordinary else inverse_length)(end - start)


def _components(planes: Float[Array, "3 ..."]) -> Vector:
    return Vector(*(cast(Array, Inlined(operator.itemgetter(i), (planes,))) for i in range(3)))


def _directions(end: Array, start: Array, inverse: Array) -> Array:
    return unit_planes(end - start, inverse)


def _distance(end: Vector, start: Vector, inverse: Array, *, ordinary: bool) -> Array:
    return normalised(end - start, inverse, ordinary)[1]
