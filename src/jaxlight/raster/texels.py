"""Texture coordinates to the texels around them."""

from __future__ import annotations

import numpy as np


def bilinear_texels(
    texcoord: np.ndarray, width: int, height: int, *, repeat_s: bool, repeat_t: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The four texels around each texture coordinate and their weights, for linear interpolation (X3D Texturing).

    Texel i of n has its centre at (i + 1/2) / n; row 0 is at t = 0. Outside [0, 1] the texture repeats, or its edge
    continues.

    Args:
        texcoord: [N, 2], s and t.
        width, height: of the texture.
        repeat_s, repeat_t: as the texture node says (X3D ImageTexture).

    Returns:
        texels [N, 4], row * width + column, and weights [N, 4] >= 0 that sum to 1.
    """
    columns, right = _along(texcoord[:, 0], width, repeat_s)
    rows, up = _along(texcoord[:, 1], height, repeat_t)
    texels = rows[:, [0, 0, 1, 1]] * width + columns[:, [0, 1, 0, 1]]
    return texels, up[:, [0, 0, 1, 1]] * right[:, [0, 1, 0, 1]]


def _along(coordinate: np.ndarray, size: int, repeat: bool) -> tuple[np.ndarray, np.ndarray]:
    """Two texels along one axis, [N, 2], and their weights."""
    wrapped = coordinate - np.floor(coordinate) if repeat else np.clip(coordinate, 0.0, 1.0)
    place = wrapped * size - 0.5
    low = np.floor(place)
    share = place - low
    texel = np.stack([low, low + 1], axis=1).astype(np.int64)
    texel = texel % size if repeat else np.clip(texel, 0, size - 1)
    return texel, np.stack([1 - share, share], axis=1)
