"""Traced functions that are equal where they compute the same, so that JAX finds what it has compiled.

A function that is written where it is used, as a `lambda` in a loss, is a new one in every call.
"""

from __future__ import annotations

import functools
from collections.abc import Hashable
from types import FunctionType, MethodType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun
from jax.extend.linear_util import WrappedFun
from jaxtyping import Array

_NONE: frozenset[str] = frozenset()
_RULES = frozenset(["jvp_jaxpr_fun", "fwd_jaxpr_thunk", "bwd", "out_trees"])
"""Parameters of functions with derivative rules of their own: made anew whenever they are traced."""


class Program:
    """A traced function of arrays; what it closes over is given after its operands.

    Two are equal if they compute the same, and their first derivatives in reverse too.
    """

    def __init__(self, jaxpr: Jaxpr) -> None:
        self._jaxpr = jaxpr

    def __call__(self, *operands: Array) -> Array:
        of_samples, constants = operands[: len(self._jaxpr.invars)], operands[len(self._jaxpr.invars) :]
        return jaxpr_as_fun(ClosedJaxpr(self._jaxpr, constants))(*of_samples)[0]

    @functools.cached_property
    def key(self) -> Hashable:
        """All that it computes; None where that cannot be told, so that it is equal to itself alone."""
        try:
            return _of_jaxpr(self._jaxpr, _NONE)
        except TypeError:
            pass
        try:
            return _of_jaxpr(self._jaxpr, _RULES), _of_value(self._derivative(), _RULES)
        except Exception:  # by some number nobody may ask for it cannot be differentiated: whatever its rules raise
            return None

    def _derivative(self) -> ClosedJaxpr:
        """What it computes when it is differentiated in reverse by all floating-point numbers: rules are followed."""
        variables: list[Any] = [*self._jaxpr.invars, *self._jaxpr.constvars, *self._jaxpr.outvars]
        *shapes, value = [jax.ShapeDtypeStruct(own.aval.shape, own.aval.dtype) for own in variables]
        moving = [place for place, shape in enumerate(shapes) if jnp.issubdtype(shape.dtype, jnp.inexact)]

        def pulled(operands: list[Array], cotangent: Array) -> Any:
            def value_at(moved: list[Array]) -> Array:
                own = dict(enumerate(operands)) | dict(zip(moving, moved, strict=True))
                return self(*own.values())

            return jax.vjp(value_at, [operands[place] for place in moving])[1](cotangent)

        return jax.make_jaxpr(pulled)(shapes, value)

    def __hash__(self) -> int:
        return id(self) if self.key is None else hash(self.key)

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Program) and self.key is not None and self.key == other.key)


def _of_jaxpr(jaxpr: Jaxpr, left_out: frozenset[str]) -> Hashable:
    """`left_out`: parameters, by name, that are not looked at."""
    places: dict[Any, int] = {}

    def put(variable: Any) -> Hashable:
        places[variable] = len(places)
        return variable.aval

    def read(atom: Any) -> Hashable:
        return (atom.aval, value_of(atom.val)) if isinstance(atom, Literal) else places[atom]

    def value_of(value: Any) -> Hashable:
        return _of_value(value, left_out)

    given = tuple(map(put, (*jaxpr.constvars, *jaxpr.invars)))
    steps = [
        (step.primitive, tuple(map(read, step.invars)), value_of(step.params), tuple(map(put, step.outvars)))
        for step in jaxpr.eqns
    ]
    return given, tuple(steps), tuple(map(read, jaxpr.outvars))


def _of_value(value: Any, left_out: frozenset[str]) -> Hashable:
    """Equal only for equal values; TypeError for functions and what else may differ unseen."""
    if isinstance(value, ClosedJaxpr):  # before the others: later releases of JAX make no difference between them
        return _of_jaxpr(value.jaxpr, left_out), _of_value(value.consts, left_out)
    if isinstance(value, Jaxpr):
        return _of_jaxpr(value, left_out)
    if isinstance(value, (tuple, list)):
        return type(value), tuple(_of_value(own, left_out) for own in value)
    if isinstance(value, dict):
        return tuple((name, _of_value(value[name], left_out)) for name in sorted(value) if name not in left_out)
    if isinstance(value, (Tracer, FunctionType, MethodType, functools.partial, WrappedFun)):
        raise TypeError(f"cannot be compared: {value!r:.60}")
    if isinstance(value, (np.ndarray, np.generic, jax.Array, float, complex)):
        array = np.asarray(value)  # bit by bit: -0.0 is not 0.0
        return type(value), array.shape, array.dtype, array.tobytes()
    hash(value)
    return type(value), value
