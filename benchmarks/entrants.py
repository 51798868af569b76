"""Who takes part: the contenders by name, what they need installed, and how many samples they can take."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import sys
from collections.abc import Iterable, Sequence
from typing import Any

from .contenders.base import Contender
from .errors import COLOR_LIMIT
from .workload import Workload


@dataclasses.dataclass(frozen=True)
class Entrant:
    """A contender class with its options; runs in a process of its own."""

    label: str
    path: str
    """`module:Class` under `benchmarks.contenders`."""
    requires: tuple[str, ...] = ()
    """Packages without which it is left out."""
    max_light_samples: int = 2**27
    """Samples times lights beyond which its memory or one's patience ends; it then gets fewer samples."""
    checked: bool = True
    """False: it does not shade, so there is nothing to compare with the reference."""
    color_limit: float = COLOR_LIMIT
    """Error at which its colours count as wrong; wider for stated approximations."""
    options: tuple[tuple[str, Any], ...] = ()
    """Keyword arguments of the class."""
    environment: tuple[tuple[str, str], ...] = ()

    def missing(self) -> str | None:
        """Why it cannot take part, or None."""
        absent = [name for name in self.requires if importlib.util.find_spec(name) is None]
        return f"{', '.join(absent)} not installed" if absent else None

    def contender(self) -> type[Contender]:
        """The class; imports its library."""
        module, name = self.path.split(":")
        return getattr(importlib.import_module(f"benchmarks.contenders.{module}"), name)

    def within_limits(self, work: Workload) -> Workload:
        """The workload with as many samples as this contender takes."""
        return dataclasses.replace(work, samples=min(work.samples, self.max_light_samples // work.lights))


def named(entrants: Iterable[Entrant], only: Sequence[str]) -> list[Entrant]:
    """Those of these names; all if no name is given. Ends the program, saying which there are, if none is left."""
    known = list(entrants)
    chosen = [entrant for entrant in known if not only or entrant.label in only]
    if not chosen:
        print(f"--only: known are {', '.join(entrant.label for entrant in known)}", file=sys.stderr)
        sys.exit(2)
    return chosen


JAXLIGHT = Entrant("jaxlight", "jaxlight_shade:JaxlightShade", ("jax", "equinox"))
JAXLIGHT_BY_TILES = dataclasses.replace(JAXLIGHT, label="jaxlight, tile by tile", options=(("by_tiles", True),))
"""For value and gradient: of a loss by `sum_over_samples`; JAXLIGHT's is one of the colours of the whole image."""

PEERS = (
    # [N, L, 3] intermediates: 64 lights on 2^20 samples would take 9 GB.
    Entrant("naive JAX", "naive_jax:NaiveJax", ("jax",), 2**23),
    Entrant("PyTorch eager", "torch_eager:TorchEager", ("torch",), 2**23),
    Entrant("torch.compile", "torch_compiled:TorchCompiled", ("torch",), 2**24),
    Entrant("PyTorch3D functions", "pytorch3d_style:PyTorch3DStyle", ("torch",), 2**23),
    Entrant("Dr.Jit", "dr_jit:DrJit", ("drjit",), 2**24),
    Entrant("Dr.Jit, gathered", "dr_jit:DrJitGathered", ("drjit",), 2**24),
    Entrant("numba", "numba_fused:NumbaFused", ("numba",), 2**25),
)
