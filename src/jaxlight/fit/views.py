"""Views: what was photographed. A `View` is what a person writes, `ViewData` the same in the order of the samples."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..arrays import GIVE_MASK, array_of, known_numbers
from ..formats.levels import is_chosen, look_like_levels, refuse_levels
from ..raster.samples import SampleBuffer
from ..scene.fields import number, positive
from ..scene.flags import Flags
from ..scene.paths import LIGHT_ATTRIBUTES, LIGHT_KINDS, light_rows
from ..scene.scene import Scene
from .coverage import Coverage


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """One picture to fit: the samples of its visible surface points and the colours seen there.

    The picture's numbers must mean what `shade` returns: linear light where light adds up, or the plain numbers of an
    X3D browser; decode an sRGB photograph first. The loss is half the sum of weight x (exposure x shade - target)^2.
    `fit` checks all of it, and its errors (ValueError) name the view and the field.

    Args:
        samples: the sample buffer (`rasterize`, `samples_from_maps`, `SampleBuffer.create`).
        target: [height, width, 3], row 0 at the top; or [N, 3] in sample order; without the 3 for a grey picture.
        mask: [height, width] or [N], also with a last axis of 1, False where the picture is not to be fitted (cast
            shadows, other objects). Floats below one half mean False, as do integers that are 0; of pictures of 8 or 16
            bits, whose largest number is above 1, those below half of the range.
        weight: weight of the squared residual, >= 0, shape of the mask or of the target. Where it is 0 the target may
            hold anything.
        noise: standard deviation of the picture's noise, > 0, a number or shape of the mask or of the target. Weights
            the residuals by 1 / noise^2; stated in every view, it makes standard errors absolute: a point with a
            `weight` besides counts as one whose noise is noise / sqrt(weight).
        exposure: factor between the scene's light and the picture's numbers; free it as `View[0].exposure`.
        lights: the light that shone, such as `"PointLight[3]"`, or several; None: all lights of the scene.
        saturated: > 0, values at or above are lower limits (the sensor was full), not measurements.
        dark: values at or below are upper limits (nothing was recorded).
        background: RGB or [height, width, 3]; shade's alpha and partly covered pixels are composited over it.
            None: alpha is ignored and pixels that the samples do not cover entirely are left out.
        name: how messages and paths name the view: `View[name].exposure`.
    """

    samples: SampleBuffer
    target: Any
    _: dataclasses.KW_ONLY
    mask: Any = None
    weight: Any = None
    noise: Any = None
    exposure: float = 1.0
    lights: str | Sequence[str] | None = None
    saturated: float | None = None
    dark: float | None = None
    background: Any = None
    name: str = ""


class ViewData(eqx.Module):
    """A view on the device, in storage order: planes over slots, or over pixels where a pixel has several samples."""

    samples: SampleBuffer
    target: Float[Array, "3 points"]
    root_weight: Float[Array, "channels points"]
    """Square root of the weights; 0 for padding, masked and unseen points. One channel, or one a colour."""
    saturated: Float[Array, ""] | None
    """None: no view has such a limit."""
    dark: Float[Array, ""] | None
    row: Int[Array, ""]
    """Which view this is: row in `World.exposure`."""
    lights: tuple[Int[Array, " lights"] | None, ...]
    """Rows of the directional, point and spot lights that shone, or None for all of a kind."""
    in_scope: tuple[Flags | None, ...] = eqx.field(static=True)
    """[surfaces, lights] of the lights that shone; goes with `lights`."""
    plan: Any = eqx.field(static=True)
    """What the equation must compute for this view (`lighting.Plan`)."""
    background: Float[Array, "3 points"] | None
    pixel: Int[Array, " slots"] | None
    """Row in the points of each slot when samples are gathered into pixels (padding: number of points); else None."""
    share: Float[Array, " slots"] | None
    """Share of its pixel that each slot stands for; goes with `pixel`."""


def view_data(scene: Scene, view: View, row: int, dtype: Any) -> ViewData:
    """Check a view and bring it into the order in which its samples are stored.

    Raises:
        ValueError: a shape, a value that is not finite, a light that does not exist; says which view and field.
    """
    label = label_of(view.name, row)
    samples = view.samples
    if not isinstance(samples, SampleBuffer):
        raise ValueError(f"{label}.samples: expected a SampleBuffer, got {type(samples).__name__}")
    layout = _Layout.of(label, samples)
    background = _background(view, layout)
    target, weight = _seen_and_heard(view, layout, dtype)
    dark, saturated = sensor_limits(view, label)
    rows = None if view.lights is None else _light_rows(label, scene, view.lights)
    chosen = [None] * 3 if rows is None else [rows[kind] for kind in LIGHT_KINDS]
    scopes = [_scope(getattr(scene, kind), own) for kind, own in zip(LIGHT_ATTRIBUTES, chosen, strict=True)]
    return ViewData(
        samples=samples,
        target=layout.stored(target, dtype),
        root_weight=layout.stored(np.sqrt(weight), dtype),
        saturated=array_of(saturated, dtype),
        dark=array_of(dark, dtype),
        row=array_of(row, jnp.int32),
        lights=tuple(None if own is None else jnp.asarray(own) for own in chosen),
        in_scope=tuple(scopes),
        plan=None,
        background=None if background is None else layout.stored(background, dtype),
        pixel=None if layout.pixel is None else array_of(layout.pixel, jnp.int32),
        share=None if layout.share is None else array_of(layout.share, dtype),
    )


def _background(view: View, layout: _Layout) -> Float[np.ndarray, "points 3"] | None:
    """What shines through where samples do not cover their pixel, or are not opaque."""
    if view.background is None:
        return None
    where = f"{layout.label}.background"
    background = _colors(where, view.background)
    if background.shape == (3,):
        background = np.broadcast_to(background, (layout.points, 3))
    else:
        background = layout.points_of("background", background)
    if not np.all(np.isfinite(background)):
        raise ValueError(f"{where}: every number must be finite")
    return background


def _seen_and_heard(
    view: View, layout: _Layout, dtype: Any
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points channels"]]:
    """The target and its weights; where these are 0 both are."""
    label = layout.label
    weight = _weights(view, layout, _mask(view, layout))
    used = weight > 0
    target = layout.points_of("target", _colors(f"{label}.target", view.target))
    bad = np.any(used & ~np.isfinite(target), axis=1)
    if np.any(bad):
        raise ValueError(
            f"{label}.target: {np.count_nonzero(bad)} of {np.count_nonzero(used.any(axis=1))} used points are not "
            f"finite (first: {layout.where(int(np.argmax(bad)))}); leave them out with `mask`"
        )
    if look_like_levels(target[used.any(axis=1)]):
        warnings.warn(
            f"{label}.target: whole numbers up to {np.max(target[used.any(axis=1)]):g}, as levels are; if they are, "
            "divide by the largest level (255 of 8 bits) or use read_image",
            stacklevel=2,
        )
    smallest, largest = float(jnp.finfo(dtype).tiny), float(jnp.finfo(dtype).max)
    field, what = ("weight", "weight") if view.weight is not None else ("noise", "weight 1 / noise^2")
    if np.any(used) and not np.any(weight[used] >= smallest):
        raise ValueError(
            f"{label}.{field}: every {what} is less than {smallest:.2g}, the smallest of {np.dtype(dtype)}"
        )
    if np.any(np.sqrt(weight[used]) > largest):
        raise ValueError(
            f"{label}.{field}: the root of a {what} is more than {largest:.2g}, the largest of {np.dtype(dtype)}"
        )
    if not np.any(used):
        raise ValueError(f"{label}: mask, weight and coverage leave no point to fit")
    return np.broadcast_to(np.where(used, target, 0.0), (layout.points, 3)), np.where(used, weight, 0.0)


def _mask(view: View, layout: _Layout) -> Bool[np.ndarray, " points"]:
    """The points to fit; without a background those only that samples cover wholly."""
    mask = np.ones(layout.points, dtype=bool)
    if view.mask is not None:
        chosen = is_chosen(view.mask, f"{layout.label}.mask")
        mask = layout.points_of("mask", chosen, grey=True)[:, 0] != 0
    if view.background is None and layout.is_whole is not None:
        mask &= layout.is_whole
    return mask


def _weights(view: View, layout: _Layout, mask: Bool[np.ndarray, " points"]) -> Float[np.ndarray, "points channels"]:
    """weight / noise^2, 0 outside of the mask; one channel, or one a colour."""
    label, weight = layout.label, np.ones((layout.points, 1))
    if view.weight is not None:
        weight = layout.points_of("weight", view.weight)
        if not np.all(np.isfinite(weight) & (weight >= 0)):
            raise ValueError(f"{label}.weight: every weight must be finite and >= 0")
    weight = np.where(mask[:, None], weight, 0.0)
    if view.noise is None:
        return weight
    noise = _numbers(f"{label}.noise", view.noise)
    if noise.ndim == 0:
        if not (np.isfinite(noise) and noise > 0):
            raise ValueError(f"{label}.noise: expected a standard deviation, finite and > 0, got {noise}")
        noise = np.full((layout.points, 1), noise)
    else:
        noise = layout.points_of("noise", noise)
    used = weight > 0
    bad = np.any(used & ~(np.isfinite(noise) & (noise > 0)), axis=1)
    if np.any(bad):
        raise ValueError(
            f"{label}.noise: every standard deviation must be finite and > 0; {np.count_nonzero(bad)} of the used "
            f"points are not (first: {layout.where(int(np.argmax(bad)))})"
        )
    with np.errstate(all="ignore"):  # what is too little or too much is said where it is used
        return np.where(used, weight / noise**2, 0.0)


def sensor_limits(view: View, label: str) -> tuple[float, float]:
    """`dark` and `saturated`; where there is none, infinite."""
    dark, saturated = (
        default if given is None else number(f"{label}.{field}", given, infinite=True)
        for field, given, default in (("dark", view.dark, -np.inf), ("saturated", view.saturated, np.inf))
    )
    if saturated <= 0:
        raise ValueError(f"{label}.saturated: expected a number > 0, got {saturated:g}")
    if dark >= saturated:
        raise ValueError(f"{label}.dark: expected a number below `saturated`, {saturated:g}, got {dark:g}")
    return dark, saturated


def exposure_of(view: View, row: int) -> float:
    """The exposure of a view, checked: a finite number > 0."""
    return positive(f"{label_of(view.name, row)}.exposure", view.exposure)


def label_of(name: str, row: int) -> str:
    """What messages and paths call a view."""
    return f"View[{name or row}]"


def is_of_surfaces_alone(scene: Scene, view: View) -> bool:
    """Whether the view has no background, and surfaces through which one would be seen."""
    return view.background is None and any(_is_transparent(scene, view, row) for row, _, _ in view.samples.runs)


def _is_transparent(scene: Scene, view: View, row: int) -> bool:
    surface = scene.surfaces[row]
    if surface.textured and scene.textures[surface.texture].image.shape[-1] in (2, 4):
        return bool(np.any(np.asarray(scene.textures[surface.texture].image[..., -1]) < 1))
    if surface.color_components == 4:
        return bool(np.any(np.asarray(view.samples.color)[:, 3] < 1))
    if scene.materials is None or surface.material < 0:
        return False
    return bool(np.asarray(scene.materials.transparency)[surface.material] > 0)


def _numbers(where: str, value: Any) -> np.ndarray:
    return known_numbers(where, value, "numbers", instead=GIVE_MASK).astype(np.float64)


def _colors(where: str, value: Any) -> np.ndarray:
    numbers = known_numbers(where, value, "numbers", instead=GIVE_MASK)
    refuse_levels(where, numbers)
    return numbers.astype(np.float64)


def _light_rows(label: str, scene: Scene, lights: Any) -> dict[str, np.ndarray]:
    try:
        return light_rows(scene, lights)
    except ValueError as error:
        raise ValueError(f"{label}.{error}") from None


def _scope(lights: Any, rows: np.ndarray | None) -> Flags | None:
    return None if lights is None or rows is None else Flags(lights.in_scope.array[:, rows])


@dataclasses.dataclass(frozen=True)
class _Layout:
    """How the points of a picture (pixels or samples) lie in the storage of its samples."""

    label: str
    samples: SampleBuffer
    points: int
    source: np.ndarray
    """Per stored point: row among the samples, or pixel among the pixels that samples gather into."""
    is_padding: np.ndarray
    image_index: np.ndarray | None
    """Pixel of each point, when the buffer knows pixels."""
    pixel: np.ndarray | None
    share: np.ndarray | None
    is_whole: np.ndarray | None
    """Pixels that samples cover wholly; goes with `pixel`."""

    @classmethod
    def of(cls, label: str, samples: SampleBuffer) -> _Layout:
        slots = samples.slots
        source = np.zeros(slots, dtype=np.int64)
        is_padding = np.ones(slots, dtype=bool)
        slot = np.arange(samples.count) if samples.slot is None else np.asarray(samples.slot)
        source[slot] = np.arange(samples.count)
        is_padding[slot] = False
        if samples.pixel is None:
            return cls(label, samples, samples.count, source, is_padding, None, None, None, None)
        coverage = Coverage.of(samples)
        pixels, share, count = np.asarray(samples.pixel), coverage.share, len(coverage.pixel)
        if count == len(pixels) and np.all(share == 1):
            return cls(label, samples, samples.count, source, is_padding, pixels, None, None, None)
        pixel_of_slot = np.where(is_padding, count, coverage.point[source])
        share_of_slot = np.where(is_padding, 0.0, share[source])
        points = np.arange(count)
        return cls(
            label, samples, count, points, np.zeros(count, bool), coverage.pixel,
            pixel_of_slot, share_of_slot, coverage.is_whole,
        )  # fmt: skip

    def points_of(self, field: str, value: Any, *, grey: bool = False) -> np.ndarray:
        """[points, 3] (or [points, 1]) from a picture or from rows in sample order."""
        array = _numbers(f"{self.label}.{field}", value)
        height, width = self.samples.height, self.samples.width
        shapes: list[tuple[int, ...]] = []
        if self.image_index is not None:
            shapes.append((height or 0, width or 0))
        if self.pixel is None:
            shapes.append((self.samples.count,))
        tails = ((), (1,)) if grey else ((), (1,), (3,))
        for shape in shapes:
            if array.shape in [(*shape, *tail) for tail in tails]:
                rows = array.reshape(int(np.prod(shape)), int(np.prod(array.shape[len(shape) :])))
                return rows[self.image_index] if len(shape) == 2 and self.image_index is not None else rows
        told = ((), (3,)) if field in ("weight", "noise") else ((),) if grey else ((3,),)
        allowed = "shape " + " or ".join(str([*shape, *tail]) for tail in told for shape in shapes)
        allowed = f"one number or an array of {allowed}" if field == "noise" else allowed
        hint = ""
        if field == "target" and array.shape in [(*shape, tail) for shape in shapes for tail in (2, 4)]:
            hint = "; the last channel, alpha, can go into the mask: target[..., :-1], mask=target[..., -1]"
        raise ValueError(f"{self.label}.{field}: expected {allowed}, got {list(array.shape)}{hint}")

    def stored(self, rows: np.ndarray, dtype: Any) -> Any:
        """[points, channels] -> planes [channels, stored points], padding 0."""
        return array_of(np.where(self.is_padding[:, None], 0.0, rows[self.source]).T, dtype)

    def where(self, point: int) -> str:
        if self.image_index is None or self.samples.width is None:
            return f"sample {point}"
        row, column = divmod(int(self.image_index[point]), self.samples.width)
        return f"row {row}, column {column}"
