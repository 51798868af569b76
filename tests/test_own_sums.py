"""Sums that stay XLA's own: the bits of any sum, and derivatives of all modes and orders, mapped over too."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight.lighting.own_sums import multilinear, spread, with_own_sums

LEFT, RIGHT = np.random.default_rng(3).normal(size=(3, 4, 1, 5)), np.random.default_rng(4).normal(size=(4, 2, 5))


def plain(left: jax.Array, right: jax.Array) -> jax.Array:
    return jnp.sum(left * right, axis=1)


def own(left: jax.Array, right: jax.Array) -> jax.Array:
    return multilinear(plain, left, right)


TRANSFORMS: dict[str, Callable[[Callable[..., jax.Array]], Callable[..., jax.Array]]] = {
    "value": lambda f: f,
    "forward": lambda f: jax.jacfwd(f, (0, 1)),
    "reverse": lambda f: jax.jacrev(f, (0, 1)),
    "forward over reverse": lambda f: jax.jacfwd(jax.jacrev(f, 0), 1),
    "reverse over reverse": lambda f: jax.jacrev(jax.jacrev(f, 1), 0),
    "one side only": lambda f: jax.grad(lambda left, right: jnp.sum(f(left, right) ** 3)),
    "both from one": lambda f: jax.grad(lambda left, right: jnp.sum(f(left * right[0, 0, 0], right * left[0, 0, 0]))),
    "mapped left": lambda f: jax.vmap(f, (0, None)),
    "mapped both, reverse": lambda f: jax.vmap(jax.grad(lambda left, right: jnp.sum(f(left, right) ** 2))),
}


@pytest.mark.parametrize("name", TRANSFORMS)
def test_a_product_that_is_added_up_and_its_derivatives(name: str) -> None:
    with jax.enable_x64(True):
        left, right = jnp.asarray(LEFT), jnp.asarray(RIGHT)
        if name.startswith("mapped"):
            left = jnp.stack([left, 2 * left, -left])
            right = right if name == "mapped left" else jnp.stack([right, right + 1, 3 * right])
        got, wanted = (jax.jit(TRANSFORMS[name](function))(left, right) for function in (own, plain))
        for one, other in zip(jax.tree.leaves(got), jax.tree.leaves(wanted), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("shape", [(2, 5), (1, 5), (5,), (1, 1)])
def test_the_cotangent_of_what_is_spread_is_a_sum(shape: tuple[int, ...]) -> None:
    weights = jnp.asarray(RIGHT)
    narrow = jnp.ones(shape)
    np.testing.assert_array_equal(spread(narrow, (4, 2, 5)), jnp.broadcast_to(narrow, (4, 2, 5)))
    got = jax.jit(jax.grad(lambda narrow: jnp.sum(weights * spread(narrow, (4, 2, 5)))))(narrow)
    wanted = jax.grad(lambda narrow: jnp.sum(weights * jnp.broadcast_to(narrow, (4, 2, 5))))(narrow)
    np.testing.assert_allclose(got, wanted, rtol=1e-5)


def test_sums_of_a_program_keep_their_bits() -> None:
    def program(numbers: jax.Array) -> jax.Array:
        inner = jax.jit(lambda numbers: jnp.sum(jnp.where(numbers > 0, numbers, 2 * numbers), axis=0))
        return inner(numbers) * jax.nn.relu(jnp.sum(numbers[0]))  # relu has a rule of derivatives of its own

    numbers = jnp.asarray(np.random.default_rng(5).normal(size=(64, 128)), jnp.float32)
    by_own = with_own_sums(jax.make_jaxpr(program)(numbers))
    np.testing.assert_array_equal(jax.jit(by_own)(numbers)[0], jax.jit(program)(numbers))


@pytest.mark.parametrize("special", [np.inf, -np.inf, np.nan, -0.0])
def test_special_numbers_are_added_as_ever(special: float) -> None:
    numbers = jnp.full((2, 3), special).at[0, 1].set(1.0)
    got = jax.jit(lambda numbers: multilinear(lambda own: jnp.sum(own, axis=0), numbers))(numbers)
    np.testing.assert_array_equal(got, jnp.sum(numbers, axis=0))
