"""Other minimisers: any of optimistix's, or optax's through them, on the loss of a fit.

They know no bounds: every bounded number is written as a smooth function of one that is not, so an optimum on a bound
is approached, never reached. The bounded Levenberg-Marquardt is the better choice wherever it fits; these serve what
is no sum of squares, and comparison.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from ..lighting.compiling import quick_jit
from . import normal
from .problem import Problem

_INSIDE = 1e-3
"""Share of its range that a number which starts on a bound is moved inwards: at the bound itself no slope is left."""


def check_minimiser(minimiser: Any) -> None:
    """Refuse what is no minimiser, before anything is done with it.

    Raises:
        ValueError: not an `optimistix` minimiser (`optimistix.LBFGS(1e-6, 1e-6)`, `optimistix.OptaxMinimiser(...)`).
    """
    if not isinstance(minimiser, optx.AbstractMinimiser):
        raise ValueError(
            f"method: expected an optimistix minimiser such as optimistix.LBFGS(1e-6, 1e-6), got {minimiser!r:.60}"
        )


class Minimum(NamedTuple):
    """Where a minimiser ended."""

    values: Float[Array, " parameters"]
    best: Float[Array, " parameters"]
    """The values of the lowest loss on the way that was a number; the start if there was none."""
    converged: bool
    """Whether the minimiser says so."""
    finite: bool
    """Whether the values are, and the loss there."""
    steps: int


def minimise(problem: Problem, minimiser: Any, max_steps: int) -> Minimum:
    """Where the minimiser ends that begins at the problem's start.

    Args:
        problem: from `make_problem`.
        minimiser: one that `check_minimiser` lets pass.
        max_steps: at most.
    """
    values, best, result, steps = _minimise(problem, minimiser, max_steps)
    finite = bool(np.all(np.isfinite(values)))
    return Minimum(values, best, finite and bool(result == optx.RESULTS.successful), finite, int(steps))


class _WithBest(optx.BestSoFarMinimiser):
    """A minimiser that ends where it ends, and says what was best on the way."""

    def __init__(self, minimiser: optx.AbstractMinimiser) -> None:
        self.solver = minimiser

    def postprocess(
        self, fn: Any, y: Array, aux: Any, args: Any, options: Any, state: Any, tags: Any, result: Any
    ) -> tuple[Array, Any, dict[str, Any]]:
        y, aux, stats = self.solver.postprocess(fn, y, aux, args, options, state.state, tags, result)
        return y, aux, {**stats, "best": state.best_y, "met": jnp.isfinite(state.best_loss)}


@quick_jit
def _minimise(problem: Problem, minimiser: Any, max_steps: int) -> tuple[Array, Array, Any, Array]:
    start = problem.parameters.start
    solution = optx.minimise(
        _loss, _WithBest(minimiser), _unbounded(problem, start), problem, max_steps=max_steps, throw=False
    )
    values, stats = _bounded(problem, solution.value), solution.stats
    best = jnp.where(stats["met"], _bounded(problem, stats["best"]), start)
    return values, best, solution.result, stats["num_steps"]


@jax.custom_vjp
def _loss(free: Array, problem: Problem) -> Array:
    return normal.loss(problem, _bounded(problem, free))


def _loss_with_slope(free: Array, problem: Problem) -> tuple[Array, Array]:
    values, pull = jax.vjp(lambda numbers: _bounded(problem, numbers), free)
    loss, gradient = normal.loss_and_gradient(problem, values)
    return loss, pull(gradient)[0]


_loss.defvjp(_loss_with_slope, lambda slope, change: (change * slope, None))


def _bounded(problem: Problem, free: Array) -> Array:
    """Sigmoid between two bounds, exponential above or below one, the number itself without any."""
    lower, upper = problem.parameters.lower, problem.parameters.upper
    below, above = jnp.isfinite(lower), jnp.isfinite(upper)
    low, high = jnp.where(below, lower, 0), jnp.where(above, upper, 1)
    between = low + (jnp.where(below & above, high, low + 1) - low) * jax.nn.sigmoid(free)
    one_sided = jnp.where(below, low + jnp.exp(jnp.where(below, free, 0)), high - jnp.exp(jnp.where(above, free, 0)))
    return jnp.where(below & above, between, jnp.where(below | above, one_sided, free))


def _unbounded(problem: Problem, values: Array) -> Array:
    """The inverse of `_bounded`, a little inside the bounds; of two that are one any number is."""
    lower, upper = problem.parameters.lower, problem.parameters.upper
    below, above = jnp.isfinite(lower), jnp.isfinite(upper)
    low, high = jnp.where(below, lower, 0), jnp.where(above, upper, 1)
    share = jnp.clip((values - low) / jnp.where(below & above & (low < high), high - low, 1), _INSIDE, 1 - _INSIDE)
    distance = jnp.maximum(jnp.where(below, values - low, high - values), _INSIDE)
    return jnp.where(below & above, jnp.log(share / (1 - share)), jnp.where(below | above, jnp.log(distance), values))
