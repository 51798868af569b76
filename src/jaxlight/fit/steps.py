"""One evaluation of a fit in numbers, and how long the rest may take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .problem import Description, Problem

_LOOK_BACK = 4
"""Accepted steps from which the rate of convergence is read."""


class Step(NamedTuple):
    """One evaluation of a fit, as progress and logs show it."""

    step: int
    """0 is the evaluation of the start."""
    part: float
    """Share of the residuals that was evaluated: less than 1 while the fit is coarse."""
    accepted: bool
    loss: float
    """At the best values so far; from a part, scaled up to all residuals."""
    rms: float
    """Root mean square of the weighted residuals; of a robust loss, and with priors, that of as many residuals whose
    squares have this loss."""
    gradient: float
    """Largest slope that no bound holds back, in units of its column's norm: the residual it could still explain."""
    damping: float
    step_norm: float
    """Size of the undamped step relative to the tolerance; below 1 is converged."""
    seconds: float
    """Since the fit began, compilation and the time before a resumed run's checkpoint included."""
    seconds_left: float
    """Estimated from the rate at which `step_norm` falls, at most the steps left; NaN while nothing is known."""

    @property
    def in_tolerances(self) -> str:
        """`step_norm` to be read; "-" where there is none."""
        return f"{self.step_norm:.2e}" if math.isfinite(self.step_norm) else "-"


def describe_step(
    problem: Problem,
    description: Description,
    state: Any,
    seconds: float,
    history: Sequence[Step] = (),
    max_steps: int | None = None,
) -> Step:
    """What the last evaluation did, on the host.

    Args:
        problem, description: the fit.
        state: its `FitState`.
        seconds: since it began.
        history: the steps before this one, for the time left.
        max_steps: after which the fit ends anyway.
    """
    inner, parameters = state.solver, problem.parameters
    norms = np.sqrt(np.maximum(np.asarray(inner.curvature.diagonal()), 0))
    slope, values = np.asarray(inner.gradient), np.asarray(state.values)
    held = ((values <= np.asarray(parameters.lower)) & (slope > 0)) | (
        (values >= np.asarray(parameters.upper)) & (slope < 0)
    )
    gradient = np.where(held, 0, np.abs(slope)) / np.where(norms > 0, norms, 1)
    part = description.part.share if int(state.every) > 1 else 1.0
    value = float(inner.loss) / part
    step = Step(
        step=state.evaluations - 1,
        part=part,
        accepted=bool(inner.accepted),
        loss=value,
        rms=rms(value, description.residuals),
        gradient=float(np.max(gradient)),
        damping=float(1 / np.asarray(inner.search_state.step_size)),
        step_norm=float(inner.step_norm),
        seconds=seconds,
        seconds_left=math.nan,
    )
    return step._replace(seconds_left=_seconds_left([*history, step], max_steps))


def rms(loss: float, count: int) -> float:
    """Root mean square of `count` weighted residuals whose squares halved sum to `loss`."""
    return float(np.sqrt(2 * loss / max(count, 1)))


def _seconds_left(steps: Sequence[Step], max_steps: int | None) -> float:
    """From the geometric rate of the last accepted steps; a fit that is not getting closer may need all its steps."""
    now = steps[-1]
    steps = [step for step in steps if step.part == now.part]
    if now.part < 1:
        return math.nan
    if now.step_norm < 1:
        return 0.0
    recent = [one.seconds for one in steps[1:]][-_LOOK_BACK - 1 :]  # the first evaluation compiles
    if len(recent) < 2:
        return math.nan
    a_step = float(np.median(np.diff(recent)))
    taken = [one for one in steps if one.accepted and 0 < one.step_norm < math.inf][-_LOOK_BACK:]
    left = math.inf if max_steps is None else float(max_steps - now.step)
    if len(taken) > 1 and taken[-1].step_norm < taken[0].step_norm:
        rate = math.log(taken[0].step_norm / taken[-1].step_norm) / (now.step - taken[0].step)
        left = min(left, math.log(now.step_norm) / rate)
    return left * a_step if math.isfinite(left) else math.nan
