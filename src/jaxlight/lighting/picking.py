"""Numbers of listed lights, picked one by one, whose derivatives are added up for all numbers of a light at once.

JAX would add up the derivatives of each number by itself: as many loops over the list, and each of their additions
waits for the one before if both are of the same light.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float, Int


def picked(numbers: Sequence[Float[Array, "... lights"]], row: Int[Array, "..."]) -> list[Float[Array, "..."]]:
    """Of each array, whose last axis counts lights, the numbers of the lights in these rows.

    Args:
        numbers: arrays [lights] or [components, lights].
        row: of any shape, which takes the place of the last axis; none is out of range.
    """
    return _picked.bind(row, *numbers)


def _pick(row: Array, *numbers: Array) -> list[Array]:
    return [_from_one_row(plane, row) for plane in numbers]


def _from_one_row(plane: Array, row: Array) -> Array:
    # Components each by itself XLA would put together element by element.
    *components, lights = plane.shape
    first = lights * jnp.arange(math.prod(components), dtype=row.dtype).reshape(*components, *[1] * row.ndim)
    return plane.reshape(-1).at[first + row].get(mode="promise_in_bounds")


def _jvp(primals: Sequence[Any], tangents: Sequence[Any]) -> tuple[list[Array], list[Any]]:
    row, *numbers = primals
    moving = [change for change in tangents[1:] if type(change) is not ad.Zero]
    changes = iter(_picked.bind(row, *moving) if moving else [])
    results = _picked.bind(row, *numbers)
    return results, [
        ad.Zero(jax.typeof(result)) if type(change) is ad.Zero else next(changes)
        for change, result in zip(tangents[1:], results, strict=True)
    ]


def _transpose(cotangents: Sequence[Any], row: Array, *numbers: Any) -> list[Any]:
    felt = [number for number, cotangent in enumerate(cotangents) if type(cotangent) is not ad.Zero]
    found: list[Any] = [None] * len(numbers)
    if not felt:
        return [None, *found]
    planes = jnp.concatenate([cotangents[number].reshape(-1, row.size) for number in felt])
    # In rows of whole vectors, or XLA would add number by number.
    planes = jnp.pad(planes, ((0, -len(planes) % 4), (0, 0)))
    lights = numbers[felt[0]].aval.shape[-1]
    table = jnp.zeros((lights, len(planes)), planes.dtype)
    table = table.at[row.reshape(-1)].add(planes.T, mode="promise_in_bounds")
    first = 0
    for number in felt:
        shape = numbers[number].aval.shape
        count = math.prod(shape[:-1])
        found[number] = table[:, first : first + count].T.reshape(shape)
        first += count
    return [None, *found]


def _batched(operands: Sequence[Any], axes: Sequence[Any]) -> tuple[list[Array], list[int]]:
    results = jax.vmap(_pick, in_axes=list(axes))(*operands)
    return results, [0] * len(results)


def _shapes(row: Any, *numbers: Any) -> list[Any]:
    return [plane.update(shape=(*plane.shape[:-1], *row.shape)) for plane in numbers]


_picked = Primitive("picked")
_picked.multiple_results = True
_picked.def_impl(_pick)
_picked.def_abstract_eval(_shapes)
mlir.register_lowering(_picked, mlir.lower_fun(_pick, multiple_results=True))
ad.primitive_jvps[_picked] = _jvp
ad.primitive_transposes[_picked] = _transpose
batching.primitive_batchers[_picked] = _batched
