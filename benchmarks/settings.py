"""Settings that all commands share."""

from __future__ import annotations

import dataclasses
import os
import sys
import time
from pathlib import Path

from .harness import Plan


@dataclasses.dataclass
class Settings:
    """How and where to measure."""

    rounds: int = 5
    """Rounds in which the contenders take turns."""
    slot_seconds: float = 0.25
    """Seconds a contender runs when it is its turn."""
    cores: tuple[int, ...] = ()
    """Processor cores to pin to; default: the last one. Several: wall time instead of processor time."""
    minutes: float = 20.0
    """Time bound: what cannot be measured before it is over is left out, with a line that says so."""
    quick: bool = False
    """Small and short, to see that it works; its figures mean little."""
    output: Path = Path("out/benchmarks")
    """Folder for tables (.md), results (.json) and plots (.png)."""
    gate: bool = False
    """Compare with the committed baseline; exit status 1 if a metric is worse than its tolerance allows."""
    write_baseline: bool = False
    """Make this run's metrics the committed baseline."""

    def plan(self, *, memory: bool = True, minutes: float | None = None) -> Plan:
        """The plan for one call of `measure`, at most so many minutes long."""
        limit = self.minutes if minutes is None else minutes
        return Plan(
            rounds=2 if self.quick else self.rounds,
            slot_seconds=0.02 if self.quick else self.slot_seconds,
            cores=self.cores or (_last_core(),),
            deadline=time.monotonic() + 60 * limit,
            memory=memory,
        )


def _last_core() -> int:
    return max(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0


def say(line: str) -> None:
    """A line of progress on standard error."""
    print(f"  {line}", file=sys.stderr, flush=True)
