"""Derivatives of pixels that gather several samples: taken tile by tile, and added up pixel by pixel.

A pixel's samples may lie in any tiles, so the rows of all pixels of a view are there before their products are taken.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .columns import Columns
from .problem import Problem
from .residuals import pixel_colors, weighted_difference
from .streaming import Tile, over_tiles
from .tile_derivatives import derivatives_by_tile
from .views import ViewData


def pixel_derivatives(
    problem: Problem, view: ViewData, values: Float[Array, " parameters"], columns: Columns
) -> tuple[Float[Array, "3 points"], Float[Array, "3 rows points"]]:
    """The residuals of a view's pixels, and the rows of their derivatives with the residuals as the last."""
    derivatives, pixel = derivatives_by_tile(problem, view, values, columns), view.pixel
    assert pixel is not None

    def of_tile(table: Array, tile: Tile) -> tuple[Array, None]:
        _, given = derivatives(tile)
        return table.at[tile.cut(pixel)].add(tile.turned(given)), None

    def exposure_at(values: Array) -> Array:
        return problem.at(values).exposure[view.row]

    rows = jnp.zeros((view.target.shape[-1] + 1, 3, columns.count + 1), values.dtype)
    rows, _ = over_tiles(problem, view, of_tile, rows, forward=True)
    sums = rows[:-1].transpose(1, 2, 0)  # the last is padding's
    exposure, push = jax.linearize(exposure_at, values)

    def residual_of(exposure: Array, sums: Array) -> Array:
        color = pixel_colors(view, exposure, sums)
        return weighted_difference(color, view.target, view.root_weight, view.dark, view.saturated)

    residual, change = jax.linearize(residual_of, exposure, sums[:, -1])
    by_exposure: Any = jax.vmap(push)(columns.directions)
    changes = jax.vmap(change, in_axes=(0, 1), out_axes=1)(by_exposure, sums[:, :-1])
    return residual, jnp.concatenate([changes, residual[:, None]], axis=1)
