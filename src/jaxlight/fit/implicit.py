"""A fit as a differentiable function: how its answer moves when pictures, weights or fixed fields move.

By the implicit function theorem on the conditions of a bounded minimum, x = clip(x - slope(x)): forward and reverse
mode, no derivative through the steps. A number that a bound holds does not move; a direction that the pictures do not
tell stays where it is.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import normal
from .problem import Problem
from .run import solve
from .solver import BoundedLevenbergMarquardt


def fitted_values(
    problem: Problem, solver: BoundedLevenbergMarquardt, max_steps: int = 100
) -> Float[Array, " parameters"]:
    """The fitted numbers, differentiable by every float of the problem (targets, weights, fields that are not free).

    Args:
        problem, solver: from `make_problem` and `make_solver`; whole textures cannot be differentiated through.
        max_steps: at most; a fit that ends there gives derivatives of no meaning.

    Raises:
        ValueError: the problem has whole textures among its free fields.
    """
    if problem.parameters.blocks:
        raise ValueError("fitted_values: derivatives of fits of whole textures are not supported")
    parameters = problem.parameters
    found = jax.lax.stop_gradient(solve(jax.lax.stop_gradient(problem), solver, parameters.start, max_steps))
    # Column lengths of the Jacobian: the units in which the conditions are well scaled.
    lengths = jnp.sqrt(jnp.maximum(found.state.curvature.diagonal(), 0))
    scale = jnp.where(lengths > 0, lengths, 1)

    def conditions(values: Array) -> Array:
        slope = jax.grad(lambda v: normal.loss(problem, v))(values)
        return scale * (values - jnp.clip(values - slope / scale**2, parameters.lower, parameters.upper))

    return jax.lax.custom_root(conditions, parameters.start, lambda _, start: found.value, _solve_linear)


def _solve_linear(function: object, right: Array) -> Array:
    """The shortest solution of function(x) = right, for a linear function of few numbers."""
    matrix = jax.vmap(function, out_axes=1)(jnp.eye(right.shape[0], dtype=right.dtype))  # type: ignore[arg-type]
    return jnp.linalg.pinv(matrix, rtol=1e3 * float(jnp.finfo(right.dtype).eps)) @ right
