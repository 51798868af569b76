"""Compiling for the processor's widest registers.

Left to itself XLA uses 256 of the 512 bits of x86 registers, and is up to half slower. JAX takes compiler options only
where no other transformation is at work.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

import equinox as eqx
import jax
from jax.core import Tracer

_Function = TypeVar("_Function", bound=Callable[..., Any])

WIDE = {"xla_cpu_prefer_vector_width": 512}


def wide_jit(function: _Function) -> _Function:
    """`eqx.filter_jit` for the widest registers; under another transformation the function itself."""

    @functools.cache
    def compiled() -> Callable[..., Any]:
        options: dict[str, Any] = {"compiler_options": WIDE} if jax.default_backend() == "cpu" else {}
        return eqx.filter_jit(function, **options)

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(arguments)):
            return function(*arguments)
        return compiled()(*arguments)

    call.compiled = compiled  # type: ignore[attr-defined]  # for those who count traces
    return cast(_Function, call)
