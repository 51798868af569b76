"""A fit step by step: `begin`, `advance`, `finished`, on a state that is arrays only.

Whatever drives a fit (a plain loop, a progress bar, a run with checkpoints) drives these three; saving `FitState`
after any step and carrying on from it gives the same numbers as never having stopped.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from ..lighting.registers import wide_jit
from . import normal
from .problem import Problem
from .solver import BoundedLevenbergMarquardt, SolverState, default_tolerance


class FitState(eqx.Module):
    """Where a fit stands: the best values so far and what the solver remembers. Arrays only."""

    values: Float[Array, " parameters"]
    solver: SolverState


def residual_function(values: Array, problem: Problem) -> tuple[Any, None]:
    """The residuals in optimistix's form, for its own solvers and its implicit derivatives."""
    return normal.residuals(problem, values), None


def _normal_equations(values: Array, problem: Problem) -> normal.NormalEquations:
    return normal.normal_equations(problem, values)


def _settled(values: Array, problem: Problem) -> tuple[Array, Array]:
    return normal.settled(problem, values)


_OPTIONS = {"settled": _settled, "normal_equations": _normal_equations}


def make_solver(problem: Problem, *, rtol: float | None = None, atol: float | None = None) -> BoundedLevenbergMarquardt:
    """The bounded Levenberg-Marquardt solver for this problem; tolerances default to what its precision can reach."""
    parameters = problem.parameters
    dtype = parameters.start.dtype
    default_rtol, default_atol = default_tolerance(dtype)
    return BoundedLevenbergMarquardt(
        rtol=jnp.asarray(default_rtol if rtol is None else rtol, dtype),
        atol=jnp.asarray(default_atol if atol is None else atol, dtype),
        lower=parameters.lower,
        upper=parameters.upper,
        strides=problem.strides,
        sampling=problem.sampling,
        freedom=jnp.maximum(problem.count - parameters.start.shape[0], 1),
    )


@wide_jit
def begin(problem: Problem, solver: BoundedLevenbergMarquardt, start: Any = None) -> FitState:
    """The state before the first step, at `start` or at the problem's own start values."""
    values = problem.parameters.start if start is None else jnp.asarray(start, problem.parameters.start.dtype)
    return FitState(values, solver.init(residual_function, values, problem, _OPTIONS, None, None, frozenset()))


@wide_jit
def advance(problem: Problem, solver: BoundedLevenbergMarquardt, state: FitState) -> FitState:
    """One evaluation: the first evaluates the start; each later one tries a step and takes or refuses it."""
    values, inner, _ = solver.step(residual_function, state.values, problem, _OPTIONS, state.solver, frozenset())
    return FitState(values, inner)


def finished(state: FitState) -> bool:
    """True when the solver has converged or failed."""
    return bool(state.solver.terminate) or not bool(state.solver.result == optx.RESULTS.successful)


@eqx.filter_jit
def solve(problem: Problem, solver: BoundedLevenbergMarquardt, start: Array, max_steps: int = 100) -> optx.Solution:
    """The whole fit in one compiled call of `optimistix.least_squares`: for `vmap` over starts, and derivatives."""
    return optx.least_squares(
        residual_function, solver, start, problem, _OPTIONS, has_aux=True, max_steps=max_steps, throw=False
    )
