"""Many starts: the places, directions and exponents that a fit could begin from, and which of them leads lowest."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .parameters import FreeField
from .problem import Problem
from .run import solve
from .solver import BoundedLevenbergMarquardt

_SCATTERED = ("location", "direction", "shininess", "beam_width", "cut_off_angle", "visibility_range")
"""Fields in which the equation is far from linear: a start may lie in the wrong valley of them."""
MAX_STARTS = 100_000
"""All are explored side by side."""


class Explored(NamedTuple):
    """Where a few steps from every start led."""

    values: np.ndarray
    """[starts, numbers]."""
    losses: np.ndarray
    """[starts]; infinite where a start failed."""

    @property
    def best(self) -> np.ndarray:
        """The values of the lowest loss."""
        return self.values[int(np.argmin(self.losses))]


def random_starts(problem: Problem, fields: list[FreeField], count: int, seed: int = 0) -> np.ndarray:
    """[count, numbers]: the start itself, then starts with the non-linear fields drawn anew.

    Lights go to random places on the side that the viewers see, one to four times as far from the middle of the
    samples as those reach; angles and exponents anywhere in their bounds; other fields keep their start value. If there
    are no others, that is told.
    """
    random = np.random.default_rng(seed)
    parameters = problem.parameters
    start, lower, upper = (np.asarray(a, np.float64) for a in (parameters.start, parameters.lower, parameters.upper))
    middle, reach, towards = _surroundings(problem)
    starts = np.repeat(start[None], count, axis=0)
    scattered = [(field, field.leaf.field) for field in fields if field.leaf and field.leaf.field in _SCATTERED]
    if not scattered:
        warnings.warn(
            f"starts: all {count} are the same, since only {', '.join(_SCATTERED[:-1])} and {_SCATTERED[-1]} are drawn "
            "at random, and none is free",
            stacklevel=4,
        )
    for field, kind in scattered:
        own, rows = field.numbers, count - 1
        if kind in ("location", "direction"):
            vectors = _hemisphere(random, rows, towards)
            lights = getattr(problem.world.scene, field.leaf.attribute)  # type: ignore[union-attr]  # kind is not None
            to_world = np.asarray(lights.to_world[field.row], np.float64)
            if kind == "location":
                places = middle + vectors * reach * random.uniform(1.2, 4.0, (rows, 1))
                drawn = np.linalg.solve(to_world[:, :3], (places - to_world[:, 3]).T).T
            else:
                drawn = np.linalg.solve(to_world[:, :3], -vectors.T).T
            starts[1:, own] = drawn[:, field.components]
        elif kind == "visibility_range":
            starts[1:, own] *= np.exp(random.uniform(-1.5, 1.5, (rows, len(own))))
        else:
            low, high = lower[own], np.where(np.isfinite(upper[own]), upper[own], 1.0)
            starts[1:, own] = low + (high - low) * random.uniform(0.05, 0.95, (rows, len(own)))
    return np.clip(starts, lower, upper)


def explore(problem: Problem, solver: BoundedLevenbergMarquardt, starts: Any, steps: int = 12) -> Explored:
    """A few steps from every start, all starts side by side in one compiled call."""
    array = jnp.asarray(starts, problem.parameters.start.dtype)
    solution = eqx.filter_vmap(solve, in_axes=(None, None, 0, None))(problem, solver, array, steps)
    values, losses = np.asarray(solution.value), np.asarray(solution.state.loss, np.float64)
    usable = np.isfinite(losses) & np.all(np.isfinite(values), axis=1)
    return Explored(values, np.where(usable, losses, np.inf))


def _surroundings(problem: Problem) -> tuple[np.ndarray, float, np.ndarray]:
    """Middle of the samples, how far they reach from it, and the mean direction to the viewers."""
    lows = [np.asarray(stack.samples.tile_low, np.float64).min(axis=(0, 2)) for stack in problem.views]
    highs = [np.asarray(stack.samples.tile_high, np.float64).max(axis=(0, 2)) for stack in problem.views]
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    middle = (low + high) / 2
    eyes = np.concatenate([np.asarray(stack.samples.eye, np.float64) for stack in problem.views]) - middle
    towards = np.sum(eyes / np.maximum(np.linalg.norm(eyes, axis=1, keepdims=True), 1e-300), axis=0)
    return middle, float(np.linalg.norm(high - low) / 2), towards


def _hemisphere(random: np.random.Generator, count: int, towards: np.ndarray) -> np.ndarray:
    """Unit vectors [count, 3], evenly over the half of the sphere around `towards`."""
    vectors = random.normal(size=(count, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where((vectors @ towards < 0)[:, None], -vectors, vectors)
