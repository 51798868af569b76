"""Which numbers a bound holds: those that the pictures would move beyond it.

What presses a number against its bound is the slope that is left when the numbers that are not held have gone to their
best: g_i - H_iF H_FF^-1 g_F, with the curvature H_ii - H_iF H_FF^-1 H_Fi. The rounding of the fitted values drops out
of it. Where that curvature is 0, the others undo whatever the number does: then no bound holds it, it can be traded.
"""

from __future__ import annotations

import numpy as np

from .identify import NULL, Seen, analyse, scaled_eigen

SIGNIFICANT = 3.0
"""Standard errors by which the pictures must want a number beyond its bound."""


def held_by_bounds(
    curvature: np.ndarray,
    precision: np.ndarray,
    gradient: np.ndarray,
    scale: np.ndarray,
    size: np.ndarray,
    side: np.ndarray,
    fixed: np.ndarray,
    noise: float,
) -> np.ndarray:
    """True for the numbers that a bound holds.

    Args:
        curvature, precision, scale, size: as for `analyse`.
        gradient: slope of the loss, texels eliminated.
        side: -1 for numbers on their lower bound, 1 on their upper, 0 on none.
        fixed: True for numbers whose bounds are one: they are held whatever the pictures want.
        noise: standard deviation of a residual.
    """
    held = fixed | (side * gradient < 0)
    while np.any(held & ~fixed):
        seen = analyse(curvature, precision, held, scale, size)
        # What only priors tell moves no picture, and so does not answer.
        inverse = inverse_of_seen(curvature, held, seen)
        answers = curvature @ inverse
        slope = gradient - answers @ gradient
        bend = np.maximum(np.diagonal(curvature) - np.sum(answers * curvature, axis=1), 0)
        pressed = (side * slope < 0) & (bend > NULL * scale**2) & (np.abs(slope) > SIGNIFICANT * noise * np.sqrt(bend))
        if np.all((pressed | fixed)[held]):
            break
        held &= pressed | fixed
    return held


def inverse_of_seen(curvature: np.ndarray, held: np.ndarray, seen: Seen) -> np.ndarray:
    """Inverse over the numbers that are seen and not held, without the directions that no picture tells."""
    rows, dropped = np.flatnonzero(~held & ~seen.unseen), len(seen.null) + len(seen.by_priors)
    inverse, scale = np.zeros_like(curvature), seen.scale
    if len(rows) > dropped:
        eigenvalues, vectors = scaled_eigen(curvature, rows, scale)
        vectors = vectors[:, dropped:] / scale[rows][:, None]
        inverse[np.ix_(rows, rows)] = (vectors / eigenvalues[dropped:]) @ vectors.T
    return inverse


def inverse_of_priors(precision: np.ndarray, seen: Seen) -> np.ndarray:
    """The same over the directions that only priors tell."""
    directions = seen.by_priors / np.where(seen.scale > 0, seen.scale, 1)
    curvature = (directions * precision) @ directions.T
    lengths = np.sqrt(np.diagonal(curvature))
    directions /= lengths[:, None]
    return directions.T @ np.linalg.inv(curvature / (lengths[:, None] * lengths[None, :])) @ directions
