"""Rules of JAX that a program may make stricter for its own code: here those hold that JAX comes with."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def usual_promotion(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """The function, whatever `jax_numpy_rank_promotion` and `jax_numpy_dtype_promotion` say where it is called."""

    @functools.wraps(function)
    def call(*arguments: _Arguments.args, **named: _Arguments.kwargs) -> _Result:
        with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
            return function(*arguments, **named)

    return call
