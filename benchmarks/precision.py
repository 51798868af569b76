"""Run time against error, by precision, light kind and number of lights: `python -m benchmarks.precision --help`."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from typing import Any

import tyro

from . import plots
from .entrants import JAXLIGHT, Entrant
from .harness import Case, Measurement, measure
from .report import conditions, own_failures, save, skipped_lines, table
from .settings import Settings, say
from .workload import Kind, Workload

DEFAULT = "float32"
_DOUBLE_ULP = 2.0**-29
"""A float64 ulp in float32 ulp."""


def _level(label: str, *, x64: bool = False, color_limit: float = 2e-5, **options: Any) -> Entrant:
    environment = (("JAX_ENABLE_X64", "1"),) if x64 else ()
    return dataclasses.replace(
        JAXLIGHT, label=label, options=tuple(options.items()), environment=environment, color_limit=color_limit
    )


LEVELS = (
    _level("float64", x64=True, precision="float64"),
    _level(DEFAULT),
    _level("float32 fast", color_limit=1e-3, lighting=(("accuracy", "fast"),)),
    _level("bfloat16 samples", color_limit=1.0, precision="bfloat16"),
    _level("float16 samples", color_limit=1.0, precision="float16"),
)


@dataclasses.dataclass
class Options(Settings):
    """Time per sample and light beside the error in ulp, with the levels that nothing beats marked."""

    lights: tuple[int, ...] = (1, 8, 64, 1000)
    kinds: tuple[Kind, ...] = ("point", "directional", "spot")
    samples: int = 2**18
    """Samples; fewer from 64 lights on, so that a call stays short."""
    gradient: bool = False
    """Also time value and gradient of all fields."""


def main() -> int:
    """Measures, prints, plots and saves; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    plan = options.plan(memory=False)
    measurements: list[Measurement] = []
    groups = [(kind, lights) for kind in options.kinds for lights in options.lights]
    for index, (kind, lights) in enumerate(groups):
        samples = min(2**12 if options.quick else options.samples, 2**24 // lights)
        work = Workload(samples, lights, kind=kind)
        operations = ("forward", "value_and_gradient") if options.gradient else ("forward",)
        cases = [Case(level, operation, work) for operation in operations for level in LEVELS]
        share = options.plan(minutes=options.minutes * (index + 1) / len(groups)).deadline
        measurements += measure(cases, dataclasses.replace(plan, deadline=share), say=say)
    text = "\n\n".join(
        [
            "# Run time against error",
            conditions(plan, measurements),
            _table(measurements),
            "ulp: units in the last place of the level's own result type (float32; float64 for `float64`), against a "
            "reference of higher precision on the exact inputs; half-precision samples are therefore charged with the "
            "rounding of their inputs. `*`: no level is both faster and closer.",
            "\n".join(skipped_lines(measurements)),
        ]
    )
    print(text)
    save(options.output, "precision", text, None, measurements)
    plots.lines(
        options.output / "precision.png",
        _series(measurements),
        x="ns per sample and light, forward",
        y="error of 99.9 % of the colours, in float32 ulp",
        title="Run time against error (a point: a light kind and number of lights)",
        markers_only=True,
    )
    return own_failures([m for m in measurements if m.case.entrant.label == DEFAULT])


def _table(measurements: Sequence[Measurement]) -> str:
    header = ["kind", "lights", "level", "", "ns forward", "ns gradient", "median ulp", "99.9 % ulp", "max ulp"]
    header += ["rms error", "max error", "compile s"]
    rows = []
    done = [m for m in measurements if m.skipped is None]
    for m in done:
        if m.case.operation != "forward" or m.error is None:
            continue
        work = m.case.work
        rivals = [other for other in done if other.case.work == work and other.case.operation == "forward"]
        gradient = [
            other.nanoseconds
            for other in done
            if other.case.work == work and other.case.entrant == m.case.entrant and other is not m
        ]
        beaten = any(
            other.error is not None
            and other.seconds < m.seconds
            and other.error["root_mean_square"] <= m.error["root_mean_square"]
            for other in rivals
        )
        error = m.error
        rows.append(
            [
                work.kind,
                work.lights,
                m.case.entrant.label + (" (default)" if m.case.entrant.label == DEFAULT else ""),
                "" if beaten else "*",
                m.nanoseconds,
                gradient[0] if gradient else None,
                error["median_ulp"],
                error["high_ulp"],
                error["largest_ulp"],
                error["root_mean_square"],
                error["largest"],
                m.compile_seconds,
            ]
        )
    return table(header, rows)


def _series(measurements: Sequence[Measurement]) -> plots.Series:
    """Level -> times, and errors in one unit for all levels."""
    series: dict[str, tuple[list[float], list[float]]] = {}
    for m in measurements:
        if m.skipped is None and m.error is not None and m.case.operation == "forward":
            across, up = series.setdefault(m.case.entrant.label, ([], []))
            across.append(m.nanoseconds)
            up.append(m.error["high_ulp"] * (_DOUBLE_ULP if m.case.entrant.label == "float64" else 1))
    return dict(series)


if __name__ == "__main__":
    sys.exit(main())
