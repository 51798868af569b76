"""The scalar factors of the lighting equation (X3D 17.2.2.4), each with its singular points, limits and subgradients.

A derivative at a kink lies between 0 and the one-sided derivatives; at a jump it is 0; at a domain's end it is the
derivative from inside.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .elementary import arctangent, exp, log_of_cosine
from .vectors import Vector, cross, dot

_TINY = {jnp.dtype("float32"): 1e-30, jnp.dtype("float64"): 1e-280}
_HUGE = {jnp.dtype("float32"): 1e37, jnp.dtype("float64"): 1e300}


def modified_dot(a: Vector, b: Vector) -> Array:
    """a . b where positive, else 0, with derivative 0 at 0 ("modified vector dot product", X3D 17.2.2.4)."""
    value = dot(a, b)
    return jnp.where(value > 0, value, 0.0)


# --- highlight: (N . H)^(128 shininess) -------------------------------------------------------------------------------


def highlight(n: Vector, l: Vector, v: Vector, exponent: Array) -> Array:
    """(N . (L + V)/|L + V|)^exponent with the modified dot product; n, l, v unit or zero vectors.

    N . H <= 0 (and L = -V, where H is undefined) gives 0^exponent: 1 for exponent 0, else 0, with derivative 0.
    """
    log_cosine, faces = log_cosine_of_half_angle(n, l + v)
    return jnp.where(faces, exp(exponent * log_cosine), jnp.where(exponent == 0, 1.0, 0.0))


@jax.custom_jvp
def log_cosine_of_half_angle(n: Vector, h: Vector) -> tuple[Float[Array, "..."], Bool[Array, "..."]]:
    """ln(N . H / |H|) and whether N . H > 0; where it is not, the logarithm is given as 0 with derivative 0.

    Close to N = H the dot product has no digits of the angle left, and an exponent of 128 would show it: the
    logarithm is then taken from the sine, |N x H| / |H|.
    """
    n_dot_h, h_dot_h = dot(n, h), dot(h, h)
    c = cross(n, h)
    faces = n_dot_h > 0
    inverse_squared = 1.0 / jnp.where(faces, h_dot_h, 1.0)
    cosine = jnp.where(faces, n_dot_h * jnp.sqrt(inverse_squared), 1.0)
    sine_squared = jnp.where(faces, dot(c, c) * inverse_squared, 0.0)
    return jnp.where(faces, log_of_cosine(jnp.minimum(cosine, 1.0), sine_squared), 0.0), faces


@log_cosine_of_half_angle.defjvp
def _log_cosine_jvp(primals, tangents):
    """d ln(n.h / |h|) = (n.dh + dn.h) / n.h - h.dh / h.h"""
    (n, h), (dn, dh) = primals, tangents
    value, faces = log_cosine_of_half_angle(n, h)
    per_cosine = jnp.where(faces, 1.0 / jnp.maximum(jnp.where(faces, dot(n, h), 1.0), _TINY[value.dtype]), 0.0)
    per_square = jnp.where(faces, 1.0 / jnp.where(faces, dot(h, h), 1.0), 0.0)
    towards = n.scaled(per_cosine) - h.scaled(per_square)
    change = dot(towards, dh) + dot(h.scaled(per_cosine), dn)
    return (value, faces), (change, np.zeros(faces.shape, jax.dtypes.float0))


# --- attenuation ------------------------------------------------------------------------------------------------------


@jax.custom_jvp
def attenuation(c1: Array, c2: Array, c3: Array, d: Array) -> Array:
    """1 / max(c1 + c2 d + c3 d^2, 1). Where the sum is exactly 1 the derivative is that of 1 / sum."""
    return 1.0 / jnp.maximum(c1 + (c2 + c3 * d) * d, 1.0)


@attenuation.defjvp
def _attenuation_jvp(primals, tangents):
    (c1, c2, c3, d), (dc1, dc2, dc3, dd) = primals, tangents
    factor = attenuation(c1, c2, c3, d)
    total = c1 + (c2 + c3 * d) * d
    active = jnp.where(total >= 1, factor, 0.0)
    relative = factor * d
    slope = jnp.minimum(c2 + 2.0 * c3 * d, _HUGE[factor.dtype]) * factor
    change = (active * factor) * dc1 + (active * relative) * dc2
    return factor, -(change + jnp.where(total >= 1, relative * relative, 0.0) * dc3 + (active * slope) * dd)


# --- spot -------------------------------------------------------------------------------------------------------------


def spot(l: Vector, axis: Vector, beam_width: Array, cut_off_angle: Array) -> Array:
    """The spotlight factor of table 17.4; l: unit vector to the light, axis: unit spot direction (or zero).

    beam_width >= cut_off_angle: full intensity inside cut_off_angle, the ramp is not evaluated. For a light at the
    sample (l = 0) or without a direction (axis = 0) the equation's acos(0) is pi/2.
    """
    angle = angle_between(-l, axis)
    has_ramp = beam_width < cut_off_angle
    width = jnp.where(has_ramp, cut_off_angle - beam_width, 1.0)
    on_ramp = has_ramp & (angle > beam_width) & (angle < cut_off_angle)
    ramp = (cut_off_angle - jnp.where(on_ramp, angle, beam_width)) / width
    return jnp.where(on_ramp, ramp, jnp.where(angle >= cut_off_angle, 0.0, 1.0))


@jax.custom_jvp
def angle_between(a: Vector, b: Vector) -> Array:
    """The angle in [0, pi] between two unit vectors, accurate to its last bits everywhere; pi/2 if one of them is zero.

    Derivative 0 where the angle is 0 or pi.
    """
    c = cross(a, b)
    return arctangent(jnp.sqrt(_positive(dot(c, c))), dot(a, b))


@angle_between.defjvp
def _angle_jvp(primals, tangents):
    """d angle = (cos angle * d sin angle - sin angle * d cos angle), with sin angle = |a x b|."""
    (a, b), (da, db) = primals, tangents
    c = cross(a, b)
    squared = dot(c, c)
    sine = jnp.sqrt(_positive(squared))
    normal = c.scaled(jnp.where(squared > 0, 1.0 / jnp.where(squared > 0, sine, 1.0), 0.0))
    d_cosine = dot(da, b) + dot(a, db)
    d_sine = dot(normal, cross(da, b) + cross(a, db))
    return angle_between(a, b), jnp.where(squared > 0, dot(a, b) * d_sine - sine * d_cosine, 0.0)


def _positive(x: Array) -> Array:
    """x with 0 replaced by the smallest normal number, so that its square root has a derivative."""
    return jnp.where(x > 0, x, jnp.finfo(x.dtype).tiny)


# --- fog --------------------------------------------------------------------------------------------------------------


def linear_fog(distance: Array, visibility: Array) -> tuple[Array, Array]:
    """f0 of table 17.5, LINEAR, and 1 - f0 to full accuracy; visibility <= 0 means no fog."""
    present = visibility > 0
    share = distance / jnp.where(present, visibility, 1.0)
    within = share < 1
    through = (jnp.where(present, visibility, 1.0) - distance) / jnp.where(present, visibility, 1.0)
    clear = jnp.where(present, jnp.where(within, through, 0.0), 1.0)
    return clear, jnp.where(present, jnp.where(within, share, 1.0), 0.0)


@jax.custom_jvp
def exponential_fog(distance: Array, visibility: Array) -> tuple[Array, Array]:
    """f0 of table 17.5, EXPONENTIAL, and 1 - f0 to full accuracy; visibility <= 0 means no fog."""
    present, within, remaining = _fog_range(distance, visibility)
    depth = distance / remaining
    clear = jnp.where(within, exp(-depth), 0.0)
    fogged = jnp.where(within, -jnp.expm1(-depth), 1.0)
    return jnp.where(present, clear, 1.0), jnp.where(present, fogged, 0.0)


def _fog_range(distance: Array, visibility: Array) -> tuple[Array, Array, Array]:
    present = visibility > 0
    within = present & (distance < visibility)
    return present, within, jnp.where(within, visibility - distance, 1.0)


@exponential_fog.defjvp
def _exponential_fog_jvp(primals, tangents):
    """With x = d / (V - d): df0 = f0 (x dV - (1 + x) dd) / (V - d); the products are formed before the division."""
    (distance, visibility), (d_distance, d_visibility) = primals, tangents
    clear, fogged = exponential_fog(distance, visibility)
    _, within, remaining = _fog_range(distance, visibility)
    depth = jnp.where(within, distance / remaining, 0.0)
    per_visibility = (clear * depth) / remaining
    change = per_visibility * d_visibility - (clear / remaining + per_visibility) * d_distance
    change = jnp.where(within, change, 0.0)
    return (clear, fogged), (change, -change)
