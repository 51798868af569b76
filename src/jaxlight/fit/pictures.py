"""The pictures of a fit: what the scene looks like in each view, and what is left of the target."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from ..formats.levels import is_chosen
from ..given import several
from ..image import resolve, sky
from ..lighting.compiling import quick_jit
from ..raster.samples import SampleBuffer
from . import normal
from .coverage import Coverage
from .problem import Problem
from .residuals import weighted_difference
from .views import View, ViewData, label_of, sensor_limits

if TYPE_CHECKING:
    from .fitting import Fit


class ViewPictures(NamedTuple):
    """One view as people look at it. [height, width, 3], row 0 at the top, in the numbers of the target."""

    name: str
    target: np.ndarray
    model: np.ndarray
    used: np.ndarray
    """[height, width]: True where the fit looked."""
    dark: float = -np.inf
    """Numbers up to here are upper limits, as `View.dark`."""
    saturated: float = np.inf
    """Numbers from here on are lower limits, as `View.saturated`."""

    @property
    def difference(self) -> np.ndarray:
        """model - target where the fit looked, as it counts: 0 where a limit of the sensor is kept."""
        looked = self.used[..., None].astype(np.float64)
        return np.asarray(weighted_difference(self.model, self.target, looked, self.dark, self.saturated))


def view_pictures(result: Fit, views: View | Sequence[View]) -> list[ViewPictures]:
    """What the views show and what the fit made of them; views whose samples have no pixels are left out.

    The model is what the fit compared with the target. What the samples do not cover is the view's background or, in a
    view without one, the scene's sky.

    Args:
        result: what `fit` returned.
        views: the views that it was given.

    Returns:
        The pictures of each view, in their order.

    Raises:
        ValueError: views of another number or size than the fit had.
    """
    each = several(views)
    fitted = len(result.exposure)
    if not all(isinstance(view, View) for view in each):
        raise ValueError("views: expected a View or a list of them")
    if len(each) != fitted:
        raise ValueError(f"views: expected the {fitted} that were fitted, got {len(each)}")
    for row, view in enumerate(each):
        fitted_size, size = (_size(one.samples) for one in (_place(result.problem, row)[0], view))
        if size != fitted_size:
            raise ValueError(f"{label_of(view.name, row)}.samples: expected {fitted_size} as in the fit, got {size}")
    return [
        _pictures_of_view(result, row, view) for row, view in enumerate(each) if view.samples.pixel_slots is not None
    ]


def _size(samples: SampleBuffer) -> str:
    return "no pixels" if samples.pixel_slots is None else f"{samples.width} x {samples.height} pixels"


def _pictures_of_view(result: Fit, row: int, view: View) -> ViewPictures:
    samples = view.samples
    coverage = Coverage.of(samples)
    covered = np.zeros((samples.height or 0, samples.width or 0))
    used = np.zeros(covered.shape, bool)
    covered.flat[coverage.pixel] = coverage.covered
    used.flat[coverage.pixel] = coverage.is_whole | (view.background is not None)

    def as_picture(values: Any) -> np.ndarray:
        """[height, width, 1 or 3] of what a View takes as a picture or as rows in sample order."""
        array = np.asarray(values, np.float64)
        if array.shape[:2] != covered.shape:
            rows = array[:, None] if array.ndim == 1 else array
            array = np.asarray(resolve(rows, samples)) / np.maximum(covered, 1e-12)[..., None]
        return array if array.ndim == 3 else array[..., None]

    name = label_of(view.name, row)
    mask = None if view.mask is None else is_chosen(view.mask, f"{name}.mask")
    for field in (mask, view.weight):
        if field is not None:
            used &= np.any(as_picture(field) > 0, axis=-1)
    target = np.broadcast_to(as_picture(view.target), (*covered.shape, 3))
    if view.background is None:
        behind, uncovered = sky(result.scene, samples), 1 - covered
    else:  # the fit has put it behind all that the samples reach
        behind = view.background if np.shape(view.background) == (3,) else as_picture(view.background)
        uncovered = (covered == 0).astype(np.float64)
    seen = np.where(covered[..., None] > 0, model_image(result.problem, result.state.values, row), 0)
    model = seen + float(result.exposure[row]) * uncovered[..., None] * np.asarray(behind, np.float64)
    unknown = np.where(used[..., None], model, 0)  # in a channel that the fit did not look at
    limits = sensor_limits(view, name)
    return ViewPictures(name, np.where(np.isfinite(target), target, unknown), model, used, *limits)


def model_image(problem: Problem, values: Any, view: int) -> np.ndarray:
    """What the fit compares with the target of a view, its exposure, lamps and background included.

    Args:
        problem: the fit.
        values: all of its numbers (`FitState.values`).
        view: row of the view.

    Returns:
        [height, width, 3], NaN where nothing was seen; or [N, 3] in sample order, of samples without pixels.

    Raises:
        ValueError: no such view.
    """
    return _as_picture(*_model_planes(problem, values, *_place(problem, view)))


def residual_image(problem: Problem, values: Any, view: int) -> np.ndarray:
    """Weighted residual (model - target) of a view; as `model_image`."""
    return _as_picture(*_residual_planes(problem, values, *_place(problem, view)))


def _place(problem: Problem, view: int) -> tuple[ViewData, int]:
    """The stack of views that a view lies in, and where."""
    for stack in problem.views:
        for position, row in enumerate(np.asarray(stack.row).tolist()):
            if row == view:
                return stack, position
    views = len(problem.world.exposure)
    raise ValueError(f"view: expected the place of one of {views} view{'s' * (views > 1)}, from 0 on, got {view!r:.60}")


@quick_jit
def _model_planes(problem: Problem, values: Any, stack: ViewData, position: Any) -> tuple[Any, ViewData]:
    data = jax.tree.map(lambda leaf: leaf[position], stack)
    return normal.view_model(problem.at(values), data), data


@quick_jit
def _residual_planes(problem: Problem, values: Any, stack: ViewData, position: Any) -> tuple[Any, ViewData]:
    data = jax.tree.map(lambda leaf: leaf[position], stack)
    return normal.view_residual(problem.at(values), data), data


def _as_picture(planes: Any, data: ViewData) -> np.ndarray:
    samples = data.samples
    if data.pixel is not None:
        pixels = np.full(planes.shape[1] + 1, -1)
        pixels[np.asarray(data.pixel)] = np.asarray(samples.pixel_slots)
        rows, pixel = np.asarray(planes).T, pixels[:-1]
    else:
        rows = np.asarray(samples.in_sample_order(planes)).T
        pixel = None if samples.pixel is None else np.asarray(samples.pixel)
    if pixel is None or samples.width is None or samples.height is None:
        return rows
    picture = np.full((samples.height * samples.width, 3), np.nan, dtype=rows.dtype)
    picture[pixel] = rows
    return picture.reshape(samples.height, samples.width, 3)
