"""Loss, gradient and Gauss-Newton matrix of a fit, streamed over tiles of samples: J is never held.

This file is the seam between fitting and rendering: solvers know only `loss` and `normal_equations`.

With residuals r (weighted, one a colour of a sample or pixel) and a loss rho:
    loss = 1/2 sum rho(r^2),   gradient = sum rho' J r,   curvature = sum rho' J J^T   (J = dr/dparameters)
where rho(s) = s for squares. Gaussian priors add (x - mean)^2 / 2 variance.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .curvature import NormalEquations
from .parameters import World
from .problem import Problem, scene_of_view
from .residuals import half_loss, reweight, view_colors, weighted_difference
from .streaming import Adder, Tile, over_tiles, over_views, split_inputs, view_inputs
from .texels import neighbour_loss, texel_equations
from .views import ViewData


def loss(problem: Problem, values: Float[Array, " parameters"]) -> Float[Array, ""]:
    """Half the sum of squares (or of the robust loss) at these values, priors included."""

    def of_view(view: ViewData, add: Adder, carry: Any) -> Any:
        if view.pixel is not None:
            return add(carry, (half_loss(*problem.rho, view_residual(problem, problem.at(values), view)),))
        inputs = view_inputs(problem, view, values)

        def of_tile(carry: Any, tile: Tile) -> Any:
            return add(carry, (half_loss(*problem.rho, jax.checkpoint(tile.residual)(inputs)),)), None

        return over_tiles(problem, view, of_tile, carry)[0]

    (total,) = over_views(problem, of_view, (jnp.zeros((), values.dtype),))
    return total + _prior_loss(problem, values)


def normal_equations(problem: Problem, values: Float[Array, " parameters"]) -> NormalEquations:
    """Loss, gradient and Gauss-Newton matrix at these values."""
    if problem.parameters.blocks:
        return texel_equations(problem, values)
    count = values.shape[0]
    directions = jnp.eye(count, dtype=values.dtype)

    def products(residual: Array, jacobian: Array) -> tuple[Array, Array, Array]:
        weight = reweight(*problem.rho, residual)
        jacobian, flat = jacobian.reshape(count, -1), residual.reshape(-1)
        weighted = jacobian if weight is None else jacobian * weight.reshape(-1)
        return half_loss(*problem.rho, residual), _dot(weighted, flat), _dot(weighted, jacobian.T)

    def of_view(view: ViewData, add: Adder, carry: Any) -> Any:
        if view.pixel is not None:
            residual, push = jax.linearize(lambda v: view_residual(problem, problem.at(v), view), values)
            return add(carry, products(residual, jax.lax.map(push, directions)))
        # The scene is linearised once a view, the tiles with respect to what the scene comes to.
        inputs, push = jax.linearize(lambda v: split_inputs(problem, view_inputs(problem, view, v))[0], values)
        fixed = split_inputs(problem, view_inputs(problem, view, values))[1]
        tangents = jax.vmap(push)(directions)

        def of_tile(carry: Any, tile: Tile) -> Any:
            residual, push = jax.linearize(lambda moving: tile.residual(eqx.combine(moving, fixed)), inputs)
            return add(carry, products(residual, jax.vmap(push)(tangents))), None

        return over_tiles(problem, view, of_tile, carry)[0]

    zeros = (jnp.zeros((), values.dtype), jnp.zeros(count, values.dtype), jnp.zeros((count, count), values.dtype))
    total, gradient, curvature = over_views(problem, of_view, zeros)
    parameters = problem.parameters
    gradient = gradient + parameters.prior_precision * (values - parameters.prior_mean)
    curvature = (curvature + curvature.T) / 2 + jnp.diag(parameters.prior_precision)
    return NormalEquations(total + _prior_loss(problem, values), gradient, curvature)


def residuals(problem: Problem, values: Float[Array, " parameters"]) -> tuple[Array, ...]:
    """All residuals, one array a stack of views, and the priors': the same sum of squares as `loss` for squares.

    For optimistix's own solvers and implicit derivatives; the steps of a fit never call it.
    """
    world = problem.at(values)
    parts = tuple(jax.vmap(lambda view: view_residual(problem, world, view))(stack) for stack in problem.views)
    parameters = problem.parameters
    return (*parts, jnp.sqrt(parameters.prior_precision) * (values - parameters.prior_mean))


def view_residual(problem: Problem, world: World, view: ViewData) -> Float[Array, "3 points"]:
    """The weighted residuals of one view, all points at once, in storage order."""
    color = view_colors(scene_of_view(world, view), view, world.exposure[view.row])
    return weighted_difference(color, view.target, view.root_weight, view)


def _prior_loss(problem: Problem, values: Array) -> Array:
    parameters = problem.parameters
    gaussian = jnp.sum(parameters.prior_precision * (values - parameters.prior_mean) ** 2) / 2
    return gaussian + sum((neighbour_loss(block, values) for block in parameters.blocks), jnp.zeros((), values.dtype))


def _dot(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision="highest")
