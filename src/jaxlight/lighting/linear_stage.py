"""A stage of a derivative, as a primitive of its own: a linear map behind a boundary (see `stages`).

As a conditional, JAX would split it into what is known and what is linear, and have the known half, a conditional too,
hand copies of all planes that it was given to the other. The primitive stays whole until it is lowered; on other
processors than the CPU, which have no use for the boundary, to the last of its forms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Int

from .at_once import at_once
from .changes import merged
from .own_sums import lower_on_cpu, with_own_sums
from .pruned import pruned


def linear_stage(
    which: Int[Array, ""],
    functions: Sequence[Callable[..., Any]],
    known: Any,
    moving: Any,
) -> Any:
    """functions[which](known, moving), linear in `moving`, behind a boundary.

    Args:
        which: one of them, but only the running program knows. Mapped over, the largest counts for all.
        functions: close over no traced value; all give the same shapes. The cotangents of the first are computed at
            once.
        known, moving: pytrees of arrays.
    """
    traced = [jax.make_jaxpr(function, return_shape=True)(known, moving) for function in functions]
    jaxprs = tuple(pruned(jaxpr) for jaxpr, _ in traced)
    known, moving = jax.tree.leaves(known), jax.tree.leaves(moving)
    tree = jax.tree.structure(traced[0][1])
    return tree.unflatten(_linear_stage.bind(which, *known, *moving, known=len(known), jaxprs=jaxprs))


_Forms = tuple[ClosedJaxpr, ...]


def _evaluated(
    which: Array,
    *operands: Array,
    jaxprs: _Forms,
    known: int,
    evaluated: Callable[[ClosedJaxpr], Callable[..., Sequence[Array]]] = jaxpr_as_fun,
) -> Sequence[Array]:
    def never(*_: Array) -> list[Array]:
        return [jnp.zeros(result.shape, result.dtype) for result in jaxprs[0].out_avals]

    return lax.switch(which, [*map(evaluated, jaxprs), never], *operands)


def _last_form(which: Array, *operands: Array, jaxprs: _Forms, known: int) -> Sequence[Array]:
    return jaxpr_as_fun(jaxprs[-1])(*operands)


def _jvp(primals: Sequence[Any], tangents: Sequence[Any], *, jaxprs: _Forms, known: int) -> Any:
    which, *operands = primals
    changes = tangents[1:]
    moving = [number for number, change in enumerate(changes) if type(change) is not ad.Zero]
    own, directions = [operands[number] for number in moving], [changes[number] for number in moving]
    if any(number < known for number in moving):

        def of_moving(*values: Array) -> Any:
            return _evaluated(which, *merged(operands, moving, values), jaxprs=jaxprs, known=known)

        return jax.jvp(of_moving, own, directions)

    def change(jaxpr: ClosedJaxpr, here: list[Array], directions: list[Array]) -> list[Array]:
        zeros = [jnp.zeros_like(direction) for direction in directions]
        return jax.jvp(_of_linear(jaxpr, here, moving), zeros, directions)[1]

    results = _linear_stage.bind(*primals, jaxprs=jaxprs, known=known)
    return results, linear_stage(which, [partial(change, jaxpr) for jaxpr in jaxprs], operands[:known], directions)


def _of_linear(jaxpr: ClosedJaxpr, known: Sequence[Array], numbers: list[int]) -> Callable[..., list[Array]]:
    """A form as a function of the operands of these numbers, in which it is linear: of the others zeros will do."""
    given = [*known, *(jnp.zeros(operand.shape, operand.dtype) for operand in jaxpr.in_avals[len(known) :])]
    return lambda *values: jaxpr_as_fun(jaxpr)(*merged(given, numbers, values))


def _transpose(cotangents: Sequence[Any], which: Array, *operands: Any, jaxprs: _Forms, known: int) -> list[Any]:
    linear = [number for number, operand in enumerate(operands) if ad.is_undefined_primal(operand)]
    felt = [number for number, cotangent in enumerate(cotangents) if type(cotangent) is not ad.Zero]
    shapes = [jax.ShapeDtypeStruct(operands[n].aval.shape, operands[n].aval.dtype) for n in linear]

    def pulled(jaxpr: ClosedJaxpr, here: tuple[Array, ...], back: list[Array]) -> list[Array]:
        of_linear = _of_linear(jaxpr, here, linear)

        def of_felt(*values: Array) -> list[Array]:
            results = of_linear(*values)
            return [results[number] for number in felt]

        found = list(jax.linear_transpose(of_felt, *shapes)(back))
        alike = [number for number, cotangent in enumerate(found) if cotangent.shape == back[0].shape]
        return merged(found, alike, at_once([found[number] for number in alike]))

    functions = [partial(pulled, jaxpr) for jaxpr in jaxprs]
    found = linear_stage(which, functions, tuple(operands[:known]), [cotangents[number] for number in felt])
    return [None, *merged([None] * len(operands), linear, found)]


def _batched(operands: Sequence[Any], axes: Sequence[Any], *, jaxprs: _Forms, known: int) -> Any:
    which, *operands = operands
    axis, *axes = axes
    which = which if axis is None else jnp.max(which)
    if all(axis is None for axis in axes):
        results = _linear_stage.bind(which, *operands, jaxprs=jaxprs, known=known)
        return results, [None] * len(results)

    def mapped(jaxpr: ClosedJaxpr, here: list[Array], there: list[Array]) -> Any:
        return jax.vmap(jaxpr_as_fun(jaxpr), in_axes=axes)(*here, *there)

    results = linear_stage(which, [partial(mapped, jaxpr) for jaxpr in jaxprs], operands[:known], operands[known:])
    return results, [0] * len(results)


_linear_stage = Primitive("linear_stage")
_linear_stage.multiple_results = True
_linear_stage.def_impl(_evaluated)
_linear_stage.def_abstract_eval(lambda *_, jaxprs, **others: jaxprs[0].out_avals)
mlir.register_lowering(_linear_stage, mlir.lower_fun(_last_form, multiple_results=True))
lower_on_cpu(_linear_stage, _evaluated, partial(_evaluated, evaluated=with_own_sums), multiple_results=True)
ad.primitive_jvps[_linear_stage] = _jvp
ad.primitive_transposes[_linear_stage] = _transpose
batching.primitive_batchers[_linear_stage] = _batched
