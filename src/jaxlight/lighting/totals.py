"""Sums over tiles that carry their rounding errors along (Neumaier), and sums over the samples of a tile by lanes."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from .at_once import at_once
from .prepared import LANES

_IN_A_ROUND = 8
Carry = Any
"""Running sums and their rounding errors, two tuples of arrays."""


def add_terms(carry: Carry, terms: tuple[Array, ...]) -> Carry:
    """The running sums and their rounding errors with the terms added; small loops, as few of them as possible."""
    sums, errors = carry
    totals, lost = zip(*map(_two_sum, sums, terms), strict=True)
    both = at_once([*totals, *(error + own for error, own in zip(errors, lost, strict=True))])
    return tuple(both[: len(sums)]), tuple(both[len(sums) :])


def add_terms_in_row(carry: Carry, terms: tuple[Array, ...], row: Array | int) -> Carry:
    """`add_terms` where the last sum is a table, to this row of which the last term is added."""
    here = tuple((*own[:-1], lax.dynamic_index_in_dim(own[-1], row, keepdims=False)) for own in carry)
    return tuple(
        (*own[:-1], lax.dynamic_update_index_in_dim(old[-1], own[-1], row, 0))
        for old, own in zip(carry, add_terms(here, terms), strict=True)
    )


def added_up(carry: Carry) -> tuple[Array, ...]:
    """The sums, rounded once."""
    # Of an infinite sum the errors are NaN.
    return tuple(jnp.where(jnp.isfinite(a), a + b, a) for a, b in zip(*carry, strict=True))


def summed_on_lanes(values: Float[Array, "..."]) -> Float[Array, " lanes"]:
    """The sum of all values, in parts to be added up by the caller: the processor adds up lanes at once, but one number
    only term by term."""
    return jnp.sum(_on_lanes(values), axis=0)


def summed_in_rounds(values: Float[Array, "..."]) -> Float[Array, ""]:
    """The sum of all values, of however many: few are added one after the other, so that few roundings add up."""
    rows = _on_lanes(values)
    while rows.shape[0] > 1:
        rows = jnp.pad(rows, ((0, -rows.shape[0] % _IN_A_ROUND), (0, 0)))
        # Behind a barrier, or XLA makes one sum of all rounds.
        rows = lax.optimization_barrier(jnp.sum(rows.reshape(-1, _IN_A_ROUND, LANES), axis=1))
    return jnp.sum(rows)


def _on_lanes(values: Float[Array, "..."]) -> Float[Array, "rows lanes"]:
    flat = values.reshape(-1)
    return jnp.pad(flat, (0, -flat.size % LANES)).reshape(-1, LANES)


def _two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """a + b as rounded, and what the rounding lost (exact)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)
