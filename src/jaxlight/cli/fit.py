"""`jaxlight fit`: make a scene look like pictures of it."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from .cameras import camera_of
from .files import existing, spare
from .options import Precision, Reading, ScenePath, SharedReading, use_precision
from .progress import stages
from .start_values import with_start_values

if TYPE_CHECKING:
    import jaxlight
    from jaxlight.fit import Step

MAX_ROWS = 60
"""Numbers listed on the terminal."""


@dataclasses.dataclass(frozen=True)
class Fit:
    """Fit fields of a scene (materials, lights, fog, textures) to one or many pictures of it.

    $ jaxlight fit scene.x3d photo.png --output fitted --free 'Material[body].diffuse_color' 'PointLight[key].location'
    $ jaxlight fit scene.x3d photo.png --output fitted --free 'Material[*].*' --start 'Material[body].shininess=0.5'
    $ jaxlight fit scene.x3d a.png b.png --viewpoints left right --masks a_mask.png b_mask.png --decode srgb
      --output fitted --free 'Material[*].diffuse_color' 'View[*].exposure'

    `jaxlight info SCENE` lists the fields. The values in the scene are the start, unless --start gives others. The
    folder --output gets scene.x3d (the scene with the fitted values), one picture a view, report.html to look at and
    fit.json for programs. Ctrl-C ends the fit and keeps the best so far. Exit status 1 if it did not converge."""

    scene: ScenePath
    """An X3D file, or a mesh (glb, obj, ply, stl): shape, camera, and what is known of materials and lights."""
    targets: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="PICTURE ...")]
    """The pictures to fit (png, jpg, exr, ...), each as the scene is seen from a viewpoint."""
    output: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """Where the results go; made if it is not there."""
    free: Annotated[tuple[str, ...], tyro.conf.arg(metavar="PATH ...")]
    """Fields to fit, such as 'Material[body].*'."""
    start: Annotated[tuple[str, ...], tyro.conf.arg(metavar="PATH=VALUE ...")] = ()
    """Start values instead of those in the scene, such as 'PointLight[key].location=1 2 3'."""
    viewpoints: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """DEF name or number of the Viewpoint of each picture (default: the scene's first for all)."""
    masks: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PICTURE ...")] = ()
    """A mask for each picture: black is not fitted."""
    decode: Literal["none", "srgb"] = "none"
    """What the pictures' numbers are: those of the equation, or sRGB of linear light (photographs)."""
    saturated: float | None = None
    """Numbers from here on are only known to be at least this (default: 1 for pictures of 8 or 16 bits)."""
    samples: int = 1
    """Samples a pixel; pixels at the rim of a shape are then compared as they are covered."""
    loss: Literal["squares", "huber", "cauchy"] = "squares"
    """Huber and Cauchy forgive what the scene cannot explain."""
    loss_scale: float = 0.02
    """Residual from which huber and cauchy forgive."""
    max_steps: int = 100
    """Steps to try at most."""
    quiet: bool = False
    """No line for each step on stderr."""
    precision: Precision = "float32"
    """Type of the numbers."""
    reading: SharedReading = dataclasses.field(default_factory=Reading)

    def run(self) -> int:
        """Fit, write the results, and say how it went."""
        self._check_words()
        use_precision(self.precision)
        with stages(2) as stage:
            stage(f"reading {self.scene}")
            from jaxlight import fit, load

            scene = with_start_values(load(self.scene), self.start)
            _refuse_headlight(scene, self.free)
            stage("finding what is visible")
            views = self._views(scene)
        result = fit(
            scene,
            views,
            list(self.free),
            loss=self.loss,
            loss_scale=None if self.loss == "squares" else self.loss_scale,
            options=self.reading.lighting_options(),
            max_steps=self.max_steps,
            progress=None if self.quiet else _StepLines(),
        )
        self._write(result, views)
        print(_summary(result))
        print(f"\nwritten: {', '.join(str(path) for path in self._outputs())}")
        return 0 if result.converged else 1

    def _check_words(self) -> None:
        """What can be said before anything is read."""
        if not self.targets:
            raise ValueError("fit: expected at least one picture after the scene (see jaxlight fit --help)")
        for option, values in (("--viewpoints", self.viewpoints), ("--masks", self.masks)):
            if values and len(values) != len(self.targets):
                raise ValueError(f"{option}: expected one for each of {len(self.targets)} pictures, got {len(values)}")
        if not self.free:
            raise ValueError("--free: expected at least one field (jaxlight info SCENE lists them)")
        inputs = [self.scene, *self.targets, *self.masks]
        existing(*inputs)
        if self.output.exists() and not self.output.is_dir():
            raise ValueError(f"{self.output}: expected a folder, got a file")
        spare(inputs, self._outputs())

    def _outputs(self) -> list[Path]:
        return [self.output / name for name in ("scene.x3d", *self._picture_names(), "report.html", "fit.json")]

    def _picture_names(self) -> list[str]:
        return [f"view_{row}.png" for row in range(len(self.targets))]

    def _views(self, scene: jaxlight.Scene) -> list[jaxlight.View]:
        from jaxlight import View, decode, rasterize, read_image

        views, seen = [], {}
        stems = [path.stem for path in self.targets]
        for row, path in enumerate(self.targets):
            target = read_image(path)
            mask = read_image(self.masks[row]).mean(axis=-1) >= 0.5 if self.masks else None
            if mask is not None and mask.shape != target.shape[:2]:
                sizes = [f"{width} x {height}" for height, width in (target.shape[:2], mask.shape)]
                raise ValueError(f"{self.masks[row]}: expected {sizes[0]} pixels as in {path}, got {sizes[1]}")
            if target.shape[2] in (2, 4):
                opaque = target[..., -1] > 0
                target, mask = target[..., :-1], opaque if mask is None else mask & opaque
            height, width = target.shape[:2]
            key = (self.viewpoints[row] if self.viewpoints else "", width, height)
            if key not in seen:
                seen[key] = rasterize(scene, camera_of(scene, key[0]), width, height, samples=self.samples)
            saturated = self.saturated if self.saturated is not None or path.suffix.lower() == ".exr" else 1.0
            name = path.stem if stems.count(path.stem) == 1 else f"{path.stem}_{row}"
            views.append(View(seen[key], decode(target, self.decode), mask=mask, saturated=saturated, name=name))
        return views

    def _write(self, result: Any, views: Sequence[Any]) -> None:
        from jaxlight import encode, save, write_image
        from jaxlight.fit.report import view_pictures, write_report
        from jaxlight.formats.safe_write import written_whole

        options = self.reading.lighting_options()
        self.output.mkdir(parents=True, exist_ok=True)
        scene_file, *picture_files, report_file, numbers_file = self._outputs()
        with written_whole(numbers_file) as draft:
            draft.write_text(json.dumps(_numbers(result), indent=2, allow_nan=False) + "\n")
        for path, pictures in zip(picture_files, view_pictures(result, views, options), strict=True):
            write_image(path, encode(pictures.model, self.decode))
        title = f"{self.scene.name} fitted to {', '.join(path.name for path in self.targets)}"
        write_report(report_file, result, views, title=title, options=options, transfer=self.decode)
        save(result.scene, scene_file)


def _refuse_headlight(scene: jaxlight.Scene, free: Sequence[str]) -> None:
    """Raise ValueError if the browser's headlight is to be fitted: no file can hold the result."""
    from jaxlight.scene.paths import select

    if scene.directional is not None and scene.directional.headlight:
        paths = [path for path in free if not path.startswith("View[")]
        for leaf, mask in select(scene, paths):
            if leaf.kind == "DirectionalLight" and mask[-1].any():
                raise ValueError("--free: the headlight is the browser's, no file holds it; add a light to the scene")


class _StepLines:
    """One line a step on stderr: a log that stays."""

    def __init__(self) -> None:
        self.begun = False

    def __call__(self, step: Step) -> None:
        if not self.begun:
            print(f"{'step':>5} {'residual':>12} {'gradient':>10} {'damping':>9} {'seconds':>8}", file=sys.stderr)
            self.begun = True
        refused = "" if step.accepted else "  refused"
        print(
            f"{step.step:5d} {step.rms:12.6g} {step.gradient:10.2e} {step.damping:9.1e} {step.seconds:8.2f}{refused}",
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
