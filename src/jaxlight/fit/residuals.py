"""Residuals: how far the model is from a picture, and how loudly each difference counts."""

from __future__ import annotations

from typing import Literal

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from ..lighting import shade_planes
from ..lighting.totals import summed_on_lanes
from ..scene.scene import Scene
from .views import ViewData

LossKind = Literal["squares", "huber", "cauchy"]


def weighted_difference(
    color: ArrayLike,
    target: ArrayLike,
    root_weight: ArrayLike,
    dark: ArrayLike | None,
    saturated: ArrayLike | None,
) -> Array:
    """Square root of the weight x (color - target); beyond the sensor's range only the wrong side counts.

    A saturated target is a lower limit, a dark one an upper limit (censored observations).
    """
    color, target = jnp.asarray(color), jnp.asarray(target)
    difference = color - target
    if saturated is not None:
        difference = jnp.where(target >= saturated, jnp.minimum(difference, 0), difference)
    if dark is not None:
        difference = jnp.where(target <= dark, jnp.maximum(difference, 0), difference)
    return difference * root_weight


def is_limit(target: ArrayLike, dark: ArrayLike | None, saturated: ArrayLike | None) -> Array:
    """Where a target is a limit of the sensor instead of a measurement."""
    target = jnp.asarray(target)
    found = jnp.zeros(target.shape, bool)
    if saturated is not None:
        found |= target >= saturated
    if dark is not None:
        found |= target <= dark
    return found


def composited(color: Array, alpha: Array, background: Array | None) -> Array:
    """The colour of a sample over the background; alpha is ignored where there is none."""
    return color if background is None else alpha * color + (1 - alpha) * background


def view_colors(scene: Scene, view: ViewData, exposure: Array) -> Float[Array, "3 points"]:
    """What the model says a view looks like, all points at once; a point with several samples is their weighted sum.

    Args:
        scene: the scene as this view saw it (`scene_of_view`).
        view: its samples, background and pixels.
        exposure: [], factor on all colours.
    """
    planes = shade_planes(scene, view.samples, plan=view.plan)
    color, alpha = planes[:3], planes[3]
    if view.pixel is None:
        return exposure * composited(color, alpha, view.background)
    assert view.share is not None
    parts = parts_of_pixels(view, exposure, color, alpha, view.pixel, view.share)
    sums = jnp.zeros((3, view.target.shape[-1] + 1), parts.dtype).at[:, view.pixel].add(parts)
    return pixel_colors(view, exposure, sums[:, :-1])  # the last is padding's


def parts_of_pixels(
    view: ViewData,
    exposure: Array,
    color: Float[Array, "3 samples"],
    alpha: Array,
    pixel: Int[Array, " samples"],
    share: Float[Array, " samples"],
) -> Float[Array, "3 samples"]:
    """What samples add to the colours of the pixels that gather them, beyond the background."""
    if view.background is not None:
        color = alpha * (color - view.background.at[:, pixel].get(mode="clip"))
    return exposure * share * color


def pixel_colors(view: ViewData, exposure: Array, sums: Float[Array, "3 points"]) -> Float[Array, "3 points"]:
    """The colours of pixels from the sums of their samples' parts."""
    return sums if view.background is None else sums + exposure * view.background


def half_losses(kind: LossKind, scale: Array, residual: Array) -> Float[Array, " lanes"]:
    """Half the sum of rho(r^2), `summed_on_lanes`: squares, Huber (linear beyond `scale`) or Cauchy (logarithmic)."""
    if kind == "squares":
        each = residual * residual / 2
    else:
        size = jnp.abs(residual) / scale
        huber = jnp.where(size <= 1, size * size / 2, size - 0.5)
        each = scale * scale * (huber if kind == "huber" else jnp.log1p(size * size) / 2)
    return summed_on_lanes(each)


def reweight(kind: LossKind, scale: Array, residual: Array) -> Array | None:
    """rho'(r^2) at each residual: how much a robust loss still listens to it. None: 1."""
    if kind == "squares":
        return None
    size = jnp.abs(residual) / scale
    return 1 / jnp.maximum(size, 1) if kind == "huber" else 1 / (1 + size * size)


def slopes_of_heard(kind: LossKind, scale: Array, residual: Array) -> Array:
    """Slope of rho'(r^2) r, which is what is heard of a residual, at each."""
    size = jnp.abs(residual) / scale
    if kind == "huber":
        return jnp.where(size <= 1, 1.0, 0.0)
    if kind == "cauchy":
        return (1 - size * size) / (1 + size * size) ** 2
    return jnp.ones_like(residual)
