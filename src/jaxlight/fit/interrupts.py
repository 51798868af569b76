"""Ctrl-C while a fit goes on, and while something is finished that must not be lost."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any


@contextlib.contextmanager
def remembered() -> Iterator[Callable[[], None]]:
    """Ctrl-C is heard as ever; what is given raises a `KeyboardInterrupt` that came of it and that somebody swallowed.

    Where a compiler calls Python back, exceptions may be lost.
    """
    raised = []

    def answer(handler: Callable[..., Any], *interrupt: Any) -> None:
        try:
            handler(*interrupt)
        except KeyboardInterrupt as error:
            raised.append(error)
            raise

    def raise_swallowed() -> None:
        if raised:
            raise KeyboardInterrupt

    with _listening(answer):
        yield raise_swallowed


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Ctrl-C does not end the block, which is short; whoever handles interrupts hears of it afterwards.

    What is done by then is done: a `KeyboardInterrupt` that the handler raises goes no further.
    """
    handler: Any = signal.getsignal(signal.SIGINT)
    came: list[Any] = []
    try:
        with _listening(lambda *_: None) as came:
            yield
    finally:
        if came:
            with contextlib.suppress(KeyboardInterrupt):
                handler(*came[-1])


@contextlib.contextmanager
def _listening(answer: Callable[..., None]) -> Iterator[list[Any]]:
    """Gives the interrupts that come in the block, each of which is answered: answer(handler, *interrupt)."""
    handler = signal.getsignal(signal.SIGINT)
    came: list[Any] = []
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield came  # no interrupt reaches this thread, or none is listened to
        return

    def hear(*interrupt: Any) -> None:
        came.append(interrupt)
        answer(handler, *interrupt)

    signal.signal(signal.SIGINT, hear)
    try:
        yield came
    finally:
        if signal.getsignal(signal.SIGINT) is hear:  # somebody may have taken over
            signal.signal(signal.SIGINT, handler)
