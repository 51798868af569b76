"""All cores of the processor: XLA evaluates the small loops of a tile one after the other, on one of them.

To share out such loops costs more than they take. Shares of the tiles are worth it: the same compiled program goes over
each, in a thread of its own.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax

LEAST_SAMPLES = 2**16
"""Samples of a share that is worth a thread: about a millisecond under few lights."""


def cores() -> int:
    """The cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def shares_of(samples: int) -> int:
    """Into how many shares so many samples are worth being divided."""
    return max(1, min(cores(), samples // LEAST_SAMPLES))


def in_threads(function: Callable[[int], Any], shares: int) -> list[Any]:
    """[function(0), function(1), ...], evaluated side by side, in this thread's precision and on its device."""
    config: Any = jax.config  # whose contexts belong to a thread
    precision, device = config.jax_enable_x64, config.jax_default_device

    def evaluated(share: int) -> Any:
        with jax.enable_x64(precision), jax.default_device(device):
            return jax.block_until_ready(function(share))

    return list(_threads(cores()).map(evaluated, range(shares)))


@functools.cache
def _threads(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="jaxlight")
