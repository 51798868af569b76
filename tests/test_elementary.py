"""Elementary functions against more digits, within the errors that they state, over all that they are asked."""

from __future__ import annotations

from typing import Any

import jax
import mpmath
import numpy as np
import pytest

from jaxlight.lighting import elementary

COUNT = 200_000
LEAST = float(np.log(np.finfo(np.float32).tiny))
"""The exponential of less is no normal number."""


def drawn(low: float, high: float) -> np.ndarray:
    """Numbers of all sizes between two powers of ten, and evenly between those."""
    random = np.random.default_rng(7)
    sizes = 10.0 ** random.uniform(low, high, COUNT)
    return np.concatenate([sizes, random.uniform(10.0**low, 10.0**high, COUNT)]).astype(np.float32)


def ulps(value: jax.Array, exact: np.ndarray) -> np.ndarray:
    """The errors of float32 values in their last place."""
    return np.abs(np.asarray(value, np.float64) - exact) / np.spacing(np.abs(exact).astype(np.float32))


def test_the_exponential_of_negative_numbers() -> None:
    x = -drawn(-9, np.log10(-LEAST - 0.01))
    error = ulps(jax.jit(elementary.exp)(x), np.exp(x.astype(np.float64)))
    assert np.max(error / (1 + np.abs(x))) < 1


def test_one_minus_the_exponential() -> None:
    x = -drawn(-9, 3)
    error = ulps(jax.jit(elementary.one_minus_exp)(x), -np.expm1(x.astype(np.float64)))
    assert np.max(error) < 1.5


@pytest.mark.parametrize("x", [LEAST - 0.01, -88.0, -89.0, -1e3, -1e30, -np.inf])
def test_an_exponential_below_all_normal_numbers_is_as_good_as_zero(x: float) -> None:
    value = float(jax.jit(elementary.exp)(np.float32(x)))
    assert 0 <= value < np.finfo(np.float32).tiny
    assert float(jax.jit(elementary.one_minus_exp)(np.float32(x))) == 1


def test_the_logarithm_of_an_alignment() -> None:
    near, far = -drawn(-9, np.log10(0.25)), drawn(-30, np.log10(0.75))
    exact = np.concatenate([np.log1p(near.astype(np.float64)), np.log(far.astype(np.float64))])
    error = ulps(jax.jit(elementary.log_of_alignment)(np.concatenate([near, far])), exact)
    assert np.max(error) < 1.5


def test_the_reciprocal_root() -> None:
    x = drawn(-37, 37)
    assert np.max(ulps(jax.jit(elementary.reciprocal_root)(x), 1 / np.sqrt(x.astype(np.float64)))) < 1.5


def test_the_reciprocal() -> None:
    x = np.exp2(np.linspace(-60, 60, 2_000_003)).astype(np.float32)
    assert np.max(ulps(jax.jit(elementary.reciprocal_in_range)(x), 1 / x.astype(np.float64))) < 2
    slope = jax.jit(jax.vmap(jax.grad(elementary.reciprocal_in_range)))(x[::1000])
    np.testing.assert_allclose(slope, -1 / x[::1000].astype(np.float64) ** 2, rtol=1e-6)


def test_the_fast_power_of_two_and_logarithm() -> None:
    x = -drawn(-6, 2)
    power = np.asarray(jax.jit(elementary.exp2_fast)(x), np.float64)
    np.testing.assert_allclose(power, np.exp2(x.astype(np.float64)), rtol=2.7e-6)
    least = np.asarray(jax.jit(elementary.exp2_fast)(np.float32([-127, -300, -1e30])))
    assert np.all((least >= 0) & (least < 1.2e-38))
    positive = drawn(-30, 0)
    logarithm = np.asarray(jax.jit(elementary.log2_fast)(positive), np.float64)
    np.testing.assert_allclose(logarithm, np.log2(positive.astype(np.float64)), rtol=1.3e-6)


def ulps_of_float64(function: Any, x: np.ndarray, exact: Any) -> np.ndarray:
    """The errors of float64 values in their last place, against 40 digits."""
    with jax.enable_x64(True), mpmath.workdps(40):
        values = np.asarray(jax.jit(function)(x)).tolist()
        exacts = [exact(mpmath.mpf(number)) for number in x.tolist()]
        assert all(abs(number) > np.finfo(np.float64).tiny for number in exacts)
        return np.array([float(abs(v - e) / np.spacing(abs(float(e)))) for v, e in zip(values, exacts, strict=True)])


def drawn_in_float64(low: float, high: float, count: int = 4000) -> np.ndarray:
    random = np.random.default_rng(8)
    return np.concatenate([10.0 ** random.uniform(low, high, count), random.uniform(10.0**low, 10.0**high, count)])


def test_float64_has_its_own_digits() -> None:
    x = -drawn_in_float64(-17, np.log10(708.3))
    assert np.max(ulps_of_float64(elementary.exp, x, mpmath.exp) / (1 + np.abs(x))) < 1
    assert np.max(ulps_of_float64(elementary.one_minus_exp, x, lambda number: -mpmath.expm1(number))) < 1.5
    near, far = -drawn_in_float64(-17, np.log10(0.25)), drawn_in_float64(-300, np.log10(0.75))
    assert np.max(ulps_of_float64(elementary.log_of_alignment, near, mpmath.log1p)) < 1.5
    assert np.max(ulps_of_float64(elementary.log_of_alignment, far, mpmath.log)) < 1.5


@pytest.mark.parametrize("x", [-709.0, -710.0, -745.0, -1e9, -1e300, -np.inf])
def test_a_float64_exponential_below_all_normal_numbers_is_as_good_as_zero(x: float) -> None:
    with jax.enable_x64(True):
        assert 0 <= float(jax.jit(elementary.exp)(np.float64(x))) < np.finfo(np.float64).tiny
        assert float(jax.jit(elementary.one_minus_exp)(np.float64(x))) == 1
