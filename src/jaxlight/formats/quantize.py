"""Numbers to show -> integers of files; the one place that rounds them."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np


def quantize(image: Any, bits: Literal[8, 16] = 8) -> np.ndarray:
    """Numbers as the integers that files of 8 or 16 bits hold.

    Args:
        image: any shape; clamped to [0, 1], then rounded, halves to the even integer.
        bits: of one integer.

    Returns:
        uint8 or uint16, the same shape.
    """
    levels = np.rint(np.clip(np.asarray(image, dtype=np.float64), 0.0, 1.0) * (2**bits - 1))
    return levels.astype(np.uint8 if bits == 8 else np.uint16)
