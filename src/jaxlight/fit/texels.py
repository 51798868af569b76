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

from ..raster.samples import LANES
from .curvature import ArrowCurvature, Neighbours, NormalEquations
from .parameters import TexelBlock
from .problem import Problem
from .residuals import half_losses, reweight
from .sampling import block_of
from .streaming import Tile, add_terms, added_up, over_tiles, view_inputs, with_textures
from .tile_derivatives import derivatives_by_tile
from .views import ViewData

_EDGE = 1e-2
"""Difference of neighbouring texels below which the total variation is smooth."""


def texel_equations(problem: Problem, values: Float[Array, " parameters"]) -> NormalEquations:
    """Loss, gradient and curvature at these values, priors included."""
    parameters = problem.parameters
    count, dtype = parameters.few, values.dtype

    def of_view(carry: Any, view: ViewData) -> tuple[Any, Any]:
        inputs = view_inputs(problem, view, values)
        images = inputs.prepared.textures
        derivatives = derivatives_by_tile(problem, view, values, problem.columns)

        def of_tile(carry: Any, tile: Tile) -> tuple[Any, Any]:
            sums, tables = carry
            residual, given = derivatives(tile)
            jacobian = problem.columns.jacobian(given[:, :-1])
            weight = reweight(*problem.rho, residual)
            heard = jnp.ones_like(residual) if weight is None else weight
            flat = (jacobian * heard).reshape(count, residual.size)
            sums = add_terms(
                sums,
                (
                    half_losses(*problem.rho, residual),
                    jnp.matmul(flat, residual.reshape(-1), precision="highest"),
                    jnp.matmul(flat, jacobian.reshape(count, residual.size).T, precision="highest"),
                ),
            )
            block = block_of(tile.run, parameters.blocks)
            if block < 0:
                return (sums, tables), None
            change = _change_by_texel(tile, inputs, images, parameters.blocks[block])
            rows, strength = _texel_rows(tile, parameters.blocks[block].shape[2], change, heard, residual, jacobian)
            index = tile.cut(view.samples.texel_index).reshape(-1)  # type: ignore[arg-type]  # the block's samples have it
            tables = list(tables)
            tables[block] = tables[block].at[index].add(rows)
            return (sums, tuple(tables)), strength

        carry, strengths = over_tiles(problem, view, of_tile, carry, forward=True)
        # [tiles, colours, tile] -> [colours, slots of the run]
        planes = [None if s is None else jnp.moveaxis(s, 1, 0).reshape(s.shape[1], -1) for s in strengths]
        return carry, planes

    zeros = (jnp.zeros(LANES, dtype), jnp.zeros(count, dtype), jnp.zeros((count, count), dtype))
    carry = (
        (zeros, jax.tree.map(jnp.zeros_like, zeros)),
        tuple(jnp.zeros((b.shape[0] * b.shape[1], b.shape[2], count + 3), dtype) for b in parameters.blocks),
    )
    strengths = []
    for stack in problem.views:
        carry, planes = jax.lax.scan(of_view, carry, stack)
        strengths.append(planes)
    total, gradient, dense = added_up(carry[0])
    table = jnp.concatenate([part.reshape(-1, count + 3) for part in carry[1]])
    texel_part = (table[:, count], table[:, count + 1], table[:, count + 2])
    return _assembled(problem, values, (jnp.sum(total), gradient, dense), table[:, :count], texel_part, strengths)


def _change_by_texel(tile: Tile, inputs: Any, images: tuple[Array, ...], block: TexelBlock) -> Array:
    """e [3, samples]: derivative of each residual by the sampled colour (of its own channel, or the only one)."""
    image = images[block.texture]
    ones = jnp.zeros_like(image).at[..., : block.shape[2]].set(1)

    def residual(own: Array) -> Array:
        return tile.residual(with_textures(inputs, (*images[: block.texture], own, *images[block.texture + 1 :])))

    change = jax.jvp(residual, (image,), (ones,))[1]
    total = jnp.sum(tile.cut(tile.view.samples.texel_weight), axis=0)  # type: ignore[arg-type]
    return jnp.where(total != 0, change / jnp.where(total != 0, total, 1), 0)


def _texel_rows(
    tile: Tile, colors: int, change: Array, heard: Array, residual: Array, jacobian: Array
) -> tuple[Array, Array]:
    """What a tile adds to the texels it sees, [4 samples, colours, few + 3], and e^2 [colours, samples].

    Columns: coupling to the numbers with labels, gradient, diagonal, row sum.
    """
    weight = tile.cut(tile.view.samples.texel_weight)  # type: ignore[arg-type]  # the block's samples have it

    def by_color(channels: Array) -> Array:
        return channels if colors == 3 else jnp.sum(channels, axis=-2, keepdims=True)

    strength = by_color(change * change * heard)
    coupled = by_color(change * heard * jacobian)
    slope = by_color(change * heard * residual)
    linear = jnp.concatenate([coupled, slope[None]])
    corners = jnp.concatenate(
        [
            weight[None, None] * linear[:, :, None],
            (weight * weight)[None, None] * strength[None, :, None],
            (weight * jnp.sum(jnp.abs(weight), axis=0))[None, None] * strength[None, :, None],
        ]
    )
    # [columns, colours, 4, samples] -> [4 samples, colours, columns]
    return corners.reshape(*corners.shape[:2], -1).transpose(2, 1, 0), strength


def _assembled(
    problem: Problem, values: Array, few: tuple[Array, ...], cross: Array, texel_part: tuple[Array, ...], strengths: Any
) -> NormalEquations:
    """The sums and the priors put together."""
    parameters = problem.parameters
    count = parameters.few
    slope, diagonal, row_sum = texel_part
    pull = parameters.prior_precision * (values - parameters.prior_mean)
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
        own = own + diagonal
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
    gradient = jnp.concatenate([few[1], slope + jnp.concatenate(slopes)]) + pull
    prior = jnp.sum(precision * (values - parameters.prior_mean) ** 2) / 2
    return NormalEquations(loss + prior, gradient, curvature)


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
