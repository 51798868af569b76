"""One contender in a process of its own: answers JSON lines on its standard input until it ends.

Started by `harness.py`. Pinned before anything heavy is imported, so that libraries size their thread pools by it.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Sequence
from typing import Any


class Cases:
    """The workloads that this process has loaded, by key."""

    def __init__(self, entrant: Any) -> None:
        self.entrant = entrant
        self.contenders: dict[Any, Any] = {}
        self.runs: dict[str, tuple[Any, Any]] = {}

    def load(self, case: str, work: dict[str, Any], operation: str, reference: str | None) -> dict[str, Any]:
        """Compiles, runs once, compares with the reference; answers what that took and how far off it is."""
        import dataclasses

        from .errors import color_errors, gradient_errors, parameter_errors
        from .reference import Answer
        from .workload import Workload, make_arrays

        workload = Workload(**work)
        if workload not in self.contenders:
            arrays = make_arrays(workload)
            options = dict(self.entrant.options)
            contender = self.entrant.contender()(workload, arrays, **options)
            self.contenders[workload] = (contender, arrays.input_bytes * contender.views)
        contender, input_bytes = self.contenders[workload]
        started = time.perf_counter()
        run = contender.prepare(operation)
        compiled = time.perf_counter()
        result = run()
        finished = time.perf_counter()
        self.runs[case] = (run, contender)
        answer: dict[str, Any] = {
            "compile_seconds": compiled - started,
            "first_seconds": finished - compiled,
            "input_bytes": input_bytes,
            "error": None,
            "steps": 0,
        }
        if reference is not None:
            expected = Answer.load(reference)
            if operation == "fit":
                fit = contender.fitted(result)
                answer["steps"] = fit.steps
                errors = parameter_errors(fit.values, make_arrays(workload).parameters)
            elif operation == "forward":
                colors = contender.colors(result)[:, :: expected.stride]
                errors = color_errors(colors, expected, colors.dtype.type, self.entrant.color_limit)
            elif expected.gradient:
                errors = gradient_errors(*contender.value_and_gradient(result), expected)
            else:
                return answer
            answer["error"] = dataclasses.asdict(errors)
        return answer

    def time(self, case: str, seconds: float, most_calls: int) -> dict[str, Any]:
        """Calls for about so long, at least once; answers processor and wall seconds of each call."""
        run, _ = self.runs[case]
        cpu, wall = [], []
        begin = time.perf_counter()
        while not cpu or (time.perf_counter() - begin < seconds and len(cpu) < most_calls):
            started, started_cpu = time.perf_counter(), time.process_time()
            result = run()
            cpu.append(time.process_time() - started_cpu)
            wall.append(time.perf_counter() - started)
            del result
        return {"cpu": cpu, "wall": wall}

    def memory(self, case: str) -> dict[str, Any]:
        from .memory import peak_bytes

        run, contender = self.runs[case]
        contender.release()
        return {"bytes": peak_bytes(run)}


def pin(cores: Sequence[int]) -> None:
    """Keeps this process on these cores; none, or a system that cannot: wherever it likes."""
    if cores and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)


def main() -> None:
    """Reads the entrant and the cores from the command line, then serves."""
    settings = json.loads(sys.argv[1])
    pin(settings["cores"])
    from .entrants import Entrant

    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print goes to the log
    cases = Cases(Entrant(**settings["entrant"]))
    for line in sys.stdin:
        message = json.loads(line)
        try:
            answer = getattr(cases, message.pop("command"))(**message)
        except Exception as error:
            answer = {"failed": f"{type(error).__name__}: {error}".splitlines()[0][:200]}
        print(json.dumps(answer), file=replies, flush=True)


if __name__ == "__main__":
    main()
