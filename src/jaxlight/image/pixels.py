"""Samples to pixels: what each sample covers, over the background."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..arrays import real_array
from ..lighting import LightingOptions, Plan, shade_slots
from ..lighting.checks import check_samples
from ..lighting.compiling import quick_jit
from ..promotion import usual_promotion
from ..raster import SampleBuffer
from ..scene import Scene
from .background import sky


@usual_promotion
def render(
    scene: Scene, samples: SampleBuffer, options: LightingOptions | None = None, *, plan: Plan | None = None
) -> Float[Array, "height width 3"]:
    """The picture of a scene: its samples shaded, weighted by coverage and alpha, over the background's sky.

    C = sum_i share_i A_i C_i + (1 - sum_i share_i A_i) C_sky over the samples i of a pixel. One layer: a transparent
    shape shows the sky through it, not the shapes behind. Pure and differentiable, like `shade`.

    Args:
        scene: materials, lights, fog and textures.
        samples: from `rasterize`, `samples_from_maps`, or `SampleBuffer.create` with pixels.
        options, plan: as for `shade`.

    Returns:
        [height, width, 3], row 0 at the top; the equation's numbers, neither clamped nor encoded.

    Raises:
        ValueError: the samples do not say which pixels they belong to, or do not fit the scene.
    """
    check_samples(scene, samples)
    _check_pixels(samples)
    behind = sky(scene, samples)
    if samples.count == 0:
        return jnp.broadcast_to(behind, (samples.height, samples.width, 3))
    return _over(shade_slots(scene, samples, options, plan=plan), behind, samples)


@usual_promotion
def resolve(values: Any, samples: SampleBuffer) -> Float[Array, "height width channels"]:
    """Sum of the samples' values in each pixel, each weighted by the share that it covers; 0 where nothing is seen.

    Args:
        values: [N] or [N, channels], in sample order.
        samples: where they belong.

    Returns:
        [height, width, channels]; without the last axis if values had none.

    Raises:
        ValueError: a shape that does not fit, or samples without pixels.
    """
    _check_pixels(samples)
    values = real_array("resolve: values", values)
    if values.ndim not in (1, 2) or values.shape[0] != samples.count:
        raise ValueError(f"resolve: expected values of shape [{samples.count}, channels], got {list(values.shape)}")
    values = values.astype(jnp.result_type(values, float))
    rows = values if values.ndim == 2 else values[:, None]
    picture = _of_samples(rows, samples)
    return picture if values.ndim == 2 else picture[..., 0]


@quick_jit
def _over(
    shaded: Float[Array, "slots 4"], behind: Float[Array, "3"] | Float[Array, "height width 3"], samples: SampleBuffer
) -> Float[Array, "height width 3"]:
    # No concatenation of columns, which takes as long as the equation of one light.
    picture = _summed(shaded * jnp.where(jnp.arange(4) < 3, shaded[:, 3:], 1), samples)
    return picture[..., :3] + (1 - picture[..., 3:]) * behind


@quick_jit
def _of_samples(
    values: Float[Array, "samples channels"], samples: SampleBuffer
) -> Float[Array, "height width channels"]:
    place = slice(samples.count) if samples.slot is None else samples.slot
    slots = jnp.zeros((samples.slots, values.shape[1]), values.dtype).at[place].set(values)
    return _summed(slots, samples)


def _summed(rows: Float[Array, "slots channels"], samples: SampleBuffer) -> Float[Array, "height width channels"]:
    """Padding falls into one pixel too many, which is cut off."""
    width, height = samples.width or 0, samples.height or 0
    if samples.coverage_slots is not None:
        rows = rows * samples.coverage_slots.astype(rows.dtype)[:, None]
    pixels = jnp.zeros((height * width + 1, rows.shape[1]), rows.dtype).at[samples.pixel_slots].add(rows)
    return pixels[:-1].reshape(height, width, -1)


def _check_pixels(samples: SampleBuffer) -> None:
    if not isinstance(samples, SampleBuffer):
        raise ValueError(f"samples: expected a SampleBuffer, got {type(samples).__name__}")
    if samples.pixel_slots is None or samples.width is None or samples.height is None:
        raise ValueError("samples: no picture to put them in; give SampleBuffer.create pixel, width and height")
