"""Sums that XLA's CPU backend keeps as loops of its own.

With JAX 0.12 it gives sums of some thousand numbers to a library, whose calls take up to a hundred times as long,
unless `compiler_options` ask it not to. It knows a sum by what it does with two numbers; one that subtracts the
opposite is none to it, though it is the same to the last bit, and to the processor.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, Literal, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array

from .changes import merged


def multilinear(function: Callable[..., Array], *operands: Array) -> Array:
    """function(*operands), linear in each of them, with sums of this kind, in derivatives of both modes too.

    Derivatives keep the operands as they are given, however they are spread.
    """
    return _multilinear.bind(*operands, jaxpr=jax.make_jaxpr(function)(*operands))


def spread(array: Array, shape: tuple[int, ...]) -> Array:
    """`jnp.broadcast_to`, whose derivatives in reverse mode are sums of this kind."""
    return array if array.shape == shape else multilinear(lambda array: jnp.broadcast_to(array, shape), array)


def with_own_sums(jaxpr: ClosedJaxpr) -> Callable[..., list[Array]]:
    """The program of a jaxpr with all its sums of this kind; it is not to be differentiated any more."""

    def evaluated(*operands: Array) -> list[Array]:
        values = dict(zip([*jaxpr.jaxpr.constvars, *jaxpr.jaxpr.invars], [*jaxpr.consts, *operands], strict=True))

        def value(atom: Any) -> Any:
            return atom.val if isinstance(atom, Literal) else values[atom]

        for equation in jaxpr.jaxpr.eqns:
            results = _results(equation, [value(atom) for atom in equation.invars])
            values.update(zip(equation.outvars, results, strict=True))
        return [value(atom) for atom in jaxpr.jaxpr.outvars]

    return evaluated


def lower_on_cpu(
    primitive: Primitive, plain: Callable[..., Any], by_own_sums: Callable[..., Any], *, multiple_results: bool
) -> None:
    """On the CPU a primitive is evaluated by own sums, but plainly where XLA divides arrays among devices.

    Parts of sums it puts together only where it knows them as sums.
    """
    ways = [mlir.lower_fun(way, multiple_results=multiple_results) for way in (by_own_sums, plain)]

    def lowered(context: mlir.LoweringRuleContext, *operands: Any, **how: Any) -> Any:
        where: Any = context.module_context.axis_context
        by_hand = getattr(where, "manual_axes", None)  # None: in no `jax.shard_map`
        if by_hand is None:
            divided = getattr(where, "num_devices", 1) != 1
        else:
            divided = by_hand != frozenset(where.mesh.axis_names)
        return ways[divided](context, *operands, **how)

    mlir.register_lowering(primitive, lowered, platform="cpu")


def _results(equation: Any, operands: list[Array]) -> Sequence[Array]:
    primitive, how = equation.primitive, equation.params
    if primitive is lax.reduce_sum_p:
        return [_own_sum(operands[0], how["axes"])]
    if primitive.name in _CALLS:
        return with_own_sums(how[_CALLS[primitive.name]])(*operands)
    results = primitive.bind(*operands, **how)
    return results if primitive.multiple_results else [results]


_CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr"}
"""Primitives that evaluate a program, and what they call it."""


def _own_sum(array: Array, axes: tuple[int, ...]) -> Array:
    return lax.reduce(array, jnp.zeros((), array.dtype), lambda total, term: total - (-term), axes)


def _result(*operands: Array, jaxpr: ClosedJaxpr) -> Array:
    return jaxpr_as_fun(jaxpr)(*operands)[0]


def _result_by_own_sums(*operands: Array, jaxpr: ClosedJaxpr) -> Array:
    return with_own_sums(jaxpr)(*operands)[0]


def _jvp(primals: Sequence[Array], tangents: Sequence[Any], *, jaxpr: ClosedJaxpr) -> tuple[Array, Array]:
    moving = [(number, change) for number, change in enumerate(tangents) if type(change) is not ad.Zero]
    changes = [_multilinear.bind(*merged(primals, [number], [change]), jaxpr=jaxpr) for number, change in moving]
    return _multilinear.bind(*primals, jaxpr=jaxpr), functools.reduce(operator.add, changes)


def _transpose(cotangent: Any, *operands: Any, jaxpr: ClosedJaxpr) -> list[Any]:
    (own,) = (number for number, operand in enumerate(operands) if ad.is_undefined_primal(operand))
    aval = operands[own].aval
    if type(cotangent) is ad.Zero:
        return merged([None] * len(operands), [own], [ad.Zero(aval)])
    others = [number for number in range(len(operands)) if number != own]

    def pulled(cotangent: Array, *known: Array) -> Array:
        def of_own(value: Array) -> Array:
            return _result(*merged(merged(operands, others, known), [own], [value]), jaxpr=jaxpr)

        return jax.linear_transpose(of_own, jax.ShapeDtypeStruct(aval.shape, aval.dtype))(cotangent)[0]

    found = multilinear(pulled, cotangent, *(operands[number] for number in others))
    return merged([None] * len(operands), [own], [found])


def _batched(operands: Sequence[Array], axes: Sequence[Any], *, jaxpr: ClosedJaxpr) -> tuple[Array, int]:
    return multilinear(jax.vmap(lambda *own: _result(*own, jaxpr=jaxpr), in_axes=tuple(axes)), *operands), 0


_multilinear = Primitive("multilinear")
_multilinear.def_impl(_result)
_multilinear.def_abstract_eval(lambda *_, jaxpr: jaxpr.out_avals[0])
mlir.register_lowering(_multilinear, mlir.lower_fun(_result, multiple_results=False))
lower_on_cpu(_multilinear, _result, _result_by_own_sums, multiple_results=False)
ad.primitive_jvps[_multilinear] = _jvp
ad.primitive_transposes[_multilinear] = _transpose
batching.primitive_batchers[_multilinear] = _batched
