"""A run: cases drawn from a seed, judged in both precisions, a table a quantity, and whether the figures hold."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import secrets
import sys
import time

import jax
import numpy as np

from jaxlight.cli.stress import Stress

from ..report import table
from .draw import Kind, blocks, family, features, find
from .explain import explain
from .figures import HEADER, Table
from .judge import Block, Judged, Precision

MODES = ("reverse", "forward")
Task = tuple[Precision, Kind]


def run(options: Stress) -> int:
    """Run, print and save; the exit status."""
    seed = secrets.randbelow(10**9) if options.seed is None else options.seed
    if options.case:
        print("\n".join(explain(find(seed, options.case, options.shapes), options.precisions)))
        return 0
    start = time.monotonic()
    print(f"seed {seed}: {options.cases} random and {options.adversarial} adversarial cases", flush=True)
    kinds: tuple[Kind, ...] = ("random", "adversarial")
    tasks = [(precision, kind) for precision in options.precisions for kind in kinds]
    tables = {(p, q): Table(p, q) for p in options.precisions for q in _quantities(options)}
    if options.jobs == 1:
        found = (judge(seed, options, task) for task in tasks)
    else:
        spawn = multiprocessing.get_context("spawn")
        with concurrent.futures.ProcessPoolExecutor(min(options.jobs, len(tasks)), spawn) as pool:
            found = list(pool.map(judge, [seed] * len(tasks), [options] * len(tasks), tasks))
    for part in found:
        for one in part:
            tables[one.precision, one.quantity].merge(one)
    text = report(seed, options, list(tables.values()), time.monotonic() - start)
    print(text)
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "stress.md").write_text(text + "\n")
    if options.plot:
        from .plot import save_plot

        save_plot(list(tables.values()), options.output / "stress.png")
    return 1 if any(t.violations() for t in tables.values()) else 0


def judge(seed: int, options: Stress, task: Task) -> list[Table]:
    """All cases of one sort in one precision; progress goes to standard error."""
    precision, kind = task
    start, count = time.monotonic(), {"random": options.cases, "adversarial": options.adversarial}[kind]
    tables = {quantity: Table(precision, quantity) for quantity in _quantities(options)}
    done = 0
    for i, cases in enumerate(blocks(seed, kind, count, options.shapes)):
        block = Block(cases, precision)
        for quantity, one in tables.items():
            if quantity == "values":
                _add(one, kind, block, block.judge_values())
            elif quantity != "second":
                _add(one, kind, block, block.judge_derivatives(quantity))
            elif i == 0:
                _add(one, kind, block, block.judge_second(options.second))
        done += len(cases)
        took = time.monotonic() - start
        print(f"  {precision}, {kind}: {done} of {count} cases, {took:.0f} s", file=sys.stderr, flush=True)
        if options.minutes and took > 60 * options.minutes:
            break
    jax.clear_caches()  # programs of the next task would be mapped beside these, until the system has no more maps
    return list(tables.values())


def report(seed: int, options: Stress, tables: list[Table], seconds: float) -> str:
    """Everything that was found, as Markdown."""
    words = [f"--seed {seed} --cases {options.cases} --adversarial {options.adversarial} --shapes {options.shapes}"]
    words += [f"--second {options.second}", *([] if options.forward else ["--no-forward"])]
    words += [f"--precisions {' '.join(options.precisions)}"]
    given = " ".join([*words, *([f"--minutes {options.minutes:g}"] if options.minutes else [])])
    parts = [f"`jaxlight stress {given}`, {seconds:.0f} s. A case again: add `--case LABEL`."]
    for one in tables:
        parts.append(f"**{one.precision}, {_title(one.quantity)}**")
        parts.append(table(HEADER, [row.cells() for row in one.rows.values()]))
        if one.by_field:
            rows = [[name, int(count), worst, int(own)] for name, (worst, count, own) in sorted(one.by_field.items())]
            parts.append(table(("derivative by", "cases", "worst / condition", "by allowance"), rows))
    violations = [line for one in tables for line in one.violations()]
    parts.append("\n".join(f"- VIOLATED: {line}" for line in violations) or "All figures hold.")
    return "\n\n".join(parts)


def _quantities(options: Stress) -> tuple[str, ...]:
    modes = MODES if options.forward else MODES[:1]
    return ("values", *modes, *(("second",) if options.second else ()))


def _title(quantity: str) -> str:
    if quantity == "second":
        return "second derivatives, forward over reverse (in ulp of the sum of their terms' sizes)"
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
        target.add_field(name, float(np.max(errors, initial=0.0)), len(errors), judged.by_allowance[name])
