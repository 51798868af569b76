"""Bounds of work that no clock tells: how many functions are called, how many programs are compiled."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

import jax


@contextlib.contextmanager
def at_most_calls(most: int) -> Iterator[None]:
    """Raises TooMuchWork where more functions than this are called: work is counted, since clocks differ."""
    count = 0

    def counted(frame: object, event: str, argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")
        if count > most:
            raise TooMuchWork(f"more than {most} calls")

    sys.setprofile(counted)
    try:
        yield
    finally:
        sys.setprofile(None)


class TooMuchWork(BaseException):
    """Not an Exception, lest a reader takes it for a damaged file."""


def programs_of(function: Callable[[], Any]) -> int:
    """How many programs are compiled by a call."""
    compiled: list[str] = []
    listening = True

    def listen(event: str, *_: Any, **__: Any) -> None:
        if listening and "backend_compile" in event:
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    jax.block_until_ready(function())
    listening = False
    return len(compiled)
