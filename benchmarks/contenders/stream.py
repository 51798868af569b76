"""The least that shading must do to memory: read every input once, write every output once; no lighting."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from ..workload import Arrays, Workload
from .base import Contender, Operation, Run


def forward(planes: tuple[Any, ...], target: Any) -> Any:
    """[4, N]: the sum of the inputs, as many outputs as colour and alpha."""
    total = sum(planes[1:], start=planes[0])
    return jnp.concatenate([total, total[:1]])


def value_and_gradient(planes: tuple[Any, ...], target: Any) -> Any:
    """[]: reads the inputs and the target, writes next to nothing."""
    return jnp.sum(sum(planes[1:], start=planes[0]) - target)


class Stream(Contender):
    """Compiled by XLA for the same device as jaxlight."""

    def __init__(self, work: Workload, arrays: Arrays) -> None:
        planes = [arrays.position, arrays.normal, *([] if arrays.sample_color is None else [arrays.sample_color])]
        self._arguments = jax.device_put((tuple(planes), arrays.target))

    def prepare(self, operation: Operation) -> Run:
        function = forward if operation == "forward" else value_and_gradient
        compiled = jax.jit(function).lower(*self._arguments).compile()
        return lambda: jax.block_until_ready(compiled(*self._arguments))
