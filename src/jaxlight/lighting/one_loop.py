"""A function of small arrays, evaluated for all elements of planes in one loop, with all that it needs in registers.

XLA's CPU backend makes a loop of every result, and puts what leads to that, however long an expression, into the same
loop, which LLVM vectorises. Here the one result has the numbers of an element side by side: which of them is asked for
says an operand that counts 0, 1, ... along a last axis. All else does not depend on it, and LLVM computes it once an
element. The code must consist of what LLVM vectorises (see `elementary`).

Two things XLA would take out of the loop and store: what it holds to be costly (a division, a root) and is asked for by
more than one, and what all numbers of an element share, before it is repeated for each of them. Both are hidden from it
by a choice whose condition is always true: that the count is less than the number of results. LLVM sees that it is.

Other backends evaluate the function on the planes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, Primitive
from jax.interpreters import batching, mlir
from jaxtyping import Array

from .unrolled import COSTLY, unrolled


def in_one_loop(jaxpr: ClosedJaxpr, planes: Sequence[Array], shape: tuple[int, ...]) -> Array:
    """A function, element by element; its results side by side, [*shape, results]. Not to be differentiated.

    Args:
        jaxpr: of the function, that can be `unrolled`; gives 2 to 8 numbers (LLVM writes no more at once), all of one
            type.
        planes: one for every number that the function is given, of as many axes as `shape`, to which they are
            broadcast.
    """
    return _one_loop.bind(*planes, jaxpr=jaxpr, shape=shape)


def on_planes(jaxpr: ClosedJaxpr, planes: Sequence[Array], shape: tuple[int, ...]) -> list[Array]:
    """The same function, any number of results, each a plane of its own."""

    def applied(primitive: Primitive, numbers: Sequence[Any], params: dict[str, Any]) -> Array:
        return primitive.bind(*(_repeated(number, shape) for number in numbers), **params)

    results = unrolled(jaxpr, applied)(*(_repeated(plane, shape) for plane in planes))
    return [_repeated(result, shape) for result in results]


def _stacked(*planes: Array, jaxpr: ClosedJaxpr, shape: tuple[int, ...]) -> Array:
    return jnp.stack(on_planes(jaxpr, planes, shape), axis=-1)


def _in_loop(*planes: Array, jaxpr: ClosedJaxpr, shape: tuple[int, ...]) -> Array:
    count = _count(jaxpr)
    whole = (*shape, count)
    which = lax.broadcasted_iota(jnp.int32, whole, len(shape))
    always = which < count

    def hidden(number: Array) -> Array:
        """The same, as something that XLA holds neither to be costly nor to be shared."""
        return lax.select(always, number, jnp.zeros_like(number))

    def applied(primitive: Primitive, numbers: Sequence[Any], params: dict[str, Any]) -> Array:
        result = primitive.bind(*(_repeated(number, whole) for number in numbers), **params)
        return hidden(result) if primitive.name in COSTLY else result

    own = [_repeated(plane, whole) for plane in planes]
    own = [number if plane.size == 1 else hidden(number) for number, plane in zip(own, planes, strict=True)]
    results = [_repeated(result, whole) for result in unrolled(jaxpr, applied)(*own)]
    value = results[-1]
    for k in reversed(range(count - 1)):
        value = lax.select(which == k, results[k], value)
    return value


def _repeated(number: Any, shape: tuple[int, ...]) -> Array:
    """A number, or a plane whose axes are the first ones of the shape, in that shape."""
    return number if number.shape == shape else lax.broadcast_in_dim(number, shape, range(number.ndim))


def _batched(
    planes: Sequence[Array], axes: Sequence[Any], *, jaxpr: ClosedJaxpr, shape: tuple[int, ...]
) -> tuple[Array, int]:
    sizes = [plane.shape[axis] for plane, axis in zip(planes, axes, strict=True) if axis is not None]
    moved = [
        plane[None] if axis is None else jnp.moveaxis(plane, axis, 0) for plane, axis in zip(planes, axes, strict=True)
    ]
    return _one_loop.bind(*moved, jaxpr=jaxpr, shape=(sizes[0], *shape)), 0


def _side_by_side(*planes: Any, jaxpr: ClosedJaxpr, shape: tuple[int, ...]) -> Any:
    return jaxpr.out_avals[0].update(shape=(*shape, _count(jaxpr)))


def _count(jaxpr: ClosedJaxpr) -> int:
    """How many numbers the function gives."""
    return sum(math.prod(result.shape) for result in jaxpr.out_avals)


_one_loop = Primitive("one_loop")
_one_loop.def_impl(_stacked)
_one_loop.def_abstract_eval(_side_by_side)
mlir.register_lowering(_one_loop, mlir.lower_fun(_stacked, multiple_results=False))
mlir.register_lowering(_one_loop, mlir.lower_fun(_in_loop, multiple_results=False), platform="cpu")
batching.primitive_batchers[_one_loop] = _batched
