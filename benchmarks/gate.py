"""A regression gate: measured ratios against a committed baseline, each with its direction and tolerance."""

from __future__ import annotations

import dataclasses
import datetime
import json
import sys
from pathlib import Path
from typing import Literal

from .report import processor, table
from .settings import Settings

BASELINE = Path(__file__).parent / "data" / "baseline.json"
Better = Literal["lower", "higher"]


@dataclasses.dataclass(frozen=True)
class Metric:
    """A ratio measured side by side in one run."""

    name: str
    value: float
    better: Better
    tolerance: float = 0.15
    """Share of the baseline by which it may be worse before the gate fails."""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """One metric against its baseline."""

    name: str
    better: Better
    baseline: float
    measured: float | None
    tolerance: float

    @property
    def limit(self) -> float:
        """The worst value that passes."""
        return self.baseline * (1 + self.tolerance if self.better == "lower" else 1 - self.tolerance)

    @property
    def passed(self) -> bool:
        """A metric that was not measured does not fail."""
        if self.measured is None:
            return True
        return self.measured <= self.limit if self.better == "lower" else self.measured >= self.limit

    @property
    def word(self) -> str:
        return "not measured" if self.measured is None else "ok" if self.passed else "REGRESSION"


def compare(metrics: list[Metric], baseline: Path = BASELINE) -> list[Verdict]:
    """Every metric of the baseline against this run.

    Raises:
        ValueError: there is no baseline, or this run measured none of its metrics.
    """
    if not baseline.is_file():
        raise ValueError(f"no baseline at {baseline}; write one with --write-baseline on a quiet machine")
    measured = {metric.name: metric.value for metric in metrics}
    known = json.loads(baseline.read_text())["metrics"]
    verdicts = [
        Verdict(name, entry["better"], entry["value"], measured.get(name), entry["tolerance"])
        for name, entry in known.items()
    ]
    if all(verdict.measured is None for verdict in verdicts):
        raise ValueError(f"this run measured none of the {len(verdicts)} metrics in {baseline}")
    return verdicts


def write_baseline(metrics: list[Metric], baseline: Path = BASELINE) -> None:
    """Makes this run the baseline; metrics that it did not measure stay as they were."""
    known = json.loads(baseline.read_text())["metrics"] if baseline.is_file() else {}
    for metric in metrics:
        known[metric.name] = {
            "value": round(metric.value, 4),
            "better": metric.better,
            "tolerance": metric.tolerance,
            "date": datetime.date.today().isoformat(),
            "processor": processor(),
        }
    baseline.write_text(json.dumps({"metrics": dict(sorted(known.items()))}, indent=1) + "\n")


def other_processors(baseline: Path = BASELINE) -> list[str]:
    """On which other processors metrics of the baseline were measured: ratios there may well differ."""
    found = {entry.get("processor", "an unknown one") for entry in json.loads(baseline.read_text())["metrics"].values()}
    return sorted(found - {processor()})


def verdict_table(verdicts: list[Verdict]) -> str:
    """The gate's findings."""
    rows = [[v.name, v.baseline, v.measured, f"{v.better} is better", v.limit, v.word] for v in verdicts]
    return table(["metric", "baseline", "measured", "direction", "limit", "verdict"], rows)


def run_gate(metrics: list[Metric], settings: Settings) -> int:
    """What `--gate` and `--write-baseline` do; the exit status: 1 on a regression, 2 without a baseline to hold to."""
    status = 0
    if settings.gate:
        try:
            verdicts = compare(metrics)
        except ValueError as error:
            print(error, file=sys.stderr)
            return 2
        print("\n" + verdict_table(verdicts))
        if others := other_processors():
            print(f"Parts of the baseline are of other processors, whose ratios may differ: {', '.join(others)}")
        failed = [verdict.name for verdict in verdicts if not verdict.passed]
        print(f"gate: {len(failed)} of {len(verdicts)} metrics worse than allowed: {', '.join(failed) or 'none'}")
        status = 1 if failed else 0
    if settings.write_baseline:
        write_baseline(metrics)
        print(f"wrote {BASELINE}")
    return status
