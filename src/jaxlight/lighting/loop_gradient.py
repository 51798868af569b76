"""The derivatives of a stage by what all its samples share, in one loop over samples.

As planes, XLA would evaluate a loop for each of them, and in each compute anew what they have in common.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .changes import merged
from .one_loop import in_one_loop
from .unrolled import unrolled


def gradient_in_one_loop(
    bounded: Callable[..., Any],
    function: Callable[..., Any],
    known: Sequence[Array],
    places: Sequence[int],
    cotangents: Any,
) -> list[Array]:
    """The cotangents of the known planes in some places, from those of the results of function(*known).

    Args:
        bounded: bounded(function, *operands) evaluates a function behind a boundary.
        function: of numbers, element by element of planes [..., rows, lanes]; closes over no traced value.
        places: of at most MOST_RESULTS planes with a single row.
    """
    back, tree = jax.tree.flatten(cotangents)
    shape = cast(tuple[int, ...], jnp.broadcast_shapes(*(plane.shape for plane in back)))
    planes = [plane.reshape((1,) * (len(shape) - plane.ndim) + plane.shape) for plane in (*known, *back)]

    def pulled(*numbers: Array) -> tuple[Array, ...]:
        own = numbers[: len(known)]

        def of_moving(*values: Array) -> Any:
            return function(*merged(own, places, values))

        _, pull = jax.vjp(of_moving, *(own[place] for place in places))
        return pull(tree.unflatten(numbers[len(known) :]))

    jaxpr = jax.make_jaxpr(pulled)(*(jax.ShapeDtypeStruct((), plane.dtype) for plane in planes))
    numbers = in_one_loop(unrolled(jaxpr), planes, shape)
    # Together with the sum XLA would evaluate the loop number by number.
    sums = bounded(_sums_of_rows, numbers)
    return [_summed_to(planes[place].shape, sums[..., k]).reshape(known[place].shape) for k, place in enumerate(places)]


def _sums_of_rows(numbers: Float[Array, "... rows lanes count"]) -> Float[Array, "... 1 lanes count"]:
    *axes, rows, lanes, count = numbers.shape
    # Side by side as they are, so that all are added up at once.
    return jnp.sum(numbers.reshape(*axes, rows, lanes * count), axis=-2).reshape(*axes, 1, lanes, count)


def _summed_to(shape: tuple[int, ...], sums: Array) -> Array:
    """The sums, summed on over axes of length 1 of the shape."""
    axes = [axis for axis, (own, length) in enumerate(zip(shape, sums.shape, strict=True)) if own < length]
    return jnp.sum(sums, axis=axes, keepdims=True)
