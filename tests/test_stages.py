"""Stages and their derivatives: the same numbers as without boundaries, in every mode, and no plane copied."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params

from jaxlight.lighting.linear_stage import linear_stage
from jaxlight.lighting.stages import Stage
from jaxlight.lighting.unstored import Inlined, stored

ROWS, LANES = 4, 8


def _plane(seed: int) -> jax.Array:
    return jnp.asarray(np.random.default_rng(seed).uniform(0.5, 1.5, (ROWS, LANES)))


def _function(plane: jax.Array, number: jax.Array, product: jax.Array) -> tuple[jax.Array, jax.Array]:
    return plane * number + jnp.sin(product), product * product


def _staged(index: Any, plane: jax.Array, number: jax.Array, array: jax.Array) -> tuple[jax.Array, jax.Array]:
    product = Inlined(jnp.multiply, (plane, Inlined(_part, (array, index))))
    return Stage(index >= 0).each(_function, plane, number, product, wide=(1,))


def _part(array: jax.Array, index: jax.Array) -> jax.Array:
    return jax.lax.dynamic_index_in_dim(array, index, keepdims=False)


def _plain(index: Any, plane: jax.Array, number: jax.Array, array: jax.Array) -> tuple[jax.Array, jax.Array]:
    return _function(plane, number, plane * array[index])


@pytest.fixture
def inputs() -> tuple[jax.Array, jax.Array, jax.Array]:
    """A plane, a number on all lanes, and an array of which one plane is read."""
    with jax.enable_x64(True):
        return _plane(1), _plane(2)[:1], jnp.stack([_plane(3), _plane(4)])


def _pulled(function: Any, inputs: Any) -> Any:
    """Values and reverse derivatives of a weighted sum of the results."""

    def total(*inputs: jax.Array) -> jax.Array:
        first, second = function(jnp.asarray(1), *inputs)
        return jnp.sum(first * _plane(5)) + jnp.sum(second * _plane(6))

    return jax.jit(jax.value_and_grad(total, argnums=(0, 1, 2)))(*inputs)


def _assert_close(found: Any, expected: Any) -> None:
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-12), found, expected)


def test_a_stage_gives_values_and_reverse_derivatives_of_its_function(inputs: Any) -> None:
    with jax.enable_x64(True):
        _assert_close(_pulled(_staged, inputs), _pulled(_plain, inputs))


def test_a_stage_gives_derivatives_of_its_function_in_both_modes_and_both_orders(inputs: Any) -> None:
    with jax.enable_x64(True):
        changes = jax.tree.map(lambda leaf: jnp.cos(7 * leaf), inputs)

        def along(function: Any) -> Any:
            return lambda *inputs: jax.jvp(function, inputs, changes)[1]

        def slopes(function: Any) -> list[Any]:
            def planes(*inputs: jax.Array) -> Any:
                return function(jnp.asarray(1), *inputs)

            def pulled(*inputs: jax.Array) -> Any:
                return jax.vjp(planes, *inputs)[1]((_plane(5), _plane(6)))

            def dotted(*inputs: jax.Array) -> jax.Array:
                first, second = along(planes)(*inputs)
                return jnp.sum(first * _plane(5)) + jnp.sum(second * _plane(6))

            orders = (along(planes), along(along(planes)), along(pulled), jax.grad(dotted, argnums=(0, 1, 2)))
            return [jax.jit(order)(*inputs) for order in orders]

        _assert_close(slopes(_staged), slopes(_plain))


def test_derivatives_of_a_stage_are_mapped(inputs: Any) -> None:
    """Over operands, and over the index that its boundary hangs on; mapped and then differentiated too."""
    with jax.enable_x64(True):
        planes, indices = jnp.stack([inputs[0], 2 * inputs[0]]), jnp.asarray([1, 0])

        def slope(function: Any, index: jax.Array, plane: jax.Array) -> Any:
            def total(plane: jax.Array, number: jax.Array) -> jax.Array:
                return jnp.sum(function(index, plane, number, inputs[2])[0] ** 2)

            return jax.grad(total, argnums=(0, 1))(plane, inputs[1])

        def total_of_all(function: Any, plane: jax.Array, number: jax.Array) -> Any:
            many = jax.vmap(lambda plane: function(indices[0], plane, number, inputs[2])[0])(plane)
            return jnp.sum(many**2)

        _assert_close(
            *(jax.grad(partial(total_of_all, f), argnums=(0, 1))(planes, inputs[1]) for f in (_staged, _plain))
        )
        for axes in ((0, 0), (None, 0), (0, None)):
            arguments = (indices if axes[0] == 0 else indices[0], planes if axes[1] == 0 else planes[0])
            found, expected = (jax.vmap(partial(slope, f), in_axes=axes)(*arguments) for f in (_staged, _plain))
            _assert_close(found, expected)


def test_the_derivative_of_a_stage_copies_no_plane(inputs: Any) -> None:
    """No conditional hands on what it was given: XLA would copy it."""

    def total(index: jax.Array, plane: jax.Array, number: jax.Array, array: jax.Array) -> jax.Array:
        first, second = _staged(index, plane, number, array)
        return jnp.sum(first) + jnp.sum(second)

    with jax.enable_x64(True):
        program = jax.make_jaxpr(jax.value_and_grad(total, argnums=(1, 2)))(jnp.asarray(1), *inputs)
    branches = [branch for equation in _equations(program.jaxpr) for branch in _branches(equation)]
    assert len(branches) == 2 + 1  # the results, and their derivative
    for branch in branches:
        given = [id(variable) for variable in branch.invars]
        assert not [result for result in branch.outvars if id(result) in given]


def _equations(jaxpr: Any) -> Iterator[Any]:
    for equation in jaxpr.eqns:
        yield equation
        for inner in jaxprs_in_params(equation.params):
            yield from _equations(inner)


def _branches(equation: Any) -> list[Any]:
    if equation.primitive.name not in ("cond", "linear_stage"):
        return []
    return list(jaxprs_in_params(equation.params))


def test_of_two_forms_that_is_evaluated_and_differentiated_that_is_asked_for(inputs: Any) -> None:
    """The forms have values and slopes of their own, to show which was taken; what is shared has two forms as well."""

    def shared(result: jax.Array, plane: jax.Array, number: jax.Array, *, ordinary: bool) -> jax.Array:
        return jnp.full_like(plane, 7.0) if ordinary else 2 * plane

    def function(plane: jax.Array, number: jax.Array, slope: Any = None, *, ordinary: bool) -> jax.Array:
        value = plane if ordinary else plane * plane
        return number * (value if slope is None else slope * plane)

    def staged(ordinary: jax.Array, plane: jax.Array, number: jax.Array) -> jax.Array:
        stage = Stage(number[0, 0] > 0, ordinary=ordinary)
        return stage.each(function, plane, number, shared=shared, has_forms=True)

    with jax.enable_x64(True):
        plane, number, _ = inputs
        for ordinary, value, slope in ((True, plane, jnp.full_like(plane, 7.0)), (False, plane**2, 2 * plane)):
            pair = jax.jit(partial(staged, jnp.asarray(ordinary)))
            np.testing.assert_allclose(pair(plane, number), number * value)
            direction = (jnp.ones_like(plane), jnp.zeros_like(number))
            np.testing.assert_allclose(jax.jvp(pair, (plane, number), direction)[1], number * slope)
            by_plane, by_number = jax.vjp(pair, plane, number)[1](jnp.ones_like(plane))
            np.testing.assert_allclose(by_plane, number * slope)
            np.testing.assert_allclose(by_number[0], jnp.sum(slope * plane, axis=0))


def test_a_linear_stage_is_transposed_twice(inputs: Any) -> None:
    """And what is linear may be more than what is transposed."""
    with jax.enable_x64(True):
        plane, number, _ = inputs

        def stage(known: jax.Array, moving: tuple[jax.Array, jax.Array]) -> jax.Array:
            which = jnp.where(known[0, 0] > 0, 0, 1)
            return linear_stage(which, [lambda k, m: k * m[0] + m[1]], known, moving)

        there = jax.linear_transpose(lambda a: stage(plane, (a, jnp.zeros_like(a))), plane)
        back = jax.linear_transpose(lambda ct: there(ct)[0], plane)
        _assert_close(there(_plane(7))[0], plane * _plane(7))
        _assert_close(back(_plane(7))[0], plane * _plane(7))
        both = jax.linear_transpose(partial(stage, plane), (plane, plane))(number * _plane(7))[0]
        _assert_close(both, (plane * number * _plane(7), number * _plane(7)))


def test_what_is_inlined_knows_its_shape_and_is_computed_where_it_is_taken(inputs: Any) -> None:
    part = Inlined(_part, (inputs[2], jnp.asarray(1)))
    assert part.shape == (ROWS, LANES)
    found = stored({"part": part, "other": inputs[0]})
    assert found["other"] is inputs[0]
    np.testing.assert_array_equal(found["part"], inputs[2][1])


def test_stages_of_a_sum_in_parts_store_no_constants_for_its_derivatives(inputs: Any) -> None:
    """What a stage holds of constants is known before the loop; JAX would compute it there, and every part load it."""

    def term(stage: Stage, total: Any, part: jax.Array) -> jax.Array:
        return stage.each(lambda plane: jnp.where(plane > 1, plane**2, 3.0), part)

    def total(always: jax.Array, parts: jax.Array) -> jax.Array:
        return jnp.sum(Stage(always).sum_over(term, None, parts))

    with jax.enable_x64(True):
        parts, always = inputs[2], jnp.asarray(True)
        program = jax.make_jaxpr(jax.value_and_grad(total, argnums=1))(always, parts)
        assert "cond" in [equation.primitive.name for equation in _equations(program.jaxpr)]
        assert "cond" not in [equation.primitive.name for equation in program.jaxpr.eqns]
        value, slope = jax.value_and_grad(total, argnums=1)(always, parts)
        np.testing.assert_allclose(value, jnp.sum(jnp.where(parts > 1, parts**2, 3.0)))
        np.testing.assert_allclose(slope, jnp.where(parts > 1, 2 * parts, 0.0))
