"""The folder of results: of one process at a time."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

if sys.platform != "win32":
    import fcntl


@contextlib.contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """A folder, made if it is not there, that no other process has in such a block until this one ends.

    The lock is the system's, on the folder itself: it leaves no file, and ends with a process that is killed. Windows
    and some network file systems have none; there the block runs without. A folder that was made and is empty at the
    end goes again.

    Raises:
        ValueError: another process has the folder.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    with _locked(folder):
        try:
            yield
        finally:
            with contextlib.suppress(OSError):  # the first that holds something
                for path in made:
                    path.rmdir()


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    if sys.platform == "win32":
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            said = "another fit is running in this folder; wait for its end, or give another --output"
            raise ValueError(f"{folder}: {said}") from None
        except OSError:  # of a file system without such locks
            pass
        yield
    finally:
        os.close(handle)
