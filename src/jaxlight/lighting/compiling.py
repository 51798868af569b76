"""How programs are compiled: what is asked of XLA's CPU backend.

JAX takes compiler options only where no other transformation is at work.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

import equinox as eqx
import jax

from ..processor import for_cpu
from ..scene.fields import boolean
from ..tracing import is_traced

_Function = TypeVar("_Function", bound=Callable[..., Any])

WANTED: Mapping[str, Any] = {
    # Left to itself XLA uses 256 of the 512 bits of x86 registers, and is up to half slower.
    "xla_cpu_prefer_vector_width": 512,
    # It orders what it does so that as much as possible could run at the same time: more arrays are in memory then.
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
    # It gives sums to a library, whose calls, with JAX 0.12, take up to a hundred times as long as its own loops.
    "xla_cpu_experimental_ynn_fusion_type": "LIBRARY_FUSION_TYPE_DOT",
}

_LEFT_OUT = "xla_disable_hlo_passes"
"""The option that names what XLA leaves out of its work; it takes names that it does not know."""

_ONE_FUNCTION = "small-while-loop-hoisting"
"""Makes one function of a loop and the loops in it, whose numbers are read every time as if they could have changed."""

_SHARED_OUT = "cpu-parallel-task-assigner"
"""Shares out loops of a few microseconds among cores, where to wait for another core takes longer."""


@functools.cache
def cpu_options(*, all_cores: bool = False) -> Mapping[str, Any]:
    """Of the options that are wanted those that the installed release of XLA knows; their names are no promise.

    `all_cores`: XLA shares out loops.
    """
    left_out = [_ONE_FUNCTION] if all_cores else [_ONE_FUNCTION, _SHARED_OUT]
    wanted = {**WANTED, _LEFT_OUT: ",".join(left_out)}
    return {name: value for name, value in wanted.items() if _is_known(name, value)}


def _is_known(name: str, value: Any) -> bool:
    with jax.default_device(jax.devices("cpu")[0]):
        try:
            jax.jit(lambda: 0, compiler_options={name: value}).lower().compile()
        except jax.errors.JaxRuntimeError:
            return False
    return True


def compiler_options(*, all_cores: bool = False) -> dict[str, Any]:
    """What to give a `jax.jit` of one's own around `shade` or its derivatives, as its `compiler_options`.

    On the CPU they make it quicker, and its peak of memory lower; elsewhere there are none. `shade` and `fit` ask for
    them by themselves where they are called outside jit.

    Args:
        all_cores: whether XLA may share out the loops of a call among cores. It gains in forward passes under up to
            four lights and in gradients under some dozens; in others the cores wait for each other.
    """
    all_cores = boolean("compiler_options: all_cores", all_cores)
    return dict(cpu_options(all_cores=all_cores)) if for_cpu() else {}


def _once(make: Callable[[], _Function]) -> Callable[[], _Function]:
    """What `make` gives, made by the first call: threads that call at the same time share it."""
    lock, cached = threading.Lock(), functools.cache(make)

    def made() -> _Function:
        with lock:
            return cached()

    return made


def jit_on_cpu(function: Callable[..., Any], *, all_cores: bool = False, **how: Any) -> Callable[..., Any]:
    """`jax.jit` of what is called outside all transformations and runs on the CPU.

    `all_cores`: as for `cpu_options`.
    """

    @_once
    def compiled() -> Callable[..., Any]:
        return jax.jit(function, compiler_options=dict(cpu_options(all_cores=all_cores)), **how)

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        return compiled()(*arguments)

    return call


def quick_jit(function: _Function, *, all_cores: bool = False) -> _Function:
    """`eqx.filter_jit` with `compiler_options`; under another transformation the function itself."""

    @_once
    def compiled() -> Callable[..., Any]:
        options: dict[str, Any] = {"compiler_options": compiler_options(all_cores=all_cores)}
        return eqx.filter_jit(function, **options)

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        if is_traced(arguments):
            return function(*arguments)
        return compiled()(*arguments)

    call.compiled = compiled  # type: ignore[attr-defined]  # for those who count traces
    return cast(_Function, call)
