"""Results as Markdown tables and JSON, with what one must know of the machine to read them."""

from __future__ import annotations

import dataclasses
import datetime
import importlib.metadata
import json
import os
import platform
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .harness import Measurement, Plan

_PACKAGES = ("jax", "numpy", "torch", "drjit", "numba", "scipy", "optax", "optimistix")
_LOADED = 1.15
"""Wall over processor time from which a run on one core counts as disturbed."""


def table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A Markdown table; floats with three figures, None as a dash."""
    cells = [[_cell(value) for value in row] for row in rows]
    widths = [max(len(row[i]) for row in [list(header), *cells]) for i in range(len(header))]
    lines = [list(header), ["-" * width for width in widths], *cells]
    aligned = [
        " | ".join(cell.ljust(width) if i == 0 else cell.rjust(width) for i, (cell, width) in enumerate(pairs))
        for pairs in (list(zip(line, widths, strict=True)) for line in lines)
    ]
    return "\n".join(f"| {line} |" for line in aligned)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        if value == 0:
            return "0"
        return f"{value:.2e}" if abs(value) < 1e-3 or abs(value) >= 1e5 else f"{value:.3g}"
    return str(value)


def conditions(plan: Plan, measurements: Sequence[Measurement] = ()) -> str:
    """The paragraph above every table: machine, date, versions, cores, and whether the machine was quiet."""
    busy = max((m.busy for m in measurements if m.skipped is None), default=1.0)
    clock = "processor time" if len(plan.cores) == 1 else "wall time"
    lines = [
        f"{datetime.date.today().isoformat()}, {processor()}, {_cores(plan)}, medians of {clock} over "
        f"{plan.rounds} rounds in turn. {', '.join(f'{k} {v}' for k, v in versions().items())}.",
    ]
    if len(plan.cores) == 1 and busy > _LOADED:
        lines.append(f"The machine was NOT quiet: wall time up to {busy:.1f} x processor time. Trust ratios only.")
    return "\n".join(lines)


def _cores(plan: Plan) -> str:
    if not plan.cores:
        return "not pinned"
    return f"pinned to core {', '.join(map(str, plan.cores))}"


def skipped_lines(measurements: Sequence[Measurement]) -> list[str]:
    """One line for each contender that was left out, with the reason."""
    lines = [f"skipped: {m.case.entrant.label} ({m.skipped})" for m in measurements if m.skipped]
    return list(dict.fromkeys(lines))


def own_failures(measurements: Sequence[Measurement]) -> int:
    """Exit status: 1 if jaxlight itself could not be measured somewhere, which is said on standard error."""
    failed = [m for m in measurements if m.skipped and m.case.entrant.path.startswith("jaxlight")]
    for m in failed:
        print(f"NOT MEASURED: {m.case.entrant.label}, {m.case.operation}, {m.case.work}: {m.skipped}", file=sys.stderr)
    return 1 if failed else 0


def versions() -> dict[str, str]:
    """Versions of the packages whose speed is compared."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.machine()} ({os.cpu_count()} cores)"


def save(folder: Path, name: str, text: str, data: Any, measurements: Sequence[Measurement] = ()) -> None:
    """Writes NAME.md and NAME.json into `folder` and says so."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.md").write_text(text + "\n")
    document = {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "processor": processor(),
        "versions": versions(),
        "data": data,
        "measurements": [_plain(m) for m in measurements],
    }
    (folder / f"{name}.json").write_text(json.dumps(document, indent=1) + "\n")
    print(f"\nwrote {folder / name}.md and .json")


def _plain(measurement: Measurement) -> dict[str, Any]:
    case = measurement.case
    fields = {k: v for k, v in dataclasses.asdict(measurement).items() if k != "case"}
    return {
        "contender": case.entrant.label,
        "title": case.title,
        "operation": case.operation,
        "work": dataclasses.asdict(case.work),
        "nanoseconds_per_sample_and_light": measurement.nanoseconds,
        **fields,
    }
