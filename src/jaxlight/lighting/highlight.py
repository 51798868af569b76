"""The highlight (N . H)^(128 shininess) of X3D 17.2.2.4, in full accuracy and fast.

A form knows two steps, which are stages of their own: how a sample is aligned with the half vector, a plane that says
all of N . H, and the power of it; and what derivatives of the first share. A derivative at a kink lies between 0 and
the one-sided derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .elementary import exp, exp2_fast, log2_fast, log_of_alignment, ratio, reciprocal_in_range, steep_reciprocal
from .vectors import Vector, cross, dot, half_vector, inverse_length_in_range, inverse_length_unscaled


class Highlight(NamedTuple):
    """How highlights are computed."""

    alignment: Callable[[Vector, Vector, Vector, bool], Array]
    """What the power asks to know of N . H, for unit n, l and v; told whether the tile is ordinary (see `ordinary`) and
    so l not near -v. Not to be differentiated."""
    slopes: Callable[[Array, Vector, Vector, Vector, bool], Any]
    """From the alignment and what it is taken of what its derivatives by all components share."""
    known_alignment: Callable[[bool, Array, Any, Vector, Vector, Vector], Array]
    """`alignment`, which is known, and told whether the tile is ordinary and its `slopes`, with derivatives by n, l
    and v."""
    asks_apart: bool
    """Whether it matters if l is near -v."""
    power: Callable[[Array, Array], Array]
    """(N . H)^exponent from the alignment; where N . H <= 0 it is 0^exponent: 1 for exponent 0, else 0."""
    known_power: Callable[[Array, Array, Array], Array]
    """`power(alignment, exponent)`, which is known to be the first argument, as a function of the other two."""


def highlight_of(accuracy: Literal["full", "fast"]) -> Highlight:
    """The form for `LightingOptions.accuracy`."""
    return FULL if accuracy == "full" else FAST


def _power_of(
    power: Callable[[Array, Array], Array], change: Callable[..., Array]
) -> tuple[Callable[[Array, Array], Array], Callable[[Array, Array, Array], Array]]:
    """`power` and `known_power` with the change of the power as `change`(power, alignment, exponent, and the changes of
    the latter two)."""

    @jax.custom_jvp
    def known(value: Array, alignment: Array, exponent: Array) -> Array:
        return value

    def of_power(primals: Any, tangents: Any) -> tuple[Array, Array]:
        value = own(*primals)
        return value, change(value, *primals, *tangents)

    def of_known(primals: Any, tangents: Any) -> tuple[Array, Array]:
        return primals[0], change(*primals, *tangents[1:])

    own = jax.custom_jvp(power)
    own.defjvp(of_power)
    known.defjvp(of_known)
    return own, known


_STEEPEST = 2.0**24
"""Below exponent 1 the slope of a power at 0 is infinite; it is held to this."""

# --- full: every digit that the inputs have ---------------------------------------------------------------------------

AWAY = 1.0
"""Stands for any N . H <= 0; a true alignment is at most 3/4."""


def aligned(n: Vector, l: Vector, v: Vector, ordinary: bool) -> Array:
    """N . H for unit n, l and v (undefined ones are 0); N . H - 1 where that is above -1/4.

    Close to N = H the dot product has no digits of the angle left, and an exponent of 128 would show it: there
    1 - N . H is taken from the difference, |N - H|^2 / 2. Where N . H <= 0: AWAY, with derivative 0.
    """
    # 1 / |l + v| here, and not in a stage before: near l = -v another rounding of l has another length of the sum.
    half, inverse = _half_and_inverse(l, v, ordinary)
    towards = half.scaled(inverse)
    difference = n - towards
    cosine, below_one = dot(n, towards), -0.5 * dot(difference, difference)
    return jnp.where(cosine > 0, jnp.where(below_one > -0.25, below_one, cosine), AWAY)


def _half_and_inverse(l: Vector, v: Vector, ordinary: bool) -> tuple[Vector, Array]:
    """l + v and 1 / |l + v|."""
    if ordinary:
        return l + v, inverse_length_in_range(l + v)
    half = half_vector(l, v)
    return half, inverse_length_unscaled(half)


class _AlignedSlopes(NamedTuple):
    """What the derivatives of an alignment by all components of n, l and v share, and is slow to compute."""

    inverse: Array
    """1 / |l + v|; 0 where N . H <= 0."""
    share: Array
    """1 / |l - v|^2 where l and v point apart, |l - v|^2 > 3; else 0. Not asked for in ordinary tiles."""


def _aligned_slopes(alignment: Array, n: Vector, l: Vector, v: Vector, ordinary: bool) -> _AlignedSlopes:
    inverse = jnp.where(alignment == AWAY, 0.0, _half_and_inverse(l, v, ordinary)[1])
    if ordinary:
        return _AlignedSlopes(inverse, jnp.zeros_like(inverse))
    apart = l - v
    squared = dot(apart, apart)
    return _AlignedSlopes(inverse, jnp.where(squared > 3, 1.0 / jnp.maximum(squared, 1.0), 0.0))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _aligned_known(ordinary: bool, alignment: Array, slopes: _AlignedSlopes, n: Vector, l: Vector, v: Vector) -> Array:
    return alignment


@_aligned_known.defjvp
def _aligned_known_jvp(ordinary, primals, tangents):
    """d(N . H) = H . dn + N . dH with dH the part of d(l + v) / |l + v| at right angles to H.

    Near the peak, N - H stands for N: rounded lengths of both would otherwise leave a part along H, as large as the
    angle between them. Where l and v point apart, dH is put together from its parts along l - v and l x v. The first is
    -H . d(l - v) / |l - v|, as H . (l - v) = 0: it has nothing to do with the large 1 / |l + v|.
    """
    (alignment, slopes, n, l, v), (_, _, dn, dl, dv) = primals, tangents
    half = l + v if ordinary else half_vector(l, v)
    towards, apart = half.scaled(slopes.inverse), l - v
    base = n - towards.scaled(jnp.where(alignment <= 0, 1.0, 0.0))
    if ordinary:
        across = base.scaled(slopes.inverse) - towards.scaled(slopes.inverse * dot(base, towards))
        return alignment, dot(across, dl + dv) + dot(towards, dn)
    side = cross(towards, apart)
    own = jnp.where(slopes.share > 0, 0.0, slopes.inverse)
    across = (
        base.scaled(own)
        - towards.scaled(own * dot(base, towards))
        + side.scaled((slopes.share * slopes.inverse) * dot(base, side))
    )
    along = towards.scaled(slopes.share * dot(base, apart))
    return alignment, dot(across - along, dl) + dot(across + along, dv) + dot(towards, dn)


def _power(alignment: Array, exponent: Array) -> Array:
    """(N . H)^exponent from `alignment`, with derivative 0 where N . H <= 0."""
    value = exp(exponent * log_of_alignment(alignment))
    return jnp.where(alignment == AWAY, jnp.where(exponent == 0, 1.0, 0.0), value)


def _power_change(power: Array, x: Array, exponent: Array, dx: Array, d_exponent: Array) -> Array:
    """d x^n = n x^(n-1) dx + x^n ln(x) dn; the products are formed first, for dx may be huge.

    Nearer than 2^-60 to 0 the slope is that of a kink.
    """
    faces = x != AWAY
    near = jnp.where(faces, x, 0.0)
    cosine = jnp.maximum(jnp.where(near <= 0, 1.0 + near, near), 2.0**-60)
    slope = jnp.minimum(exponent * (power * reciprocal_in_range(cosine)), _STEEPEST)
    change = slope * dx + (power * log_of_alignment(near)) * d_exponent
    return jnp.where(faces, change, 0.0)


FULL = Highlight(aligned, _aligned_slopes, _aligned_known, True, *_power_of(_power, _power_change))

# --- fast: fewer operations ------------------------------------------------------------------------------------------


def squared_cosine(n: Vector, l: Vector, v: Vector, ordinary: bool = False) -> Array:
    """(N . H)^2 without a unit half vector, 0 where N . H <= 0; its rounding counts exponent / 2 times in the power."""
    half = l + v
    cosine = dot(n, half)
    faces = cosine > 0
    return jnp.where(faces, ratio(cosine * cosine, jnp.where(faces, dot(half, half), 1.0)), 0.0)


class _SquaredSlopes(NamedTuple):
    inverse: Array
    """1 / |l + v|^2, 0 where N . H <= 0."""


def _squared_slopes(squared: Array, n: Vector, l: Vector, v: Vector, ordinary: bool) -> _SquaredSlopes:
    half = l + v
    faces = squared > 0
    return _SquaredSlopes(jnp.where(faces, steep_reciprocal(jnp.where(faces, dot(half, half), 1.0)), 0.0))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _squared_known(ordinary: bool, squared: Array, slopes: _SquaredSlopes, n: Vector, l: Vector, v: Vector) -> Array:
    return squared


@_squared_known.defjvp
def _squared_known_jvp(ordinary, primals, tangents):
    (squared, slopes, n, l, v), (_, _, dn, dl, dv) = primals, tangents
    half, change = l + v, dl + dv
    cosine = 2.0 * slopes.inverse * dot(n, half)
    moved = cosine * (dot(dn, half) + dot(n, change)) - (2.0 * slopes.inverse * squared) * dot(half, change)
    return squared, moved


def _power_of_squared(squared: Array, exponent: Array) -> Array:
    """`squared`^(exponent / 2)"""
    value = exp2_fast((0.5 * exponent) * log2_fast(jnp.where(squared > 0, squared, 1.0)))
    return jnp.where(squared > 0, value, jnp.where(exponent == 0, 1.0, 0.0))


def _power_of_squared_change(power: Array, squared: Array, exponent: Array, d_squared: Array, d_exponent: Array):
    faces = squared > 0
    base = jnp.where(faces, squared, 1.0)
    half = 0.5 * exponent
    slope = jnp.minimum(half * (power / base), _STEEPEST)
    change = slope * d_squared + (power * (0.5 * math.log(2)) * log2_fast(base)) * d_exponent
    return jnp.where(faces, change, 0.0)


FAST = Highlight(
    squared_cosine,
    _squared_slopes,
    _squared_known,
    False,
    *_power_of(_power_of_squared, _power_of_squared_change),
)
