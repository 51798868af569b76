"""How cost grows with samples, lights, free parameters, materials and views: `python -m benchmarks.scaling --help`."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Sequence
from typing import Any, Literal

import tyro

from . import plots
from .contenders.base import Operation
from .entrants import JAXLIGHT, Entrant
from .gate import Metric, run_gate
from .harness import Case, Measurement, measure
from .report import conditions, own_failures, save, skipped_lines, table
from .settings import Settings, say
from .workload import Workload

_FIT = Entrant("jaxlight", "jaxlight_fit:JaxlightFit", ("jax", "optimistix"))
_LIGHTS = 18
"""Lights of the scene of which more and more fields are freed: 11 numbers of the material and 11 of each light."""
_BEND = 1.3
"""Growth of the cost of one more unit, from one row to the next, that is called out as not linear."""
Axis = Literal["samples", "lights", "parameters", "materials", "views"]


@dataclasses.dataclass
class Options(Settings):
    """Time against samples, lights, free parameters, materials and views, with the places where it is not linear."""

    axes: tuple[Axis, ...] = ("samples", "lights", "parameters", "materials", "views")


@dataclasses.dataclass(frozen=True)
class Sweep:
    """One axis: what is varied and measured."""

    axis: Axis
    title: str
    cases: tuple[tuple[float, Case], ...]
    """Place on the axis, and what to measure there."""
    normalise: bool
    """True: the unit cost is per sample and light; False: per unit of the axis."""

    @property
    def name(self) -> str:
        """Of its metrics."""
        first = self.cases[0][1]
        return "/".join([self.axis, first.operation, *(option for option, _ in first.entrant.options)])


def _fit_entrant(**options: Any) -> Entrant:
    return dataclasses.replace(_FIT, options=tuple(options.items()))


def sweeps(quick: bool) -> list[Sweep]:
    """All axes."""
    samples = [10**4, 10**5] if quick else [10**4, 31_623, 10**5, 316_228, 10**6, 3_162_278, 10**7]
    lights = [1, 10] if quick else [1, 3, 10, 32, 100, 316, 1000, 3162, 10_000]
    freed = [-1, 0, 1] if quick else [-1, 0, 1, 2, 4, 8, 17]
    materials = [1, 2] if quick else [1, 3, 10, 32, 100]
    views = [1, 2] if quick else [1, 2, 4, 8, 16]
    forward: Operation = "forward"
    gradient: Operation = "value_and_gradient"
    all_free = dataclasses.replace(JAXLIGHT, options=(("by_samples", True),))

    def brute(count: int) -> Workload:
        """So many lights that all reach every sample: fewer samples when there are many, to bound the time."""
        return Workload(min(2**17, 2**24 // count), count, radius=100.0)

    result = []
    for operation in (forward, gradient):
        word = operation.replace("_", " ")
        by_samples = [(float(n), Case(JAXLIGHT, operation, Workload(n))) for n in samples]
        result.append(Sweep("samples", f"{word} against samples (8 lights)", tuple(by_samples), True))
        by_lights = [(float(count), Case(JAXLIGHT, operation, brute(count))) for count in lights]
        result.append(Sweep("lights", f"{word} against lights (all in reach)", tuple(by_lights), True))
    of_all = [(float(n), Case(all_free, gradient, Workload(n))) for n in samples]
    result.append(
        Sweep("samples", "value and gradient, by samples too, against samples (8 lights)", tuple(of_all), True)
    )
    work = Workload(2**13 if quick else 2**16, _LIGHTS, sample_color=False)
    by_parameters = [
        (float(1 if k < 0 else 11 * (k + 1)), Case(_fit_entrant(free_lights=k), "normal_equations", work))
        for k in freed
    ]
    result.append(Sweep("parameters", f"J^T J against free parameters ({_LIGHTS} lights)", tuple(by_parameters), False))
    many = Workload(2**13 if quick else 2**18, sample_color=False)
    titles: dict[Operation, str] = {
        "normal_equations": "J^T J of all materials, 11 numbers each,",
        gradient: "value and gradient tile by tile, of all materials and lights,",
    }
    for operation, title in titles.items():
        no_lights = {"free_lights": 0} if operation == "normal_equations" else {}
        by_materials = [(float(m), Case(_fit_entrant(**no_lights, materials=m), operation, many)) for m in materials]
        result.append(Sweep("materials", f"{title} against materials (8 lights)", tuple(by_materials), False))
    one_light = Workload(2**13 if quick else 2**16, 1, sample_color=False)
    by_views = [(float(v), Case(_fit_entrant(views=v), "normal_equations", one_light)) for v in views]
    result.append(Sweep("views", "J^T J of 22 parameters against views", tuple(by_views), False))
    with_exposures = [
        (float(v), Case(_fit_entrant(views=v, exposures=True), "normal_equations", one_light)) for v in views
    ]
    result.append(Sweep("views", "J^T J of 22 parameters and the views' exposures", tuple(with_exposures), False))
    return result


def main() -> int:
    """Measures, prints, plots and saves; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    chosen = [sweep for sweep in sweeps(options.quick) if sweep.axis in options.axes]
    plan = options.plan()
    sections, series, everything = [], {}, []
    for index, sweep in enumerate(chosen):
        deadline = options.plan(minutes=options.minutes * (index + 1) / len(chosen)).deadline
        plan = dataclasses.replace(plan, deadline=deadline)
        measurements = measure([case for _, case in sweep.cases], plan, say=say)
        everything += measurements
        places = [place for place, _ in sweep.cases]
        sections.append(_section(sweep, places, measurements))
        done = [(place, m) for place, m in zip(places, measurements, strict=True) if m.skipped is None]
        series[sweep.title] = ([place for place, _ in done], [m.seconds * 1e3 for _, m in done])
    metrics = _metrics(everything)
    if "parameters" in options.axes:
        in_pairs = measure([case for pair in _over_forward(options.quick) for case in pair], plan, say=say)
        section, more = _over_forward_section(in_pairs)
        everything, metrics = [*everything, *in_pairs], [*metrics, *more]
        sections.append(section)
    text = "\n\n".join(["# Scaling", conditions(plan, everything), *sections, *skipped_lines(everything)])
    print(text)
    save(options.output, "scaling", text, [dataclasses.asdict(metric) for metric in metrics], everything)
    plots.lines(
        options.output / "scaling.png",
        series,
        x="samples / lights / parameters / materials / views",
        y="ms",
        title="Scaling",
    )
    return run_gate(metrics, options) or own_failures(everything)


def _section(sweep: Sweep, places: Sequence[float], measurements: Sequence[Measurement]) -> str:
    unit = "ns per sample and light" if sweep.normalise else f"ms per {sweep.axis.rstrip('s')}"
    header = [sweep.axis, "of samples", "ms", unit, "exponent", "", "compile s", "peak MB", "x inputs"]
    rows: list[list[Any]] = []
    last: tuple[float, Measurement] | None = None
    for place, m in zip(places, measurements, strict=True):
        if m.skipped:
            continue
        cost = m.nanoseconds if sweep.normalise else m.seconds * 1e3 / place
        exponent = bend = None
        if last is not None:
            exponent, bend = _growth(sweep, last, (place, m))
        rows.append(
            [
                int(place),
                m.case.work.samples,
                m.seconds * 1e3,
                cost,
                exponent,
                bend or "",
                m.compile_seconds,
                m.extra_bytes / 1e6,
                m.memory_ratio,
            ]
        )
        last = (place, m)
    return f"## {sweep.title[0].upper()}{sweep.title[1:]}\n\n{table(header, rows)}"


def _growth(sweep: Sweep, before: tuple[float, Measurement], after: tuple[float, Measurement]) -> tuple[float, str]:
    """Local exponent (1: linear), and a word where one more unit costs much more than before."""
    (x0, m0), (x1, m1) = before, after
    # Rows of the lights' sweep differ in samples, which are linear: compare time per sample there.
    t0, t1 = (m.seconds / (m.case.work.samples if sweep.axis == "lights" else 1) for m in (m0, m1))
    exponent = math.log(t1 / t0) / math.log(x1 / x0)
    return exponent, "superlinear" if (t1 / x1) / (t0 / x0) > _BEND else ""


def _metrics(measurements: Sequence[Measurement]) -> list[Metric]:
    """Unit cost at the far end of each sweep over the best on the way: 1 where growth is linear."""
    metrics = []
    for sweep in sweeps(False):
        cases = [case for _, case in sweep.cases]
        found = [m for m in measurements if m.case in cases and m.skipped is None]
        if len(found) < len(cases):
            continue
        if sweep.axis in ("materials", "views"):
            growth = found[-1].seconds / found[0].seconds
            # All materials together take as long as one; each view takes as long as the one before.
            ratio = growth if sweep.axis == "materials" else growth / (sweep.cases[-1][0] / sweep.cases[0][0])
            metrics.append(Metric(f"scaling/{sweep.name}/many over one", ratio, "lower", 0.3))
        if sweep.normalise:
            ratio = found[-1].nanoseconds / min(m.nanoseconds for m in found)
            metrics.append(Metric(f"scaling/{sweep.name}/last over best", ratio, "lower", 0.3))
            memory = max(m.memory_ratio for m in found if m.case.work.samples >= 10**5)
            metrics.append(Metric(f"scaling/{sweep.name}/memory", memory, "lower"))
    return metrics


def _over_forward(quick: bool) -> list[tuple[Case, Case]]:
    """Forward pass and J^T J of the same samples, which are many: calls do not count."""
    works = [
        Workload(2**13 if quick else 2**20, lights, sample_color=False) for lights in ([1] if quick else [1, 8, 64])
    ]
    return [(Case(JAXLIGHT, "forward", work), Case(_fit_entrant(), "normal_equations", work)) for work in works]


def _over_forward_section(measurements: Sequence[Measurement]) -> tuple[str, list[Metric]]:
    rows, metrics = [], []
    for forward, normal in zip(measurements[::2], measurements[1::2], strict=True):
        if forward.skipped or normal.skipped:
            continue
        work, ratio = forward.case.work, normal.seconds / forward.seconds
        rows.append([work.lights, work.samples, forward.seconds * 1e3, normal.seconds * 1e3, ratio])
        metrics.append(Metric(f"normal equations/22 parameters/{work.lights} lights/over forward", ratio, "lower"))
    header = ["lights", "samples", "forward ms", "J^T J ms", "x forward"]
    return f"## J^T J of 22 parameters, of a material and a light\n\n{table(header, rows)}", metrics


if __name__ == "__main__":
    sys.exit(main())
