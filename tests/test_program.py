"""Traced functions are equal where they compute the same, bit by bit, and only there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight import encode
from jaxlight.lighting.program import Program

COLORS = jnp.full((4, 16), 0.5)


def program(function: Callable[..., Any]) -> Program:
    return Program(jax.make_jaxpr(function)(COLORS).jaxpr)


ALIKE: dict[str, Callable[..., Any]] = {
    "arithmetic": lambda c: (c[:3] - 0.5) ** 2,
    "choice": lambda c: jnp.where(jnp.abs(c) < 1, c * c / 2, jnp.abs(c) - 0.5),
    "transfer function": lambda c: encode(c[:3], "srgb"),
    "loop": lambda c: jax.lax.scan(lambda total, own: (total + own, own), c[0], c)[1],
    "a constant array": lambda c: c * np.arange(16.0, dtype=np.float32),
}


@pytest.mark.parametrize("case", ALIKE)
def test_what_is_traced_again_is_equal(case: str) -> None:
    one, again = program(ALIKE[case]), program(lambda c: ALIKE[case](c))
    assert one == again and hash(one) == hash(again)


def test_any_other_number_makes_another_program() -> None:
    different = [lambda c: c * 0.0, lambda c: c * -0.0, lambda c: c * 0.1, lambda c: c * 0.2, lambda c: c + 0.1]
    programs = [program(one) for one in different]
    assert len(set(programs)) == len(programs)
    assert program(lambda c: c.sum(0)) != program(lambda c: c.max(0))
    assert Program(jax.make_jaxpr(lambda c: c)(COLORS[:3]).jaxpr) != program(lambda c: c)


def test_rules_of_a_derivative_are_compared_by_what_they_compute() -> None:
    def of_jvp(rule: float) -> Callable[..., Any]:
        doubled = jax.custom_jvp(lambda c: 2 * c)
        doubled.defjvp(lambda primals, tangents: (2 * primals[0], rule * tangents[0]))
        return doubled

    def of_vjp(rule: Any) -> Callable[..., Any]:
        doubled = jax.custom_vjp(lambda c: 2 * c)
        doubled.defvjp(lambda c: (2 * c, None), lambda _, cotangent: (rule * cotangent,))
        return doubled

    for own in (of_jvp, of_vjp):
        one, again, other = program(own(2.0)), program(own(2.0)), program(own(3.0))
        assert one == again and hash(one) == hash(again) and one != other
        np.testing.assert_array_equal(one(COLORS), 2 * COLORS)
    assert program(of_vjp(np.arange(16.0))) != program(of_vjp(np.arange(16.0) + 1))
    assert program(jax.nn.softplus) == program(lambda c: jax.nn.softplus(c)) != program(jax.nn.relu)


def test_what_cannot_be_differentiated_by_some_number_is_equal_to_itself() -> None:
    """Nobody may ask for that number."""

    def grown(c: Any) -> Any:
        return jax.nn.relu(jax.lax.while_loop(lambda x: jnp.sum(x) < 1000, lambda x: 2 * x, c))

    one, other = program(grown), program(lambda c: grown(c))
    assert one != other and one == one and hash(one) == hash(one)


def test_what_cannot_be_compared_is_equal_to_itself() -> None:
    def called(c: Any) -> Any:
        return jax.pure_callback(lambda own: np.asarray(own), jax.ShapeDtypeStruct(c.shape, c.dtype), c)

    one, other = program(called), program(lambda c: called(c))
    assert one != other and one == one and hash(one) == hash(one)


def test_constants_are_given_anew() -> None:
    factor = jnp.arange(16.0)
    traced = jax.make_jaxpr(lambda c: factor * c)(COLORS)
    one = Program(traced.jaxpr)
    np.testing.assert_array_equal(one(COLORS, *traced.consts), factor * COLORS)
    np.testing.assert_array_equal(one(COLORS, 2 * factor), 2 * factor * COLORS)
