"""The scalar factors of the lighting equation (X3D 17.2.2.4), each with its singular points, limits and subgradients.

A derivative at a kink lies between 0 and the one-sided derivatives; at a jump it is 0; at a domain's end it is the
derivative from inside.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .elementary import arctangent, exp, one_minus_exp, ratio, steep_reciprocal
from .vectors import Vector, cross, dot

_HUGE = {jnp.dtype("float32"): 1e37, jnp.dtype("float64"): 1e300}
_ROOT_OF_HUGEST = {jnp.dtype("float32"): 2.0**63, jnp.dtype("float64"): 2.0**511}


def positive_part(x: Array) -> Array:
    """x where positive, else 0, with derivative 0 at 0: what makes a dot product the "modified" one of 17.2.2.4."""
    return jnp.where(x > 0, x, 0.0)


# --- attenuation ------------------------------------------------------------------------------------------------------


@jax.custom_jvp
def attenuation(c1: Array, c2: Array, c3: Array, d: Array) -> Array:
    """1 / max(c1 + c2 d + c3 d^2, 1). Where the sum is exactly 1 the derivative is that of 1 / sum."""
    total = c1 + (c2 + c3 * d) * d
    return 1.0 / jnp.where(total < 1, 1.0, total)


@attenuation.defjvp
def _attenuation_jvp(primals, tangents):
    factor = attenuation(*primals)
    return factor, _attenuation_change(factor, primals, tangents)


@jax.custom_jvp
def known_attenuation(factor: Array, c1: Array, c2: Array, c3: Array, d: Array) -> Array:
    """`attenuation(c1, c2, c3, d)`, which is known to be the first argument, as a function of the others."""
    return factor


@known_attenuation.defjvp
def _known_attenuation_jvp(primals, tangents):
    return primals[0], _attenuation_change(primals[0], primals[1:], tangents[1:])


def _attenuation_change(factor, primals, tangents):
    (c1, c2, c3, d), (dc1, dc2, dc3, dd) = primals, tangents
    total = c1 + (c2 + c3 * d) * d
    active = jnp.where(total >= 1, factor, 0.0)
    relative = active * d
    slope = jnp.minimum(c2 + 2.0 * c3 * d, _HUGE[factor.dtype]) * active
    held = jnp.minimum(relative, _ROOT_OF_HUGEST[factor.dtype])
    # Twice times the factor: the square of a far light's underflows, where a step as large would make up for it.
    return -(active * (active * dc1 + relative * dc2 + slope * dd) + held * (held * dc3))


# --- spot -------------------------------------------------------------------------------------------------------------


def spot(angle: Array, beam_width: Array, cut_off_angle: Array) -> Array:
    """The spotlight factor of table 17.4.

    beam_width >= cut_off_angle: full intensity inside cut_off_angle, the ramp is not evaluated.
    """
    has_ramp = beam_width < cut_off_angle
    width = jnp.where(has_ramp, cut_off_angle - beam_width, 1.0)
    on_ramp = has_ramp & (angle > beam_width) & (angle < cut_off_angle)
    ramp = ratio(cut_off_angle - jnp.where(on_ramp, angle, beam_width), width)
    return jnp.where(on_ramp, ramp, jnp.where(angle >= cut_off_angle, 0.0, 1.0))


@jax.custom_jvp
def angle_between(a: Vector, b: Vector) -> Array:
    """The angle in [0, pi] between two unit vectors, accurate to its last bits everywhere; pi/2 if one of them is zero.

    Derivative 0 where the angle is 0 or pi.
    """
    c = _perpendicular(a, b)
    return arctangent(jnp.sqrt(_positive(dot(c, c))), dot(a, b))


@angle_between.defjvp
def _angle_jvp(primals, tangents):
    return angle_between(*primals), _angle_change(primals, tangents)


@jax.custom_jvp
def known_angle(angle: Array, a: Vector, b: Vector) -> Array:
    """`angle_between(a, b)`, which is known to be the first argument, as a function of the others."""
    return angle


@known_angle.defjvp
def _known_angle_jvp(primals, tangents):
    return primals[0], _angle_change(primals[1:], tangents[1:])


def _angle_change(primals, tangents):
    """d angle = (cos angle * d sin angle - sin angle * d cos angle), with sin angle = |a x b|."""
    (a, b), (da, db) = primals, tangents
    c = _perpendicular(a, b)
    squared = dot(c, c)
    sine = jnp.sqrt(_positive(squared))
    normal = c.scaled(jnp.where(squared > 0, 1.0 / jnp.where(squared > 0, sine, 1.0), 0.0))
    d_cosine = dot(da, b) + dot(a, db)
    d_sine = dot(normal, cross(da, b) + cross(a, db))
    return jnp.where(squared > 0, dot(a, b) * d_sine - sine * d_cosine, 0.0)


def _perpendicular(a: Vector, b: Vector) -> Vector:
    """a x b of unit vectors, from their difference (or sum): exactly 0 where they are parallel, however rounded."""
    sign = jnp.where(dot(a, b) < 0, 1.0, -1.0)
    return cross(a, b + a.scaled(sign))


def _positive(x: Array) -> Array:
    """x with 0 replaced by the smallest normal number, so that its square root has a derivative."""
    return jnp.where(x > 0, x, jnp.finfo(x.dtype).tiny)


# --- fog --------------------------------------------------------------------------------------------------------------


@jax.custom_jvp
def linear_fog(distance: Array, visibility: Array) -> tuple[Array, Array]:
    """f0 of table 17.5, LINEAR, and 1 - f0 to full accuracy; visibility <= 0 means no fog."""
    present, within, remaining = _fog_range(distance, visibility)
    safe = jnp.where(within, visibility, 1.0)
    clear = jnp.where(within, remaining / safe, 0.0)
    fogged = jnp.where(within, distance / safe, 1.0)
    return jnp.where(present, clear, 1.0), jnp.where(present, fogged, 0.0)


@linear_fog.defjvp
def _linear_fog_jvp(primals, tangents):
    """df0 = ((d / V) dV - dd) / V: no square of V, which may be 1e-37 or 1e37."""
    (distance, visibility), (d_distance, d_visibility) = primals, tangents
    clear, fogged = linear_fog(distance, visibility)
    _, within, _ = _fog_range(distance, visibility)
    slope = jnp.where(within, steep_reciprocal(jnp.where(within, visibility, 1.0)), 0.0)
    change = (jnp.where(within, fogged, 0.0) * d_visibility - d_distance) * slope
    return (clear, fogged), (change, -change)


def exponential_fog(distance: Array, visibility: Array) -> tuple[Array, Array]:
    """f0 of table 17.5, EXPONENTIAL, and 1 - f0 to full accuracy; visibility <= 0 means no fog."""
    present, within, remaining = _fog_range(distance, visibility)
    depth = ratio(jnp.where(within, distance, 0.0), remaining)
    clear = jnp.where(within, exp(-depth), 0.0)
    fogged = jnp.where(within, one_minus_exp(-depth), 1.0)
    return jnp.where(present, clear, 1.0), jnp.where(present, fogged, 0.0)


def _fog_range(distance: Array, visibility: Array) -> tuple[Array, Array, Array]:
    """Whether there is fog, whether the sample is nearer than the visibility, and how much (1 if it is not)."""
    present, remaining = visibility > 0, visibility - distance
    within = present & (remaining > 0)  # a difference that is flushed to zero is none
    return present, within, jnp.where(within, remaining, 1.0)
