"""For all tests: none leaves its precision behind, none depends on a clock or on chance, and compiled programs are let
go before they are too many."""

from __future__ import annotations

import gc
import importlib
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import pytest
from hypothesis import settings

from jaxlight.lighting import cores

MAPS = Path("/proc/self/maps")
MOST_MAPS = 30_000
"""Linux allows a process 65 530 pieces of memory; every compiled program holds some, and LLVM aborts without."""
EVERY = 8
gc.set_threshold(1_000_000, 50, 1000)
"""Tracing makes millions of objects that stay: to go through all of them takes long, and finds hardly any memory."""
settings.register_profile("same everywhere", deadline=None, derandomize=True)
settings.load_profile("same everywhere")
_numbers = itertools.count()
PRECISION: bool = jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]


def pytest_sessionfinish() -> None:
    """Python looks through all objects at the end, too; without this."""
    gc.freeze()


@pytest.fixture(autouse=True)
def own_precision() -> Iterator[None]:
    """The command line, called in this process by a test or by a fixture of its file, switches double precision on."""
    jax.config.update("jax_enable_x64", PRECISION)
    yield
    jax.config.update("jax_enable_x64", PRECISION)


@pytest.fixture(autouse=True)
def let_go_of_programs() -> Iterator[None]:
    """After every few tests, look whether there are too many programs."""
    yield
    if next(_numbers) % EVERY == 0 and MAPS.exists():
        with MAPS.open("rb") as lines:
            many = sum(1 for _ in lines) > MOST_MAPS
        if many:
            jax.clear_caches()
            gc.collect()


@pytest.fixture
def several_cores(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, int], list[int]]:
    """several_cores(module, count): so many cores, worth it for few samples; notes the shares of what it divides."""

    def pretend(module: str, count: int) -> list[int]:
        noted: list[int] = []

        def in_threads(function: Any, shares: int) -> list[Any]:
            noted.append(shares)
            return cores.in_threads(function, shares)

        monkeypatch.setattr(cores, "cores", lambda: count)
        monkeypatch.setattr(cores, "LEAST_SAMPLES", 256)
        monkeypatch.setattr(importlib.import_module(module), "in_threads", in_threads)
        return noted

    return pretend
