"""Numbers picked by rows: the values and derivatives of indexing, added up in one pass."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight.lighting.picking import picked

LIGHTS = 7


def inputs() -> tuple[list[jax.Array], jax.Array]:
    random = np.random.default_rng(2)
    numbers = [jnp.asarray(random.normal(size=shape), jnp.float32) for shape in [(3, LIGHTS), (LIGHTS,), (LIGHTS,)]]
    return numbers, jnp.asarray(random.integers(0, LIGHTS, (4, 16)), jnp.int32)


def indexed(numbers: list[jax.Array], row: jax.Array) -> list[jax.Array]:
    """What `picked` stands for."""
    return [plane[..., row] for plane in numbers]


def equal(got: Any, expected: Any) -> None:
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6), got, expected)


@pytest.mark.parametrize("compiled", [True, False])
def test_values_and_derivatives_are_those_of_indexing(compiled: bool) -> None:
    numbers, row = inputs()
    equal((jax.jit(picked) if compiled else picked)(numbers, row), indexed(numbers, row))

    def slopes(function: Any) -> Any:
        def total(numbers: list[jax.Array]) -> jax.Array:
            return sum(jnp.sum(jnp.sin(2 * result)) for result in function(numbers, row))

        changes = [jnp.cos(plane) for plane in numbers]
        along = jax.jvp(lambda numbers: function(numbers, row), (numbers,), (changes,))[1]
        twice = jax.jvp(jax.grad(total), (numbers,), (changes,))[1]
        return (jax.jit(jax.grad(total)) if compiled else jax.grad(total))(numbers), along, twice

    equal(slopes(picked), slopes(indexed))


def test_what_does_not_move_has_no_derivative() -> None:
    """Neither is it computed nor handed on, in both modes."""
    numbers, row = inputs()

    def second(plane: jax.Array) -> jax.Array:
        colors, one, other = picked([numbers[0], plane, numbers[2]], row)
        return jnp.sum(colors) + jnp.sum(one * one) + jnp.sum(other)

    def expected(plane: jax.Array) -> jax.Array:
        return jnp.sum(plane[row] ** 2)

    equal(jax.grad(second)(numbers[1]), jax.grad(expected)(numbers[1]))
    pulled = jax.make_jaxpr(lambda plane: jax.jvp(second, (plane,), (plane,))[1])(numbers[1])
    picks = [len(equation.outvars) for equation in pulled.eqns if equation.primitive.name == "picked"]
    assert sorted(picks) == [1, 3]


def test_of_results_that_are_not_used_nothing_is_added_up() -> None:
    numbers, row = inputs()
    slope = jax.grad(lambda numbers: jnp.sum(picked(numbers, row)[2] ** 2))(numbers)
    equal(slope, jax.grad(lambda numbers: jnp.sum(numbers[2][row] ** 2))(numbers))


@pytest.mark.parametrize("axes", [(0, None), (None, 0), (0, 0)])
def test_mapped_over_numbers_and_rows(axes: tuple[int | None, int | None]) -> None:
    numbers, row = inputs()
    if axes[0] is not None:
        numbers = [jnp.stack([plane, plane[..., ::-1]]) for plane in numbers]
    if axes[1] is not None:
        row = jnp.stack([row, (row + 1) % LIGHTS])
    mapped = [jax.vmap(function, in_axes=axes)(numbers, row) for function in (picked, indexed)]
    equal(*mapped)

    def slopes(function: Any) -> Any:
        def total(numbers: list[jax.Array], row: jax.Array) -> jax.Array:
            return sum(jnp.sum(jnp.sin(result)) for result in function(numbers, row))

        return jax.vmap(jax.grad(total), in_axes=axes)(numbers, row)

    equal(slopes(picked), slopes(indexed))
