"""A run: cases drawn from a seed, judged in both precisions, a table a quantity, and whether the figures hold."""

from __future__ import annotations

import dataclasses
import secrets
import sys
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ..report import table
from .draw import Kind, blocks, family, features, find
from .explain import explain
from .figures import HEADER, Table
from .judge import Block, Judged, Precision

MODES = ("reverse", "forward")


@dataclasses.dataclass(frozen=True)
class Options:
    """Judge values and derivatives of random and adversarial cases by exact answers, in ulp and in ulp / condition.

    Asked are: values of well-conditioned cases within 4 ulp x condition (99.9 % within 2), their derivatives within 16,
    and every number of every case finite. Exit status 1 if one is not."""

    cases: int = 100_000
    """Random cases."""
    adversarial: int = 20_000
    """Cases at and next to singular points."""
    seed: int | None = None
    """What the cases are drawn from; default: a new one, which is printed."""
    precisions: tuple[Precision, ...] = ("float32", "float64")
    """Float types of scenes and samples."""
    forward: bool = True
    """Also judge the derivatives of forward mode."""
    second: int = 2_000
    """Of so many random and adversarial cases also judge second derivatives, forward over reverse."""
    case: Annotated[str, tyro.conf.arg(metavar="LABEL")] = ""
    """Explain one case of the run of this seed, by the label that a table gives it, instead of running."""
    output: Path = Path("out/stress")
    """Folder for the tables (stress.md) and the plot (stress.png)."""
    plot: bool = True
    """Draw the plot, if matplotlib is there."""


def run(options: Options) -> int:
    """Run, print and save; the exit status."""
    seed = secrets.randbelow(10**9) if options.seed is None else options.seed
    if options.case:
        print("\n".join(explain(find(seed, options.case), options.precisions)))
        return 0
    start = time.monotonic()
    print(f"seed {seed}: {options.cases} random and {options.adversarial} adversarial cases", flush=True)
    modes = MODES if options.forward else MODES[:1]
    quantities = ("values", *modes, *(("second",) if options.second else ()))
    tables = {(p, q): Table(p, q) for p in options.precisions for q in quantities}
    for kind, count in (("random", options.cases), ("adversarial", options.adversarial)):
        for i, cases in enumerate(blocks(seed, kind, count)):  # type: ignore[arg-type]  # one of the two
            for precision in options.precisions:
                block = Block(cases, precision)
                _add(tables[precision, "values"], kind, block, block.judge_values())  # type: ignore[arg-type]
                for mode in modes:
                    judged = block.judge_derivatives(mode)  # type: ignore[arg-type]  # one of the two
                    _add(tables[precision, mode], kind, block, judged)  # type: ignore[arg-type]
                if i == 0 and options.second:
                    judged = block.judge_second(options.second)
                    _add(tables[precision, "second"], kind, block, judged)  # type: ignore[arg-type]
            elapsed = time.monotonic() - start
            print(f"  {kind} block {i + 1} of {-(-count // len(cases))}, {elapsed:.0f} s", file=sys.stderr, flush=True)
    text = report(seed, options, list(tables.values()), time.monotonic() - start)
    print(text)
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "stress.md").write_text(text + "\n")
    if options.plot:
        from .plot import save_plot

        save_plot(list(tables.values()), options.output / "stress.png")
    return 1 if any(t.violations() for t in tables.values()) else 0


def report(seed: int, options: Options, tables: list[Table], seconds: float) -> str:
    """Everything that was found, as Markdown."""
    parts = [
        f"`python -m benchmarks.stress --seed {seed} --cases {options.cases} --adversarial {options.adversarial}`, "
        f"{seconds:.0f} s. A case again: `--seed {seed} --case LABEL`."
    ]
    for one in tables:
        parts.append(f"**{one.precision}, {_title(one.quantity)}**")
        parts.append(table(HEADER, [row.cells() for row in one.rows.values()]))
        if one.by_field:
            rows = [[name, int(count), worst] for name, (worst, count) in sorted(one.by_field.items())]
            parts.append(table(("derivative by", "cases", "worst / condition"), rows))
    violations = [line for one in tables for line in one.violations()]
    parts.append("\n".join(f"- VIOLATED: {line}" for line in violations) or "All figures hold.")
    return "\n\n".join(parts)


def _title(quantity: str) -> str:
    if quantity == "second":
        return "second derivatives, forward over reverse (errors in ulp of the sum of their terms' sizes)"
    return quantity if quantity == "values" else f"derivatives, {quantity} mode"


def _add(target: Table, kind: Kind, block: Block, judged: Judged) -> None:
    """The block's cases to the rows of their families and features."""
    places: dict[str, list[int]] = {}
    for i, case in enumerate(block.cases[: len(judged.finite)]):
        names = ["random", *(f"random: {name}" for name in features(case))] if kind == "random" else [family(case)]
        for name in names:
            places.setdefault(name, []).append(i)
    for name, own in places.items():
        labels = [block.cases[i].label for i in own]
        target.row(name).add(labels, judged.ulp[own], judged.relative[own], judged.finite[own])
    for name, errors in judged.by_field.items():
        worst, count = target.by_field.get(name, [0.0, 0])
        target.by_field[name] = [max(worst, float(np.max(errors, initial=0.0))), count + len(errors)]
