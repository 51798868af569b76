"""Sums over lights of their colours times planes of weights."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from .stages import Stage
from .unstored import Inlined

SUMMED = 8
"""Lights whose colours one loop adds up, if there are more than twice as many: longer sums XLA does not vectorise."""


def sums_of_colors(
    stage: Stage, colors: Float[Array, "3 lights 1 lanes"], weights: list[Float[Array, "lights rows lanes"]]
) -> list[Any]:
    """Of each of the weights the sum over lights of color * weight; planes [3, rows, lanes]."""
    lights = colors.shape[1]
    if lights == 1:
        return [Inlined(jnp.multiply, (colors[:, 0], own)) for own in weights]
    if lights <= 2 * SUMMED:
        return _sums(colors, weights)
    return _sums_in_parts(colors, weights) if stage.forward else _sums_for_reverse(colors, weights)


def _sums(colors: Array, weights: list[Array]) -> list[Array]:
    return [jnp.sum(colors * own, axis=1) for own in weights]


def _sums_in_parts(colors: Array, weights: list[Array]) -> list[Array]:
    full, rest = divmod(colors.shape[1], SUMMED)

    def part(first: Array | int, count: int) -> list[Array]:
        own = [lax.dynamic_slice_in_dim(plane, first, count) for plane in weights]
        return _sums(lax.dynamic_slice_in_dim(colors, first, count, axis=1), own)

    def with_part(number: Array, totals: list[Array]) -> list[Array]:
        return list(map(jnp.add, totals, part(number * SUMMED, SUMMED)))

    return lax.fori_loop(0, full, with_part, part(full * SUMMED, rest))


_sums_for_reverse = jax.custom_jvp(_sums_in_parts)
"""`_sums_in_parts` whose changes are no sums in parts: cotangents would be put together from parts."""


@_sums_for_reverse.defjvp
def _sums_jvp(primals, tangents):
    return _sums_for_reverse(*primals), jax.jvp(_sums, primals, tangents)[1]
