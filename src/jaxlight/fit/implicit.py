"""A fit as a differentiable function: how its answer moves when pictures, weights or fixed fields move.

By the implicit function theorem on the conditions of a bounded minimum, x = clip(x - slope(x)): forward and reverse
mode, no derivative through the steps. A number that a bound holds does not move; a direction that the pictures do not
tell stays where it is. Nothing is left out of the equation: what makes no difference where it is may move the answer.
"""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from ..lighting import make_plan
from ..lighting.compiling import quick_jit
from ..scene.fields import whole
from . import normal
from .problem import Problem, scene_of_view
from .run import make_solver, solve
from .solver import BoundedLevenbergMarquardt, default_tolerance
from .views import ViewData

TOLD = 32
"""Times the rounding of numbers: of a sum of many pixels at most so much is noise."""


def fitted_values(
    problem: Problem, solver: BoundedLevenbergMarquardt | None = None, max_steps: int = 100
) -> Float[Array, " parameters"]:
    """The fitted numbers as a function that is differentiated by every float of a problem.

    Args:
        problem: what a `Fit` was made from (`Fit.problem`), or that with other numbers in place of its own
            (`equinox.tree_at`): fields of `world.scene` that are not free, `target` and `root_weight` of `views`.
        solver: default: that of `fit`, with tolerances far below small moves. It begins where the fit ended.
        max_steps: evaluations at most.

    Returns:
        The numbers of `Fit.values`, in the order of `Fit.labels`.

    Raises:
        ValueError: no problem of a fit; another solver; `max_steps` is no whole number >= 1; whole textures are among
            the free fields.

    Where the solver does not come to a smooth minimum derivatives have no meaning, which a warning says: after
    `max_steps`, and on a kink of the model (`Fit.message` says so, too).
    """
    if not isinstance(problem, Problem):
        raise ValueError(f"problem: expected the problem of a fit (`Fit.problem`), got {type(problem).__name__}")
    if problem.parameters.blocks:
        raise ValueError("fitted_values: derivatives of fits of whole textures are not supported")
    if solver is not None and not isinstance(solver, BoundedLevenbergMarquardt):
        raise ValueError(f"solver: expected a BoundedLevenbergMarquardt, got {solver!r:.60}")
    problem = _with_every_term(problem)
    solver = _exact_solver(problem) if solver is None else solver
    steps = min(whole("max_steps", max_steps, at_least=1), np.iinfo(np.int32).max)
    return _answer(problem, solver, steps).values


def _exact_solver(problem: Problem) -> BoundedLevenbergMarquardt:
    """So near to the answer a step below the tolerances of `fit` would be none, and small moves would show as steps."""
    dtype = problem.parameters.start.dtype
    rtol, atol = default_tolerance(dtype)
    less = min(1e4 * float(jnp.finfo(dtype).eps) / rtol, 1.0)
    return make_solver(problem, rtol=less * rtol, atol=less * atol)


class _Answer(eqx.Module):
    """Where a fit ends."""

    values: Array
    lengths: Array
    """Of the columns of its Jacobian: the units in which the conditions of a minimum are well scaled."""
    is_smooth: Array
    """Whether these conditions hold there."""


@eqx.filter_custom_jvp
def _answer(problem: Problem, solver: BoundedLevenbergMarquardt, max_steps: int) -> _Answer:
    return _solved(problem, solver, max_steps)


@quick_jit
def _solved(problem: Problem, solver: BoundedLevenbergMarquardt, max_steps: int) -> _Answer:
    start = problem.parameters.start if problem.found is None else problem.found
    found = solve(problem, solver, start, max_steps)
    return _Answer(
        values=found.value,
        lengths=jnp.sqrt(jnp.maximum(found.state.curvature.diagonal(), 0)),
        is_smooth=(found.result == optx.RESULTS.successful) & ~found.state.at_kink,
    )


@_answer.def_jvp
def _answer_moves(primals: Any, tangents: Any) -> tuple[_Answer, _Answer]:
    problem, *how = primals
    answer = _answer(problem, *how)
    jax.debug.callback(_warn_unless, answer.is_smooth)
    return answer, _Answer(values=_moves(problem, answer, tangents[0]), lengths=None, is_smooth=None)  # pyright: ignore[reportArgumentType]


def _warn_unless(is_smooth: Any) -> None:
    if not np.all(is_smooth):
        warnings.warn(
            "fitted_values: the fit did not end at a smooth minimum (it ran out of steps, or the answer lies on a "
            "kink); its derivatives have no meaning",
            stacklevel=2,
        )


@eqx.filter_jit
def _moves(problem: Problem, answer: _Answer, moves: Problem) -> Array:
    """How the answer moves when the problem does."""
    scale = jnp.where(answer.lengths > 0, answer.lengths, 1)

    def conditions(values: Array, problem: Problem) -> Array:
        lower, upper = problem.parameters.lower, problem.parameters.upper
        wanted = values - jax.grad(lambda v: normal.loss(problem, v))(values) / scale**2
        return scale * (values - jnp.where(wanted <= lower, lower, jnp.where(wanted >= upper, upper, wanted)))

    def by_value(direction: Array) -> Array:
        return jax.jvp(lambda values: conditions(values, problem), (answer.values,), (direction,))[1]

    _, ahead = eqx.filter_jvp(lambda problem: conditions(answer.values, problem), (problem,), (moves,))
    matrix = jax.vmap(by_value, out_axes=1)(jnp.diag(1 / scale))
    # The shortest solution, in these units.
    return -(jnp.linalg.pinv(matrix, rtol=TOLD * float(jnp.finfo(matrix.dtype).eps)) @ ahead) / scale


def _with_every_term(problem: Problem) -> Problem:
    def planned(stack: ViewData) -> ViewData:
        view = jax.tree.map(lambda leaf: leaf[0], stack)
        scene = scene_of_view(problem.world, view)
        return dataclasses.replace(stack, plan=make_plan(scene, options=stack.plan.options, free=True))

    return dataclasses.replace(problem, views=tuple(planned(stack) for stack in problem.views))
