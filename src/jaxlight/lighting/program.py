"""Traced functions that are equal where they compute the same, so that JAX finds what it has compiled.

A function that is written where it is used, as a `lambda` in a loss, is a new one in every call.
"""

from __future__ import annotations

import functools
from collections.abc import Hashable
from types import FunctionType, MethodType
from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun
from jax.extend.linear_util import WrappedFun
from jaxtyping import Array


class Program:
    """A traced function of arrays; what it closes over is given after its operands."""

    def __init__(self, jaxpr: Jaxpr) -> None:
        self._jaxpr = jaxpr

    def __call__(self, *operands: Array) -> Array:
        of_samples, constants = operands[: len(self._jaxpr.invars)], operands[len(self._jaxpr.invars) :]
        return jaxpr_as_fun(ClosedJaxpr(self._jaxpr, constants))(*of_samples)[0]

    @functools.cached_property
    def key(self) -> Hashable:
        """All that it computes; None where that cannot be told, so that it is equal to itself alone."""
        try:
            return _of_jaxpr(self._jaxpr)
        except TypeError:
            return None

    def __hash__(self) -> int:
        return id(self) if self.key is None else hash(self.key)

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Program) and self.key is not None and self.key == other.key)


def _of_jaxpr(jaxpr: Jaxpr) -> Hashable:
    places: dict[Any, int] = {}

    def put(variable: Any) -> Hashable:
        places[variable] = len(places)
        return variable.aval

    def read(atom: Any) -> Hashable:
        return (atom.aval, _of_value(atom.val)) if isinstance(atom, Literal) else places[atom]

    given = tuple(map(put, (*jaxpr.constvars, *jaxpr.invars)))
    steps = [
        (step.primitive, tuple(map(read, step.invars)), _of_value(step.params), tuple(map(put, step.outvars)))
        for step in jaxpr.eqns
    ]
    return given, tuple(steps), tuple(map(read, jaxpr.outvars))


def _of_value(value: Any) -> Hashable:
    """Equal only for equal values; TypeError for functions and what else may differ unseen."""
    if isinstance(value, Jaxpr):
        return _of_jaxpr(value)
    if isinstance(value, ClosedJaxpr):
        return _of_jaxpr(value.jaxpr), _of_value(value.consts)
    if isinstance(value, (tuple, list)):
        return type(value), tuple(map(_of_value, value))
    if isinstance(value, dict):
        return tuple((name, _of_value(value[name])) for name in sorted(value))
    if isinstance(value, (Tracer, FunctionType, MethodType, functools.partial, WrappedFun)):
        raise TypeError(f"cannot be compared: {value!r:.60}")
    if isinstance(value, (np.ndarray, np.generic, jax.Array, float, complex)):
        array = np.asarray(value)  # bit by bit: -0.0 is not 0.0
        return type(value), array.shape, array.dtype, array.tobytes()
    hash(value)
    return type(value), value
