"""Sums of unknown length: values and derivatives of both modes and higher order are those of the terms written out."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight.lighting.running_sum import running_sum

TABLE = np.random.default_rng(7).normal(size=(6, 3))


def of_loop(count: jax.Array, x: jax.Array) -> jax.Array:
    """Closes over numbers of all kinds: differentiated, constant, whole, and nested."""
    rows = jnp.asarray(TABLE)

    def term(number: jax.Array) -> dict[str, jax.Array]:
        inner = running_sum(lambda power: x**2 * (power + 1.0), number)
        return {"sine": jnp.sin(x * rows[number]), "scaled": x[0] * x * number + inner}

    sums = running_sum(term, count)
    return sums["sine"] * sums["scaled"]


def written_out(count: int, x: jax.Array) -> jax.Array:
    sine, scaled = jnp.zeros(3), jnp.zeros(3)
    for number in range(count):
        sine += jnp.sin(x * TABLE[number])
        scaled += x[0] * x * number + sum(x**2 * (power + 1.0) for power in range(number))
    return sine * scaled


TRANSFORMS: dict[str, Callable[[Callable[[jax.Array], jax.Array]], Callable[[jax.Array], jax.Array]]] = {
    "value": lambda f: f,
    "forward": jax.jacfwd,
    "reverse": jax.jacrev,
    "forward over reverse": lambda f: jax.jacfwd(jax.jacrev(f)),
    "reverse over forward": lambda f: jax.jacrev(jax.jacfwd(f)),
    "reverse over reverse": lambda f: jax.jacrev(jax.jacrev(f)),
    "checkpoint": lambda f: jax.jacrev(jax.checkpoint(f)),
}


@pytest.mark.parametrize("name", TRANSFORMS)
@pytest.mark.parametrize("count", [0, 4])
def test_derivatives_of_a_sum_are_those_of_its_terms(name: str, count: int) -> None:
    transform = TRANSFORMS[name]
    with jax.enable_x64(True):
        x = jnp.asarray([0.4, -1.2, 2.0])
        got = jax.jit(lambda count, x: transform(lambda x: of_loop(count, x))(x))(jnp.int32(count), x)
        wanted = transform(lambda x: written_out(count, x))(x)
        np.testing.assert_allclose(got, wanted, rtol=1e-12, atol=1e-12)


def test_sums_of_different_lengths_are_mapped() -> None:
    with jax.enable_x64(True):
        counts, x = jnp.asarray([0, 4, 2], jnp.int32), jnp.asarray(np.random.default_rng(8).normal(size=(3, 3)))
        slope = jax.vmap(jax.jacrev(of_loop, argnums=1))(counts, x)
        wanted = [jax.jacrev(lambda x, n=n: written_out(n, x))(row) for n, row in zip((0, 4, 2), x, strict=True)]
        np.testing.assert_allclose(slope, jnp.stack(wanted), rtol=1e-12, atol=1e-12)
        same = jax.vmap(of_loop, in_axes=(None, 0))(jnp.int32(3), x)
        np.testing.assert_allclose(same, jax.vmap(lambda x: written_out(3, x))(x), rtol=1e-12, atol=1e-12)
        one = jax.vmap(of_loop, in_axes=(0, None))(counts, x[1])
        np.testing.assert_allclose(one, [written_out(n, x[1]) for n in (0, 4, 2)], rtol=1e-12, atol=1e-12)
