"""One fit from a problem to a folder of results."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .files import files_of_scene, spare
from .fit_views import make_views
from .folder import alone_in
from .interrupts import Interrupts
from .options import use_precision
from .problem import FitProblem, Source, blamed_by_name, blamed_on, input_files
from .progress import stages
from .start_values import with_start_values
from .status import FAILURE, INTERRUPTED, SUCCESS

if TYPE_CHECKING:
    import jaxlight
    from jaxlight.fit import Step

MAX_ROWS = 60
"""Numbers listed on the terminal."""
LOSS_SCALE = 0.02
LOSS_SCALES_OF_NOISE = {"huber": 1.345, "cauchy": 2.385}
"""In standard deviations: of normal noise they lose 5 % of what least squares would know."""
_HEADING = (
    f"{'step':>5} {'loss':>12} {'residual':>12} {'gradient':>10} {'step/tol':>10} {'damping':>9} {'seconds':>8} "
    f"{'left':>8}"
)


def outputs(problem: FitProblem, folder: Path) -> list[Path]:
    """The files that a fit writes: results, then what it writes while it goes."""
    pictures = [f"view_{row}.png" for row in range(len(problem.views))]
    return [
        folder / name for name in ("scene.x3d", *pictures, "report.html", "fit.json", "log.jsonl", "checkpoint.npz")
    ]


@dataclasses.dataclass(frozen=True)
class FitJob:
    """A problem, where its words come from, and how to go about it."""

    problem: FitProblem
    source: Source
    resume: bool
    overwrite: bool
    quiet: bool

    def run(self) -> int:
        """Fit, write the results, and say how it went; the exit status."""
        folder = self._folder()
        with alone_in(folder), _heard() as warned:
            return self._run(folder, warned)

    def _run(self, folder: Path, warned: list[str]) -> int:
        problem, source = self.problem, self.source
        *results, log, checkpoint = outputs(problem, folder)
        use_precision(problem.precision)
        with stages(2) as stage:
            stage(f"reading {problem.scene}")
            scene = self._scene()
            spare(files_of_scene(problem.scene, scene), outputs(problem, folder))
            if not self.overwrite:
                self._spare_earlier(folder)
            stage("finding what is visible")
            views = make_views(problem, source, scene)
        from jaxlight import Free, fit
        from jaxlight.fit.earlier import previous_of

        method = _method(problem)
        frees = [dataclasses.asdict(one) for one in problem.frees]
        with Interrupts() as interrupts:
            with blamed_by_name(source, [view.name for view in views]):
                result = fit(
                    scene,
                    views,
                    [Free(one.pop("path"), **one) for one in frees],
                    loss=problem.loss,
                    loss_scale=loss_scale_of(problem),
                    options=problem.reading.lighting_options(),
                    max_steps=problem.max_steps,
                    rtol=problem.rtol,
                    atol=problem.atol,
                    starts=problem.starts,
                    seed=problem.seed,
                    method=method,
                    progress=None if self.quiet else _StepLines(),
                    log=log,
                    checkpoint=None if method is not None else checkpoint,
                    checkpoint_seconds=problem.checkpoint_seconds,
                    resume=self.resume,
                    overwrite=self.overwrite,
                )
            interrupts.hold()
            if not result.history:
                print(result.message, file=sys.stderr)
                return INTERRUPTED
            if method is not None:  # what is there is of the fit that is replaced
                checkpoint.unlink(missing_ok=True)
                previous_of(checkpoint).unlink(missing_ok=True)
            try:
                textures = self._write(result, views, results, warned)
            finally:  # the numbers are not lost with a full disk, nor the files with a reader that went away
                print(_summary(result))
            print(f"\nwritten: {', '.join(str(path) for path in (*results, *textures))}")
            if interrupts.came or result.outcome == "interrupted":
                return INTERRUPTED
            return SUCCESS if result.converged else FAILURE

    def _folder(self) -> Path:
        """What can be said before anything is read."""
        problem = self.problem
        if self.resume and self.overwrite:
            raise ValueError("--overwrite: expected --resume or --overwrite, not both")
        if problem.output is None:
            raise self.source.error(("output",), "expected a folder for the results")
        if not problem.views:
            raise self.source.error(("views",), "expected at least one picture")
        if not problem.free:
            raise self.source.error(("free",), "expected at least one field (jaxlight info SCENE lists them)")
        if problem.starts > 1 and problem.solver != "levenberg-marquardt":
            raise self.source.error(("starts",), f"the solver {problem.solver} explores no random starts")
        if self.resume and problem.solver != "levenberg-marquardt":
            raise ValueError(f"--resume: the solver {problem.solver} has no checkpoints")
        with blamed_on(self.source, "loss"):
            loss_scale_of(problem)
        if problem.output.exists() and not problem.output.is_dir():
            raise ValueError(f"{problem.output}: expected a folder, got a file")
        files = outputs(problem, problem.output)
        for path in files:
            if path.is_dir():
                raise ValueError(f"{path}: expected a file, got a folder")
        spare(input_files(problem), files)
        return problem.output

    def _spare_earlier(self, folder: Path) -> None:
        """Raise ValueError for what an earlier fit left, unless checkpoints tell whether it was this one."""
        from jaxlight.fit.earlier import previous_of, spare_unfinished

        *results, _, checkpoint = outputs(self.problem, folder)
        solver = self.problem.solver
        if solver != "levenberg-marquardt":
            spare_unfinished(checkpoint, previous_of(checkpoint))
            untold, why = [*results, checkpoint], f"fits by {solver} keep no checkpoint"
        else:
            untold, why = [] if checkpoint.exists() else results, "there is no checkpoint"
        path = next((path for path in untold if path.exists()), None)
        if path is not None:
            raise ValueError(f"{path}: is there, and {why} that tells of which fit; --overwrite replaces it")

    def _scene(self) -> jaxlight.Scene:
        """The scene with its start values, which a file can hold; every free path leads somewhere in it."""
        from jaxlight import load
        from jaxlight.formats.changes import changed_nodes
        from jaxlight.scene.paths import select

        with blamed_on(self.source, "scene"):
            scene = load(self.problem.scene)
        for path, values in self.problem.start.items():
            with blamed_on(self.source, "start", path):
                scene = with_start_values(scene, path, values)
        if self.problem.start:
            with blamed_on(self.source, "start"):
                changed_nodes(scene)
        for row, free in enumerate(self.problem.frees):
            with blamed_on(self.source, "free", row):
                chosen = select(scene, [path for path in free.paths if not path.startswith("View[")])
                headlight = scene.directional is not None and scene.directional.headlight
                if headlight and any(leaf.kind == "DirectionalLight" and mask[-1].any() for leaf, mask in chosen):
                    raise ValueError("the headlight is the browser's, no file holds it; add a light to the scene")
        return scene

    def _write(
        self, result: Any, views: Sequence[Any], results: Sequence[Path], warned: Sequence[str]
    ) -> Sequence[Path]:
        """Write the results; the files of textures that lie beside the scene then."""
        from jaxlight import encode, save, write_image, write_report
        from jaxlight.fit import view_pictures
        from jaxlight.formats.safe_write import written_whole

        scene_file, *picture_files, report_file, numbers_file = results
        with written_whole(numbers_file) as draft:
            draft.write_text(json.dumps(_numbers(result), indent=2, allow_nan=False) + "\n")
        _, *textures = save(result.scene, scene_file)
        asked = self.problem.views
        for path, one, pictures in zip(picture_files, asked, view_pictures(result, views), strict=True):
            write_image(path, encode(pictures.model, one.decode))
        title = f"{self.problem.scene.name} fitted to {', '.join(one.picture.name for one in asked)}"
        write_report(report_file, result, views, title=title, transfer=[one.decode for one in asked], warnings=warned)
        return textures


@contextlib.contextmanager
def _heard() -> Iterator[list[str]]:
    """The warnings of the block, in their order; they are shown as ever."""
    heard: list[str] = []
    shown = warnings.showwarning

    def hear(message: Warning | str, *place: Any, **more: Any) -> None:
        heard.append(str(message))
        shown(message, *place, **more)

    warnings.showwarning = hear
    try:
        yield heard
    finally:
        warnings.showwarning = shown


def loss_scale_of(problem: FitProblem) -> float | None:
    """The scale that was asked for, or that of a loss which needs one: in units of the noise where that is stated.

    Raises:
        ValueError: only some views state their noise, so that there is no scale for all.
    """
    if problem.loss == "squares" or problem.loss_scale is not None:
        return problem.loss_scale
    stated = [view.noise is not None for view in problem.views]
    if any(stated) and not all(stated):
        raise ValueError(f"where only some views state their noise, {problem.loss} needs a loss_scale")
    return LOSS_SCALES_OF_NOISE[problem.loss] if all(stated) else LOSS_SCALE


def _method(problem: FitProblem) -> Any:
    """The optimistix minimiser that the problem asks for; None: the bounded Levenberg-Marquardt."""
    if problem.solver == "levenberg-marquardt":
        return None
    import optimistix as optx

    coarse = 1e-6 if problem.precision == "float64" else 1e-4
    kind = optx.BFGS if problem.solver == "bfgs" else optx.LBFGS
    return kind(coarse if problem.rtol is None else problem.rtol, coarse if problem.atol is None else problem.atol)


class _StepLines:
    """One line a step on stderr: a log that stays."""

    def __init__(self) -> None:
        self.begun = False

    def __call__(self, step: Step) -> None:
        if not self.begun:
            print(_HEADING, file=sys.stderr)
            self.begun = True
        left = "" if math.isnan(step.seconds_left) else f"{step.seconds_left:.2f}"
        refused = "" if step.accepted else "  refused"
        part = "" if step.part == 1 else f"  {100 * step.part:.3g} % of the samples"
        print(
            f"{step.step:5d} {step.loss:12.6g} {step.rms:12.6g} {step.gradient:10.2e} {step.in_tolerances:>10} "
            f"{step.damping:9.1e} {step.seconds:8.2f} {left:>8}{refused}{part}",
            file=sys.stderr,
            flush=True,
        )


def _numbers(result: Any) -> dict[str, Any]:
    """The fit as data that JSON can carry."""
    known = result.uncertainty
    return {
        "outcome": result.outcome,
        "message": result.message,
        "rms": _finite(result.rms),
        "loss": _finite(result.loss),
        "values": {
            label: {"start": float(start), "fitted": float(value), "standard_error": _finite(float(error))}
            for label, start, value, error in zip(
                result.labels, result.start, result.values, known.standard_error, strict=True
            )
        },
        "cautions": known.messages(),
        "steps": [{name: _finite(value) for name, value in step._asdict().items()} for step in result.history],
    }


def _finite(value: float) -> float | None:
    """The number, or None: JSON has neither infinity nor NaN."""
    return value if math.isfinite(value) else None


def _summary(result: Any) -> str:
    """The fit for a person: how it ended, each number with its standard error, what to be careful about."""
    known = result.uncertainty
    width = max((len(label) for label in result.labels), default=0)
    lines = [result.message, f"  {'':<{width}}  {'start':>12}  {'fitted':>12}  {'+-':>9}"]
    table = list(zip(result.labels, result.start, result.values, known.standard_error, strict=True))
    for label, old, new, error in table[:MAX_ROWS]:
        lines.append(f"  {label:<{width}}  {float(old):>12.6g}  {float(new):>12.6g}  {float(error):>9.2g}")
    if len(table) > MAX_ROWS:
        lines.append(f"  and {len(table) - MAX_ROWS} more, all of them in fit.json")
    return "\n".join([*lines, *known.messages()])
