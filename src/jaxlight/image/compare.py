"""How far one image is from another."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from ..arrays import known_numbers
from ..formats.levels import is_chosen
from ..scene.fields import positive
from ..tracing import refuse_traced


@dataclasses.dataclass(frozen=True)
class Difference:
    """Errors of an image against a reference, over the channels of the compared pixels."""

    largest: float
    """Largest absolute difference."""
    mean: float
    """Mean absolute difference."""
    rmse: float
    """Root of the mean squared difference."""
    psnr: float
    """20 log10(peak / rmse) in decibels; infinite for equal images."""
    relative_l2: float
    """Length of the difference over the length of the reference."""
    worst_pixel: tuple[int, int]
    """Row and column where the largest difference lies."""
    pixels: int
    """How many pixels were compared."""

    def __str__(self) -> str:
        row, column = self.worst_pixel
        return (
            f"max {self.largest:.4g} (row {row}, column {column}), mean {self.mean:.4g}, rmse {self.rmse:.4g}, "
            f"psnr {self.psnr:.2f} dB, relative L2 {self.relative_l2:.4g}, {self.pixels} pixels"
        )


@np.errstate(over="ignore")
def compare(image: Any, reference: Any, mask: Any = None, *, peak: float = 1.0) -> Difference:
    """The errors of `image` against `reference`, in float64.

    Args:
        image, reference: [height, width] or [height, width, channels], of one shape. uint8 and uint16 count as
            fractions of their largest value.
        mask: [height, width], True (or from one half on) where pixels are compared.
        peak: the largest value that a picture has, for `psnr`.

    Returns:
        The errors over all channels of the compared pixels; printed, they are one line.

    Raises:
        ValueError: shapes that differ, a mask that leaves nothing, a compared value that is not finite, a `peak`
            that is not > 0; traced arrays.
    """
    refuse_traced("compare", image, reference, mask)
    peak = positive("compare: peak", peak)
    a, b = _image("image", image), _image("reference", reference)
    if a.shape != b.shape:
        raise ValueError(f"compare: image has shape {list(np.shape(image))}, reference {list(np.shape(reference))}")
    if mask is None:
        used = np.ones(a.shape[:2], dtype=bool)
    else:
        used = is_chosen(mask, "compare: mask")
        if used.shape != a.shape[:2]:
            raise ValueError(f"compare: mask: expected shape {list(a.shape[:2])}, got {list(used.shape)}")
    if not np.any(used):
        raise ValueError("compare: there is no pixel to compare")
    for what, values in (("image", a), ("reference", b)):
        bad = np.argwhere(used & ~np.all(np.isfinite(values), axis=2))
        if len(bad):
            raise ValueError(f"compare: {what} is not finite at row {bad[0][0]}, column {bad[0][1]}")
    difference = np.where(used[:, :, None], a - b, 0.0) if mask is not None else a - b
    errors, length = difference[used], float(np.linalg.norm(b[used]))
    worst = np.unravel_index(int(np.argmax(np.abs(difference).max(axis=2))), used.shape)
    rmse = float(np.sqrt(np.mean(errors**2)))
    return Difference(
        largest=float(np.abs(errors).max()),
        mean=float(np.abs(errors).mean()),
        rmse=rmse,
        psnr=20 * (math.log10(peak) - math.log10(rmse)) if rmse > 0 else math.inf,
        relative_l2=float(np.linalg.norm(errors)) / length if length > 0 else (math.inf if rmse > 0 else 0.0),
        worst_pixel=(int(worst[0]), int(worst[1])),
        pixels=int(used.sum()),
    )


def _image(what: str, value: Any) -> np.ndarray:
    array = known_numbers(f"compare: {what}", value, "[height, width, channels]")
    if array.ndim not in (2, 3) or array.size == 0:
        raise ValueError(f"compare: {what}: expected [height, width, channels], got {array.dtype} {list(array.shape)}")
    scale = np.iinfo(array.dtype).max if array.dtype in (np.uint8, np.uint16) else 1
    return np.atleast_3d(array).astype(np.float64) / scale
