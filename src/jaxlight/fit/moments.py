"""Sums that normal equations are made of: what samples add to J^T r and J^T J."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..raster.samples import LANES
from .columns import Columns
from .residuals import LossKind, half_losses, reweight


class Moments(NamedTuple):
    """Sums over samples, channel by channel; the directions are those of `Columns`."""

    loss: Float[Array, " lanes"]
    """Half the losses, by lanes."""
    slope: Float[Array, "3 directions"]
    """J^T r"""
    square: Float[Array, "3 directions directions"]
    """J^T J"""

    def __add__(self, other: Moments) -> Moments:  # sums over more tiles, not a longer tuple
        return jax.tree.map(jnp.add, self, other)


def zero_moments(columns: Columns, dtype: Any) -> Moments:
    """The moments of no sample."""
    count = columns.count
    return Moments(jnp.zeros(LANES, dtype), jnp.zeros((3, count), dtype), jnp.zeros((3, count, count), dtype))


def moments_of(
    rho: tuple[LossKind, Array], residual: Float[Array, "3 samples"], rows: Float[Array, "3 rows samples"]
) -> Moments:
    """The moments of some samples from their derivatives, with the residuals as the last row."""
    weight = reweight(*rho, residual)
    heard = rows if weight is None else rows * weight[:, None]
    product = jnp.einsum("cip,cjp->cij", heard, rows, precision="highest")
    return Moments(half_losses(*rho, residual), product[:, :-1, -1], product[:, :-1, :-1])
