"""Many small lights: the cost of thousands of which about 8 reach a sample: `python -m benchmarks.culling --help`.

What it is compared with: the same samples under 8 lights that all reach every sample. They are stored by place, as
`rasterize` stores them, and once more row by row of the picture, as they come from maps.
"""

from __future__ import annotations

import dataclasses
import sys
from typing import Any

import numpy as np
import tyro

from .entrants import JAXLIGHT
from .gate import Metric, run_gate
from .harness import Case, Measurement, measure
from .report import conditions, own_failures, save, skipped_lines, table
from .settings import Settings, say
from .workload import Arrays, Workload, make_arrays

_OPERATIONS = ("forward", "value_and_gradient")
_IN_ROWS = dataclasses.replace(JAXLIGHT, label="jaxlight, in rows", options=(("by_place", False),))


@dataclasses.dataclass
class Options(Settings):
    """Cost of 1000 and 10 000 small lights over the cost of the few that reach a sample; forward and gradient."""

    lights: tuple[int, ...] = (1000, 10_000)
    cover: int = 8
    """Lights that reach a sample on average."""
    samples: int = 2**18


def main() -> int:
    """Measures, prints and saves; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    samples = 2**13 if options.quick else options.samples
    plan = options.plan()
    few = Workload(samples, options.cover, radius=100.0)
    many = [Workload(samples, lights, cover=options.cover) for lights in options.lights]
    cases = [
        Case(entrant, operation, work)
        for operation in _OPERATIONS
        for work in (few, *many)
        for entrant in ((JAXLIGHT,) if work == few else (JAXLIGHT, _IN_ROWS))
    ]
    measurements = measure(cases, plan, say=say)
    base = {m.case.operation: m for m in measurements if m.case.work == few and m.skipped is None}
    rows, metrics = [], []
    for m in measurements:
        if m.skipped:
            continue
        ratio = m.seconds / base[m.case.operation].seconds if m.case.operation in base else None
        rows.append(_row(m, ratio))
        if ratio is not None and m.case.work != few:
            rows_too = "/in rows" if m.case.entrant == _IN_ROWS else ""
            metrics.append(Metric(f"culling/{m.case.work.lights}/{m.case.operation}{rows_too}", ratio, "lower"))
    header = [
        "operation",
        "lights",
        "samples",
        "reach a sample",
        "ms",
        "x the few",
        "max error",
        "compile s",
        "peak MB",
    ]
    text = "\n\n".join(["# Culling", conditions(plan, measurements), table(header, rows)])
    text = "\n".join([text, "", *skipped_lines(measurements)])
    print(text)
    save(options.output, "culling", text, [dataclasses.asdict(metric) for metric in metrics], measurements)
    return run_gate(metrics, options) or own_failures(measurements)


def _row(m: Measurement, ratio: float | None) -> list[Any]:
    return [
        m.case.operation,
        m.case.work.lights,
        "by place" if m.case.entrant == JAXLIGHT and m.case.work.cover else "in rows",
        mean_reach(m.case.work, make_arrays(m.case.work)),
        1e3 * m.seconds,
        ratio,
        m.error and m.error["largest"],
        m.compile_seconds,
        m.extra_bytes / 1e6,
    ]


def mean_reach(work: Workload, arrays: Arrays) -> float:
    """How many lights reach a sample on average, from a thousand samples."""
    position = arrays.position[:, np.random.default_rng(0).integers(work.samples, size=1000)]
    offset = arrays.lights["location"][:, :, None] - position
    return float(np.mean(np.sum(np.sum(offset**2, axis=1) <= arrays.lights["radius"][:, None] ** 2, axis=0)))


if __name__ == "__main__":
    sys.exit(main())
