"""Many small lights: the cost of thousands of which about 8 reach a sample: `python -m benchmarks.culling --help`.

What it is compared with: the same samples under 8 lights that all reach every sample. They are stored by place, as
`rasterize` stores them, and once more row by row of the picture, as they come from maps.
"""

from __future__ import annotations

import dataclasses
import sys
from typing import Any

import jax.numpy as jnp
import numpy as np
import tyro

from jaxlight.lighting.clusters import InLanes, InRows

from .contenders.base import Operation
from .contenders.jaxlight_shade import samples_of
from .entrants import JAXLIGHT
from .gate import Metric, run_gate
from .harness import Case, Measurement, measure
from .report import conditions, own_failures, save, skipped_lines, table
from .settings import Settings, say
from .workload import Arrays, Workload, make_arrays

_OPERATIONS: tuple[Operation, ...] = ("forward", "value_and_gradient")
_AT_ONCE = 256
"""Clusters that are held against all lights at once."""
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
        "listed",
        "worked through",
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
    arrays = make_arrays(m.case.work)
    by_place = m.case.entrant == JAXLIGHT
    lists = mean_lists(arrays, by_place, m.case.operation) if m.case.work.cover else (None, None)
    return [
        m.case.operation,
        m.case.work.lights,
        "by place" if by_place and m.case.work.cover else "in rows",
        mean_reach(m.case.work, arrays),
        *lists,
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


def mean_lists(arrays: Arrays, by_place: bool, operation: Operation) -> tuple[float, float]:
    """How many lights a cluster lists on average, and how many entries of lists it works through: those of the longest
    of the lists side by side, some at a time."""
    samples = samples_of(arrays, np.float32, by_place=by_place)
    low, high = (np.asarray(end)[:, :, None] for end in (samples.cluster_low, samples.cluster_high))
    location, radius = arrays.lights["location"].T[:, None], arrays.lights["radius"]
    length = np.empty(low.shape[1], int)
    for first in range(0, len(length), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        outside = np.maximum(np.maximum(low[:, some] - location, location - high[:, some]), 0)
        length[some] = np.count_nonzero(np.sum(outside**2, axis=0) <= radius**2, axis=1)
    arrangement = InRows if operation == "forward" else InLanes
    in_block = samples.group * samples.tile // samples.cluster
    side_by_side = np.sort(length.reshape(-1, in_block)).reshape(-1, min(arrangement.at_once(), in_block))
    steps = arrangement.steps(jnp.asarray(side_by_side.max(axis=1)))
    return float(np.mean(length)), sum(float(np.mean(own.count)) * own.entries for own in steps)


if __name__ == "__main__":
    sys.exit(main())
