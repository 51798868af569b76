"""A sum of which only the running program knows how many terms it has, as a primitive of its own.

JAX differentiates no loop of unknown length in reverse mode, and of a loop of known length it keeps something of every
turn, needed or not. The derivative of a sum is the sum of its terms' derivatives, in both modes and of any order: here
each is one more such sum, which computes anew what it needs of a term and keeps nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Int

from .changes import merged


def running_sum(function: Callable[[Int[Array, ""]], Any], count: Int[Array, ""]) -> Any:
    """function(0) + function(1) + ... + function(count - 1), zeros if `count` is 0.

    Args:
        function: of the number of a term; gives a pytree of floating-point arrays.
        count: mapped over, all sums run for as long as the longest.
    """
    jaxpr, shapes = jax.make_jaxpr(function, return_shape=True)(jnp.zeros((), jnp.int32))
    given = jaxpr.consts  # what it closes over

    def term(number: Array, *given: Array) -> Sequence[Array]:
        return jaxpr_as_fun(ClosedJaxpr(jaxpr.jaxpr, given))(number)

    return jax.tree.structure(shapes).unflatten(_sum(term, count, given))


def _sum(term: Callable[..., Sequence[Array]], count: Array, given: Sequence[Array]) -> list[Array]:
    """The sum of term(number, *given); `term` closes over no traced value."""
    jaxpr = jax.make_jaxpr(term)(jnp.zeros((), jnp.int32), *given)
    return _running_sum.bind(count, *given, jaxpr=jaxpr)


def _loop(count: Array, *given: Array, jaxpr: ClosedJaxpr) -> list[Array]:
    def turn(state: tuple[Array, list[Array]]) -> tuple[Array, list[Array]]:
        number, total = state
        terms = jaxpr_as_fun(jaxpr)(number, *given)
        return number + 1, [so_far + term for so_far, term in zip(total, terms, strict=True)]

    zeros = [jnp.zeros(result.shape, result.dtype) for result in jaxpr.out_avals]
    return lax.while_loop(lambda state: state[0] < count, turn, (jnp.zeros((), jnp.int32), zeros))[1]


def _jvp(primals: Sequence[Any], tangents: Sequence[Any], *, jaxpr: ClosedJaxpr) -> tuple[Sequence[Any], Sequence[Any]]:
    count, *given = primals
    changes = tangents[1:]
    moving = [number for number, change in enumerate(changes) if type(change) is not ad.Zero]

    def change(number: Array, *operands: Array) -> Sequence[Array]:
        known, directions = operands[: len(given)], operands[len(given) :]

        def of_moving(*values: Array) -> Sequence[Array]:
            return jaxpr_as_fun(jaxpr)(number, *merged(known, moving, values))

        return jax.jvp(of_moving, [known[n] for n in moving], list(directions))[1]

    results = _running_sum.bind(*primals, jaxpr=jaxpr)
    return results, _sum(change, count, [*given, *(changes[n] for n in moving)])


def _transpose(cotangents: Sequence[Any], count: Array, *given: Any, jaxpr: ClosedJaxpr) -> list[Any]:
    linear = [number for number, operand in enumerate(given) if ad.is_undefined_primal(operand)]
    felt = [number for number, cotangent in enumerate(cotangents) if type(cotangent) is not ad.Zero]
    known = [number for number in range(len(given)) if number not in linear]
    shapes = [jax.ShapeDtypeStruct(given[n].aval.shape, given[n].aval.dtype) for n in linear]

    def pulled(number: Array, *operands: Array) -> Sequence[Array]:
        here, back = operands[: len(known)], operands[len(known) :]

        def of_linear(*values: Array) -> list[Array]:
            operands = merged(merged([None] * len(given), known, here), linear, values)
            results = jaxpr_as_fun(jaxpr)(number, *operands)
            return [results[n] for n in felt]

        return jax.linear_transpose(of_linear, *shapes)(list(back))

    found = _sum(pulled, count, [*(given[n] for n in known), *(cotangents[n] for n in felt)])
    return [None, *merged([None] * len(given), linear, found)]


def _batched(operands: Sequence[Any], axes: Sequence[Any], *, jaxpr: ClosedJaxpr) -> tuple[list[Array], list[int]]:
    count, *given = operands

    def term(number: Array, count: Array, *given: Array) -> list[Array]:
        return [jnp.where(number < count, one, 0.0) for one in jaxpr_as_fun(jaxpr)(number, *given)]

    if axes[0] is None:
        results = _sum(jax.vmap(jaxpr_as_fun(jaxpr), in_axes=(None, *axes[1:])), count, given)
    else:
        results = _sum(jax.vmap(term, in_axes=(None, *axes)), jnp.max(count), [count, *given])
    return results, [0] * len(results)


_running_sum = Primitive("running_sum")
_running_sum.multiple_results = True
_running_sum.def_impl(_loop)
_running_sum.def_abstract_eval(lambda *_, jaxpr: jaxpr.out_avals)
mlir.register_lowering(_running_sum, mlir.lower_fun(_loop, multiple_results=True))
ad.primitive_jvps[_running_sum] = _jvp
ad.primitive_transposes[_running_sum] = _transpose
batching.primitive_batchers[_running_sum] = _batched
