"""Other minimisers: any of optimistix's, or optax's through them, on the loss of a fit.

They know no bounds: every bounded number is written as a smooth function of one that is not, so an optimum on a bound
is approached, never reached. The bounded Levenberg-Marquardt is the better choice wherever it fits; these serve what
is no sum of squares, and comparison.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
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


def minimise(problem: Problem, minimiser: Any, max_steps: int) -> tuple[Float[Array, " parameters"], bool, int]:
    """(values, whether the minimiser says it converged, steps) from the problem's start.

    Args:
        problem: from `make_problem`.
        minimiser: one that `check_minimiser` lets pass.
        max_steps: at most.
    """
    values, result, steps = _minimise(problem, minimiser, max_steps)
    return values, bool(result == optx.RESULTS.successful), int(steps)


@quick_jit
def _minimise(problem: Problem, minimiser: Any, max_steps: int) -> tuple[Array, Any, Array]:
    start = _unbounded(problem, problem.parameters.start)
    solution = optx.minimise(_loss, minimiser, start, problem, max_steps=max_steps, throw=False)
    return _bounded(problem, solution.value), solution.result, solution.stats["num_steps"]


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
    """The inverse of `_bounded`, a little inside the bounds."""
    lower, upper = problem.parameters.lower, problem.parameters.upper
    below, above = jnp.isfinite(lower), jnp.isfinite(upper)
    low, high = jnp.where(below, lower, 0), jnp.where(above, upper, 1)
    share = jnp.clip((values - low) / jnp.where(below & above, high - low, 1), _INSIDE, 1 - _INSIDE)
    distance = jnp.maximum(jnp.where(below, values - low, high - values), _INSIDE)
    return jnp.where(below & above, jnp.log(share / (1 - share)), jnp.where(below | above, jnp.log(distance), values))
