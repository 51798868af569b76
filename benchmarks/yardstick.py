"""A measuring instrument from outside: a program that times the same kernels on this machine and prints a table.

Each line that counts reads `NAME  ns1 ns8 ns64 | ... | max_error rms_error`: nanoseconds per sample and light for 1, 8
and 64 lights. It is run by path between the rounds, pinned to the same core, and never needed.
"""

from __future__ import annotations

import contextlib
import os
import re
import statistics
import subprocess
from collections.abc import Iterator
from pathlib import Path

LIGHTS = (1, 8, 64)
FORWARD = "point full (att+radius+spec+expfog+tex)"
FORWARD_UNIFORM = "point full, one uniform material"
_ROW = re.compile(r"^(?P<name>\S.*?)\s+(?P<numbers>(?:\d+\.\d+\s+){3})\|.*\|\s*(?P<largest>\S+)\s+(?P<rms>\S+)\s*$")


def parse(table: str) -> dict[str, dict[int, float]]:
    """Kernel name -> lights -> nanoseconds per sample and light; raises ValueError if no line is a kernel's."""
    rows = {}
    for line in table.splitlines():
        match = _ROW.match(line)
        if match:
            rows[match["name"]] = dict(zip(LIGHTS, map(float, match["numbers"].split()), strict=True))
    if not rows:
        raise ValueError("the yardstick printed no line of the form `NAME ns ns ns | ... | error error`")
    return rows


@contextlib.contextmanager
def _pinned(cores: tuple[int, ...]) -> Iterator[None]:
    """This thread, and the programs it starts meanwhile, on these cores."""
    if not cores or not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


class Yardstick:
    """Collects the tables of several runs of the program, and gives the median of each figure.

    Raises:
        ValueError: the program cannot be run, or prints no table.
    """

    def __init__(self, program: Path | None, cores: tuple[int, ...]) -> None:
        self._program = program
        self._cores = cores
        self._tables: list[dict[str, dict[int, float]]] = []

    def run(self) -> None:
        """Lets the program take its turn; nothing happens without one."""
        if self._program is None:
            return
        command = [str(self._program.resolve()), str(len(self._cores))]
        try:
            with _pinned(self._cores):
                done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
        except (OSError, subprocess.SubprocessError) as error:
            raise ValueError(f"yardstick {self._program}: {error}") from None
        self._tables.append(parse(done.stdout))

    def nanoseconds(self, kernel: str, lights: int) -> float | None:
        """The median over the runs, or None where the program was not run or does not know the kernel."""
        found = [table[kernel][lights] for table in self._tables if lights in table.get(kernel, {})]
        return statistics.median(found) if found else None
