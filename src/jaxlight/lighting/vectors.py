"""Vectors as three planes, and the home of the zero vector: `inverse_length`."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .elementary import STEEPEST, power_of_two_above, reciprocal_of_power_of_two, reciprocal_root, second_factor


class Vector(NamedTuple):
    """Planes x, y, z of equal (broadcastable) shape."""

    x: Float[Array, ...]
    y: Float[Array, ...]
    z: Float[Array, ...]

    def __add__(self, other: Vector) -> Vector:  # a vector sum, not a tuple's
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


Matrix = tuple[Vector, Vector, Vector]
"""The rows of a matrix."""


def matrix_of(rows: Float[Array, "... 3 3"]) -> Matrix:
    """The matrix from an array that is indexed [..., row, column]."""
    return tuple(Vector(rows[..., i, 0], rows[..., i, 1], rows[..., i, 2]) for i in range(3))  # type: ignore[return-value]  # three rows


def transform(matrix: Matrix, v: Vector) -> Vector:
    """matrix v"""
    return Vector(*(dot(row, v) for row in matrix))


def unit(v: Vector) -> tuple[Vector, Array]:
    """v / |v| and |v|; the zero vector gives zero and 0, with derivative 0."""
    return normalised(v, inverse_length(v))


_LIFT = {jnp.dtype("float32"): 2.0**64, jnp.dtype("float64"): 2.0**512}


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def normalised(v: Vector, inverse: Array, in_range: bool = False) -> tuple[Vector, Array]:
    """v / |v| and |v|, given `inverse` = 1 / |v| (or 0 for the zero vector) of this very v.

    `in_range`: the square of v is known to be a normal number; the same to the last bit, with less to do.
    """
    u = v.scaled(inverse)
    if in_range:
        return u, dot(v, u)
    # Of a tiny vector the products with small components of u would underflow.
    lift = _LIFT[inverse.dtype]
    tiny = inverse > math.sqrt(lift)
    return u, dot(v.scaled(jnp.where(tiny, lift, 1.0)), u) * jnp.where(tiny, 1.0 / lift, 1.0)


@normalised.defjvp
def _normalised_jvp(in_range, primals, tangents):
    """d|v| = u . dv;  du = dv / |v| - u (u . dv) / |v|. The change of `inverse` is part of that.

    Divided first, and so last in reverse mode: 1 / |v| may be 1e-37, and a product with it lost before the difference.
    """
    (v, inverse), (dv, _) = primals, tangents
    u, length = _normalised_once(v, inverse)
    return (u, length), _turned(u, dv, inverse if in_range else jnp.minimum(inverse, STEEPEST[inverse.dtype]))


@jax.custom_jvp
def unit_planes(v: Float[Array, "3 ..."], inverse: Array) -> Float[Array, "3 ..."]:
    """v / |v| of `normalised` for a vector whose components are one array."""
    return v * inverse


@unit_planes.defjvp
def _unit_planes_jvp(primals, tangents):
    (v, inverse), (dv, _) = primals, tangents
    (u, _), (du, _) = jax.jvp(lambda v: normalised(v, inverse), (Vector(*v),), (Vector(*dv),))
    return jnp.stack(u), jnp.stack(du)


@jax.custom_jvp
def _normalised_once(v: Vector, inverse: Array) -> tuple[Vector, Array]:
    """`normalised` within its derivative."""
    return normalised(v, inverse)


@_normalised_once.defjvp
def _normalised_once_jvp(primals, tangents):
    (v, inverse), (dv, _) = primals, tangents
    u, length = _normalised_once(v, inverse)
    return (u, length), _turned(u, dv, second_factor(inverse))


def _turned(u: Vector, dv: Vector, inverse: Array) -> tuple[Vector, Array]:
    """The part of dv / |v| at right angles to u, and u . dv.

    Component x is dv.x (u.y^2 + u.z^2) - u.x (u.y dv.y + u.z dv.z): dv - u (u . dv) has no digits left along an axis
    that u almost points along, and u x (dv x u) none along an axis at right angles to a dv that is so to u too.
    """
    turn = dv.scaled(inverse)
    square = Vector(u.x * u.x, u.y * u.y, u.z * u.z)
    along = Vector(u.x * turn.x, u.y * turn.y, u.z * turn.z)
    across = Vector(
        turn.x * (square.y + square.z) - u.x * (along.y + along.z),
        turn.y * (square.z + square.x) - u.y * (along.z + along.x),
        turn.z * (square.x + square.y) - u.z * (along.x + along.y),
    )
    return across, dot(u, dv)


@jax.custom_jvp
def half_vector(l: Vector, v: Vector) -> Vector:
    """l + v of unit (or zero) vectors; where these point apart, at right angles to l - v as it must be.

    Close to l = -v the rounding of their lengths is all that l + v has along l - v, and turns it.
    """
    total, difference = l + v, l - v
    excess = dot(total, difference)  # |l|^2 - |v|^2
    # Of ordinary tiles, which know no such vectors, nothing is more than rounding beyond 3.
    apart = dot(difference, difference) > 3.25
    return total - difference.scaled(jnp.where(apart, 0.25 * excess, 0.0))


@half_vector.defjvp
def _half_vector_jvp(primals, tangents):
    return half_vector(*primals), tangents[0] + tangents[1]


@jax.custom_jvp
def inverse_length(v: Vector) -> Array:
    """1 / |v|, and 0 for the zero vector.

    Scaled by a power of two first, so that squares neither overflow nor underflow: in float32 right between 1e-37
    and 1e37.
    """
    largest = jnp.maximum(jnp.maximum(jnp.abs(v.x), jnp.abs(v.y)), jnp.abs(v.z))
    scale = reciprocal_of_power_of_two(power_of_two_above(largest))
    return inverse_length_unscaled(v.scaled(scale)) * scale


@jax.custom_jvp
def inverse_length_unscaled(v: Vector) -> Array:
    """`inverse_length` of vectors whose squares do not overflow; 0 if the square is no normal number."""
    squared = dot(v, v)
    return jnp.where(squared < jnp.finfo(squared.dtype).tiny, 0.0, reciprocal_root(squared))


@jax.custom_jvp
def inverse_length_in_range(v: Vector) -> Array:
    """`inverse_length`, to the last bit, of vectors whose squares are known to be normal numbers."""
    return reciprocal_root(dot(v, v))


def _inverse_length_jvp(function, primals, tangents):
    """d(1/|v|) = -(u . dv) / |v|^2"""
    (v,), (dv,) = primals, tangents
    inverse = function(v)
    return inverse, -(inverse * (second_factor(inverse) * dot(v.scaled(inverse), dv)))


inverse_length.defjvp(partial(_inverse_length_jvp, inverse_length))
inverse_length_unscaled.defjvp(partial(_inverse_length_jvp, inverse_length_unscaled))
inverse_length_in_range.defjvp(partial(_inverse_length_jvp, inverse_length_in_range))
