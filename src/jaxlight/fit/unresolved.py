"""What only priors tell, and a fit did not find: its precision rounded it away beside what precise pictures tell.

Along a direction of which the pictures tell nothing, the slope that is left and the priors' own curvature say by how
many standard errors the values are off.
"""

from __future__ import annotations

import numpy as np

from .identify import ZERO, Seen, scaled_eigen

FAR = 0.25
"""Standard errors from which on it is said."""


def off_by_priors(
    curvature: np.ndarray,
    precision: np.ndarray,
    gradient: np.ndarray,
    side: np.ndarray,
    held: np.ndarray,
    seen: Seen,
    eps: float,
) -> float:
    """Standard errors by which the values are off along the worst direction that only priors tell; 0: there is none.

    Args:
        curvature, precision, gradient, side: as for `held_by_bounds`.
        held: numbers that bounds hold.
        seen: the numbers sorted.
        eps: rounding of the fit's own precision.
    """
    use = np.flatnonzero(~held & ~seen.unseen)
    scale = seen.scale[use]
    eigenvalues, vectors = scaled_eigen(curvature, use, seen.scale)
    told = (precision[use] / scale**2) @ vectors**2
    moving = np.linalg.norm(vectors[precision[use] > 0], axis=0) > ZERO
    lost = moving & (eigenvalues < eps * len(use)) & (eigenvalues < 2 * told)
    vectors, told = vectors[:, lost], told[lost]
    slope = (gradient[use] / scale) @ vectors
    # Where a bound is in the way, the values are at their best.
    stopped = np.any((np.abs(vectors) > ZERO) & (side[use][:, None] * -slope * vectors > 0), axis=0)
    return float(np.max(np.where(stopped, 0, np.abs(slope) / np.sqrt(told)), initial=0))
