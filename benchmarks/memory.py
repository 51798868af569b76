"""Peak memory of one call, from the kernel's own bookkeeping."""

from __future__ import annotations

import ctypes
import gc
import resource
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")


def peak_bytes(run: Callable[[], Any]) -> int:
    """Resident memory that `run` needs beyond what is resident before it, at its peak.

    On Linux the high-water mark is reset before the call; elsewhere it can only be compared, so a peak below an earlier
    one counts as 0.
    """
    gc.collect()
    if sys.platform != "linux":
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        run()
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    ctypes.CDLL(None).malloc_trim(0)
    _CLEAR.write_text("5")
    before = _kilobytes("VmRSS")
    run()
    return max(_kilobytes("VmHWM") - before, 0) * 1024


def _kilobytes(field: str) -> int:
    line = next(line for line in _STATUS.read_text().splitlines() if line.startswith(field))
    return int(line.split()[1])
