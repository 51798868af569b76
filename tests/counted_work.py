"""Bounds of work that no clock tells: how many functions are called."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator


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
