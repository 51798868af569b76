"""How near the memory's limit, on whatever device JAX finds (a GPU included): `python -m benchmarks.bandwidth --help`.

Beside jaxlight runs a program that only reads the same inputs and writes as many outputs. Its time is what the memory
allows; the share of it in jaxlight's time is the fraction of the bandwidth that shading reaches.
"""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import tyro

from .contenders.base import Operation
from .entrants import JAXLIGHT, JAXLIGHT_BY_TILES, PEERS, Entrant, named
from .harness import Case, Measurement, Plan, measure
from .report import conditions, own_failures, save, skipped_lines, table
from .settings import Settings, say
from .workload import Workload

# JAX processes side by side must share a GPU's memory.
_SHARED = (("XLA_PYTHON_CLIENT_PREALLOCATE", "false"),)
STREAM = Entrant("stream", "stream:Stream", ("jax",), environment=_SHARED, checked=False)
_OPERATIONS: tuple[Operation, ...] = ("forward", "value_and_gradient")


@dataclasses.dataclass
class Options(Settings):
    """Fraction of the memory bandwidth that the forward pass and value-and-gradient reach, on all of a device."""

    lights: tuple[int, ...] = (1, 8, 64)
    samples: int = 2**22
    only: tuple[str, ...] = ()
    """Names of the contenders to run beside `stream`; default: all."""


def main() -> int:
    """Measures, prints and saves; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    # No pinning: a device's queue, or all cores; wall time.
    plan: Plan = dataclasses.replace(options.plan(memory=False), cores=options.cores)
    samples = 2**14 if options.quick else options.samples
    naive = next(entrant for entrant in PEERS if entrant.label == "naive JAX")
    entrants = named((JAXLIGHT, JAXLIGHT_BY_TILES, naive), options.only)
    entrants = [STREAM, *(dataclasses.replace(entrant, environment=_SHARED) for entrant in entrants)]
    cases = [
        Case(entrant, operation, entrant.within_limits(Workload(samples, lights)))
        for lights in options.lights
        for operation in _OPERATIONS
        for entrant in entrants
        if operation != "forward" or entrant.label != JAXLIGHT_BY_TILES.label
    ]
    measurements = measure(cases, plan, say=say)
    rows = [row for m in measurements if not m.skipped for row in [_row(m, measurements)]]
    header = ["contender", "operation", "lights", "samples", "ms", "ns", "GB/s", "of the bandwidth", "compile s"]
    note = (
        "`GB/s`: bytes of inputs and outputs (forward), or of inputs and target (gradient), over time. `of the "
        "bandwidth`: the time of `stream`, which only moves these bytes, over the contender's for the same samples."
    )
    text = "\n\n".join(
        ["# Memory bandwidth", f"Device: {_device()}.", conditions(plan, measurements), table(header, rows), note]
    )
    text = "\n".join([text, "", *skipped_lines(measurements)])
    print(text)
    save(options.output, "bandwidth", text, None, measurements)
    return own_failures(measurements)


def _row(m: Measurement, measurements: list[Measurement]) -> list[object]:
    work = m.case.work
    planes = 9 + (4 if m.case.operation == "forward" else 3)
    streams = {
        (other.case.work.lights, other.case.operation): other
        for other in measurements
        if other.case.entrant == STREAM and not other.skipped
    }
    stream = streams.get((work.lights, m.case.operation))
    share = None
    if stream is not None:
        share = stream.seconds / stream.case.work.samples / (m.seconds / work.samples)
    return [
        m.case.entrant.label,
        m.case.operation,
        work.lights,
        work.samples,
        1e3 * m.seconds,
        m.nanoseconds,
        planes * 4 * work.samples / m.seconds / 1e9,
        share,
        m.compile_seconds,
    ]


def _device() -> str:
    """Asked in another process, so that this one does not take the device."""
    code = "import jax; print(jax.devices()[0].device_kind, len(jax.devices()), jax.default_backend())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    return done.stdout.strip() or "unknown"


if __name__ == "__main__":
    sys.exit(main())
