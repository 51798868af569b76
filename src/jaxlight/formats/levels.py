"""Levels, the integers of 8 or 16 bits in image files, told from numbers of which 1 is the brightest."""

from __future__ import annotations

from typing import Any

import numpy as np
from jax.core import Tracer

from ..arrays import known_numbers


def is_levels(value: Any) -> bool:
    """Whether an array holds unsigned integers of 8 or 16 bits."""
    return getattr(value, "dtype", None) in (np.uint8, np.uint16)


def are_bytes(largest: float) -> bool:
    """Whether colours of floats, of which this is the largest, mean 0 to 255: a little above 1 a light may be."""
    return largest > 2.0


def look_like_levels(colors: np.ndarray) -> bool:
    """Whether floats are whole numbers as levels are, of a picture that was not divided by the largest."""
    return bool(colors.size and np.all(colors == np.round(colors)) and are_bytes(float(np.max(colors))))


def refuse_levels(where: str, value: Any, advice: str = " or use read_image") -> None:
    """Raise ValueError for an array of levels, also for those in wider integers: whole numbers above 1.

    Taken as numbers they would be up to 255 or 65535. `advice`: what can be done other than to divide them.
    """
    if is_levels(value):
        raise ValueError(f"{where}: got {value.dtype}; divide by {np.iinfo(value.dtype).max}{advice}")
    kind = getattr(value, "dtype", None)
    if not isinstance(kind, np.dtype) or isinstance(value, Tracer) or not np.issubdtype(kind, np.integer):
        return  # no array of NumPy or JAX, or no known integers
    if np.any(np.asarray(value) > 1):
        raise ValueError(f"{where}: got {kind} above 1; divide by the largest level (255 of 8 bits){advice}")


def is_chosen(mask: Any, where: str = "mask") -> np.ndarray:
    """What a mask chooses, in its own shape: True from one half on, of levels from above half of the largest one.

    Levels of which none is above 1 are truth values, as other whole numbers are.

    Raises:
        ValueError: no numbers, or NaN among them; begins with `where`.
    """
    array = known_numbers(where, mask, "numbers or truth values")
    if array.dtype.kind == "f":
        if np.any(np.isnan(array)):
            raise ValueError(f"{where}: {np.count_nonzero(np.isnan(array))} of its {array.size} numbers are NaN")
        return array >= 0.5
    if is_levels(array) and np.any(array > 1):
        return array > np.iinfo(array.dtype).max // 2
    return array != 0
