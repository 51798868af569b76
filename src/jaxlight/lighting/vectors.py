"""Vectors as three planes, and the home of the zero vector: `unit`."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .elementary import power_of_two_above, reciprocal_of_power_of_two


class Vector(NamedTuple):
    """Planes x, y, z of equal (broadcastable) shape."""

    x: Float[Array, "..."]
    y: Float[Array, "..."]
    z: Float[Array, "..."]

    def __add__(self, other: Vector) -> Vector:  # type: ignore[override]  # a vector sum, not a tuple's
        return Vector(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Vector) -> Vector:
        return Vector(self.x - other.x, self.y - other.y, self.z - other.z)

    def __neg__(self) -> Vector:
        return Vector(-self.x, -self.y, -self.z)

    def scaled(self, factor: Array) -> Vector:
        """Every component times `factor`."""
        return Vector(self.x * factor, self.y * factor, self.z * factor)


def dot(a: Vector, b: Vector) -> Array:
    """a . b"""
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: Vector, b: Vector) -> Vector:
    """a x b"""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def transform(matrix: Float[Array, "... 3 3"], v: Vector) -> Vector:
    """matrix v; `matrix` indexed [..., row, column] with leading axes that broadcast against the planes."""
    rows = [dot(Vector(matrix[..., i, 0], matrix[..., i, 1], matrix[..., i, 2]), v) for i in range(3)]
    return Vector(*rows)


@jax.custom_jvp
def unit(v: Vector) -> tuple[Vector, Array]:
    """v / |v| and |v|.

    The zero vector gives zero and 0, with derivative 0. Scaled by a power of two first, so that squares neither
    overflow nor underflow between 1e-37 and 1e37 in float32.
    """
    largest = jnp.maximum(jnp.maximum(jnp.abs(v.x), jnp.abs(v.y)), jnp.abs(v.z))
    scale = power_of_two_above(largest)
    near_one = v.scaled(reciprocal_of_power_of_two(scale))
    squared = dot(near_one, near_one)
    is_zero = largest == 0
    length = jnp.sqrt(jnp.where(is_zero, 1.0, squared))
    direction = near_one.scaled(jnp.where(is_zero, 0.0, 1.0 / length))
    return direction, jnp.where(is_zero, 0.0, length * scale)


@unit.defjvp
def _unit_jvp(primals, tangents):
    """d|v| = u . dv;  du = (dv - u d|v|) / |v|."""
    (v,), (dv,) = primals, tangents
    u, length = unit(v)
    along = dot(u, dv)
    inverse = jnp.where(length == 0, 0.0, 1.0 / jnp.where(length == 0, 1.0, length))
    return (u, length), ((dv - u.scaled(along)).scaled(inverse), along)
