"""Measures contenders side by side in one run: a process each, pinned to the same cores, taking turns."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import select
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .contenders.base import Operation
from .entrants import Entrant
from .reference import answer
from .workload import Workload, make_arrays

_ROOT = Path(__file__).parent.parent
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "TORCH_NUM_THREADS")
_REFERENCE_LIMIT = 2**27
"""Samples times lights of a reference answer; beyond it, only some samples are checked, and no gradient."""
_EXTENDED_COST = 16
"""How much slower NumPy is in extended precision."""


@dataclasses.dataclass(frozen=True)
class Case:
    """Something to measure: who does what on which workload."""

    entrant: Entrant
    operation: Operation
    work: Workload
    title: str = ""
    """What tables call it; free for the command that asks."""

    @property
    def key(self) -> str:
        return f"{self.operation} {self.work}"


@dataclasses.dataclass
class Measurement:
    """What came out; `skipped` says why nothing did."""

    case: Case
    skipped: str | None = None
    compile_seconds: float = 0.0
    first_seconds: float = 0.0
    """The first call; with libraries that cannot compile ahead of it, compilation included."""
    seconds: float = 0.0
    """Median of the steady state: processor time on one core, wall time on several."""
    spread: float = 0.0
    """Interquartile range over median."""
    busy: float = 1.0
    """Wall time over processor time: well above 1 on one core means that others disturbed the run."""
    calls: int = 0
    steps: int = 0
    """Of a fit."""
    extra_bytes: int = 0
    """Peak resident memory beyond the inputs."""
    input_bytes: int = 0
    error: dict[str, float] | None = None

    @property
    def nanoseconds(self) -> float:
        """Per sample and light."""
        return self.seconds / self.case.work.light_samples * 1e9

    @property
    def memory_ratio(self) -> float:
        """Inputs and peak beyond them, over the inputs."""
        return 1 + self.extra_bytes / self.input_bytes if self.input_bytes else 0.0


@dataclasses.dataclass(frozen=True)
class Plan:
    """How long and where to measure."""

    rounds: int = 5
    slot_seconds: float = 0.25
    """For how long a contender runs when it is its turn; one call at least."""
    most_calls: int = 50
    cores: tuple[int, ...] = (0,)
    """Where to pin to; empty: nowhere, and threads are the libraries' own affair."""
    timeout: float = 240.0
    """Seconds after which a contender that does not answer is given up."""
    deadline: float = math.inf
    """On `time.monotonic`: no further case is loaded and no further round begun after it."""
    memory: bool = True
    check: bool = True


_ONE_ARENA = {"MALLOC_ARENA_MAX": "1"}
"""glibc gives memory of other arenas back to no `malloc_trim`: what is kept there a call could use again, unseen."""


class Worker:
    """A contender's process."""

    def __init__(self, entrant: Entrant, plan: Plan) -> None:
        self._plan = plan
        self._log = tempfile.TemporaryFile("w+")  # noqa: SIM115  # closed with the process
        settings = {"entrant": dataclasses.asdict(entrant), "cores": list(plan.cores)}
        threads = {name: str(len(plan.cores)) for name in _THREADS} if plan.cores else {}
        environment = {**os.environ, **threads, **_ONE_ARENA, **dict(entrant.environment)}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.worker", json.dumps(settings)],
            cwd=_ROOT,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
        )

    def ask(self, command: str, **arguments: Any) -> dict[str, Any]:
        """The process's answer; `failed` in it says what went wrong, also when the process has died."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            print(json.dumps({"command": command, **arguments}), file=self._process.stdin, flush=True)
        except BrokenPipeError:
            return {"failed": self._last_words()}
        ready, _, _ = select.select([self._process.stdout], [], [], self._plan.timeout)
        if not ready:
            self.close()
            return {"failed": f"no answer within {self._plan.timeout:g} s"}
        line = self._process.stdout.readline()
        return json.loads(line) if line else {"failed": self._last_words()}

    def _last_words(self) -> str:
        self._process.wait()
        self._log.seek(0)
        lines = [line.strip() for line in self._log.read().splitlines() if line.strip()]
        told = next((line for line in lines if "rror" in line), lines[-1] if lines else "no message")
        return f"its process ended with status {self._process.returncode}: {told[:160]}"

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._log.close()


def measure(
    cases: Sequence[Case],
    plan: Plan,
    *,
    say: Callable[[str], None] = lambda line: None,
    between: Callable[[], None] = lambda: None,
) -> list[Measurement]:
    """Measures all cases in turns: case 1, 2, 3, 1, 2, 3 ..., so that a busy spell hits them alike.

    Args:
        cases: what to measure; those of one entrant share its process.
        plan: rounds, seconds, cores.
        say: gets a line of progress.
        between: called once before the first and after every round (a foreign program may take its turn there).
    """
    measurements = [Measurement(case) for case in cases]
    with contextlib.ExitStack() as stack:
        references = _References(cases, Path(stack.enter_context(tempfile.TemporaryDirectory())))
        workers = _start(measurements, plan, stack)
        for measurement in _alive(measurements):
            case = measurement.case
            if time.monotonic() > plan.deadline:
                measurement.skipped = "the time was up"
                continue
            say(f"{case.entrant.label}: {case.operation}, {case.work.lights} lights, {case.work.samples} samples")
            reference = references.path(case) if plan.check and case.entrant.checked else None
            reply = workers[case.entrant].ask(
                "load", case=case.key, work=dataclasses.asdict(case.work), operation=case.operation, reference=reference
            )
            _take(measurement, reply)
        times: dict[int, list[tuple[float, float]]] = {id(measurement): [] for measurement in measurements}
        between()
        for number in range(plan.rounds):
            if number and time.monotonic() > plan.deadline:
                say("the time is up: no further round")
                break
            say(f"round {number + 1} of {plan.rounds}")
            for measurement in _alive(measurements):
                reply = workers[measurement.case.entrant].ask(
                    "time", case=measurement.case.key, seconds=plan.slot_seconds, most_calls=plan.most_calls
                )
                if not _failed(measurement, reply):
                    times[id(measurement)] += list(zip(reply["cpu"], reply["wall"], strict=True))
            between()
        for measurement in _alive(measurements):
            _summarise(measurement, times[id(measurement)], len(plan.cores))
            if plan.memory:
                reply = workers[measurement.case.entrant].ask("memory", case=measurement.case.key)
                if not _failed(measurement, reply):
                    measurement.extra_bytes = reply["bytes"]
    return measurements


def _start(measurements: list[Measurement], plan: Plan, stack: contextlib.ExitStack) -> dict[Entrant, Worker]:
    workers: dict[Entrant, Worker] = {}
    for measurement in measurements:
        entrant = measurement.case.entrant
        measurement.skipped = entrant.missing()
        if measurement.skipped is None and entrant not in workers:
            workers[entrant] = Worker(entrant, plan)
            stack.callback(workers[entrant].close)
    return workers


def _alive(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
    return (measurement for measurement in measurements if measurement.skipped is None)


def _failed(measurement: Measurement, reply: dict[str, Any]) -> bool:
    measurement.skipped = reply.get("failed")
    return measurement.skipped is not None


def _take(measurement: Measurement, reply: dict[str, Any]) -> None:
    if not _failed(measurement, reply):
        for name, value in reply.items():
            setattr(measurement, name, value)


def _summarise(measurement: Measurement, times: list[tuple[float, float]], cores: int) -> None:
    cpu, wall = ([pair[i] for pair in times] for i in range(2))
    chosen = cpu if cores == 1 else wall
    measurement.calls = len(chosen)
    measurement.seconds = statistics.median(chosen)
    low, high = np.quantile(chosen, [0.25, 0.75])
    measurement.spread = float(high - low) / measurement.seconds
    measurement.busy = sum(wall) / max(sum(cpu), 1e-12)


class _References:
    """Reference answers of the workloads of a run, each computed once and handed over as a file."""

    def __init__(self, cases: Sequence[Case], folder: Path) -> None:
        self._folder = folder
        self._differentiated = {
            case.work for case in cases if case.operation in ("value_and_gradient", "normal_equations")
        }
        self._paths: dict[tuple[Workload, Any], Path] = {}

    def path(self, case: Case) -> str:
        options = dict(case.entrant.options)
        dtype = np.longdouble if options.get("precision") == "float64" else np.float64
        key = (case.work, dtype)
        if key not in self._paths:
            cost = case.work.samples * (case.work.lights if not case.work.cover else 4 * case.work.cover)
            stride = math.ceil(cost * (_EXTENDED_COST if dtype is np.longdouble else 1) / _REFERENCE_LIMIT)
            path = self._folder / f"{len(self._paths)}.npz"
            gradient = case.work in self._differentiated
            answer(case.work, make_arrays(case.work), dtype=dtype, stride=stride, gradient=gradient).save(path)
            self._paths[key] = path
        return str(self._paths[key])
