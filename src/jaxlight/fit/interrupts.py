"""Ctrl-C while something is finished that must not be lost."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Ctrl-C does not end the block, which is short; whoever handles interrupts hears of it afterwards.

    What is done by then is done: a `KeyboardInterrupt` that the handler raises goes no further.
    """
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield  # no interrupt reaches this thread, or none is listened to
        return
    came = []
    signal.signal(signal.SIGINT, lambda *interrupt: came.append(interrupt))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if came:
            with contextlib.suppress(KeyboardInterrupt):
                handler(*came[-1])
