"""Numbers in float64: for what a fit says of itself, whatever the precision it ran in."""

from __future__ import annotations

from typing import TypeVar

import jax
import jax.numpy as jnp

from ..arrays import array_of

_Tree = TypeVar("_Tree")


def widened(tree: _Tree) -> _Tree:
    """The pytree with all its floats in float64; to be called where 64-bit numbers are switched on."""

    def widen(leaf: jax.Array) -> jax.Array:
        return array_of(leaf, jnp.float64) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    return jax.tree.map(widen, tree)
