"""What Ctrl-C does to a command: while it starts up, while a fit steps, and while results are written."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType
from typing import Any

from .status import INTERRUPTED


def leave_at_once() -> None:
    """From here on Ctrl-C says so and ends the process, without a word of those whom it interrupts: while modules are
    imported and compilers run, an exception may be lost, or leave them in pieces.

    Where interrupts are ignored, as in the background of a shell, that stays so.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, b"jaxlight: interrupted\n")
    os._exit(INTERRUPTED)


class Interrupts:
    """Ctrl-C in a command that keeps what it has: the first ends the work, and none what comes after `hold`."""

    def __init__(self) -> None:
        self.came = False
        self._held = False

    def __enter__(self) -> Interrupts:
        self._before: Any = signal.getsignal(signal.SIGINT)
        self._heard = threading.current_thread() is threading.main_thread() and callable(self._before)
        if self._heard:
            signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        if self._heard:
            signal.signal(signal.SIGINT, self._before)

    def hold(self) -> None:
        """From here on they are only remembered."""
        self._held = True

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        again, self.came = self.came, True
        if not (again or self._held):
            raise KeyboardInterrupt
