"""One fit, many solvers: material and light from a picture of a sphere: `python -m benchmarks.fits --help`."""

from __future__ import annotations

import dataclasses
import sys
from typing import Any

import tyro

from .entrants import Entrant
from .fit_problem import WORK
from .gate import Metric, run_gate
from .harness import Case, Measurement, measure
from .report import conditions, own_failures, save, skipped_lines, table
from .settings import Settings, say

_X64 = (("JAX_ENABLE_X64", "1"),)
REACHED = {"float32": 1e-4, "float64": 1e-6}
"""Relative error of the worst parameter at which a fit counts as done."""


def _entrant(label: str, path: str, package: str, precision: str, **options: Any) -> tuple[Entrant, str]:
    environment = _X64 if precision == "float64" else ()
    if not path.startswith("fit_torch"):
        options["precision"] = precision
    return Entrant(label, path, (package,), options=tuple(options.items()), environment=environment), precision


ENTRANTS = (
    _entrant("jaxlight", "jaxlight_fit:JaxlightFit", "optimistix", "float32"),
    _entrant("jaxlight", "jaxlight_fit:JaxlightFit", "optimistix", "float64"),
    _entrant("optimistix LM, naive JAX", "fit_jax:OptimistixFit", "optimistix", "float32"),
    _entrant("optimistix LM, naive JAX", "fit_jax:OptimistixFit", "optimistix", "float64"),
    _entrant("SciPy trf, naive JAX", "fit_jax:ScipyFit", "scipy", "float64", method="trf"),
    _entrant("SciPy lm, naive JAX", "fit_jax:ScipyFit", "scipy", "float64", method="lm"),
    _entrant("optax Adam, naive JAX", "fit_jax:OptaxFit", "optax", "float32"),
    _entrant("torch Adam, eager", "fit_torch:TorchFit", "torch", "float32"),
)


@dataclasses.dataclass
class Options(Settings):
    """Seconds to fit ten numbers to a 256 x 256 picture, compilation apart, beside the error that is left."""

    rounds: int = 3


def main() -> int:
    """Measures, prints and saves; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    plan = options.plan(memory=False)
    work = dataclasses.replace(WORK, samples=32 * 32) if options.quick else WORK
    measurements = measure([Case(entrant, "fit", work, precision) for entrant, precision in ENTRANTS], plan, say=say)
    done = [m for m in measurements if m.skipped is None]
    own = {m.case.title: m for m in done if m.case.entrant.label == "jaxlight"}
    rows = [_row(m, own.get(m.case.title)) for m in done]
    header = ["solver", "precision", "seconds", "x jaxlight", "evaluations", "parameter error", "reached", "compile s"]
    note = (
        "`parameter error`: of the worst number, relative to its field. `reached`: below "
        + ", ".join(f"{limit:g} in {precision}" for precision, limit in REACHED.items())
        + ". `compile s`: compilation and first fit, less one warm fit."
    )
    text = "\n\n".join(["# Fits", conditions(plan, measurements), table([*header], rows), note])
    text = "\n".join([text, "", *skipped_lines(measurements)])
    print(text)
    metrics = _metrics(done, own)
    save(options.output, "fits", text, [dataclasses.asdict(metric) for metric in metrics], measurements)
    return run_gate(metrics, options) or own_failures(measurements)


def _reached(m: Measurement) -> bool:
    return m.error is not None and m.error["largest"] <= REACHED[m.case.title]


def _row(m: Measurement, own: Measurement | None) -> list[Any]:
    return [
        m.case.entrant.label,
        m.case.title,
        m.seconds,
        own and m.seconds / own.seconds,
        m.steps,
        m.error and m.error["largest"],
        "yes" if _reached(m) else "no",
        max(m.compile_seconds + m.first_seconds - m.seconds, 0.0),
    ]


def _metrics(done: list[Measurement], own: dict[str, Measurement]) -> list[Metric]:
    """How much longer the fastest peer takes that gets as far; peers that do not are no peers."""
    metrics = []
    for precision, mine in own.items():
        peers = [m.seconds for m in done if m.case.title == precision and m not in own.values() and _reached(m)]
        if peers:
            metrics.append(Metric(f"fit/{precision}/fastest peer over", min(peers) / mine.seconds, "higher"))
    return metrics


if __name__ == "__main__":
    sys.exit(main())
