"""How fits end, in a word and in a sentence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import optimistix as optx

from .minimisers import Minimum
from .problem import Problem
from .run import FitState
from .solver import KINK_OFFSET, BoundedLevenbergMarquardt
from .steps import Step

Outcome = Literal["converged", "max_steps", "stalled", "unseen", "nonfinite", "interrupted"]


def outcome_of(state: FitState, interrupted: bool, *, fits: bool) -> Outcome:
    """How a fit ended that stands at this state; `fits`: what is left there is no more than rounding or noise."""
    if bool(state.solver.result == optx.RESULTS.nonfinite):
        return "nonfinite"
    if bool(state.solver.terminate):
        seen = np.any(state.solver.curvature.diagonal())
        return "converged" if seen or fits else "unseen"
    if bool(state.solver.result == optx.RESULTS.nonlinear_divergence):
        return "stalled"
    return "interrupted" if interrupted else "max_steps"


def left_of(rms: float, problem: Problem) -> str:
    """What is left, and what it counts."""
    robust = "" if problem.loss_kind == "squares" else f", as the {problem.loss_kind} loss counts it"
    return f"residual RMS {rms:.3g}{robust}{', priors included' if problem.parameters.has_priors else ''}"


def message_of(outcome: Outcome, state: FitState, history: Sequence[Step], rms: float, problem: Problem) -> str:
    """The same in a sentence, after these steps."""
    left = left_of(rms, problem)
    trials = f"{state.accepted} step{'' if state.accepted == 1 else 's'} ({state.tried} tried)"
    coarse = sum(step.part < 1 for step in history)
    if coarse > 1:
        trials += f", the first {coarse - 1 if coarse > 2 else 'one'} with {100 * history[0].part:.3g} % of the samples"
    if math.isnan(rms) and outcome == "interrupted":
        return "Interrupted before the start values were evaluated; they are unchanged."
    if outcome == "converged" and bool(state.solver.at_kink):
        # How far it is from there is an estimate of what pictures tell.
        near = "" if problem.parameters.has_priors else ", within a quarter of a standard error of the optimum"
        return (
            f"Converged in {trials} to a kink of the equation (samples where a light sets or its cone ends)"
            f"{near}; {left}."
        )
    return {
        "converged": f"Converged in {trials}; {left}.",
        "max_steps": f"Not converged: stopped after {trials}, the most that were allowed; {left}.",
        "stalled": f"Not converged: after {trials} no step lowers the residual any more, although its slope says one "
        f"should; {left}. They may lie at a jump or kink of the equation (a light's radius or cone).",
        "unseen": f"Not converged: after {trials} no picture changes with any free number, near the "
        f"{'start' if state.accepted == 0 else 'end'}; {left}.",
        "nonfinite": "Failed: the loss or its derivative is not finite at the start values.",
        "interrupted": f"Interrupted after {trials}, not converged; the best values so far are kept; {left}.",
    }[outcome]


_GAIN = 1e-5
"""Of what another minimiser has gained: what it leaves is then no matter of its tolerance."""


def falls_short(state: FitState, start: FitState, solver: BoundedLevenbergMarquardt, *, noise_known: bool) -> bool:
    """Whether the loss can be lowered by something that matters: values a quarter of a standard error away.

    Args:
        state: evaluated where another minimiser ended.
        start: evaluated where it began.
        solver: ours, which evaluated both.
        noise_known: whether the residuals' noise is 1; else what is left is taken for it.
    """
    loss, achievable = float(state.solver.loss), float(state.solver.achievable)
    variance = max(2 * loss / float(solver.freedom), 1.0 if noise_known else 0.0)
    offset_squared = 2 * achievable / (state.values.size * variance) if variance > 0 else 0.0
    gained = float(start.solver.loss) - loss
    return math.isfinite(achievable) and offset_squared > KINK_OFFSET**2 and achievable > _GAIN * gained


def ending_of(
    minimum: Minimum, name: str, evaluated: Outcome, rms: float, problem: Problem, *, short: bool
) -> tuple[Outcome, str]:
    """How the fit of another minimiser ended, in a word and in a sentence.

    Args:
        minimum: where it ended.
        name: what the minimiser is called.
        evaluated: how a fit of ours would end there, or at the best values if that was nowhere.
        rms: what is left.
        problem: the fit.
        short: whether that `falls_short`.
    """
    steps, left = f"{minimum.steps} steps", left_of(rms, problem)
    if evaluated == "nonfinite":
        return evaluated, f"Failed: the loss or its derivative is not finite where {name} ended, after {steps}."
    if not minimum.finite:
        met = "the best values that it met are kept"
        return "nonfinite", f"Failed: {name} came to what is not finite in {steps}; {met}; {left}."
    if evaluated == "unseen":
        nothing = f"no picture changes with any free number where {name} ended"
        return evaluated, f"Not converged: {nothing}, after {steps}; {left}."
    if minimum.converged and short:
        why = "although the slope there says that the residual can be lowered"
        return "stalled", f"Not converged: {name} ended after {steps}, {why}; {left}."
    if minimum.converged:
        return "converged", f"Converged by {name} in {steps}; {left}."
    return "max_steps", f"Not converged by {name} in {steps}; {left}."
