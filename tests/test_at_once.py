"""Arrays that are computed in one loop: the same arrays, to the last bit and in every transformation."""

from __future__ import annotations

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import precision
from jaxlight.lighting.at_once import at_once

PLANES = [np.random.default_rng(seed).uniform(0.5, 1.5, (6, 4, 64)) for seed in (1, 2)]


def alone(a: jax.Array, b: jax.Array) -> list[jax.Array]:
    """Three planes that share a long expression."""
    shared = a * b
    for _ in range(6):
        shared = shared * shared - a * shared + b
    return [shared + a, shared * b, a - shared]


def together(a: jax.Array, b: jax.Array) -> list[jax.Array]:
    return at_once(alone(a, b))


@pytest.mark.parametrize("bits", ["float32", "float64"])
def test_no_bit_changes(bits: str) -> None:
    special = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e-30, -2.5, 3.0])
    with precision(bits) as dtype:
        arrays = [jnp.asarray(special, dtype), jnp.asarray(special[::-1], dtype), jnp.arange(8), jnp.zeros(3, dtype)]
        for function in (at_once, jax.jit(at_once)):
            for found, array in zip(function(arrays), arrays, strict=True):
                assert found.dtype == array.dtype and found.shape == array.shape
                assert np.asarray(found).tobytes() == np.asarray(array).tobytes()


def test_what_is_shared_is_computed_in_one_loop() -> None:
    """Compiled for the CPU, it is multiplied in one loop alone."""
    planes = [jnp.asarray(plane, jnp.float32) for plane in PLANES]

    def loops_that_multiply(function: object) -> int:
        program = jax.jit(function).lower(*planes).compile().as_text()
        computations = re.split(r"^(?:ENTRY )?%?[\w.]+ \(", program, flags=re.MULTILINE)
        return sum(" multiply(" in computation for computation in computations)

    assert loops_that_multiply(together) == 1 < loops_that_multiply(alone)


def test_other_platforms_leave_the_arrays_alone() -> None:
    traced = jax.jit(together).trace(*(jnp.asarray(plane, jnp.float32) for plane in PLANES))
    assert "stablehlo.reduce" in traced.lower(lowering_platforms=("cpu",)).as_text()
    assert "stablehlo.reduce" not in traced.lower(lowering_platforms=("cuda",)).as_text()


def test_derivatives_are_those_of_the_arrays() -> None:
    with precision("float64"):
        planes = [jnp.asarray(plane) for plane in PLANES]
        changes = [jnp.cos(plane) for plane in planes]
        for found, expected in zip(*(jax.jvp(f, planes, changes) for f in (together, alone)), strict=True):
            jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12), found, expected)
        back = [jnp.sin(plane) for plane in (*planes, planes[0] + 1)]
        by_both, expected = (jax.jit(jax.vjp(f, *planes)[1])(back) for f in (together, alone))
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12), by_both, expected)
        transposed = jax.linear_transpose(lambda a, b: at_once([a + b, 2 * b]), *planes)([planes[0], changes[1]])
        np.testing.assert_allclose(transposed[1], planes[0] + 2 * changes[1], rtol=1e-15)


def test_arrays_are_mapped_over_any_axis() -> None:
    first, second = (jnp.asarray(plane, jnp.float32) for plane in PLANES)

    def both(a: jax.Array, b: jax.Array) -> list[jax.Array]:
        return at_once([a, b])

    found = jax.jit(jax.vmap(both, in_axes=(1, None)))(first, second[:, 0])
    np.testing.assert_array_equal(found[0], jnp.moveaxis(first, 1, 0))
    np.testing.assert_array_equal(found[1], jnp.broadcast_to(second[:, 0], (4, 6, 64)))
