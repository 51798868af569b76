"""Normal equations of a fit in which whole textures are free: the texels are kept as an arrow, never as a matrix.

A colour is linear in the sampled texel: with e = dr/d(sampled colour), one number a colour and sample, the texels'
part is sum over samples of w w^T e^2 with the sampling weights w. One pass over the tiles gives e, the gradient, the
coupling to the other numbers and the rows' sums.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..lighting.totals import add_terms, added_up
from .columns import Columns
from .curvature import ArrowCurvature, Neighbours, NormalEquations
from .moments import Products, moments_of, products_of, zero_products
from .parameters import TexelBlock
from .problem import Problem
from .residuals import reweight
from .sampling import block_of
from .streaming import Tile, over_tiles, view_inputs, with_textures
from .tile_derivatives import derivatives_by_tile
from .views import ViewData

_EDGE = 1e-2
"""Difference of neighbouring texels below which the total variation is smooth."""


def texel_equations(problem: Problem, values: Float[Array, " parameters"]) -> NormalEquations:
    """Loss, gradient and curvature at these values, priors included."""
    parameters, columns, dtype = problem.parameters, problem.columns, values.dtype

    def of_view(carry: Any, view: ViewData) -> tuple[Any, Any]:
        inputs = view_inputs(problem, view, values)
        images = inputs.prepared.textures
        derivatives = derivatives_by_tile(problem, view, values, columns)

        def of_tile(carry: Any, tile: Tile) -> tuple[Any, Any]:
            sums, tables = carry
            residual, given = derivatives(tile)
            sums = add_terms(sums, products_of(problem.rho, columns, residual, given))
            block = block_of(tile.run, parameters.blocks)
            if block < 0:
                return (sums, tables), None
            change = _change_by_texel(tile, inputs, images, parameters.blocks[block])
            weight = reweight(*problem.rho, residual)
            heard = change if weight is None else change * weight
            if parameters.blocks[block].shape[2] == 3:
                strength, products = change * heard, heard[:, None] * given
            else:
                strength = jnp.sum(change * heard, axis=0, keepdims=True)
                rows = jnp.concatenate([columns.jacobian(given[:, :-1]), residual[None]])
                products = jnp.sum(heard * rows, axis=1)[None]
            index = tile.cut(view.samples.texel_index).reshape(-1)  # type: ignore[arg-type]  # the block's samples have it
            tables = list(tables)
            tables[block] = tables[block].at[index].add(_texel_rows(tile, products, strength))
            return (sums, tuple(tables)), strength

        carry, strengths = over_tiles(problem, view, of_tile, carry, forward=True)
        # [tiles, colours, tile] -> [colours, slots of the run]
        planes = [None if s is None else jnp.moveaxis(s, 1, 0).reshape(s.shape[1], -1) for s in strengths]
        return carry, planes

    zeros = zero_products(columns, dtype)
    tables = [
        jnp.zeros((height * width, colors, (columns.count if colors == 3 else parameters.few) + 2), dtype)
        for height, width, colors in (block.shape for block in parameters.blocks)
    ]
    carry: Any = ((tuple(zeros), tuple(jax.tree.map(jnp.zeros_like, zeros))), tuple(tables))
    strengths = []
    for stack in problem.views:
        carry, planes = jax.lax.scan(of_view, carry, stack)
        strengths.append(planes)
    moments = moments_of(columns, Products(*added_up(carry[0])))
    few = (jnp.sum(moments.loss), moments.slope, moments.square)
    cross = jnp.concatenate([_by_number(columns, table[..., :-2]) for table in carry[1]])
    texel_part = tuple(jnp.concatenate([table[..., column].reshape(-1) for table in carry[1]]) for column in (-2, -1))
    return _assembled(problem, values, few, cross, texel_part, strengths)


def _by_number(columns: Columns, products: Float[Array, "texels colors rows"]) -> Float[Array, "all numbers"]:
    """The coupling of texels to numbers: three colours are coupled to directions, a channel each; one to numbers."""
    if products.shape[1] == 3:
        products = columns.by_number(products) * columns.channels
    texels, colors, numbers = products.shape
    return products.reshape(texels * colors, numbers)


def _change_by_texel(tile: Tile, inputs: Any, images: tuple[Array, ...], block: TexelBlock) -> Array:
    """e [3, samples]: derivative of each residual by the sampled colour (of its own channel, or the only one)."""
    image = images[block.texture]
    ones = jnp.zeros_like(image).at[..., : block.shape[2]].set(1)

    def residual(own: Array) -> Array:
        return tile.residual(with_textures(inputs, (*images[: block.texture], own, *images[block.texture + 1 :])))

    change = jax.jvp(residual, (image,), (ones,))[1]
    total = jnp.sum(tile.cut(tile.view.samples.texel_weight), axis=0)  # type: ignore[arg-type]  # its samples have it
    return jnp.where(total != 0, change / jnp.where(total != 0, total, 1), 0)


def _texel_rows(
    tile: Tile, products: Float[Array, "colors rows samples"], strength: Float[Array, "colors samples"]
) -> Float[Array, "corners colors columns"]:
    """What a tile adds to the four texels that each sample sees: products with e, and the row sum of squares."""
    weight = tile.cut(tile.view.samples.texel_weight)  # type: ignore[arg-type]  # the block's samples have it
    row_sum = strength * jnp.sum(jnp.abs(weight), axis=0)
    turned = tile.turned(products, row_sum[:, None])  # before it becomes four times as large
    return (weight[:, :, None, None] * turned).reshape(-1, *turned.shape[1:])


def _assembled(
    problem: Problem, values: Array, few: tuple[Array, ...], cross: Array, texel_part: tuple[Array, ...], strengths: Any
) -> NormalEquations:
    """The sums and the priors put together."""
    parameters = problem.parameters
    count = parameters.few
    slope, row_sum = texel_part
    precision = parameters.prior_precision
    neighbours, slopes, degrees, loss = [], [], [], few[0]
    for block in parameters.blocks:
        image = block.image(values)
        weights = neighbour_weights(block, image)
        neighbours.append(weights)
        slopes.append(weights.product(image).reshape(-1))
        degrees.append(weights.degree().reshape(-1))
        loss = loss + neighbour_loss(block, values)
    degree = jnp.concatenate(degrees)
    kept = [
        tuple(None if sampling.single else plane for plane in planes)
        for sampling, planes in zip(problem.sampling, strengths, strict=True)
    ]
    own = precision[count:]
    if all(sampling.single for sampling in problem.sampling):
        own = own + row_sum  # with one texel a sample nothing else is in a row
    elif any(sampling.single for sampling in problem.sampling):
        kept = [tuple(planes) for planes in strengths]
    curvature = ArrowCurvature(
        few=(few[2] + few[2].T) / 2 + jnp.diag(precision[:count]),
        cross=cross,
        row_sum=row_sum + precision[count:] + 2 * degree,
        strengths=tuple(kept),
        own=own,
        neighbours=tuple(neighbours),
        shapes=tuple(block.shape for block in parameters.blocks),
    )
    gradient = jnp.concatenate([few[1], slope + jnp.concatenate(slopes)])
    gradient = gradient + parameters.gaussian_slope(values)
    return NormalEquations(loss + parameters.gaussian_loss(values), gradient, curvature)


def neighbour_loss(block: TexelBlock, values: Float[Array, " parameters"]) -> Float[Array, ""]:
    """Smoothness and total variation of one texture: s/2 sum d^2 + t sum sqrt(d^2 + edge^2) over neighbours."""
    image = block.image(values)
    total = jnp.zeros((), values.dtype)
    for difference in (image[:, 1:] - image[:, :-1], image[1:] - image[:-1]):
        edge = jnp.sqrt(difference**2 + _EDGE**2) - _EDGE
        total = total + block.smoothness * jnp.sum(difference**2) / 2 + block.total_variation * jnp.sum(edge)
    return total


def neighbour_weights(block: TexelBlock, image: Float[Array, "height width colors"]) -> Neighbours:
    """The weights with which squared differences have the slope of `neighbour_loss` at this image."""

    def weight(difference: Array) -> Array:
        return block.smoothness + block.total_variation / jnp.sqrt(difference**2 + _EDGE**2)

    return Neighbours(across=weight(image[:, 1:] - image[:, :-1]), down=weight(image[1:] - image[:-1]))
