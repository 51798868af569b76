"""Functions that JAX has traced, without what their results do not need."""

from __future__ import annotations

from jax.extend.core import ClosedJaxpr
from jax.interpreters.partial_eval import dce_jaxpr


def pruned(jaxpr: ClosedJaxpr, result: int | None = None) -> ClosedJaxpr:
    """The function, or one of its results alone, without what need not be computed."""
    asked = [result is None or number == result for number in range(len(jaxpr.out_avals))]
    needed, _ = dce_jaxpr(jaxpr.jaxpr, asked, instantiate=True)
    return ClosedJaxpr(needed, jaxpr.consts)
