"""Levels, the integers of 8 or 16 bits in image files, told from numbers of which 1 is the brightest."""

from __future__ import annotations

from typing import Any

import numpy as np


def is_levels(value: Any) -> bool:
    """Whether an array holds unsigned integers of 8 or 16 bits."""
    return getattr(value, "dtype", None) in (np.uint8, np.uint16)


def refuse_levels(where: str, value: Any) -> None:
    """Raise ValueError for an array of levels; taken as numbers they would be up to 255 or 65535."""
    if is_levels(value):
        kind = value.dtype
        raise ValueError(f"{where}: got {kind}; divide by {np.iinfo(kind).max} or use read_image")
