"""A stage of a derivative, as a primitive of its own: a linear map behind a boundary (see `stages`).

As a conditional, JAX would split it into what is known and what is linear, and have the known half, a conditional too,
hand copies of all planes that it was given to the other. The primitive stays whole until it is lowered.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Bool


def linear_stage(always: Bool[Array, ""], function: Callable[..., Any], known: Any, moving: Any) -> Any:
    """function(known, moving), linear in `moving`, behind a boundary.

    Args:
        always: true, but only the running program knows.
        function: closes over no traced value.
        known, moving: pytrees of arrays.
    """
    known_leaves, known_tree = jax.tree.flatten(known)
    moving_leaves, moving_tree = jax.tree.flatten(moving)

    def flat(*leaves: Array) -> Any:
        here, there = leaves[: len(known_leaves)], leaves[len(known_leaves) :]
        return function(known_tree.unflatten(here), moving_tree.unflatten(there))

    jaxpr, shapes = jax.make_jaxpr(flat, return_shape=True)(*known_leaves, *moving_leaves)
    results = _linear_stage.bind(always, *known_leaves, *moving_leaves, jaxpr=jaxpr, known=len(known_leaves))
    return jax.tree.structure(shapes).unflatten(results)


def _conditional(always: Array, *operands: Array, jaxpr: ClosedJaxpr, known: int) -> Sequence[Array]:
    def never(*_: Array) -> list[Array]:
        return [jnp.zeros(result.shape, result.dtype) for result in jaxpr.out_avals]

    return lax.cond(always, jaxpr_as_fun(jaxpr), never, *operands)


def _jvp(primals: Sequence[Any], tangents: Sequence[Any], *, jaxpr: ClosedJaxpr, known: int) -> Any:
    always, *operands = primals
    changes = tangents[1:]
    moving = [number for number, change in enumerate(changes) if type(change) is not ad.Zero]

    def of_moving(*values: Array) -> Any:
        merged = list(operands)
        for number, value in zip(moving, values, strict=True):
            merged[number] = value
        return _conditional(always, *merged, jaxpr=jaxpr, known=known)

    return jax.jvp(of_moving, [operands[number] for number in moving], [changes[number] for number in moving])


def _transpose(cotangents: Sequence[Any], always: Array, *operands: Any, jaxpr: ClosedJaxpr, known: int) -> list[Any]:
    linear = [number for number, operand in enumerate(operands) if ad.is_undefined_primal(operand)]
    felt = [number for number, cotangent in enumerate(cotangents) if type(cotangent) is not ad.Zero]
    shapes = [jax.ShapeDtypeStruct(operands[n].aval.shape, operands[n].aval.dtype) for n in linear]

    def pulled(here: tuple[Array, ...], back: list[Array]) -> list[Array]:
        def of_linear(*values: Array) -> list[Array]:
            # What else it is linear in does not matter to its transpose.
            merged = [*here, *(jnp.zeros(a.shape, a.dtype) for a in jaxpr.in_avals[known:])]
            for number, value in zip(linear, values, strict=True):
                merged[number] = value
            results = jaxpr_as_fun(jaxpr)(*merged)
            return [results[number] for number in felt]

        return list(jax.linear_transpose(of_linear, *shapes)(back))

    found = linear_stage(always, pulled, tuple(operands[:known]), [cotangents[number] for number in felt])
    result: list[Any] = [None] * (1 + len(operands))
    for number, cotangent in zip(linear, found, strict=True):
        result[1 + number] = cotangent
    return result


def _batched(operands: Sequence[Any], axes: Sequence[Any], *, jaxpr: ClosedJaxpr, known: int) -> Any:
    always, *operands = operands
    axis, *axes = axes
    always = always if axis is batching.not_mapped else jnp.all(always)
    if all(axis is batching.not_mapped for axis in axes):
        results = _linear_stage.bind(always, *operands, jaxpr=jaxpr, known=known)
        return results, [batching.not_mapped] * len(results)

    def mapped(here: list[Array], there: list[Array]) -> Any:
        return jax.vmap(jaxpr_as_fun(jaxpr), in_axes=axes)(*here, *there)

    results = linear_stage(always, mapped, operands[:known], operands[known:])
    return results, [0] * len(results)


_linear_stage = Primitive("linear_stage")
_linear_stage.multiple_results = True
_linear_stage.def_impl(_conditional)
_linear_stage.def_abstract_eval(lambda *_, jaxpr, known: jaxpr.out_avals)
mlir.register_lowering(_linear_stage, mlir.lower_fun(_conditional, multiple_results=True))
ad.primitive_jvps[_linear_stage] = _jvp
ad.primitive_transposes[_linear_stage] = _transpose
batching.primitive_batchers[_linear_stage] = _batched
