"""The benchmarks of speed within one time bound: `python -m benchmarks --minutes 60 --yardstick PATH`."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import time
from pathlib import Path

import tyro

SHARES = {
    "peers": 0.35,
    "precision": 0.17,
    "scaling": 0.17,
    "skips": 0.08,
    "culling": 0.07,
    "fits": 0.08,
    "startup": 0.04,
    "bandwidth": 0.04,
}
"""Parts of the time bound; what one leaves over goes to those after it."""


@dataclasses.dataclass
class Options:
    """Runs the benchmarks of speed one after the other; the exit status is the worst of theirs."""

    minutes: float = 60.0
    """Time bound for all of it."""
    yardstick: Path | None = None
    """Handed to `benchmarks.peers`."""
    quick: bool = False
    """Small and short, to see that it works."""
    output: Path = Path("out/benchmarks")
    gate: bool = False
    """Compare with the committed baseline."""
    write_baseline: bool = False
    """Make this run's metrics the committed baseline."""
    only: tuple[str, ...] = tuple(SHARES)
    """Which of them."""


def main() -> int:
    """Runs the commands; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    unknown = [name for name in options.only if name not in SHARES]
    if unknown:
        print(f"--only: unknown {', '.join(unknown)}; known are {', '.join(SHARES)}", file=sys.stderr)
        return 2
    end = time.monotonic() + 60 * options.minutes
    statuses = {}
    for position, name in enumerate(options.only):
        left = sum(SHARES[other] for other in options.only[position:])
        minutes = max((end - time.monotonic()) / 60, 0) * SHARES[name] / left
        print(f"\n===== {name}: at most about {minutes:.1f} minutes\n", flush=True)
        statuses[name] = _run(name, minutes, options)
    bad = {name: status for name, status in statuses.items() if status}
    print(f"\n{len(statuses) - len(bad)} of {len(statuses)} benchmarks ended well", end="")
    print("" if not bad else ": " + ", ".join(f"{name} with status {status}" for name, status in bad.items()))
    return max(statuses.values(), default=0)


def _run(name: str, minutes: float, options: Options) -> int:
    command = [sys.executable, "-m", f"benchmarks.{name}", "--minutes", f"{minutes:.2f}"]
    command += ["--output", str(options.output)]
    command += ["--quick"] * options.quick
    gated = name in ("peers", "scaling", "culling", "fits")
    command += ["--gate"] * (options.gate and gated) + ["--write-baseline"] * (options.write_baseline and gated)
    if name == "peers" and options.yardstick is not None:
        command += ["--yardstick", str(options.yardstick)]
    try:
        # A call that has begun is finished beyond the bound, but not for ever.
        return subprocess.run(command, timeout=60 * minutes + 600).returncode
    except subprocess.TimeoutExpired:
        print(f"{name} did not end in time", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
