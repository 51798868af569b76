"""A fit step by step: `begin`, `advance`, `carried_on`, on a state that is arrays only.

Whatever drives a fit (a plain loop, a progress bar, a run with checkpoints) drives these three; saving `FitState`
after any step and carrying on from it gives the same numbers as never having stopped.

A fit of many samples first goes to the optimum of a part of them (`carried_on`). What the part says is believed only
if all samples agree: a part can miss what few samples see, such as a small highlight. Otherwise the fit begins again at
its start, with all of them.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ..lighting.compiling import quick_jit
from ..lighting.cores import in_threads, shares_of
from ..lighting.tiles import Share
from ..processor import for_cpu
from ..scene.fields import non_negative
from ..tracing import is_traced
from . import normal
from .moments import Moments
from .problem import Problem
from .solver import BoundedLevenbergMarquardt, SolverState, default_tolerance
from .steps import Step


class FitState(eqx.Module):
    """Where a fit stands: the best values so far and what the solver remembers. Arrays only."""

    values: Float[Array, " parameters"]
    solver: SolverState
    every: Int[Array, ""]
    """One tile in so many is evaluated."""
    origin: Float[Array, " parameters"]
    """Where the fit began."""
    earlier: Int[Array, "3"]
    """Steps accepted, steps tried and evaluations before the last time that the solver began."""
    over: Bool[Array, ""]
    """Whether the solver has converged or failed."""

    @property
    def accepted(self) -> int:
        """Steps that lowered the loss, within its rounding; the evaluation of a start is none."""
        return int(np.asarray(self.earlier)[0]) + int(self.solver.num_accepted_steps)

    @property
    def tried(self) -> int:
        """Steps that were tried."""
        return int(np.asarray(self.earlier)[1]) + max(int(self.solver.num_steps) - 1, 0)

    @property
    def evaluations(self) -> int:
        """Evaluations so far, those of starts included."""
        return int(np.asarray(self.earlier)[2]) + int(self.solver.num_steps)


def residual_function(values: Array, problem: Problem) -> tuple[Any, None]:
    """The residuals in optimistix's form. A solver that is given normal equations needs their shapes alone."""
    return normal.residuals(problem, values), None


def _normal_equations(values: Array, problem: Problem) -> normal.NormalEquations:
    return normal.normal_equations(problem, values)


def _settled(values: Array, problem: Problem) -> tuple[Array, Array]:
    return normal.settled(problem, values)


def _curvature(values: Array, problem: Problem) -> Any:
    if problem.parameters.blocks:
        return normal.normal_equations(problem, values).curvature
    return jnp.zeros((values.size, values.size), values.dtype)


_OPTIONS = {"settled": _settled, "normal_equations": _normal_equations, "curvature": _curvature}


def make_solver(problem: Problem, *, rtol: float | None = None, atol: float | None = None) -> BoundedLevenbergMarquardt:
    """The bounded Levenberg-Marquardt solver for this problem; tolerances default to what its precision can reach."""
    parameters = problem.parameters
    dtype = parameters.start.dtype
    default_rtol, default_atol = default_tolerance(dtype)
    return BoundedLevenbergMarquardt(
        rtol=jnp.asarray(default_rtol if rtol is None else non_negative("rtol", rtol), dtype),
        atol=jnp.asarray(default_atol if atol is None else non_negative("atol", atol), dtype),
        lower=parameters.lower,
        upper=parameters.upper,
        strides=problem.strides,
        sampling=problem.sampling,
        freedom=jnp.maximum(problem.count - parameters.start.shape[0], 1),
        floor=jnp.finfo(dtype).eps ** 2 * problem.signal,
    )


def begin(problem: Problem, solver: BoundedLevenbergMarquardt, start: Any = None, every: int = 1) -> FitState:
    """The state before the first step, at `start` or at the problem's own start values, with one tile in `every`."""
    values = problem.parameters.start if start is None else jnp.asarray(start, problem.parameters.start.dtype)
    return FitState(
        values=values,
        solver=_initialised(problem, solver, values),
        every=jnp.asarray(every, jnp.int32),
        origin=values,
        earlier=jnp.zeros(3, jnp.int32),
        over=jnp.array(False),
    )


@quick_jit
def _initialised(problem: Problem, solver: BoundedLevenbergMarquardt, values: Array) -> SolverState:
    return solver.init(residual_function, values, problem, _OPTIONS, None, None, frozenset())


def advance(problem: Problem, solver: BoundedLevenbergMarquardt, state: FitState) -> FitState:
    """One evaluation: the first evaluates the start; each later one tries a step and takes or refuses it.

    Of many samples the tiles are divided among the processor's cores.
    """
    shares = _shares(problem, state)
    if shares == 1:
        in_one_call = advance_alone if _is_by_tiles(problem) else _advance_on_all_cores
        return in_one_call(problem, solver, state)
    moments = _added(lambda share: _trial_moments(problem, state, share, shares), shares)
    trial, loss, accept = _judged(problem, solver, state, moments)
    moments = normal.no_moments(problem)
    if accept:
        moments = _added(lambda share: _model_moments(problem, state, trial, share, shares), shares)
    return _advanced(problem, solver, state, trial, loss, moments)


def _shares(problem: Problem, state: FitState) -> int:
    """Among how many cores the tiles of a step are divided; the same in all steps, which then share compiled code."""
    if not _is_by_tiles(problem) or not for_cpu() or is_traced(problem, state):
        return 1
    return shares_of(sum(math.prod(view.root_weight.shape) // view.root_weight.shape[-2] for view in problem.views))


def _is_by_tiles(problem: Problem) -> bool:
    """Whether all that takes long is done tile by tile; else there are loops over whole pictures."""
    return not problem.parameters.blocks and all(view.pixel is None for view in problem.views)


def _added(moments: Callable[[Array], Moments], shares: int) -> Moments:
    return functools.reduce(operator.add, in_threads(lambda share: moments(jnp.asarray(share)), shares))


def _part(problem: Problem, state: FitState) -> Problem:
    """The problem with the tiles that this state asks for."""
    return eqx.tree_at(lambda problem: problem.every, problem, state.every)


@quick_jit
def advance_alone(problem: Problem, solver: BoundedLevenbergMarquardt, state: FitState) -> FitState:
    """`advance` in one compiled call."""
    return _stepped(_part(problem, state), solver, state, _OPTIONS)


@functools.partial(quick_jit, all_cores=True)
def _advance_on_all_cores(problem: Problem, solver: BoundedLevenbergMarquardt, state: FitState) -> FitState:
    return advance_alone(problem, solver, state)


def _stepped(problem: Problem, solver: BoundedLevenbergMarquardt, state: FitState, options: dict[str, Any]) -> FitState:
    values, inner, _ = solver.step(residual_function, state.values, problem, options, state.solver, frozenset())
    over = inner.terminate | (inner.result != optx.RESULTS.successful)
    return dataclasses.replace(state, values=values, solver=inner, over=over)


@quick_jit
def _trial_moments(problem: Problem, state: FitState, share: Array, shares: int) -> Moments:
    return normal.trial_moments(_part(problem, state), state.solver.y_eval, Share(share, shares))


@quick_jit
def _model_moments(problem: Problem, state: FitState, values: Array, share: Array, shares: int) -> Moments:
    return normal.model_moments(_part(problem, state), values, Share(share, shares))


@quick_jit
def _judged(
    problem: Problem, solver: BoundedLevenbergMarquardt, state: FitState, moments: Moments
) -> tuple[Array, Array, Array]:
    """The settled trial, its loss, and whether the solver accepts it; the loss of one that it refuses is infinite, so
    that rounding cannot make it think otherwise."""
    trial, loss = normal.settled_by(problem, state.solver.y_eval, moments)
    accept = solver.judged(state.values, loss, state.solver)[1]
    return trial, jnp.where(accept, loss, jnp.inf), accept


@quick_jit
def _advanced(
    problem: Problem,
    solver: BoundedLevenbergMarquardt,
    state: FitState,
    trial: Array,
    loss: Array,
    moments: Moments,
) -> FitState:
    """The state after a trial; `moments` are those at the trial if it is accepted."""

    def equations(values: Array, problem: Problem) -> normal.NormalEquations:
        return normal.equations_of(problem, values, moments)

    return _stepped(problem, solver, state, {"settled": lambda *_: (trial, loss), "normal_equations": equations})


def carried_on(
    problem: Problem, solver: BoundedLevenbergMarquardt, state: FitState, history: Sequence[Step], max_steps: int
) -> FitState | None:
    """The state to be evaluated next, after the steps of `history`; None: the fit is over."""
    if bool(state.solver.first_step):
        return state
    out_of_steps = state.tried >= max_steps
    if int(state.every) > 1:
        if bool(state.over) or out_of_steps or state.tried >= _MOST_OF_PART:
            return _begun_with_all(problem, solver, state, state.values)
        return state
    if len(history) > 1 and history[-2].part < 1 and _disagree(history[-1], history[-2], history[0]):
        return _begun_with_all(problem, solver, state, state.origin)
    return None if bool(state.over) or out_of_steps else state


def _begun_with_all(problem: Problem, solver: BoundedLevenbergMarquardt, state: FitState, start: Array) -> FitState:
    earlier = jnp.asarray([state.accepted, state.tried, state.evaluations], jnp.int32)
    return dataclasses.replace(begin(problem, solver, start), origin=state.origin, earlier=earlier)


_MOST_OF_PART = 30
"""Trials on a part; one that needs more is no short cut."""


def _disagree(of_all: Step, of_part: Step, start: Step) -> bool:
    """Whether all samples are explained much worse than the part was, as far as that matters at the start."""
    return not of_all.loss <= 4 * of_part.loss + 1e-6 * start.loss


@eqx.filter_jit
def solve(problem: Problem, solver: BoundedLevenbergMarquardt, start: Array, max_steps: int = 100) -> optx.Solution:
    """The whole fit in one compiled call of `optimistix.least_squares`: for `vmap` over starts, and derivatives."""
    return optx.least_squares(
        residual_function, solver, start, problem, _OPTIONS, has_aux=True, max_steps=max_steps, throw=False
    )
