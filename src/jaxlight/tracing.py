"""Whether numbers are traced, by `jax.jit` or another transformation, and so not known."""

from __future__ import annotations

from collections.abc import Iterator, ValuesView
from typing import Any

import jax
from jax.core import Tracer, eval_context
from jax.extend.core import get_opaque_trace_state

with eval_context():
    _OUTSIDE = get_opaque_trace_state()
    """The state in which nothing is traced."""


def is_traced(*arguments: Any) -> bool:
    """Whether arguments are traced, or what calls this is: a jit or loop may know what it is not given."""
    return get_opaque_trace_state() != _OUTSIDE or _holds_tracers(arguments)


def refuse_traced(function: str, *arguments: Any) -> None:
    """Raise ValueError for arguments of a public function that are traced, where it has to know their numbers."""
    if _holds_tracers(arguments):
        raise ValueError(f"{function}: expected numbers, got traced ones; {_CALL_OUTSIDE}")


def refuse_inside(function: str) -> None:
    """Raise ValueError inside any transformation, for a public function that decides by the numbers it computes."""
    if is_traced():
        raise ValueError(f"{function}: it decides by numbers that a transformation does not know; {_CALL_OUTSIDE}")


_CALL_OUTSIDE = "call it outside of jax.jit, jax.grad, jax.vmap and their like"


def _holds_tracers(arguments: Any) -> bool:
    leaves = jax.tree.leaves(arguments, is_leaf=lambda node: isinstance(node, Iterator | ValuesView))  # or JAX warns
    return any(isinstance(leaf, Tracer) for leaf in leaves)
