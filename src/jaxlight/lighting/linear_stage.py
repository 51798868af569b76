"""A stage of a derivative, as a primitive of its own: a linear map behind a boundary (see `stages`).

As a conditional, JAX would split it into what is known and what is linear, and have the known half, a conditional too,
hand copies of all planes that it was given to the other. The primitive stays whole until it is lowered.
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

from .changes import merged


def linear_stage(
    which: Int[Array, ""],
    functions: Sequence[Callable[..., Any]],
    known: Any,
    moving: Any,
    *,
    gradients: Sequence[Callable[..., Any]] | None = None,
    quick: Sequence[Callable[..., Any]] | None = None,
) -> Any:
    """functions[which - 1](known, moving), linear in `moving`, behind a boundary.

    Args:
        which: at least 1, but only the running program knows. Mapped over, the largest counts for all.
        functions: close over no traced value; all give the same shapes.
        known, moving: pytrees of arrays.
        gradients: of (known, results), quicker forms of the functions' transposes; give what `moving` is.
        quick: of (known, moving), quicker forms of the functions. Neither form is differentiated.
    """
    known_leaves, known_tree = jax.tree.flatten(known)
    moving_leaves, moving_tree = jax.tree.flatten(moving)

    def flat(function: Callable[..., Any], tree: Any, *leaves: Array) -> Any:
        here, there = leaves[: len(known_leaves)], leaves[len(known_leaves) :]
        return function(known_tree.unflatten(here), tree.unflatten(there))

    shapes = jax.eval_shape(functions[0], known, moving)
    results, tree = jax.tree.flatten(shapes)

    def jaxprs_of(functions: Sequence[Callable[..., Any]], tree: Any, *given: Any) -> _Forms:
        return tuple(jax.make_jaxpr(partial(flat, function, tree))(*known_leaves, *given) for function in functions)

    forms = {
        "jaxprs": jaxprs_of(functions, moving_tree, *moving_leaves),
        "gradients": None if gradients is None else jaxprs_of(gradients, tree, *results),
        "quick": None if quick is None else jaxprs_of(quick, moving_tree, *moving_leaves),
    }
    leaves = (*known_leaves, *moving_leaves)
    return tree.unflatten(_linear_stage.bind(which, *leaves, known=len(known_leaves), **forms))


_Forms = tuple[ClosedJaxpr, ...]


def _evaluated(
    which: Array, *operands: Array, jaxprs: _Forms, known: int, gradients: _Forms | None, quick: _Forms | None
) -> Sequence[Array]:
    return _conditional(which, operands, jaxprs if quick is None else quick)


def _conditional(which: Array, operands: Sequence[Array], jaxprs: Sequence[ClosedJaxpr]) -> Sequence[Array]:
    def never(*_: Array) -> list[Array]:
        return [jnp.zeros(result.shape, result.dtype) for result in jaxprs[0].out_avals]

    return lax.switch(which, [never, *map(jaxpr_as_fun, jaxprs)], *operands)


def _jvp(
    primals: Sequence[Any], tangents: Sequence[Any], *, jaxprs: _Forms, known: int, **quicker: _Forms | None
) -> Any:
    which, *operands = primals
    changes = tangents[1:]
    moving = [number for number, change in enumerate(changes) if type(change) is not ad.Zero]

    def of_moving(*values: Array) -> Any:
        return _conditional(which, merged(operands, moving, values), jaxprs)

    return jax.jvp(of_moving, [operands[number] for number in moving], [changes[number] for number in moving])


def _transpose(
    cotangents: Sequence[Any],
    which: Array,
    *operands: Any,
    jaxprs: _Forms,
    known: int,
    gradients: _Forms | None,
    quick: _Forms | None,
) -> list[Any]:
    linear = [number for number, operand in enumerate(operands) if ad.is_undefined_primal(operand)]
    felt = [number for number, cotangent in enumerate(cotangents) if type(cotangent) is not ad.Zero]
    shapes = [jax.ShapeDtypeStruct(operands[n].aval.shape, operands[n].aval.dtype) for n in linear]

    def pulled(jaxpr: ClosedJaxpr, here: tuple[Array, ...], back: list[Array]) -> list[Array]:
        def of_linear(*values: Array) -> list[Array]:
            # What else it is linear in does not matter to its transpose.
            given = [*here, *(jnp.zeros(a.shape, a.dtype) for a in jaxpr.in_avals[known:])]
            results = jaxpr_as_fun(jaxpr)(*merged(given, linear, values))
            return [results[number] for number in felt]

        return list(jax.linear_transpose(of_linear, *shapes)(back))

    def quickly(gradient: ClosedJaxpr, here: tuple[Array, ...], back: list[Array]) -> list[Array]:
        results = jaxpr_as_fun(gradient)(*here, *back)
        return [results[number - known] for number in linear]

    functions = [partial(pulled, jaxpr) for jaxpr in jaxprs]
    back = [cotangents[number] for number in felt]
    forms = None
    if gradients is not None and len(felt) == len(cotangents):
        forms = [partial(quickly, gradient) for gradient in gradients]
    found = linear_stage(which, functions, tuple(operands[:known]), back, quick=forms)
    return [None, *merged([None] * len(operands), linear, found)]


def _batched(
    operands: Sequence[Any],
    axes: Sequence[Any],
    *,
    jaxprs: _Forms,
    known: int,
    gradients: _Forms | None,
    quick: _Forms | None,
) -> Any:
    which, *operands = operands
    axis, *axes = axes
    which = which if axis is None else jnp.max(which)
    if all(axis is None for axis in axes):
        results = _linear_stage.bind(which, *operands, jaxprs=jaxprs, known=known, gradients=gradients, quick=quick)
        return results, [None] * len(results)

    def mapped(jaxpr: ClosedJaxpr, here: list[Array], there: list[Array]) -> Any:
        return jax.vmap(jaxpr_as_fun(jaxpr), in_axes=axes)(*here, *there)

    def mapped_gradient(jaxpr: ClosedJaxpr, here: list[Array], back: list[Array]) -> list[Array]:
        in_axes = (*axes[:known], *([0] * len(back)))
        found = jax.vmap(jaxpr_as_fun(jaxpr), in_axes=in_axes)(*here, *back)
        return [
            jnp.sum(own, axis=0) if axis is None else jnp.moveaxis(own, 0, axis)
            for axis, own in zip(axes[known:], found, strict=True)
        ]

    results = linear_stage(
        which,
        [partial(mapped, jaxpr) for jaxpr in jaxprs],
        operands[:known],
        operands[known:],
        gradients=None if gradients is None else [partial(mapped_gradient, gradient) for gradient in gradients],
        quick=None if quick is None else [partial(mapped, form) for form in quick],
    )
    return results, [0] * len(results)


_linear_stage = Primitive("linear_stage")
_linear_stage.multiple_results = True
_linear_stage.def_impl(_evaluated)
_linear_stage.def_abstract_eval(lambda *_, jaxprs, **others: jaxprs[0].out_avals)
mlir.register_lowering(_linear_stage, mlir.lower_fun(_evaluated, multiple_results=True))
ad.primitive_jvps[_linear_stage] = _jvp
ad.primitive_transposes[_linear_stage] = _transpose
batching.primitive_batchers[_linear_stage] = _batched
