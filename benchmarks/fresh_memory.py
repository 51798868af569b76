"""What it costs that large results lie in memory new to the process: `python -m benchmarks.fresh_memory --help`.

glibc hands freed memory of some sizes back to the kernel, which clears it page by page for the next call. Whether it
does so with the results of a process is a matter of chance, so that each setting is measured in several processes.
"""

from __future__ import annotations

import dataclasses
import statistics
import sys
from typing import Any

import tyro

from .contenders.base import Operation
from .entrants import JAXLIGHT, Entrant
from .harness import Case, Measurement, measure
from .report import conditions, own_failures, save, skipped_lines, table
from .settings import Settings, say
from .workload import Workload

ALLOCATIONS = {
    "as it comes": (("MALLOC_ARENA_MAX", "0"),),
    "one arena": (("MALLOC_ARENA_MAX", "1"),),
    "huge pages": (("MALLOC_ARENA_MAX", "0"), ("GLIBC_TUNABLES", "glibc.malloc.hugetlb=1")),
}
"""The environment of each; 0 arenas: as many as glibc likes, against what other benchmarks ask for."""
_OPERATIONS: tuple[Operation, ...] = ("forward", "value_and_gradient")


@dataclasses.dataclass
class Options(Settings):
    """Time of one image after the other, by how memory is allocated, in the quickest and slowest of some processes."""

    processes: int = 5
    """So many for each way to allocate."""
    samples: int = 2**20
    lights: int = 1


def main() -> int:
    """Measures, prints and saves; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    samples, processes = (2**14, 2) if options.quick else (options.samples, options.processes)
    plan = options.plan(memory=False)
    work = Workload(samples, options.lights, sample_color=False)
    cases = [
        Case(_process(environment, number), operation, work, title)
        for number in range(processes)
        for title, environment in ALLOCATIONS.items()
        for operation in _OPERATIONS
    ]
    measurements = measure(cases, plan, say=say)
    header = ["operation", "allocation", "processes", "ns: quickest", "median", "slowest"]
    rows = [_row(measurements, operation, title) for operation in _OPERATIONS for title in ALLOCATIONS]
    text = "\n\n".join(["# Fresh memory", conditions(plan, measurements), table(header, [row for row in rows if row])])
    text = "\n".join([text, "", *skipped_lines(measurements)])
    print(text)
    save(options.output, "fresh_memory", text, None, measurements)
    return own_failures(measurements)


def _process(environment: tuple[tuple[str, str], ...], number: int) -> Entrant:
    # One more variable tells processes of one setting apart.
    return dataclasses.replace(JAXLIGHT, environment=(*environment, ("JAXLIGHT_BENCHMARK_PROCESS", str(number))))


def _row(measurements: list[Measurement], operation: Operation, title: str) -> list[Any]:
    found = [
        m.nanoseconds
        for m in measurements
        if m.skipped is None and m.case.operation == operation and m.case.title == title
    ]
    return [operation, title, len(found), min(found), statistics.median(found), max(found)] if found else []


if __name__ == "__main__":
    sys.exit(main())
