"""Levels, the integers of 8 or 16 bits in image files, told from numbers of which 1 is the brightest."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import known_numbers


def is_levels(value: Any) -> bool:
    """Whether an array holds unsigned integers of 8 or 16 bits."""
    return getattr(value, "dtype", None) in (np.uint8, np.uint16)


def refuse_levels(where: str, value: Any) -> None:
    """Raise ValueError for an array of levels; taken as numbers they would be up to 255 or 65535."""
    if is_levels(value):
        kind = value.dtype
        raise ValueError(f"{where}: got {kind}; divide by {np.iinfo(kind).max} or use read_image")


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
