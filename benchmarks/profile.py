"""Where the time goes: the loops of one call, by stage of the equation. `python -m benchmarks.profile --help`.

XLA's own trace, on one core; loops are told by the scopes that `lighting/stages.py` gives them. What is in no stage
goes by the operation it ends with: "while" is a loop with all that is in it, of which later JAX tells no more.
"""

from __future__ import annotations

import collections
import dataclasses
import gzip
import json
import re
import statistics
import sys
import tempfile
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import tyro

from .contenders.base import Operation
from .report import conditions, save, table
from .settings import Settings
from .worker import pin
from .workload import Workload, make_arrays

_INSTRUCTION = re.compile(r'^\s*(?:ROOT )?%?([\w.\-]+) = (?:[^\n]*op_name="([^"]*)")?', re.MULTILINE)
"""Its name, and the operation that it comes from; what XLA puts in by itself has none."""
_SHOWN = 0.01
"""Smaller shares are added up."""


@dataclasses.dataclass
class Options(Settings):
    """Shares of the stages in a forward pass and in value-and-gradient."""

    lights: tuple[int, ...] = (1, 8, 64)
    samples: int = 2**17
    accuracy: str = "full"
    """Of highlights."""
    cover: float = 0.0
    """Lights are small, and so many of them reach a sample on average; 0: all do."""


def main() -> int:
    """Measures, prints and saves; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    plan = options.plan(memory=False)
    pin(plan.cores)  # before JAX counts the cores
    parts = ["# Where the time goes", conditions(plan)]
    operations: tuple[Operation, ...] = ("forward", "value_and_gradient")
    for operation in operations:
        for lights in options.lights:
            samples = 2**14 if options.quick else options.samples
            work = Workload(samples, lights, cover=options.cover)
            shares, nanoseconds = stage_shares(work, operation, options.accuracy, plan.rounds)
            parts.append(f"**{operation}, {lights} lights**: {nanoseconds:.3g} ns per sample and light in loops")
            parts.append(table(["stage", "share", "loops"], _rows(shares)))
    text = "\n\n".join(parts)
    print(text)
    save(options.output, "profile", text, None, [])
    return 0


def stage_shares(
    work: Workload, operation: Operation, accuracy: str, rounds: int
) -> tuple[Mapping[str, tuple[float, int]], float]:
    """Of every stage its share and number of loops; and the time of all, ns per sample and light."""
    from .contenders.jaxlight_shade import JaxlightShade

    contender = JaxlightShade(work, make_arrays(work), lighting=(("accuracy", accuracy),))
    call, program = contender.compiled(operation)
    for _ in range(rounds):
        call()
    names = operations(program)
    durations = _durations(call, rounds, names)
    times: dict[str, float] = collections.defaultdict(float)
    loops: dict[str, int] = collections.defaultdict(int)
    for instruction, own in durations.items():
        # The median: a core that does something else in between is no part of it.
        times[_stage(names[instruction])] += statistics.median(own) * len(own) / rounds
        loops[_stage(names[instruction])] += 1
    total = sum(times.values())
    return {name: (time / total, loops[name]) for name, time in times.items()}, 1e3 * total / work.light_samples


def operations(program: str) -> Mapping[str, str]:
    """Of every instruction of a compiled program the operation that it comes from, or else what XLA calls it."""
    return {name: operation or name.split(".")[0] for name, operation in _INSTRUCTION.findall(program)}


def _durations(call: Callable[[], Any], rounds: int, instructions: Collection[str]) -> Mapping[str, list[float]]:
    """How long each of the instructions took, each time in so many calls, in microseconds; not what holds others."""
    import jax

    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder, create_perfetto_trace=True):
            for _ in range(rounds):
                call()  # its result is let go, so that the next one finds memory that is there already
        (path,) = Path(folder).rglob("perfetto_trace.json.gz")
        events = json.loads(gzip.decompress(path.read_bytes()))["traceEvents"]
    own = [event for event in events if event.get("ph") == "X" and event["name"] in instructions]
    own.sort(key=lambda event: (event["tid"], event["ts"], -event["dur"]))
    found = collections.defaultdict(list)
    for event, following in zip(own, [*own[1:], None], strict=True):
        if following is None or not _holds(event, following):
            found[event["name"]].append(event["dur"])
    return found


def _holds(event: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    return event["tid"] == other["tid"] and other["ts"] < event["ts"] + event["dur"]


def _stage(name: str) -> str:
    scopes = re.findall(r"(?:stage|loop)\.([\w.\[\]]+)", name)
    if scopes:
        return scopes[-1] + (" (reverse)" if "transpose(" in name else "")
    return "no stage: " + name.rsplit("/", 1)[-1]


def _rows(shares: Mapping[str, tuple[float, int]]) -> list[list[Any]]:
    ordered = sorted(shares.items(), key=lambda item: -item[1][0])
    rows = [[name, f"{100 * share:.1f} %", count] for name, (share, count) in ordered if share >= _SHOWN]
    rest = [pair for _, pair in ordered if pair[0] < _SHOWN]
    return [*rows, ["all others", f"{100 * sum(s for s, _ in rest):.1f} %", sum(n for _, n in rest)]]


if __name__ == "__main__":
    sys.exit(main())
