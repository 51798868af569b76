"""Cases at and next to every singular point of the equation, from a seed.

A family (see `families`, `combinations`) sets up the point itself; its cases then come at the point and with one number
moved by 1, 2 and 16 float32 ulp to both sides. Orientation, place, material and what else does not matter are random.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .case import Case
from .combinations import FAMILIES
from .paths import get, put

STEPS = (0, 1, -1, 2, -2, 16, -16)


def adversarial_cases(seed: int, count: int, families: tuple[str, ...] = tuple(FAMILIES)) -> list[Case]:
    """`count` cases, the families in turn; a label says family, number and step (`spot_edge[3]-16`)."""
    unknown = set(families) - set(FAMILIES)
    if unknown:
        raise ValueError(f"families: unknown {sorted(unknown)}; there are {sorted(FAMILIES)}")
    drawn = [_points(name, np.random.default_rng([seed, 2, *name.encode()])) for name in families]
    turns = (next(points) for points in itertools.cycle(drawn))
    return list(itertools.islice(itertools.chain.from_iterable(turns), count))


def step(value: float, ulps: int) -> float:
    """The float32 number so many ulps above (or below) `value`."""
    moved, end = np.float32(value), np.float32(np.inf if ulps > 0 else -np.inf)
    for _ in range(abs(ulps)):
        moved = np.nextafter(moved, end)
    return float(moved)


def _points(name: str, rng: np.random.Generator) -> Iterator[list[Case]]:
    """Forever: the cases around the family's next point."""
    for number in itertools.count():
        case, path = FAMILIES[name](rng)
        label = f"{name}[{number}]"
        if path is None:
            yield [replace(case, label=label)]
        else:
            yield [replace(put(case, path, step(get(case, path), k)), label=f"{label}{k:+d}") for k in STEPS]
