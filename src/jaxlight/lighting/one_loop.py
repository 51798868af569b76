"""A function of small arrays, evaluated for all elements of planes in one loop, with all that it needs in registers.

XLA's CPU backend makes a loop of every result. HLO's `map` applies a computation on numbers, as long as one likes, to
all elements in one loop that LLVM vectorises, but it has one result. Here that result has the numbers of an element
side by side: which of them is asked for says an operand that counts 0, 1, ... along a last axis. All else does not
depend on it, and LLVM computes it once an element. The code must consist of what LLVM vectorises (see `elementary`).

Other backends evaluate the function on the planes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.extend.mlir import ir
from jax.extend.mlir.dialects import stablehlo
from jax.interpreters import batching, mlir
from jaxtyping import Array

from .unrolled import unrolled


def in_one_loop(jaxpr: ClosedJaxpr, planes: Sequence[Array], shape: tuple[int, ...]) -> Array:
    """A function, element by element; its results side by side, [*shape, results]. Not to be differentiated.

    Args:
        jaxpr: of the function, that can be `unrolled`; gives at most 8 numbers (LLVM writes no more at once), all of
            one type.
        planes: one for every number that the function is given, of as many axes as `shape`, to which they are
            broadcast.
    """
    return _one_loop.bind(*planes, jaxpr=jaxpr, shape=shape)


def _of_numbers(jaxpr: ClosedJaxpr) -> ClosedJaxpr:
    """The function unrolled. That takes long, and is done only for loops that are compiled: derivatives need none."""
    numbers = [
        jax.ShapeDtypeStruct((), operand.dtype) for operand in jaxpr.in_avals for _ in range(math.prod(operand.shape))
    ]
    return jax.make_jaxpr(unrolled(jaxpr))(*numbers)


def _on_planes(*planes: Array, jaxpr: ClosedJaxpr, shape: tuple[int, ...]) -> Array:
    function = jaxpr_as_fun(_of_numbers(jaxpr))
    for _ in shape:
        function = jax.vmap(function)
    return jnp.stack(function(*(jnp.broadcast_to(plane, shape) for plane in planes)), axis=-1)


def _in_loop(*planes: Array, jaxpr: ClosedJaxpr, shape: tuple[int, ...]) -> Array:
    count, function = _count(jaxpr), jaxpr_as_fun(_of_numbers(jaxpr))

    def chosen(which: Array, *numbers: Array) -> Array:
        results = function(*numbers)
        value = results[-1]
        for k in reversed(range(count - 1)):
            value = lax.select(lax.eq(which, jnp.int32(k)), results[k], value)
        return value

    whole = (*shape, count)
    operands = [lax.broadcasted_iota(jnp.int32, whole, len(shape))]
    operands += [lax.broadcast_in_dim(plane, whole, range(len(shape))) for plane in planes]
    body = jax.make_jaxpr(chosen)(*(jax.ShapeDtypeStruct((), operand.dtype) for operand in operands))
    return _map.bind(*operands, jaxpr=body)


def _lowered_map(context: Any, *operands: Any, jaxpr: ClosedJaxpr) -> Any:
    (result,) = context.avals_out
    kind = mlir.dtype_to_ir_type(result.dtype)
    operation = stablehlo.MapOp(ir.RankedTensorType.get(result.shape, kind), operands, range(result.ndim))
    numbers = [ir.RankedTensorType.get((), operand.type.element_type) for operand in operands]
    block = operation.regions[0].blocks.append(*numbers)
    inside = context.replace(avals_in=jaxpr.in_avals, avals_out=jaxpr.out_avals)
    with ir.InsertionPoint(block):
        function = mlir.lower_fun(jaxpr_as_fun(jaxpr), multiple_results=True)
        stablehlo.ReturnOp(jax.tree.leaves(function(inside, *block.arguments)))
    return operation.results


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
_one_loop.def_impl(_on_planes)
_one_loop.def_abstract_eval(_side_by_side)
mlir.register_lowering(_one_loop, mlir.lower_fun(_on_planes, multiple_results=False))
mlir.register_lowering(_one_loop, mlir.lower_fun(_in_loop, multiple_results=False), platform="cpu")
batching.primitive_batchers[_one_loop] = _batched

_map = Primitive("map")
_map.def_abstract_eval(lambda *operands, jaxpr: jaxpr.out_avals[0].update(shape=operands[0].shape))
mlir.register_lowering(_map, _lowered_map)
