"""How programs are compiled: what is asked of XLA's CPU backend.

Left to itself XLA uses 256 of the 512 bits of x86 registers, and is up to half slower; and it orders what it does so
that as much as possible could run at the same time, for which more arrays have to be in memory. JAX takes compiler
options only where no other transformation is at work.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

import equinox as eqx
import jax
from jax.core import Tracer

_Function = TypeVar("_Function", bound=Callable[..., Any])

CPU_OPTIONS = {
    "xla_cpu_prefer_vector_width": 512,
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
}


def compiler_options() -> dict[str, Any]:
    """What to give a `jax.jit` of one's own around `shade` or its derivatives, as its `compiler_options`.

    On the CPU they make it quicker, and its peak of memory lower; elsewhere there are none. `shade` and `fit` ask for
    them by themselves where they are called outside jit.
    """
    return dict(CPU_OPTIONS) if jax.default_backend() == "cpu" else {}


def quick_jit(function: _Function) -> _Function:
    """`eqx.filter_jit` with `compiler_options`; under another transformation the function itself."""

    @functools.cache
    def compiled() -> Callable[..., Any]:
        options: dict[str, Any] = {"compiler_options": compiler_options()}
        return eqx.filter_jit(function, **options)

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(arguments)):
            return function(*arguments)
        return compiled()(*arguments)

    call.compiled = compiled  # type: ignore[attr-defined]  # for those who count traces
    return cast(_Function, call)
