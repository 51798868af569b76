"""Compile time of typical scenes, and what JAX's persistent cache leaves of it: `python -m benchmarks.startup --help`.

Each figure comes from a process that starts with nothing but its cache folder. They are no ratios: no gate knows them.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
import time
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import tyro

from jaxlight import compiler_options

from .contenders.base import Operation
from .entrants import JAXLIGHT, Entrant
from .harness import Case, Measurement, measure
from .report import conditions, own_failures, save, skipped_lines, table
from .settings import Settings, say
from .worker import pin
from .workload import Workload

SCENES = {
    "1 directional light, diffuse": Workload(2**16, 1, kind="directional", specular=False, fog="NONE"),
    "3 point lights": Workload(2**16, 3, fog="NONE"),
    "8 point lights, fog": Workload(2**16, 8),
    "8 spot lights, fog": Workload(2**16, 8, kind="spot"),
    "64 point lights, fog": Workload(2**16, 64),
}
_OPERATIONS: tuple[Operation, ...] = ("forward", "value_and_gradient")


@dataclasses.dataclass
class Options(Settings):
    """Seconds to compile, with an empty and with a filled persistent cache."""


def main() -> int:
    """Measures, prints and saves; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    plan = dataclasses.replace(options.plan(memory=False), rounds=1, most_calls=1, check=False)
    rows, everything = [], []
    with tempfile.TemporaryDirectory() as cache:
        for title, work in list(SCENES.items())[: 2 if options.quick else None]:
            for operation in _OPERATIONS:
                cold = _compile(work, operation, plan, cache)
                warm = _compile(work, operation, plan, cache)
                everything += [cold, warm]
                rows.append([title, operation, cold.compile_seconds, warm.compile_seconds, cold.first_seconds])
    header = ["scene", "operation", "compile s", "with filled cache s", "first call s"]
    more = 1e3 * _seconds_a_kernel(plan.cores)
    kernel = f"Each short loop more, a kernel of its own, is compiled in {more:.3g} ms."
    note = "The cache is switched on by JAX_COMPILATION_CACHE_DIR (or `jax.config.jax_compilation_cache_dir`)."
    text = "\n\n".join(["# Compile time", conditions(plan, everything), table(header, rows), kernel, note])
    text = "\n".join([text, "", *skipped_lines(everything)])
    print(text)
    save(options.output, "startup", text, [], everything)
    return own_failures(everything)


def _compile(work: Workload, operation: Operation, plan: Any, cache: str) -> Measurement:
    """A process of its own, whose cache keeps everything however quick it was to compile."""
    environment = (
        ("JAX_COMPILATION_CACHE_DIR", cache),
        ("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0"),
        ("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1"),
    )
    entrant: Entrant = dataclasses.replace(JAXLIGHT, environment=environment)
    (measurement,) = measure([Case(entrant, operation, work)], plan, say=say)
    return measurement


def _seconds_a_kernel(cores: Sequence[int], few: int = 10, many: int = 60) -> float:
    """What compiling takes longer for one more loop that multiplies a plane and adds another."""
    pin(cores)
    plane = jnp.ones((8, 16, 64))

    def compiled(kernels: int) -> float:
        def loops(a: jax.Array, b: jax.Array) -> list[jax.Array]:
            return [a * (number + 2.5) + b for number in range(kernels)]

        lowered = jax.jit(loops, compiler_options=compiler_options()).lower(plane, plane)
        start = time.process_time()
        lowered.compile()
        return time.process_time() - start

    compiled(few)  # what the first program pays for all
    return (compiled(many) - compiled(few)) / (many - few)


if __name__ == "__main__":
    sys.exit(main())
