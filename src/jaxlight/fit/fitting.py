"""`fit`: find the free fields of a scene that make its render look like the pictures."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from ..formats.limits import as_path
from ..lighting import LightingOptions
from ..promotion import usual_promotion
from ..scene.fields import boolean, reach, string, whole
from ..scene.scene import Scene
from ..tracing import refuse_inside
from .checkpoint import Checkpoint, CheckpointWarning
from .chosen import canonical
from .interrupts import held_back, remembered
from .minimisers import check_minimiser, minimise
from .outcomes import Outcome, ending_of, falls_short, message_of, outcome_of
from .pictures import residual_image
from .problem import Description, Problem, make_problem
from .record import Record
from .residuals import LossKind
from .run import FitState, advance, begin, carried_on, make_solver
from .solver import BoundedLevenbergMarquardt
from .starts import MAX_STARTS, explore, random_starts
from .steps import Step, describe_step
from .steps import rms as step_rms
from .uncertainty import Uncertainty, nothing_known, uncertainty
from .views import View


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """What a fit found, and how much of it to believe.

    `outcome` is "converged" only if the solver met its tolerance; `message` says in words what happened.
    """

    scene: Scene
    """The scene with the fitted values."""
    exposure: np.ndarray
    """[views]: the exposure of each."""
    values: np.ndarray
    """[numbers]: the free numbers, in the order of `labels`; whole textures are in the scene."""
    labels: tuple[str, ...]
    """The path of each number, `Material[body].diffuse_color.r` for example."""
    loss: float
    """Half the sum of the weighted squared residuals, priors included; of a robust loss what it makes of them."""
    rms: float
    """Root mean square of the weighted residuals, as `Step.rms`."""
    outcome: Outcome
    """"converged", "max_steps", "stalled", "unseen", "nonfinite" or "interrupted"."""
    message: str
    """The same in a sentence, with the steps and what is left."""
    history: tuple[Step, ...]
    """Every evaluation, rejected trials too."""
    problem: Problem = dataclasses.field(repr=False)
    """What was minimised, for `fitted_values`, `model_image` and `residual_image`."""
    description: Description = dataclasses.field(repr=False)
    state: FitState = dataclasses.field(repr=False)

    @functools.cached_property
    def uncertainty(self) -> Uncertainty:
        """Standard errors, numbers at a bound, and what the pictures cannot tell, at the fitted values."""
        if self.outcome == "nonfinite":
            return nothing_known(self.problem, self.description, "the fit failed")
        return uncertainty(self.problem, self.description, self.state.values)

    @property
    def start(self) -> np.ndarray:
        """Where the free numbers began, in the order of `labels`."""
        return np.asarray(self.problem.parameters.start)[: len(self.labels)]

    @property
    def converged(self) -> bool:
        """True if the solver met its tolerance."""
        return self.outcome == "converged"

    @property
    def accepted_steps(self) -> int:
        """Steps that lowered the loss, within its rounding; the evaluation of a start is none."""
        return self.state.accepted

    def value(self, path: str) -> np.ndarray:
        """The fitted value of one free field or of a component, by its path; of a whole texture its colours.

        Raises:
            ValueError: the field was not free.
        """
        path = canonical(self.scene, self.description.view_names, string("path", path))
        for field in self.description.fields:
            if field.path == path:
                return self.values[field.numbers].reshape(-1 if len(field.numbers) > 1 else ())
            if path in field.labels:
                return self.values[field.numbers[field.labels.index(path)]]
        for block in self.problem.parameters.blocks:
            if block.path == path:
                return np.asarray(block.image(self.state.values))
        free = [part.path for part in (*self.description.fields, *self.problem.parameters.blocks)]
        raise ValueError(f"{path!r} was not free; free: {', '.join(free)}")

    def residual_image(self, view: int = 0) -> np.ndarray:
        """Weighted residual (model - target) of one view: [height, width, 3], NaN where nothing was seen; or [N, 3].

        `view`: its place among the views, from 0; another is a ValueError.
        """
        return residual_image(self.problem, self.state.values, view)

    def __str__(self) -> str:
        lines = [self.message]
        width = max((len(label) for label in self.labels), default=0)
        for label, start, value in zip(self.labels, self.start, self.values, strict=True):
            lines.append(f"  {label:<{width}}  {start:>12.6g} -> {value:>12.6g}")
        for block in self.problem.parameters.blocks:
            height, breadth, _ = block.shape
            lines.append(f"  {block.path}: {height} x {breadth} texels")
        if self.history and self.outcome != "nonfinite":
            lines += self.uncertainty.messages()
        return "\n".join(lines)


@usual_promotion
def fit(
    scene: Scene,
    views: View | Sequence[View],
    free: Any,
    *,
    loss: LossKind = "squares",
    loss_scale: float | None = None,
    options: LightingOptions | None = None,
    max_steps: int = 100,
    rtol: float | None = None,
    atol: float | None = None,
    starts: int = 1,
    seed: int = 0,
    method: Any = None,
    progress: Callable[[Step], Any] | None = None,
    log: str | Path | None = None,
    checkpoint: str | Path | None = None,
    checkpoint_seconds: float = 1.0,
    resume: bool = False,
    overwrite: bool = False,
) -> Fit:
    """Fit the free fields of a scene to one or many views by bounded Levenberg-Marquardt.

    Fits of some ten thousand samples and more begin with one tile of samples in so many, and go on with all of them
    from where these lead, or from the start if all of them disagree.

    Args:
        scene: start values of the free fields, and the values of all others.
        views: the pictures, each with its samples.
        free: field paths ("Material[body].diffuse_color", "PointLight[*].intensity", "View[*].exposure"), functions
            of the scene (`lambda s: s.materials.shininess`) or `Free`s; a mapping from path to options of `Free`.
        loss: "squares"; "huber" and "cauchy" forgive residuals larger than `loss_scale`.
        options: readings of the specification, as for `shade`.
        max_steps: steps to try at most; reaching it is never reported as success.
        rtol, atol: relative and absolute tolerance of the parameters (default: what the precision can reach).
        starts: more than 1, up to 100 000: begin from so many places, the given one and random places, directions and
            cones of lights, exponents of highlights and ranges of fog, where free, a few steps each, and carry on from
            the lowest.
        seed: of the random starts; a run that is resumed has the same as before.
        method: an optimistix minimiser (`optimistix.LBFGS(1e-6, 1e-6)`, `optimistix.OptaxMinimiser(optax.adam(0.01),
            1e-6, 1e-6)`) instead of the bounded Levenberg-Marquardt; it has tolerances of its own, shows no
            steps, explores no random starts, and only approaches bounds.
        progress: called with a `Step` after each evaluation; an interrupt (Ctrl-C) returns the best so far.
        log: file that gets a line of JSON a step (docs/fitting.md says which).
        checkpoint: .npz file from which the fit can be resumed, also after its process was killed.
        checkpoint_seconds: least time from one checkpoint to the next; 0: one after every step.
        resume: carry on from the checkpoint, to the same numbers as if there had been no interruption; begin if there
            is none yet. Random starts are not explored again.
        overwrite: begin anew even if the checkpoint is that of a fit that is not over, or of another, which is lost
            then. One of the same fit that is over is replaced in any case.

    Returns:
        The fitted scene and numbers, how the fit ended, and what is not known. A fit that did not converge is no error:
        its `outcome` says so, and its values are the best that were found.

    Raises:
        ValueError: a path, shape, bound or value that does not fit, found before anything is compiled; a checkpoint
            that belongs to another fit or is damaged, or that only `resume` or `overwrite` may replace; a call inside
            `jax.jit` or another transformation (`fitted_values` is for those).
    """
    refuse_inside("fit")
    starts = whole("starts", starts, at_least=1, at_most=MAX_STARTS)
    max_steps = whole("max_steps", max_steps, at_least=1)
    seed = whole("seed", seed, at_least=0)
    checkpoint_seconds = reach("checkpoint_seconds", checkpoint_seconds)
    resume, overwrite = boolean("resume", resume), boolean("overwrite", overwrite)
    log = None if log is None else as_path("log", log)
    checkpoint = None if checkpoint is None else as_path("checkpoint", checkpoint)
    if log is not None and log == checkpoint:
        raise ValueError(f"log: expected another file than the checkpoint, got {str(log)!r} for both")
    if progress is not None and not callable(progress):
        raise ValueError(f"progress: expected a function of a Step, got {progress!r:.60}")
    if resume and checkpoint is None:
        raise ValueError("resume: give `checkpoint` too, the file to carry on from")
    if resume and overwrite:
        raise ValueError("overwrite: expected resume or overwrite, not both")
    if method is not None:
        check_minimiser(method)
        if checkpoint is not None:
            raise ValueError("checkpoint: only the bounded Levenberg-Marquardt has them, not another method")
        if starts > 1:
            raise ValueError("starts: only the bounded Levenberg-Marquardt explores them, not another method")
    problem, description = make_problem(scene, views, free, loss=loss, loss_scale=loss_scale, options=options)
    solver = make_solver(problem, rtol=rtol, atol=atol)
    if method is not None:
        return _fit_by(method, problem, description, solver, max_steps, Record(log, None))
    state, history, kept = None, None, None
    if checkpoint is not None:
        run = (starts, seed, description.labels, description.view_names)
        kept = Checkpoint(checkpoint, problem, solver, run)
        if not (resume or overwrite):
            kept.spare_earlier()
        saved = kept.load() if resume else None
        if saved is not None:
            state, history = saved
        elif resume:
            warnings.warn(f"{checkpoint}: no checkpoint yet; the fit begins", CheckpointWarning, stacklevel=2)
    return run_fit(
        problem,
        description,
        solver,
        max_steps=max_steps,
        state=state,
        history=history or (),
        drawn=random_starts(problem, description.fields, starts, seed) if state is None and starts > 1 else None,
        progress=progress,
        record=Record(log, kept, seconds=checkpoint_seconds, resumed=history),
    )


def _fit_by(
    method: Any, problem: Problem, description: Description, solver: Any, max_steps: int, record: Record
) -> Fit:
    """The fit that another minimiser makes, evaluated like one of ours."""
    began = time.monotonic()
    try:
        start = begin(problem, solver)
        record.begin(problem, description, start, max_steps)
        found = minimise(problem, method, max_steps)
        state = advance(problem, solver, begin(problem, solver, found.values))
        if not (found.finite and np.isfinite(state.solver.loss)):
            found = found._replace(converged=False, finite=False)
            state = advance(problem, solver, begin(problem, solver, found.best))
        short = falls_short(state, advance(problem, solver, start), solver, noise_known=description.noise_known)
    except BaseException as error:
        record.fail(error)
        raise
    history = [describe_step(problem, description, state, time.monotonic() - began)]
    made = make_fit(problem, description, state, history)
    outcome, message = ending_of(found, type(method).__name__, made.outcome, made.rms, problem, short=short)
    made = dataclasses.replace(made, outcome=outcome, message=message)
    record.end(made.outcome, made.message, loss=made.loss, values=made.values)
    return made


def run_fit(
    problem: Problem,
    description: Description,
    solver: BoundedLevenbergMarquardt,
    *,
    max_steps: int = 100,
    state: FitState | None = None,
    history: Sequence[Step] = (),
    drawn: np.ndarray | None = None,
    progress: Callable[[Step], Any] | None = None,
    record: Record | None = None,
) -> Fit:
    """Drive a fit to its end: from its beginning, from the best of the starts that were drawn, or from a saved state
    and the steps that led to it."""
    record = Record(None, None) if record is None else record
    steps = list(history)
    began = time.monotonic() - (steps[-1].seconds if steps else 0.0)
    interrupted = False
    state = begin(problem, solver, every=description.part.every) if state is None else state
    try:
        with remembered() as raise_swallowed:
            record.begin(problem, description, state, max_steps)
            if drawn is not None:
                state = begin(problem, solver, explore(problem, solver, drawn).best, description.part.every)
            while (following := carried_on(problem, solver, state, steps, max_steps)) is not None:
                new_state = advance(problem, solver, following)
                step = describe_step(problem, description, new_state, time.monotonic() - began, steps, max_steps)
                state, steps = new_state, [*steps, step]
                record.step(step, state, steps, problem.parameters.few)
                if progress is not None:
                    progress(step)
                raise_swallowed()
    except KeyboardInterrupt:
        interrupted = True
    except BaseException as error:
        record.fail(error)
        raise
    with held_back():
        if steps:  # before the first, a resumed fit had better explore its random starts itself
            with _not_to_be_lost("the last checkpoint"):
                record.save(state, steps)
        made = make_fit(problem, description, state, steps, interrupted=interrupted)
        with _not_to_be_lost("the end of the log"):
            record.end(made.outcome, made.message, loss=made.loss, rms=made.rms, values=made.values)
    return made


@contextlib.contextmanager
def _not_to_be_lost(what: str) -> Iterator[None]:
    """A fit that is done is given back, also where the disk is full."""
    try:
        yield
    except OSError as error:
        warnings.warn(f"{what} could not be written: {error}", CheckpointWarning, stacklevel=4)


def make_fit(
    problem: Problem,
    description: Description,
    state: FitState,
    history: Sequence[Step],
    *,
    interrupted: bool = False,
) -> Fit:
    """The result for a state, finished or not."""
    outcome = outcome_of(state, interrupted, fits=_fits(problem, description, state))
    world = _world_at(problem, state.values)
    value = history[-1].loss if history else math.nan
    rms = step_rms(value, description.residuals)
    return Fit(
        scene=dataclasses.replace(world.scene, document=description.document),
        exposure=np.asarray(world.exposure),
        values=np.asarray(state.values)[: problem.parameters.few],
        labels=tuple(description.labels),
        loss=value,
        rms=rms,
        outcome=outcome,
        message=message_of(outcome, state, history, rms, problem),
        history=tuple(history),
        problem=dataclasses.replace(problem, found=state.values),
        description=description,
        state=state,
    )


def _fits(problem: Problem, description: Description, state: FitState) -> bool:
    """Whether what is left is rounding, or the noise that is stated: nothing a fit could explain."""
    loss = float(state.solver.loss)
    rounding = (16 * np.finfo(problem.parameters.start.dtype).eps) ** 2 * float(problem.signal)
    return loss <= max(rounding, description.residuals if description.noise_known else 0)


@eqx.filter_jit
def _world_at(problem: Problem, values: Any) -> Any:
    return problem.at(values)
