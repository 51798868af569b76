"""A fit as a differentiable function: how its answer moves when pictures, weights or fixed fields move.

By the implicit function theorem on the conditions of a bounded minimum, x = clip(x - slope(x)): forward and reverse
mode, no derivative through the steps. A number that a bound holds does not move; a direction that the pictures do not
tell stays where it is. Nothing is left out of the equation: what makes no difference where it is may move the answer.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..lighting import make_plan
from ..lighting.compiling import quick_jit
from ..scene.fields import whole
from . import normal
from .problem import Problem, scene_of_view
from .run import make_solver, solve
from .solver import BoundedLevenbergMarquardt
from .views import ViewData


def fitted_values(
    problem: Problem, solver: BoundedLevenbergMarquardt | None = None, max_steps: int = 100
) -> Float[Array, " parameters"]:
    """The fitted numbers as a function that is differentiated by every float of a problem.

    Args:
        problem: what a `Fit` was made from (`Fit.problem`), or that with other numbers in place of its own
            (`equinox.tree_at`): fields of `world.scene` that are not free, `target` and `root_weight` of `views`.
        solver: default: that of `fit` with its default tolerances.
        max_steps: evaluations at most; a fit that ends there gives derivatives of no meaning.

    Returns:
        The numbers of `Fit.values`, in the order of `Fit.labels`.

    Raises:
        ValueError: no problem of a fit; another solver; `max_steps` is no whole number >= 1; whole textures are among
            the free fields.
    """
    if not isinstance(problem, Problem):
        raise ValueError(f"problem: expected the problem of a fit (`Fit.problem`), got {type(problem).__name__}")
    if problem.parameters.blocks:
        raise ValueError("fitted_values: derivatives of fits of whole textures are not supported")
    if solver is not None and not isinstance(solver, BoundedLevenbergMarquardt):
        raise ValueError(f"solver: expected a BoundedLevenbergMarquardt, got {solver!r:.60}")
    problem = _with_every_term(problem)
    solver = make_solver(problem) if solver is None else solver
    return _answer(problem, solver, whole("max_steps", max_steps, at_least=1))[0]


@eqx.filter_custom_jvp
def _answer(problem: Problem, solver: BoundedLevenbergMarquardt, max_steps: int) -> tuple[Array, Array]:
    """Where the fit ends, and the column lengths of its Jacobian there."""
    return _solved(problem, solver, max_steps)


@quick_jit
def _solved(problem: Problem, solver: BoundedLevenbergMarquardt, max_steps: int) -> tuple[Array, Array]:
    found = solve(problem, solver, problem.parameters.start, max_steps)
    return found.value, jnp.sqrt(jnp.maximum(found.state.curvature.diagonal(), 0))


@_answer.def_jvp
def _answer_moves(primals: Any, tangents: Any) -> tuple[tuple[Array, Array], tuple[Array, None]]:
    problem, *how = primals
    found, lengths = _answer(problem, *how)
    return (found, lengths), (_moves(problem, found, lengths, tangents[0]), None)


@eqx.filter_jit
def _moves(problem: Problem, found: Array, lengths: Array, moves: Problem) -> Array:
    """How the answer moves when the problem does."""
    scale = jnp.where(lengths > 0, lengths, 1)  # units in which the conditions are well scaled

    def conditions(values: Array, problem: Problem) -> Array:
        slope = jax.grad(lambda v: normal.loss(problem, v))(values)
        lower, upper = problem.parameters.lower, problem.parameters.upper
        return scale * (values - jnp.clip(values - slope / scale**2, lower, upper))

    def by_value(direction: Array) -> Array:
        return jax.jvp(lambda values: conditions(values, problem), (found,), (direction,))[1]

    _, ahead = eqx.filter_jvp(lambda problem: conditions(found, problem), (problem,), (moves,))
    matrix = jax.vmap(by_value, out_axes=1)(jnp.diag(1 / scale))
    # The shortest solution, in these units.
    return -(jnp.linalg.pinv(matrix, rtol=1e3 * float(jnp.finfo(found.dtype).eps)) @ ahead) / scale


def _with_every_term(problem: Problem) -> Problem:
    def planned(stack: ViewData) -> ViewData:
        view = jax.tree.map(lambda leaf: leaf[0], stack)
        scene = scene_of_view(problem.world, view)
        return dataclasses.replace(stack, plan=make_plan(scene, options=stack.plan.options, free=True))

    return dataclasses.replace(problem, views=tuple(planned(stack) for stack in problem.views))
