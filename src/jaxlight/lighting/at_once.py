"""Arrays that are computed in one loop, with what they have in common, and not each in its own.

XLA's CPU backend makes a loop of every result, and each computes anew what several need. The one loop that has several
results is HLO's `reduce` of several arrays. Here it adds up two of each: the array itself, and zeros. Which of the two
an operand is decides nothing but the last choice before the sum, so that LLVM computes all else once, and for many
elements side by side. Divisions and the like that several results need XLA keeps in loops of their own even so.

On other backends the arrays stay what they are.
"""

from __future__ import annotations

import operator
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array


def at_once(arrays: Sequence[Array]) -> list[Array]:
    """The arrays, to the last bit; those of one shape and floating-point type are computed in one loop."""
    alike: dict[Any, list[int]] = defaultdict(list)
    for number, array in enumerate(arrays):
        alike[array.shape, array.dtype].append(number)
    found = list(arrays)
    for (_, dtype), numbers in alike.items():
        if len(numbers) > 1 and jnp.issubdtype(dtype, jnp.floating):
            for number, array in zip(numbers, _at_once.bind(*(arrays[n] for n in numbers)), strict=True):
                found[number] = array
    return found


def _themselves(*arrays: Array) -> list[Array]:
    return list(arrays)


def _in_one_loop(*arrays: Array) -> Sequence[Array]:
    first = lax.broadcasted_iota(jnp.int32, (2, *arrays[0].shape), 0) == 0
    zero = jnp.full((), -0.0, arrays[0].dtype)  # added to -0 it is no 0
    pairs = [jnp.where(first, jnp.broadcast_to(array, first.shape), zero) for array in arrays]

    def added(sums: Sequence[Array], terms: Sequence[Array]) -> tuple[Array, ...]:
        return tuple(map(operator.add, sums, terms))

    return lax.reduce(tuple(pairs), (zero,) * len(arrays), added, (0,))


def _batched(arrays: Sequence[Array], axes: Sequence[Any]) -> tuple[list[Array], list[int]]:
    sizes = [array.shape[axis] for array, axis in zip(arrays, axes, strict=True) if axis is not None]
    moved = [
        jnp.broadcast_to(array, (sizes[0], *array.shape)) if axis is None else jnp.moveaxis(array, axis, 0)
        for array, axis in zip(arrays, axes, strict=True)
    ]
    return _at_once.bind(*moved), [0] * len(arrays)


_at_once = Primitive("at_once")
_at_once.multiple_results = True
_at_once.def_impl(_themselves)
_at_once.def_abstract_eval(lambda *arrays: list(arrays))
mlir.register_lowering(_at_once, mlir.lower_fun(_themselves, multiple_results=True))
mlir.register_lowering(_at_once, mlir.lower_fun(_in_one_loop, multiple_results=True), platform="cpu")
# Whoever wants changes or cotangents at once too says so.
ad.primitive_jvps[_at_once] = lambda arrays, changes: (_at_once.bind(*arrays), list(changes))
ad.primitive_transposes[_at_once] = lambda cotangents, *arrays: list(cotangents)
batching.primitive_batchers[_at_once] = _batched
