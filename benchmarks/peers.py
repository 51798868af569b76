"""jaxlight and its peers on the common scene, side by side in one run: `python -m benchmarks.peers --help`."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import tyro

from . import plots
from .entrants import JAXLIGHT, JAXLIGHT_BY_TILES, PEERS, Entrant, named
from .gate import Metric, run_gate
from .harness import Case, Measurement, measure
from .report import conditions, own_failures, save, skipped_lines, table
from .settings import Settings, say
from .workload import Workload
from .yardstick import FORWARD, FORWARD_UNIFORM, Yardstick

# The forward pass with a colour a sample; the gradient, and what it is compared with, with the material's own colour,
# so that every field of the material counts.
_OPERATIONS = (("forward", True), ("forward", False), ("value_and_gradient", False))
_OWN = (JAXLIGHT, JAXLIGHT_BY_TILES)
_TITLES = {
    ("forward", True): "Forward, a colour a sample",
    ("forward", False): "Forward, one material",
    ("value_and_gradient", False): "Value and gradient of all material and light fields, one material",
}


@dataclasses.dataclass
class Options(Settings):
    """Forward pass and value-and-gradient of jaxlight, its peers and (if given) the yardstick, as ratios."""

    lights: tuple[int, ...] = (1, 8, 64)
    """Numbers of point lights (attenuation, radius, ambient, specular, exponential fog)."""
    samples: int = 2**20
    """Samples; contenders that would need too much memory get fewer, as their table says."""
    yardstick: Path | None = None
    """A program that times the forward pass on this machine; run before, between and after the rounds."""
    only: tuple[str, ...] = ()
    """Names of the contenders to run; default: all."""


def main() -> int:
    """Measures, prints and saves; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    entrants = named((*_OWN, *PEERS), options.only)
    samples = 2**14 if options.quick else options.samples
    plan = options.plan()
    measurements: list[Measurement] = []
    try:
        yardstick = Yardstick(options.yardstick, plan.cores)
        for index, lights in enumerate(options.lights):
            share = options.minutes * (index + 1) / len(options.lights)
            plan = dataclasses.replace(plan, deadline=options.plan(minutes=share).deadline)
            measurements += measure(_cases(entrants, samples, lights), plan, say=say, between=yardstick.run)
        text = "\n\n".join(
            [
                "# Peers",
                conditions(plan, measurements),
                *(_section(measurements, yardstick, *kind) for kind in _OPERATIONS),
                *skipped_lines(measurements),
            ]
        )
        metrics = headline(measurements, yardstick)
        print(text)
        save(options.output, "peers", text, [dataclasses.asdict(metric) for metric in metrics], measurements)
        plots.peers(options.output / "peers.png", measurements)
        return run_gate(metrics, options) or own_failures(measurements)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2


def _cases(entrants: Sequence[Entrant], samples: int, lights: int) -> list[Case]:
    return [
        Case(entrant, operation, entrant.within_limits(Workload(samples, lights, sample_color=sample_color)))
        for operation, sample_color in _OPERATIONS
        for entrant in entrants
        if operation == "value_and_gradient" or entrant is not JAXLIGHT_BY_TILES
    ]


def _of(measurements: Sequence[Measurement], operation: str, sample_color: bool) -> list[Measurement]:
    return [
        m
        for m in measurements
        if m.skipped is None and m.case.operation == operation and m.case.work.sample_color == sample_color
    ]


def _section(measurements: Sequence[Measurement], yardstick: Yardstick, operation: str, sample_color: bool) -> str:
    """One table: a row a contender and number of lights."""
    header = ["contender", "lights", "samples", "ns", "x jaxlight", "spread", "compile s", "first call s"]
    header += ["max error", "rms error", "99.9 % ulp", "peak MB", "x inputs"]
    rows: list[list[object]] = []
    found = _of(measurements, operation, sample_color)
    for lights in sorted({m.case.work.lights for m in found}):
        group = [m for m in found if m.case.work.lights == lights]
        own = min((m.nanoseconds for m in group if m.case.entrant in _OWN), default=None)
        kernel = FORWARD if sample_color else FORWARD_UNIFORM
        limit = yardstick.nanoseconds(kernel, lights) if operation == "forward" else None
        if limit is not None:
            rows.append(["yardstick", lights, 2**20, limit, own and limit / own, *[None] * 8])
        rows += [_row(m, own) for m in sorted(group, key=lambda m: m.nanoseconds)]
    return f"## {_TITLES[operation, sample_color]}\n\n{table(header, rows)}"


def _row(m: Measurement, own: float | None) -> list[object]:
    error = m.error or {}
    ulp = error.get("high_ulp") if m.case.operation == "forward" else None
    return [
        m.case.entrant.label,
        m.case.work.lights,
        m.case.work.samples,
        m.nanoseconds,
        own and m.nanoseconds / own,
        f"{m.spread:.0%}",
        m.compile_seconds if m.compile_seconds > 1e-2 else None,
        m.first_seconds,
        error.get("largest"),
        error.get("root_mean_square"),
        ulp,
        m.extra_bytes / 1e6,
        m.memory_ratio,
    ]


def headline(measurements: Sequence[Measurement], yardstick: Yardstick) -> list[Metric]:
    """The ratios that the gate watches."""
    metrics = []
    for lights in sorted({m.case.work.lights for m in measurements}):

        def pick(operation: str, sample_color: bool, lights: int = lights) -> tuple[Measurement | None, float | None]:
            """jaxlight's measurement, and the fastest peer's nanoseconds."""
            group = [m for m in _of(measurements, operation, sample_color) if m.case.work.lights == lights]
            # By name: of fewer contenders the quickest is no better known.
            ours = JAXLIGHT_BY_TILES if operation == "value_and_gradient" else JAXLIGHT
            own = next((m for m in group if m.case.entrant == ours), None)
            return own, min((m.nanoseconds for m in group if m.case.entrant not in _OWN), default=None)

        forward, forward_peer = pick("forward", True)
        uniform, _ = pick("forward", False)
        gradient, gradient_peer = pick("value_and_gradient", False)
        limit = yardstick.nanoseconds(FORWARD, lights)
        if forward is not None and limit is not None:
            metrics.append(Metric(f"forward/{lights}/over yardstick", forward.nanoseconds / limit, "lower"))
        if forward is not None and forward_peer is not None:
            metrics.append(Metric(f"forward/{lights}/fastest peer over", forward_peer / forward.nanoseconds, "higher"))
        if gradient is not None and uniform is not None:
            metrics.append(Metric(f"gradient/{lights}/over forward", gradient.seconds / uniform.seconds, "lower"))
            metrics.append(Metric(f"gradient/{lights}/memory over inputs", gradient.memory_ratio, "lower"))
        if gradient is not None and gradient_peer is not None:
            ratio = gradient_peer / gradient.nanoseconds
            metrics.append(Metric(f"gradient/{lights}/fastest peer over", ratio, "higher"))
    return metrics


if __name__ == "__main__":
    sys.exit(main())
