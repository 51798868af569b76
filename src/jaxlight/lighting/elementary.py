"""Elementary functions from operations that every backend vectorises, each with its own derivative.

XLA's CPU backend calls scalar library routines for pow, atan2 and rsqrt, and in float64 functions for exp, expm1 and
log1p that LLVM takes for different calls wherever one is repeated. The exponential, logarithm and arctangent here are
minimax polynomials after an exact reduction by bits.
Errors, in float32 and float64: `exp` 1 ulp + 1 ulp * |x|, `log_of_alignment` 1.5 ulp, `arctangent` 2 ulp,
`reciprocal_root` 1.5 ulp, `reciprocal_in_range` 2 ulp.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

_INTEGER = {jnp.dtype("float32"): jnp.int32, jnp.dtype("float64"): jnp.int64}
_MANTISSA = {jnp.dtype("float32"): 23, jnp.dtype("float64"): 52}
_BIAS = {jnp.dtype("float32"): 127, jnp.dtype("float64"): 1023}

# Minimax coefficients, lowest order first: exp(r) = 1 + r + r^2 P(r), |r| <= ln(2)/2, relative errors 3e-9 and 4e-19;
# log(1 + t) = t - t^2/2 + t^3 P(t), -1/4 <= t <= 1/2, relative errors 5e-9 and 5e-18;
# atan(t) = t + t^3 P(t^2), |t| <= sqrt(2) - 1, relative errors 7e-10 and 1e-18.
_EXP = {
    jnp.dtype("float32"): (0.500000009571, 0.166665183063, 0.0416662041216, 0.00836895349286, 0.0013950603204),
    jnp.dtype("float64"): (
        0.5,
        0.16666666666666671293,
        0.041666666666666671293,
        0.00833333333332613585,
        0.0013888888888883748132,
        0.00019841269874820626558,
        0.000024801587325547742673,
        2.755725540020642234e-6,
        2.7557273643110297443e-7,
        2.5105217004720744732e-8,
        2.0914686968086875816e-9,
    ),
}
_LOG = {
    jnp.dtype("float32"): (
        0.333334481377,
        -0.250001940867,
        0.199910906528,
        -0.166437430493,
        0.144677035057,
        -0.131868881116,
        0.105827713406,
        -0.0461674420411,
    ),
    jnp.dtype("float64"): (
        0.33333333333333331483,
        -0.24999999999999969469,
        0.20000000000000933698,
        -0.16666666666685370224,
        0.14285714285473910534,
        -0.12499999996330912744,
        0.11111111131710903199,
        -0.10000000330110601909,
        0.090909085163210390235,
        -0.083333177797958651878,
        0.076922971391643862882,
        -0.071432473394333340089,
        0.066676511662933563018,
        -0.062454547197642207301,
        0.058602257914729678767,
        -0.055592342396107004288,
        0.054569015893568710573,
        -0.053744476808477895102,
        0.045469640020326024255,
        -0.026115859640381385021,
        0.007110126854803117645,
    ),
}
_ATAN32 = (
    -0.33333315492180769,
    0.19998488570915717,
    -0.14243831270328501,
    0.10595864820839271,
    -0.060830890609915366,
)
_ATAN64 = (
    -0.33333333333333198898,
    0.19999999999954016214,
    -0.14285714280241497954,
    0.11111110785771009627,
    -0.090908978254856376968,
    0.07692061435428902999,
    -0.066631180219260314841,
    0.058479912638001776635,
    -0.050397640180049174325,
    0.038076203965553785344,
    -0.017919913027972984932,
)
# 1/sqrt(1 - e) = 1 + e P(e), -0.0691 <= e <= 0.0676, relative error 2.4e-8
_ROOT = (0.49999833, 0.37500026, 0.31393671, 0.27411241)
# With less to do: log2(1 + t) = t P(t), 1/sqrt(2) <= 1 + t <= sqrt(2), relative error 1.1e-6; 2^f = P(f), |f| <= 1/2,
# relative error 2.6e-6.
_LOG2_FAST = (
    1.4426964472732127,
    -0.7213635760931496,
    0.4806267663538427,
    -0.3593716377518933,
    0.2956995502416934,
    -0.2693202915704278,
    0.17162454384181533,
)
_EXP2_FAST = (0.9999992614376432, 0.6931218145594343, 0.2402474484144777, 0.0559178617824677, 0.009570101877583571)


def polynomial(coefficients: tuple[float, ...], x: Array) -> Array:
    """Sum of coefficients[k] * x^k (Horner)."""
    value = jnp.full_like(x, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = value * x + coefficient
    return value


def _bits(x: Array) -> Array:
    return lax.bitcast_convert_type(x, _INTEGER[x.dtype])


def _from_bits(bits: Array, dtype: jnp.dtype) -> Array:
    return lax.bitcast_convert_type(bits, dtype)


def power_of_two_above(x: Float[Array, ...]) -> Float[Array, ...]:
    """2^k with x in [2^k, 2^(k+1)) for x >= 0; the smallest normal power for 0 and denormals."""
    mantissa = _MANTISSA[x.dtype]
    bits = (_bits(x) >> mantissa) << mantissa
    return _from_bits(jnp.maximum(bits, 1 << mantissa), x.dtype)


def reciprocal_of_power_of_two(x: Float[Array, ...]) -> Float[Array, ...]:
    """1/x, exactly, for a power of two whose reciprocal is normal; at the largest, the smallest normal number."""
    mantissa, bias = _MANTISSA[x.dtype], _BIAS[x.dtype]
    return _from_bits(jnp.maximum((2 * bias << mantissa) - _bits(x), 1 << mantissa), x.dtype)


def reciprocal_root(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 / sqrt(x) of a normal number x > 0; no derivative is taken of it."""
    if x.dtype != jnp.float32:
        return jnp.sqrt(x) / x  # XLA turns 1 / sqrt(x) into a slower rsqrt
    y = _from_bits(0x5F37599E - (_bits(x) >> 1), x.dtype)  # to 2^-5
    error = 1.0 - (x * y) * y
    return y + (y * error) * polynomial(_ROOT, error)


STEEPEST = {jnp.dtype("float32"): 2.0**123, jnp.dtype("float64"): 2.0**1019}
"""The largest 1 / x in a derivative: that of x = 1e-37 is right, those of smaller x are finite."""

_STEEPEST_SQUARED = {jnp.dtype("float32"): 2.0**107, jnp.dtype("float64"): 2.0**1007}


def second_factor(inverse: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 / x from 1 / x, or less, so that their product, in second derivatives, stays in range."""
    return jnp.minimum(inverse, _STEEPEST_SQUARED[inverse.dtype] / jnp.where(inverse > 0, inverse, 1.0))


@jax.custom_jvp
def steep_reciprocal(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 / x for the derivatives by x > 0, at most STEEPEST; its own derivative is held in range."""
    return 1.0 / jnp.maximum(x, 1.0 / STEEPEST[x.dtype])


@steep_reciprocal.defjvp
def _steep_reciprocal_jvp(primals, tangents):
    inverse = steep_reciprocal(*primals)
    return inverse, -(inverse * (second_factor(inverse) * tangents[0]))


@jax.custom_jvp
def reciprocal_in_range(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 / x of 2^-60 <= x <= 2^60, where XLA may put it into one loop with what needs it."""
    if x.dtype != jnp.float32:
        return 1.0 / x
    y = _from_bits(0x7EF311C3 - _bits(x), x.dtype)  # to 2^-4
    error = 1.0 - x * y
    squared = error * error
    y = y + y * error
    y = y + y * squared
    return y + y * (squared * squared)


@reciprocal_in_range.defjvp
def _reciprocal_in_range_jvp(primals, tangents):
    inverse = reciprocal_in_range(*primals)
    return inverse, -(inverse * (inverse * tangents[0]))


@jax.custom_jvp
def ratio(x: Float[Array, "..."], y: Float[Array, "..."]) -> Float[Array, "..."]:
    """x / y for y > 0, with derivatives that form no square of y: it may be 1e-37 or 1e37."""
    return x / y


@ratio.defjvp
def _ratio_jvp(primals, tangents):
    (x, y), (dx, dy) = primals, tangents
    quotient = ratio(x, y)
    return quotient, (dx - quotient * dy) * steep_reciprocal(y)


@jax.custom_jvp
def exp(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """e^x for x <= 0; what is below the smallest normal number is 0, or subnormal where it is not flushed."""
    power_of_two, fraction = _reduced_exp(x)
    return power_of_two * (1.0 + fraction)


@exp.defjvp
def _exp_jvp(primals, tangents):
    value = exp(*primals)
    return value, value * tangents[0]


@jax.custom_jvp
def one_minus_exp(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 - e^x for x <= 0, accurate for small x too."""
    power_of_two, fraction = _reduced_exp(x)
    return (1.0 - power_of_two) - power_of_two * fraction


@one_minus_exp.defjvp
def _one_minus_exp_jvp(primals, tangents):
    return one_minus_exp(*primals), -exp(*primals) * tangents[0]


_LEAST = {jnp.dtype("float32"): -88.02, jnp.dtype("float64"): -709.0}
"""Rounds to the power 2^-127 or 2^-1023, which is stored as 0."""
_LOG_2 = {jnp.dtype("float32"): (math.log(2),), jnp.dtype("float64"): (0.69314718036912381649, 1.9082149292705877e-10)}
"""The parts of ln 2: k times the first is exact in float64; in float32, k times its rounding, 2e-9, is far less than
that of x."""


def _reduced_exp(x: Array) -> tuple[Array, Array]:
    """2^k and f with e^x = 2^k (1 + f), |f| <= sqrt(2) - 1; x is first raised to _LEAST."""
    x = jnp.where(x < _LEAST[x.dtype], _LEAST[x.dtype], x)
    k, power_of_two = _rounded(x * (1 / math.log(2)))
    r = x
    for part in _LOG_2[x.dtype]:
        r = r - k * part
    return power_of_two, r + r * r * polynomial(_EXP[x.dtype], r)


_TO_INTEGER = {jnp.dtype("float32"): 1.5 * 2.0**23, jnp.dtype("float64"): 1.5 * 2.0**52}
"""A sum of this and a small number has that number, rounded, in its lowest bits."""
_BITS_OF_ZERO = {jnp.dtype("float32"): 0x4B400000, jnp.dtype("float64"): 0x4338 << 48}


def _rounded(x: Float[Array, "..."]) -> tuple[Array, Array]:
    """The integer k that is next to x, and 2^k, for normal powers and the 0 below them."""
    bits, mantissa = _bits(x + _TO_INTEGER[x.dtype]), _MANTISSA[x.dtype]
    # By way of the bits: XLA would take the sum apart again, and rounding and conversion care for numbers out of range.
    power_of_two = _from_bits((bits << mantissa) + (_BIAS[x.dtype] << mantissa), x.dtype)
    return (bits - _BITS_OF_ZERO[x.dtype]).astype(x.dtype), power_of_two


_THREE_QUARTERS = {jnp.dtype("float32"): 0x3F400000, jnp.dtype("float64"): 0x3FE8 << 48}
"""Its bits."""


@jax.custom_jvp
def log_of_alignment(alignment: Float[Array, "..."]) -> Float[Array, "..."]:
    """ln(cos a) from cos a where positive, and from cos a - 1 where not: near a = 0 the digits are in the second."""
    near = alignment <= 0
    # cos a = 2^e (1 + t) with 1 + t in [3/4, 3/2)
    mantissa, bias = _MANTISSA[alignment.dtype], _BIAS[alignment.dtype]
    e = (_bits(alignment) - _THREE_QUARTERS[alignment.dtype]) >> mantissa
    # A product, not the bits of one: where JAX drops the rule below (in primal loops that it hoists from), derivatives
    # of this are right too.
    t = jnp.where(near, alignment, alignment * _from_bits((bias - e) << mantissa, alignment.dtype) - 1.0)
    e = jnp.where(near, 0, e).astype(alignment.dtype)
    t2 = t * t
    log1p = t + (t2 * t * polynomial(_LOG[alignment.dtype], t) - 0.5 * t2)
    return e * math.log(2) + log1p


@log_of_alignment.defjvp
def _log_of_alignment_jvp(primals, tangents):
    (alignment,), (change,) = primals, tangents
    return log_of_alignment(alignment), change * steep_reciprocal(jnp.where(alignment <= 0, 1.0 + alignment, alignment))


def log2_fast(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """log2(x) of a normal number x > 0, in float32 to 1.3e-6 of itself; no derivative is taken of it."""
    if x.dtype != jnp.float32:
        return log_of_alignment(x) * (1 / math.log(2))
    bits = _bits(x)
    e = (bits - 0x3F3504F3) >> 23  # x = 2^e (1 + t) with 1 + t in [1/sqrt(2), sqrt(2))
    t = _from_bits(bits - (e << 23), x.dtype) - 1.0
    return e.astype(x.dtype) + t * polynomial(_LOG2_FAST, t)


def exp2_fast(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """2^x for x < 1, in float32 to 2.6e-6 of itself, at least 2^-126; no derivative is taken of it."""
    if x.dtype != jnp.float32:
        return exp(x * math.log(2))
    x = jnp.where(x < -126.0, -126.0, x)
    k, power_of_two = _rounded(x)
    return polynomial(_EXP2_FAST, x - k) * power_of_two


def arctangent(y: Float[Array, ...], x: Float[Array, ...]) -> Float[Array, ...]:
    """atan2(y, x) for y >= 0 and not both 0, in [0, pi]."""
    smaller, larger = jnp.minimum(y, jnp.abs(x)), jnp.maximum(y, jnp.abs(x))
    t = smaller / jnp.where(larger == 0, 1.0, larger)
    fold = t > math.sqrt(2) - 1
    u = jnp.where(fold, (smaller - larger) / jnp.where(larger == 0, 1.0, smaller + larger), t)
    u2 = u * u
    u = u + u * u2 * polynomial(_ATAN32 if u.dtype == jnp.float32 else _ATAN64, u2)
    # The angle is offset + sign * u; adding the small part of pi/4, pi/2, pi apart keeps the last bit.
    first = u + jnp.where(fold, math.pi / 4, 0.0)
    steep = jnp.where(y > jnp.abs(x), math.pi / 2 - first, first)
    return jnp.where(x < 0, math.pi - steep, steep)
