"""Functions of small arrays as functions of single numbers: every operation on an array becomes one on each element.

What only moves elements costs nothing then, and what is left is operations on numbers, for `one_loop` to put into one
loop.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Primitive
from jaxtyping import Array

Elements = np.ndarray
"""Of any shape, whose elements (dtype object) are numbers or traced numbers."""

Applied = Callable[[Primitive, Sequence[Any], dict[str, Any]], Any]
"""The result of an operation on numbers, given its parameters too."""


def _applied(primitive: Primitive, numbers: Sequence[Any], params: dict[str, Any]) -> Any:
    return primitive.bind(*numbers, **params)


def unrolled(jaxpr: ClosedJaxpr, applied: Applied = _applied) -> Callable[..., list[Array]]:
    """The function that the jaxpr stands for, from the elements of its operands, row by row, to those of its results.

    Args:
        jaxpr: of the function.
        applied: how operations on numbers are applied. Constants are given to it as numbers of NumPy.

    Raises:
        NotImplementedError: an operation that cannot be unrolled.
    """
    shapes = [operand.shape for operand in jaxpr.in_avals]

    def function(*numbers: Array) -> list[Array]:
        operands, first = [], 0
        for shape in shapes:
            count = math.prod(shape)
            operands.append(_elements(numbers[first : first + count], shape))
            first += count
        results = _evaluated(applied, jaxpr.jaxpr, [_constants(const) for const in jaxpr.consts], operands)
        return [number for result in results for number in result.reshape(-1)]

    return function


def _elements(numbers: Sequence[Any], shape: tuple[int, ...]) -> Elements:
    return np.fromiter(numbers, dtype=object, count=len(numbers)).reshape(shape)


def _constants(value: Any) -> Elements:
    array = np.asarray(value)
    return _elements([array.dtype.type(number) for number in array.reshape(-1)], array.shape)


def _evaluated(
    applied: Applied, jaxpr: Jaxpr, consts: Sequence[Elements], operands: Sequence[Elements]
) -> list[Elements]:
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *operands], strict=True))

    def read(variable: Any) -> Elements:
        return _constants(variable.val) if isinstance(variable, Literal) else known[variable]

    for equation in jaxpr.eqns:
        results = _results(applied, equation, [read(variable) for variable in equation.invars])
        known.update(zip(equation.outvars, results, strict=True))
    return [read(variable) for variable in jaxpr.outvars]


def _results(applied: Applied, equation: Any, operands: list[Elements]) -> list[Elements]:
    name, params = equation.primitive.name, equation.params
    inner = params.get("call_jaxpr", params.get("jaxpr"))
    if isinstance(inner, ClosedJaxpr):
        return _evaluated(applied, inner.jaxpr, [_constants(const) for const in inner.consts], operands)
    if isinstance(inner, Jaxpr):
        return _evaluated(applied, inner, [], operands)
    shape = equation.outvars[0].aval.shape
    if name in _IDENTITIES:
        return operands
    if name in _MOVES:
        return [_MOVES[name](operands, shape, params)]
    if name == "unstack":  # what later releases of JAX make of an array that is taken apart
        parts = np.moveaxis(operands[0], params["axis"], 0)
        return [parts[number : number + 1].reshape(shape) for number in range(len(parts))]
    if name == "reduce_sum":
        kept = [axis for axis in range(operands[0].ndim) if axis not in params["axes"]]
        rows = operands[0].transpose(*kept, *params["axes"]).reshape(math.prod(shape), -1)
        return [_elements([functools.reduce(operator.add, row) for row in rows], shape)]
    if name not in _ELEMENTWISE:
        raise NotImplementedError(f"{name} of {[operand.shape for operand in operands]} cannot be unrolled")
    columns = [np.broadcast_to(operand, shape).reshape(-1) for operand in operands]
    return [_elements([applied(equation.primitive, row, params) for row in zip(*columns, strict=True)], shape)]


def _broadcast(operands: list[Elements], shape: tuple[int, ...], params: dict[str, Any]) -> Elements:
    own = [1] * len(shape)
    for axis, length in zip(params["broadcast_dimensions"], operands[0].shape, strict=True):
        own[axis] = length
    return np.broadcast_to(operands[0].reshape(own), shape)


def _slice(operands: list[Elements], shape: tuple[int, ...], params: dict[str, Any]) -> Elements:
    strides = params["strides"] or (1,) * operands[0].ndim
    parts = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return operands[0][tuple(slice(*part) for part in parts)]


_MOVES: dict[str, Callable[[list[Elements], tuple[int, ...], dict[str, Any]], Elements]] = {
    "broadcast_in_dim": _broadcast,
    "reshape": lambda operands, shape, params: operands[0].reshape(shape),
    "squeeze": lambda operands, shape, params: operands[0].reshape(shape),
    "expand_dims": lambda operands, shape, params: operands[0].reshape(shape),
    "transpose": lambda operands, shape, params: operands[0].transpose(params["permutation"]),
    "slice": _slice,
    "stack": lambda operands, shape, params: np.stack(operands, axis=params["axis"]),
    "concatenate": lambda operands, shape, params: np.concatenate(operands, axis=params["dimension"]),
}
_IDENTITIES = {"layout_constraint", "name", "optimization_barrier", "pvary", "reshard", "sharding_constraint"}
"""What says of arrays where they lie, how they are called or when they are computed: of numbers nothing."""
_ARITHMETIC = {"abs", "add", "add_any", "div", "max", "min", "mul", "neg", "rem", "sign", "sub"}
_ROUNDED = {"clamp", "convert_element_type", "copy", "floor", "round"}
_FUNCTIONS = {"atan2", "cos", "integer_pow", "rsqrt", "sin", "sqrt", "square", "tanh"}
_POWERS = {"exp", "exp2", "expm1", "log", "log1p", "log2", "pow"}
_CHOICES = {"and", "eq", "ge", "gt", "is_finite", "le", "lt", "ne", "not", "or", "select_n", "xor"}
_BITS = {"bitcast_convert_type", "shift_left", "shift_right_arithmetic", "shift_right_logical"}
COSTLY = {"div", "rem"} | _FUNCTIONS | _POWERS
"""Names of what XLA holds to be costly, and some others."""
_ELEMENTWISE = _ARITHMETIC | _ROUNDED | _FUNCTIONS | _POWERS | _CHOICES | _BITS
