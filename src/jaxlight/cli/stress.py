"""`jaxlight stress`: are the equation's last bits right?"""

from __future__ import annotations

import dataclasses
import importlib
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from .options import Precision

_LEAST = {"cases": 0, "adversarial": 0, "seed": 0, "second": 0, "shapes": 1, "jobs": 1, "minutes": 0}
"""The smallest number that each option takes."""


@dataclasses.dataclass(frozen=True)
class Stress:
    """Judge values and derivatives of random and adversarial cases by exact answers, to the last bits.

    $ jaxlight stress
    $ jaxlight stress --cases 2000 --adversarial 2000 --seed 7 --precisions float32
    $ jaxlight stress --seed 7 --case adversarial:0:fog_edge[3]-1

    Errors are in ulp, and in ulp / condition. Asked are: values of well-conditioned cases within 4 ulp x condition
    (99.9 % within 2), their derivatives within 16, and every number of every case finite. Exit status 1 if one is not.
    Needs a source checkout: the exact answers are those of its tests."""

    cases: int = 100_000
    """Random cases."""
    adversarial: int = 20_000
    """Cases at and next to singular points."""
    seed: int | None = None
    """What the cases are drawn from (default: a new one, which is printed)."""
    precisions: tuple[Precision, ...] = ("float32", "float64")
    """Float types of scenes and samples."""
    forward: bool = True
    """Also judge the derivatives of forward mode."""
    second: int = 2_000
    """Of so many random and adversarial cases also judge second derivatives, forward over reverse."""
    shapes: int = 12
    """How many kinds of scene the random cases have; each is compiled, in each mode."""
    jobs: int = 1
    """Processes; up to one a precision and sort of cases is of use."""
    minutes: float = 0
    """Draw no more cases after so long; the tables count those that were judged (default: no limit)."""
    case: Annotated[str, tyro.conf.arg(metavar="LABEL")] = ""
    """Explain one case of the run of this seed, by the label that a table gives it, instead of running."""
    output: Path = Path("output/stress")
    """Folder for the tables (stress.md) and the plot (stress.png)."""
    plot: bool = True
    """Draw the plot, if matplotlib is there."""

    def run(self) -> int:
        """Print the tables."""
        for name, least in _LEAST.items():
            value = getattr(self, name)
            if value is not None and not value >= least:
                raise ValueError(f"stress: --{name}: expected a number >= {least}, got {value}")
        if not self.precisions:
            raise ValueError("stress: --precisions: expected at least one of float32, float64")
        if self.cases + self.adversarial == 0:
            raise ValueError("stress: --cases, --adversarial: both are 0, there is nothing to judge")
        if self.case and self.seed is None:
            raise ValueError("stress: --case needs the --seed of its run")
        return _command().run(self)


def _command() -> Any:
    """benchmarks.stress.command of the checkout that this is run in, or that the package is installed from."""
    places = (Path.cwd(), Path(__file__).resolve().parents[3])
    found = [place for place in places if (place / "benchmarks/stress").is_dir() and (place / "tests/oracle").is_dir()]
    if not found:
        raise ValueError(
            "stress: needs a source checkout of jaxlight as the current folder, because its exact answers are those "
            "of tests/oracle; there is none"
        )
    sys.path.insert(0, str(found[0]))
    try:
        return importlib.import_module("benchmarks.stress.command")
    except ImportError as error:
        raise ValueError(f"stress: needs the extra `test` (pip install 'jaxlight[test]'): {error}") from error
