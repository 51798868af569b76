"""`jaxlight fit`: make a scene look like pictures of it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from .files import existing, spare
from .fit_job import FitJob, outputs
from .options import ScenePath
from .problem import CommandLine, FitProblem, FitSettings, Numbers, Source, ViewProblem, blamed_on
from .start_values import parse_assignment


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fit:
    """Fit fields of a scene (materials, lights, fog, textures) to one or many pictures of it.

    $ jaxlight fit scene.x3d photo.png --output fitted --free 'Material[body].diffuse_color' 'PointLight[key].location'
    $ jaxlight fit scene.x3d photo.png --output fitted --free 'Material[*].*' --start 'Material[body].shininess=0.5'
    $ jaxlight fit scene.x3d a.png b.png --viewpoints left right --masks a_mask.png b_mask.png --decode srgb
      --output fitted --free 'Material[*].diffuse_color' 'View[*].exposure'
    $ jaxlight fit problem.toml --output fitted
    $ jaxlight fit problem.toml --output fitted --resume

    `jaxlight info SCENE` lists the fields. The values in the scene are the start, unless --start gives others. A
    problem file says all of this in one place, and more (docs/problem-files.md). The folder --output gets scene.x3d
    (the scene with the fitted values, its textures beside it), one picture a view (sRGB after --decode srgb),
    report.html to look at, fit.json and log.jsonl for programs, and checkpoint.npz for --resume. Ctrl-C ends the fit
    and keeps the best so far. Exit status 1 if it did not converge."""

    scene: ScenePath
    """An X3D file or a mesh (glb, obj, ply, stl); or a problem file (.toml), which says everything."""
    targets: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="PICTURE ...")] = ()
    """The pictures to fit (png, jpg, exr, ...), each as the scene is seen from a viewpoint."""
    output: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER", aliases=("-o",))] = None
    """Where the results go; made if it is not there."""
    free: Annotated[tuple[str, ...], tyro.conf.arg(metavar="PATH ...")] = ()
    """Fields to fit, such as 'Material[body].*'."""
    start: Annotated[tuple[str, ...], tyro.conf.arg(metavar="PATH=VALUE ...")] = ()
    """Start values instead of those in the scene, such as 'PointLight[key].location=1 2 3'."""
    viewpoints: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """DEF name of the Viewpoint of each picture or its number from 0 (default: the scene's first for all)."""
    masks: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PICTURE ...")] = ()
    """A mask for each picture: what is darker than one half is not fitted."""
    decode: Literal["none", "srgb"] = "none"
    """What the pictures' numbers are: those of the equation, or sRGB of linear light (photographs)."""
    saturated: float | None = None
    """Numbers from here on, as they are after --decode, are only known to be at least this (default: 1 for pictures of
    8 or 16 bits; inf: none)."""
    samples: int = 1
    """Samples a pixel; pixels where shapes meet are then compared as they are covered. Those at the rim of what is
    seen are left out: only a problem file says what is behind them (`background`)."""
    resume: bool = False
    """Carry on from the checkpoint in --output, to the same numbers as if the fit had never stopped."""
    overwrite: bool = False
    """Begin anew where --output holds the checkpoint of a fit that is not over or of another fit, or results of which
    no checkpoint tells by which fit."""
    quiet: bool = False
    """No line for each step on stderr."""
    settings: Annotated[FitSettings, tyro.conf.arg(name="")] = dataclasses.field(default_factory=FitSettings)

    def run(self) -> int:
        """Fit, write the results, and say how it went."""
        return FitJob(*self._asked(), resume=self.resume, overwrite=self.overwrite, quiet=self.quiet).run()

    def _asked(self) -> tuple[FitProblem, Source]:
        """The problem, from its file or from the options."""
        if self.scene.suffix.lower() != ".toml":
            return self._from_options(), CommandLine()
        from .problem_file import ProblemFile

        beside = ("scene", "output", "resume", "overwrite", "quiet")
        default = Fit(scene=self.scene)._words()
        for name, value in self._words().items():
            if name not in beside and value != default[name]:
                option = "PICTURE" if name == "targets" else f"--{name.replace('_', '-')}"
                raise ValueError(f"{option}: belongs in {self.scene}, which says all about the fit")
        file = ProblemFile(self.scene)
        problem = file.problem if self.output is None else dataclasses.replace(file.problem, output=self.output)
        spare([self.scene], [] if problem.output is None else outputs(problem, problem.output))
        return problem, file

    def _from_options(self) -> FitProblem:
        if not self.targets:
            raise ValueError("fit: expected at least one picture after the scene (see jaxlight fit --help)")
        for option, values in (("--viewpoints", self.viewpoints), ("--masks", self.masks)):
            if values and len(values) != len(self.targets):
                raise ValueError(f"{option}: expected one for each of {len(self.targets)} pictures, got {len(values)}")
        existing(self.scene, *self.targets, *self.masks)
        views = tuple(
            ViewProblem(
                picture=picture,
                decode=self.decode,
                viewpoint=self.viewpoints[row] if self.viewpoints else None,
                mask=self.masks[row] if self.masks else None,
                saturated=self.saturated,
                samples=self.samples,
            )
            for row, picture in enumerate(self.targets)
        )
        start: dict[str, Numbers] = {}
        with blamed_on(CommandLine(), "start"):
            for text in self.start:
                path, numbers = parse_assignment(text)
                if path in start:
                    raise ValueError(f"{path} is given twice")
                start[path] = numbers
        settings = vars(self.settings)
        return FitProblem(**settings, scene=self.scene, views=views, free=self.free, start=start, output=self.output)

    def _words(self) -> dict[str, Any]:
        """Every option by its name."""
        words = {**vars(self), **vars(self.settings), **vars(self.settings.reading)}
        return {name: value for name, value in words.items() if name not in ("settings", "reading")}
