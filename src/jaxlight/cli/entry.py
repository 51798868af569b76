"""Where the command line begins: interrupts are cared for before anything that takes long is imported."""

from __future__ import annotations

from collections.abc import Sequence

from .interrupts import leave_at_once


def main(args: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        args: the words after `jaxlight`; default: the process's own, whose Ctrl-C this then handles.

    Returns:
        The exit status.
    """
    if args is None:
        leave_at_once()
    from .app import main as run

    return run(args)
