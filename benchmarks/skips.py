"""What each static skip buys: `python -m benchmarks.skips --help`.

A row is a scene that does not need a term. "planned" is what the library does with it; "everything" is the same scene
planned as if all its fields were free, so that nothing may be skipped. Both are checked against the same reference.
"""

from __future__ import annotations

import dataclasses
import sys
from typing import Any, NamedTuple

import tyro

from .contenders.base import Operation
from .entrants import JAXLIGHT, Entrant
from .harness import Case, Measurement, measure
from .report import conditions, own_failures, save, skipped_lines, table
from .settings import Settings, say
from .workload import Workload


@dataclasses.dataclass
class Options(Settings):
    """Time with a skip over time without it, feature by feature, on one scene of 8 lights."""

    lights: int = 8
    samples: int = 2**20


class Feature(NamedTuple):
    """A scene that lacks something."""

    title: str
    changes: dict[str, Any]
    """Against the common workload."""
    options: dict[str, Any] = {}
    """Of the contender."""


FEATURES = (
    Feature("everything present", {}),
    Feature("no specular", {"specular": False}),
    Feature("no attenuation", {"attenuation": False}),
    Feature("radius encloses all samples", {"radius": 100.0}),
    Feature("no ambient", {"ambient": False}),
    Feature("no emissive", {"emissive": False}),
    Feature("no fog", {"fog": "NONE"}),
    Feature("linear fog", {"fog": "LINEAR"}),
    Feature("no specular, no fog", {"specular": False, "fog": "NONE"}),
    Feature(
        "diffuse only", {"specular": False, "fog": "NONE", "attenuation": False, "radius": 100.0, "ambient": False}
    ),
    Feature("half of the lights off", {"dark": "off"}),
    Feature("half of the lights black", {"dark": "black"}),
    Feature("half of the lights out of reach", {"dark": "far"}),
    Feature("directional instead of point", {"kind": "directional"}),
    Feature("directional, diffuse only", {"kind": "directional", "specular": False, "fog": "NONE", "ambient": False}),
    Feature("spot instead of point", {"kind": "spot"}),
    Feature("one material for all samples", {"sample_color": False}),
    Feature("16 materials", {"sample_color": False}, {"materials": 16}),
)


def entrant(title: str, **options: Any) -> Entrant:
    """jaxlight with other options."""
    return dataclasses.replace(JAXLIGHT, label=title, options=tuple(options.items()))


def main() -> int:
    """Measures, prints and saves; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    base = Workload(2**14 if options.quick else options.samples, options.lights)
    plan = options.plan(memory=False)
    measurements = measure(_cases(base, "forward"), plan, say=say)
    full = next((m for m in measurements if m.case.title == "everything present" and not m.skipped), None)
    rows = [_row(feature, measurements, full) for feature in FEATURES]
    rows.append(["70 % of the pixels are background", *_background(base, plan, full)])
    header = ["scene", "ns planned", "ns everything", "planned / everything", "planned / full scene", "max error"]
    note = (
        "`ns` per sample and light of the forward pass; lights that are skipped count too. `full scene`: the first "
        "row, planned. A ratio below 1 is a gain."
    )
    text = "\n\n".join(["# Static skips", conditions(plan, measurements), table(header, rows), note])
    text = "\n".join([text, "", *skipped_lines(measurements)])
    print(text)
    save(options.output, "skips", text, rows, measurements)
    return own_failures(measurements)


def _cases(base: Workload, operation: Operation) -> list[Case]:
    return [
        Case(entrant(kind, skip=kind == "planned", **feature.options), operation, work, feature.title)
        for feature in FEATURES
        for work in [dataclasses.replace(base, **feature.changes)]
        for kind in ("planned", "everything")
    ]


def _row(feature: Feature, measurements: list[Measurement], full: Measurement | None) -> list[Any]:
    found = {m.case.entrant.label: m for m in measurements if m.case.title == feature.title and m.skipped is None}
    planned, everything = found.get("planned"), found.get("everything")
    return [
        feature.title,
        planned and planned.nanoseconds,
        everything and everything.nanoseconds,
        planned and everything and planned.seconds / everything.seconds,
        planned and full and planned.seconds / full.seconds,
        planned and planned.error and planned.error["largest"],
    ]


def _background(base: Workload, plan: Any, full: Measurement | None) -> list[Any]:
    """Background pixels are never stored, so an image with 30 % of the samples is the whole measure."""
    if full is None:
        return [None] * 5
    work = dataclasses.replace(base, samples=int(0.3 * base.samples))
    (part,) = measure([Case(JAXLIGHT, "forward", work)], plan, say=say)
    if part.skipped:
        return [None] * 5
    return [part.seconds / base.light_samples * 1e9, None, None, part.seconds / full.seconds, None]


if __name__ == "__main__":
    sys.exit(main())
