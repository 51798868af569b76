"""How the families of adversarial cases are set up: one sample, one light and a viewer around it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from .case import Case, Material, Sample, Vec
from .cases import random_light, random_material, single, unit_vector
from .paths import Path, get

Rng = np.random.Generator
Point = tuple[Case, Path | None]
"""A case at a singular point, and the number that its neighbours move (None: it has none)."""

SIZES = (1e-37, 1e-30, 1e-20, 1e-12, 1e-6, 1e6, 1e12, 1e20, 1e30, 1e37)
TINY = 1e-40
"""A subnormal float32."""
HALF_PI = float(np.float32(math.pi / 2))
LOCATION: Path = ("lights", 0, "location")
DIRECTION: Path = ("lights", 0, "direction")
NORMAL: Path = ("sample", "normal")
EYE: Path = ("sample", "eye")
POSITION: Path = ("sample", "position")

FAMILIES: dict[str, Callable[[Rng], Point]] = {}


def family(function: Callable[[Rng], Point]) -> Callable[[Rng], Point]:
    """Registers a family under its name."""
    FAMILIES[function.__name__] = function
    return function


class Setting:
    """A sample, a light and a viewer given by vectors from the sample, in a random exact orientation and place."""

    def __init__(self, rng: Rng, *, placed: bool = True, origin: np.ndarray | None = None):
        self.rng = rng
        self.order, self.signs = rng.permutation(3), rng.choice([-1.0, 1.0], 3)
        if origin is None:
            origin = rng.integers(1, 5, 3) * rng.choice([-1.0, 1.0], 3) if placed else np.zeros(3)
        self.origin = origin

    def turned(self, vector: Any) -> np.ndarray:
        """The vector with its axes permuted and mirrored."""
        return (np.asarray(vector, dtype=np.float64) * self.signs)[self.order]

    def case(
        self,
        *,
        kind: str = "point",
        to_light: Any = (1.0, 2.0, 2.0),
        to_eye: Any = (1.0, -2.0, 2.0),
        normal: Any = (0.0, 0.0, 1.0),
        material: Material | None = None,
        **light: Any,
    ) -> Case:
        """One light of `kind`; `direction` is turned like the rest and defaults to one towards the sample."""
        rng = self.rng
        drawn = random_light(rng, kind, self.origin)
        direction = light.pop("direction", -np.asarray(to_light, dtype=np.float64))
        fields = {
            "location": single(*(self.origin + self.turned(to_light))),
            "direction": single(*self.turned(direction)),
            "radius": float(np.float32(3e38)),
            "intensity": single(rng.uniform(0.2, 1))[0],
            **light,
        }
        return Case(
            sample=Sample(
                position=single(*self.origin),
                normal=single(*self.turned(normal)),
                eye=single(*(self.origin + self.turned(to_eye))),
            ),
            material=material or random_material(rng),
            lights=(replace(drawn, **fields),),
        )


def moving(rng: Rng, case: Case, vector: Path) -> Point:
    """The case, to be moved in a component of this vector that is not zero (if there is one)."""
    components = np.array(get(case, vector))
    chosen = np.flatnonzero(components) if np.any(components) else np.arange(3)
    return case, (*vector, int(rng.choice(chosen)))


def sized(rng: Rng, size: float) -> Vec:
    """A random vector of about this length."""
    return single(*(unit_vector(rng) * size))


def shiny(rng: Rng, shininess: float) -> Material:
    """A random material with this shininess and a highlight."""
    return replace(random_material(rng), shininess=single(shininess)[0], specular_color=single(*rng.uniform(0.2, 1, 3)))


def leaning(normal: np.ndarray, aside: np.ndarray, angle: float) -> np.ndarray:
    """A unit vector at `angle` from the unit vector `normal`, towards `aside`."""
    aside = aside - normal * np.dot(aside, normal)
    return normal * math.cos(angle) + aside / np.linalg.norm(aside) * math.sin(angle)
