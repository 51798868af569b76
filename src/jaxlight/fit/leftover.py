"""What a fit leaves: sums over its residuals that tell how noisy they are."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..lighting.compiling import quick_jit
from .normal import view_residual
from .problem import Problem
from .residuals import is_limit, reweight, slopes_of_heard
from .views import ViewData


class Leftover(NamedTuple):
    """Sums over the residuals r that say something: those with a weight, but for limits of the sensor that are kept.

    With a loss rho, psi = rho'(r^2) r is what is heard of a residual; of squares that is r.
    """

    count: Any
    squares: Any
    """Of psi^2."""
    heard: Any
    """Of psi / r."""
    slopes: Any
    """Of dpsi / dr."""
    squared_slopes: Any
    """Of (dpsi / dr)^2."""


@quick_jit
def leftover(problem: Problem, values: Float[Array, " parameters"]) -> Leftover:
    """The sums at these values, over all views."""
    world = problem.at(values)

    def of_view(view: ViewData) -> Leftover:
        residual = view_residual(world, view)
        kept = is_limit(view.target, view.dark, view.saturated) & (residual == 0)
        said = (view.root_weight > 0) & ~kept
        weight = reweight(*problem.rho, residual)
        heard = jnp.ones_like(residual) if weight is None else weight
        slopes = slopes_of_heard(*problem.rho, residual)
        each = (jnp.ones_like(residual), (heard * residual) ** 2, heard, slopes, slopes**2)
        return Leftover(*(jnp.sum(jnp.where(said, numbers, 0)) for numbers in each))

    stacks = [jax.tree.map(jnp.sum, jax.lax.map(of_view, stack)) for stack in problem.views]
    return jax.tree.map(lambda *sums: sum(sums[1:], sums[0]), *stacks)
