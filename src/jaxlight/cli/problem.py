"""A fit as a person asks for it, by options or by a problem file: one wording, one set of defaults."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

from .options import Precision, Reading, SharedReading
from .toml_lines import Key

OUTPUT = "a folder that need not exist"
"""Marks the paths of outputs, which are not looked for."""

Numbers = float | tuple[float, ...]
Vector = tuple[float, float, float]

OF_ALL_VIEWS = (("samples",), ("saturated",))
"""Entries of a view that are an option of the same name for all of them."""


class Source(Protocol):
    """Where the words come from: it knows how to say what is wrong with which of them."""

    def error(self, key: Key, message: str) -> ValueError:
        """The error to raise about the entry at `key`."""
        ...


class CommandLine:
    """Options; an entry is called by its option."""

    def error(self, key: Key, message: str) -> ValueError:
        """`--free: message`, `--start: path: message`; what belongs to the scene or one picture names that itself."""
        if key[:1] == ("views",):
            return ValueError(f"--{key[2]}: {message}" if key[2:] in OF_ALL_VIEWS else message)
        option = f"--{str(key[0]).replace('_', '-')}: " if key and key[0] != "scene" else ""
        path = f"{key[1]}: " if option and len(key) > 1 and isinstance(key[1], str) else ""
        return ValueError(f"{option}{path}{message}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class FitSettings:
    """How to fit."""

    loss: Literal["squares", "huber", "cauchy"] = "squares"
    """Huber and Cauchy forgive what the scene cannot explain."""
    loss_scale: float | None = None
    """Residual from which huber and cauchy forgive (default: 0.02; where a problem file states the noise of every view
    1.345 and 2.385 of its standard deviations)."""
    solver: Literal["levenberg-marquardt", "bfgs", "lbfgs"] = "levenberg-marquardt"
    """The bounded Levenberg-Marquardt, or a minimiser that only approaches bounds and cannot be resumed."""
    max_steps: int = 100
    """Steps to try at most."""
    rtol: float | None = None
    """Relative tolerance of the numbers (default: what the precision can reach)."""
    atol: float | None = None
    """Absolute tolerance of the numbers."""
    starts: int = 1
    """So many starts: the given one, the others with random places, directions and cones of lights, exponents of
    highlights and ranges of fog, where these are free."""
    seed: int = 0
    """Of the random starts."""
    checkpoint_seconds: float = 1.0
    """Least time from one checkpoint to the next; 0: one after every step."""
    precision: Precision = "float32"
    """Type of the numbers."""
    reading: SharedReading = dataclasses.field(default_factory=Reading)


@dataclasses.dataclass(frozen=True, kw_only=True)
class CameraProblem:
    """A calibrated camera in OpenCV's convention (`Camera.from_intrinsics`)."""

    fx: float
    fy: float
    cx: float
    cy: float
    R: tuple[Vector, Vector, Vector] | None = None
    t: Vector | None = None
    pixel_center: float = 0.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class MapsProblem:
    """Geometry from maps instead of the scene's shapes (`samples_from_maps`)."""

    normal: Path
    depth: float | Path | None = None
    position: Path | None = None
    mask: Path | None = None
    color: Path | None = None
    surface: int | Path = 0
    normal_encoding: Literal["vector", "color"] | None = None
    normal_frame: Literal["camera", "world"] = "camera"
    normal_y_down: bool = False
    position_frame: Literal["camera", "world"] = "world"
    depth_kind: Literal["z", "distance"] = "z"
    texel_per_pixel: bool = False
    pixel_size: float = 1.0
    """Of the parallel view that is taken where neither camera nor viewpoint is given."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ViewProblem:
    """One picture and what is known of it (`View`)."""

    picture: Path
    name: str = ""
    decode: Literal["none", "srgb"] = "none"
    viewpoint: str | None = None
    camera: CameraProblem | None = None
    maps: MapsProblem | None = None
    samples: int = 1
    mask: Path | None = None
    weight: Path | None = None
    noise: float | Path | None = None
    exposure: float = 1.0
    lights: tuple[str, ...] | None = None
    saturated: float | None = None
    dark: float | None = None
    background: Vector | Path | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class FreeProblem:
    """Fields to fit with more to say about them than their path (`Free`)."""

    path: str | tuple[str, ...]
    lower: Numbers | None = None
    upper: Numbers | None = None
    tied: bool | Literal["all"] = False
    mean: Numbers | None = None
    deviation: Numbers | None = None
    smoothness: float | None = None
    total_variation: float | None = None

    @property
    def paths(self) -> tuple[str, ...]:
        """The paths, also of a single one."""
        return (self.path,) if isinstance(self.path, str) else self.path


@dataclasses.dataclass(frozen=True, kw_only=True)
class FitProblem(FitSettings):
    """All of a fit."""

    scene: Path
    views: tuple[ViewProblem, ...]
    free: tuple[str | FreeProblem, ...]
    start: dict[str, Numbers] = dataclasses.field(default_factory=dict)
    output: Annotated[Path, OUTPUT] | None = None

    @property
    def frees(self) -> list[FreeProblem]:
        """What is free, each in its long form."""
        return [FreeProblem(path=one) if isinstance(one, str) else one for one in self.free]


@contextlib.contextmanager
def blamed_on(source: Source, *key: str | int) -> Iterator[None]:
    """Errors of the block are about the entry at `key`."""
    try:
        yield
    except ValueError as error:
        raise source.error(key, str(error)) from None


@contextlib.contextmanager
def blamed_by_name(source: Source, views: Sequence[str]) -> Iterator[None]:
    """Errors of the block that begin with what they are about, as those of `fit` do, are about its entry.

    Args:
        source: of the entries.
        views: names of the views: of a view it is `View[name].field`.
    """
    try:
        yield
    except ValueError as error:
        from jaxlight.fit.free import RequestError

        text = str(error)
        name, _, message = text.partition(": ")
        if isinstance(error, RequestError):
            raise source.error(("free", error.place), message if name == "free" else text) from None
        if name in ("free", *(field.name for field in dataclasses.fields(FitSettings))):
            raise source.error((name,), message) from None
        number = re.fullmatch(r"views\[(\d+)\]\.(\w+)", name)
        if number and not isinstance(source, CommandLine):
            raise source.error(("views", int(number[1]), number[2]), message) from None
        of_view = re.fullmatch(r"View\[(.*?)\](?:\.(\w+))?", name)
        field = () if of_view is None or of_view[2] is None else (of_view[2],)
        known = set(field) <= {one.name for one in dataclasses.fields(ViewProblem)}
        told = field in OF_ALL_VIEWS or not isinstance(source, CommandLine)
        if of_view and of_view[1] in views and known and told:
            raise source.error(("views", views.index(of_view[1]), *field), message) from None
        raise source.error((), text) from None


def input_files(problem: Any) -> list[Path]:
    """Every file that the problem reads."""
    if isinstance(problem, Path):
        return [problem]
    if isinstance(problem, tuple):
        return [path for one in problem for path in input_files(one)]
    if dataclasses.is_dataclass(problem):
        names = [field.name for field in dataclasses.fields(problem) if field.name != "output"]
        return [path for name in names for path in input_files(getattr(problem, name))]
    return []
