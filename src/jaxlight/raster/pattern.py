"""Where the samples of a pixel lie, and in which order pixels are stored."""

from __future__ import annotations

import math

import numpy as np

from ..scene.fields import whole

MAX_SAMPLES = 256


def sample_pattern(samples: int) -> np.ndarray:
    """[samples, 2], places (right, down) in [0, 1): the pixel's centre, or a rotated grid.

    The grid is the rank-1 lattice ((i + 1/2) / k, frac(g i / k) + 1/(2k)) whose g keeps neighbours (also across pixel
    borders) farthest apart: every row and every column of k holds one sample, so edges of any slope come out smooth.

    Raises:
        ValueError: `samples` is not a whole number in [1, 256].
    """
    what = "a whole number of samples a pixel"
    samples = whole("samples", samples, at_least=1, at_most=MAX_SAMPLES, what=what)
    steps = np.arange(samples)
    best = max((g for g in range(1, samples + 1) if math.gcd(g, samples) == 1), key=lambda g: _spread(steps, g))
    return np.stack([steps, steps * best % samples], axis=1) / samples + 0.5 / samples


def _spread(steps: np.ndarray, g: int) -> int:
    """Smallest squared distance between two points of the periodic lattice, in lattice units."""
    count = len(steps)
    down = steps * g % count
    down, right = np.minimum(down, count - down), np.minimum(steps, count - steps)
    return int((right**2 + down**2)[1:].min(initial=count * count))


def morton(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Place of a pixel on the Morton (Z-order) curve: the bits of x and y in turn."""
    code = np.zeros(len(x), dtype=np.int64)
    for bit in range(max(int(x.max(initial=0)).bit_length(), int(y.max(initial=0)).bit_length())):
        code |= ((x >> bit) & 1) << (2 * bit) | ((y >> bit) & 1) << (2 * bit + 1)
    return code
