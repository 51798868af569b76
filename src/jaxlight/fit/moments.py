"""Sums that normal equations are made of: what samples add to J^T r and J^T J."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..lighting.prepared import LANES
from ..lighting.totals import Carry, add_terms, add_terms_in_row
from .columns import Columns
from .residuals import LossKind, half_losses, reweight


class Products(NamedTuple):
    """Sums over samples, channel by channel: products of the derivatives along directions of `Columns` with those along
    all directions, and with the residuals as the last."""

    loss: Float[Array, " lanes"]
    """Half the losses, by lanes."""
    shared: Float[Array, "3 shared products"]
    """Of directions that do not tell materials apart."""
    apart: Float[Array, "*materials 3 apart products"]
    """Of the others; a table of all materials, or what samples of one of them add to its row."""


class Moments(NamedTuple):
    """Sums over samples, by the numbers of a fit."""

    loss: Float[Array, " lanes"]
    """Half the losses, by lanes."""
    slope: Float[Array, " numbers"]
    """J^T r"""
    square: Float[Array, "numbers numbers"]
    """J^T J"""

    def __add__(self, other: Moments) -> Moments:  # sums over more tiles, not a longer tuple
        return jax.tree.map(jnp.add, self, other)


_QUICK = 8
"""Matrices are multiplied quickest where their rows are a multiple of this, if they are not much more for it."""


def rows_of_products(columns: Columns) -> int:
    """How many rows products are quickest of: the directions, the residuals, and some of zeros."""
    rows = columns.count + 1
    more = -rows % _QUICK
    return rows + more if more < _QUICK / 2 else rows


def zero_products(columns: Columns, dtype: Any) -> Products:
    """The products of no sample."""
    shared, apart, products = len(columns.shared), len(columns.apart), columns.count + 1
    table = jnp.zeros((columns.materials, 3, apart, products), dtype)
    return Products(jnp.zeros(LANES, dtype), jnp.zeros((3, shared, products), dtype), table)


def zero_moments(columns: Columns, dtype: Any) -> Moments:
    """The moments of no sample."""
    numbers = columns.channels.shape[1]
    return Moments(jnp.zeros(LANES, dtype), jnp.zeros(numbers, dtype), jnp.zeros((numbers, numbers), dtype))


def products_of(
    rho: tuple[LossKind, Array],
    columns: Columns,
    residual: Float[Array, "3 samples"],
    rows: Float[Array, "3 rows samples"],
) -> Products:
    """The products of some samples, all of one material if materials are told apart, from their derivatives, with the
    residuals as one row more, and maybe rows of zeros."""
    weight = reweight(*rho, residual)
    heard = rows if weight is None else rows * weight[:, None]
    product = jnp.einsum("cip,cjp->cij", heard, rows, precision="highest")[:, : columns.count + 1, : columns.count + 1]
    loss, shared = half_losses(*rho, residual), product[:, :-1]
    if not columns.apart:
        return Products(loss, shared, zero_products(columns, product.dtype).apart)
    return Products(loss, *(product[:, np.asarray(chosen, int)] for chosen in (columns.shared, columns.apart)))


def add_products(carry: Carry, columns: Columns, products: Products, material: Array | int) -> Carry:
    """The running sums with what samples of a material add; it is not asked for if materials are not told apart."""
    return add_terms_in_row(carry, products, material) if columns.apart else add_terms(carry, products)


def moments_of(columns: Columns, products: Products) -> Moments:
    """The moments by numbers; views are not told apart."""
    if columns.count == 0:
        return zero_moments(columns, products.loss.dtype)._replace(loss=products.loss)
    own = _by_number(columns, products)
    slope = jnp.sum(columns.channels * own[..., -1], axis=0)
    square = columns.by_number(own[..., :-1])
    square = jnp.sum(columns.channels[:, :, None] * columns.channels[:, None] * square, axis=0)
    if not columns.apart:
        return Moments(products.loss, slope, square)
    # A row tells of numbers of its own material and of those that are not told apart; of the rest the other row does.
    told = (columns.material < 0) | (columns.material == columns.material[:, None])
    return Moments(products.loss, slope, jnp.where(told, square, jnp.where(told.T, square.T, 0)))


def _by_number(columns: Columns, products: Products) -> Float[Array, "3 numbers products"]:
    """Of every number the products of its direction."""
    place = np.zeros(columns.count, int)
    for rows in (columns.shared, columns.apart):
        place[list(rows)] = np.arange(len(rows))
    own = jnp.asarray(place)[columns.direction]
    if not columns.apart:
        return products.shared[:, own]
    apart = jnp.swapaxes(products.apart[jnp.maximum(columns.material, 0), :, own], 0, 1)
    if not columns.shared:
        return apart
    return jnp.where((columns.material < 0)[:, None], products.shared[:, own], apart)
