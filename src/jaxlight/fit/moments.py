"""Sums that normal equations are made of: what samples add to J^T r and J^T J."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..lighting.totals import Carry, add_terms, add_terms_in_row
from ..raster.samples import LANES
from .columns import Columns
from .residuals import LossKind, half_losses, reweight


class Moments(NamedTuple):
    """Sums over samples, channel by channel: products of the derivatives along directions of `Columns` with those along
    all directions, and with the residuals as the last."""

    loss: Float[Array, " lanes"]
    """Half the losses, by lanes."""
    shared: Float[Array, "3 shared products"]
    """Of directions that are not told apart by material."""
    apart: Float[Array, "*materials 3 apart products"]
    """Of the others; a table of all materials, or what samples of one of them add to its row."""

    def __add__(self, other: Moments) -> Moments:  # sums over more tiles, not a longer tuple
        return jax.tree.map(jnp.add, self, other)


def zero_moments(columns: Columns, dtype: Any) -> Moments:
    """The moments of no sample."""
    shared, apart, products = len(columns.shared), len(columns.apart), columns.count + 1
    table = jnp.zeros((columns.materials, 3, apart, products), dtype)
    return Moments(jnp.zeros(LANES, dtype), jnp.zeros((3, shared, products), dtype), table)


def moments_of(
    rho: tuple[LossKind, Array],
    columns: Columns,
    residual: Float[Array, "3 samples"],
    rows: Float[Array, "3 rows samples"],
) -> Moments:
    """The moments of some samples, all of one material if materials are told apart, from their derivatives, with the
    residuals as the last row."""
    weight = reweight(*rho, residual)
    heard = rows if weight is None else rows * weight[:, None]
    product = jnp.einsum("cip,cjp->cij", heard, rows, precision="highest")
    loss, shared = half_losses(*rho, residual), product[:, :-1]
    if not columns.apart:
        return Moments(loss, shared, zero_moments(columns, product.dtype).apart)
    return Moments(loss, *(product[:, np.asarray(chosen, int)] for chosen in (columns.shared, columns.apart)))


def add_moments(carry: Carry, columns: Columns, moments: Moments, material: Array | int) -> Carry:
    """The running sums with what samples of a material add; it is not asked for if materials are not told apart."""
    return add_terms_in_row(carry, moments, material) if columns.apart else add_terms(carry, moments)


def slope_and_square(
    columns: Columns, moments: Moments
) -> tuple[Float[Array, " numbers"], Float[Array, "numbers numbers"]]:
    """J^T r and J^T J."""
    products = _by_number(columns, moments)
    slope = jnp.sum(columns.channels * products[..., -1], axis=0)
    square = columns.by_number(products[..., :-1])
    square = jnp.sum(columns.channels[:, :, None] * columns.channels[:, None] * square, axis=0)
    if not columns.apart:
        return slope, square
    # A row tells of numbers of its own material and of those that are not told apart; of the rest the other row does.
    told = (columns.material < 0) | (columns.material == columns.material[:, None])
    return slope, jnp.where(told, square, jnp.where(told.T, square.T, 0))


def _by_number(columns: Columns, moments: Moments) -> Float[Array, "3 numbers products"]:
    """Of every number the products of its direction."""
    place = np.zeros(columns.count, int)
    for rows in (columns.shared, columns.apart):
        place[list(rows)] = np.arange(len(rows))
    own = jnp.asarray(place)[columns.direction]
    if not columns.apart:
        return moments.shared[:, own]
    apart = jnp.swapaxes(moments.apart[jnp.maximum(columns.material, 0), :, own], 0, 1)
    if not columns.shared:
        return apart
    return jnp.where((columns.material < 0)[:, None], moments.shared[:, own], apart)
