"""Boundaries between the stages of a tile, which XLA's CPU backend keeps as small vectorised loops.

Left alone, XLA fuses a tile's whole expression, and the slice that cuts the tile out of the buffer, into loops that it
evaluates element by element, several times over. It drops `lax.optimization_barrier` before it fuses, but never
moves work across a conditional whose predicate it cannot know. A stage with one result is one loop.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool


class Stage(NamedTuple):
    """Evaluates `stage(function)` behind a boundary; `always` is true, but only the running program knows."""

    always: Bool[Array, ""]

    def __call__(self, function: Callable[[], Any]) -> Any:
        """function(), a stage of its own; derivatives of all orders and modes pass through."""

        def never() -> Any:
            return jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), jax.eval_shape(function))

        return lax.cond(self.always, function, never)
