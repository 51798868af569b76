"""Fits killed by SIGKILL at random moments and resumed: do they end in the same bits? `python -m benchmarks.resume`."""

from __future__ import annotations

import dataclasses
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import tyro

from .report import save, table
from .settings import say

DATA = Path(__file__).resolve().parent.parent / "fitting" / "data" / "spot"
FREE = ("diffuse_color", "specular_color", "shininess")
START = ("Material[body].shininess=0.9", "PointLight[key].location=1.5 2 -2")
TIMES = ("seconds", "seconds_left")
"""Of a step: they differ from run to run."""


@dataclasses.dataclass
class Options:
    """`jaxlight fit` of ten numbers to a 256 x 256 picture, killed and resumed, beside the same fit left alone."""

    kills: int = 20
    """Runs, each killed once."""
    seed: int = 0
    """Of the moments."""
    quick: bool = False
    """Two kills."""
    output: Path = Path("out/benchmarks")
    """Folder for the table (.md) and the results (.json)."""


class Kill(NamedTuple):
    """What a kill found and what came of it."""

    seconds: float
    """After the run's first step line in the log."""
    logged: int
    """Evaluations in the log."""
    doing: str
    """The last line of the log."""
    resumed_after: int | None
    """Step of the checkpoint; None: there was none yet."""
    same: bool


def main() -> int:
    """Kills, resumes, prints and saves; exit status 1 if one result differs."""
    options = tyro.cli(Options, description=__doc__)
    count = 2 if options.quick else options.kills
    moments = random.Random(options.seed)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        environment = {
            **os.environ,
            "JAX_COMPILATION_CACHE_DIR": str(folder / "compiled"),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
            "TF_CPP_MIN_LOG_LEVEL": "3",  # what the compiler says about its cache
        }
        _run(folder / "warm", environment)
        seconds = _run(folder / "whole", environment)
        expected = _result(folder / "whole")
        say(f"left alone: {expected['numbers']['message']} {seconds:.1f} s from the first step to the end")
        kills: list[Kill] = []
        while len(kills) < count:
            run = folder / f"run{len(kills)}"
            kill = _killed(run, environment, moments.uniform(0, seconds), expected)
            if kill is None:
                say("it had ended before the kill; again")
                continue
            kills.append(kill)
            say(f"{len(kills)}: {kill}")
    rows = [
        [i + 1, f"{kill.seconds:.2f}", kill.doing, kill.logged, kill.resumed_after, "yes" if kill.same else "NO"]
        for i, kill in enumerate(kills)
    ]
    header = ["kill", "seconds", "last log line", "evaluations logged", "resumed after step", "same bits"]
    same = sum(kill.same for kill in kills)
    text = f"# Resumed fits\n\n{table(header, rows)}\n\n{same} of {count} killed fits resumed to the same result."
    print(text)
    save(options.output, "resume", text, [kill._asdict() for kill in kills])
    return 0 if same == count else 1


def _command(folder: Path, *more: str) -> list[str]:
    free = [f"Material[body].{field}" for field in FREE]
    command = [sys.executable, "-m", "jaxlight", "fit", str(DATA / "spot.x3d"), str(DATA / "spot_256.png")]
    command += ["--output", str(folder), "--free", *free, "PointLight[key].location", "--start", *START]
    return [*command, "--precision", "float64", "--samples", "16", "--checkpoint-seconds", "0", "--quiet", *more]


def _begun(process: subprocess.Popen[bytes], folder: Path) -> float:
    """When the start has been evaluated; all before that is compilation, and nothing to lose."""
    log = folder / "log.jsonl"
    while process.poll() is None and not (log.exists() and b'"event": "step"' in log.read_bytes()):
        time.sleep(0.002)
    return time.monotonic()


def _run(folder: Path, environment: dict[str, str]) -> float:
    """The fit left alone; seconds from its first step to its end."""
    process = subprocess.Popen(_command(folder), env=environment, stdout=subprocess.DEVNULL)
    begun = _begun(process, folder)
    if process.wait() != 0:
        raise SystemExit("the fit that was left alone did not end well")
    return time.monotonic() - begun


def _killed(folder: Path, environment: dict[str, str], moment: float, expected: dict[str, Any]) -> Kill | None:
    """One run, killed so many seconds after its first step and resumed; None if it was faster than that."""
    process = subprocess.Popen(_command(folder), env=environment, stdout=subprocess.DEVNULL)
    wake = _begun(process, folder) + moment
    time.sleep(max(wake - time.monotonic(), 0))
    process.kill()
    if process.wait() == 0:
        for file in folder.iterdir():
            file.unlink()
        return None
    before = _events(folder)
    subprocess.run(_command(folder, "--resume"), env=environment, capture_output=True, check=True)
    after = _events(folder)[len(before)]
    return Kill(
        seconds=moment,
        logged=sum(line["event"] == "step" for line in before),
        doing=before[-1]["event"],
        resumed_after=after.get("after_step"),
        same=_result(folder) == expected,
    )


def _events(folder: Path) -> list[dict[str, Any]]:
    """The log, every line of which must be whole."""
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def _result(folder: Path) -> dict[str, Any]:
    """All that must be the same: every number but the times, and the files."""
    numbers = json.loads((folder / "fit.json").read_text())
    for step in numbers["steps"]:
        for name in TIMES:
            step.pop(name)
    files = {name: (folder / name).read_bytes() for name in ("scene.x3d", "view_0.png")}
    return {"numbers": numbers, **files}


if __name__ == "__main__":
    sys.exit(main())
