"""Loss, gradient and Gauss-Newton matrix of a fit, streamed over tiles of samples: J is never held, but for pixels that
gather several samples (`pixels`).

Solvers know only `loss` and `normal_equations`.

With residuals r (weighted, one a colour of a sample or pixel) and a loss rho:
    loss = 1/2 sum rho(r^2),   gradient = sum rho' J r,   curvature = sum rho' J J^T   (J = dr/dparameters)
where rho(s) = s for squares. Gaussian priors add (x - mean)^2 / 2 variance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ..lighting.prepared import LANES
from ..lighting.tiles import Share, tiles_at_once
from ..lighting.totals import add_terms, added_up
from .columns import Columns
from .curvature import DenseCurvature, NormalEquations
from .moments import (
    Moments,
    Products,
    add_products,
    moments_of,
    products_of,
    rows_of_products,
    zero_moments,
    zero_products,
)
from .parameters import World
from .pixels import pixel_derivatives
from .problem import Problem, scene_of_view
from .residuals import half_losses, reweight, view_colors, weighted_difference
from .streaming import (
    Adder,
    Tile,
    over_tiles,
    over_views,
    sum_over_tiles,
    view_inputs,
)
from .texels import neighbour_loss, texel_equations
from .tile_derivatives import derivatives_by_tile, parts_of
from .views import ViewData


def loss(problem: Problem, values: Float[Array, " parameters"], *, by_view: bool = False) -> Float[Array, ""]:
    """Half the sum of squares (or of the robust loss) at these values, of all samples, priors included.

    `by_view`: residuals are those of whole views, for derivatives by what is as large.
    """

    def of_view(view: ViewData, add: Adder, carry: Any) -> Any:
        def of_part(carry: Any, residual: Array) -> tuple[Any, None]:
            return add(carry, (half_losses(*problem.rho, residual),)), None

        if view.pixel is not None:
            return of_part(carry, view_residual(problem.at(values), view))[0]
        if by_view:
            residual = view_residual(problem.at(values), view)
            parts = jnp.swapaxes(residual.reshape(3, -1, view.samples.tile), 0, 1)
            return jax.lax.scan(of_part, carry, parts)[0]
        together = _together(problem, view)
        inputs = view_inputs(problem, view, values, together)

        def of_tile(carry: Any, tile: Tile) -> Any:
            return of_part(carry, jax.checkpoint(tile.residual)(inputs))[0]

        return _over_all(problem, view, of_tile, carry, together)

    (total,) = over_views(problem, of_view, (jnp.zeros(LANES, values.dtype),))
    return jnp.sum(total) + prior_loss(problem, values)


def _together(problem: Problem, view: ViewData) -> int:
    return tiles_at_once(problem.world.scene, view.samples, view.plan)


def _over_all(problem: Problem, view: ViewData, of_tile: Callable[[Any, Tile], Any], carry: Any, together: int) -> Any:
    return over_tiles(problem, view, lambda carry, tile: (of_tile(carry, tile), None), carry, together=together)[0]


def loss_and_gradient(problem: Problem, values: Float[Array, " parameters"]) -> tuple[Array, Array]:
    """`loss` and its gradient in one pass: every tile is differentiated as soon as it is evaluated."""
    if problem.parameters.blocks:  # a gradient by every texel is too large to be taken tile by tile
        return jax.value_and_grad(lambda v: loss(problem, v, by_view=True))(values)

    def of_view(view: ViewData, add: Adder, carry: Any) -> Any:
        if view.pixel is not None:
            return add(carry, pulled(lambda v: view_residual(problem.at(v), view), values))

        together = _together(problem, view)
        parts = parts_of(problem, view, values, together)

        def of_tile(carry: Any, tile: Tile) -> Any:
            colors, slopes_of = zip(*(part.color_and_slope(tile) for part in parts), strict=True)
            residual, pull_both = jax.vjp(tile.residual_of, parts[0].inputs.exposure, colors[0])
            exposure, color = pull_both(heard(residual))
            slopes = [slope_of(color) for slope_of in slopes_of]
            if parts[0].moving.exposure is not None:
                slopes[0] = slopes[0]._replace(exposure=exposure)
            return add_terms(carry, (ravel_pytree((half_losses(*problem.rho, residual), slopes))[0],))

        # As one array: of several, each would be copied for every tile.
        zeros, apart = ravel_pytree((jnp.zeros(LANES, values.dtype), [part.zeros for part in parts]))
        (total,) = added_up(_over_all(problem, view, of_tile, ((zeros,), (zeros,)), together))
        value, slopes = apart(total)
        gradients = [part.pull(slope) for part, slope in zip(parts, slopes, strict=True)]
        return add(carry, (value, sum(gradients[1:], gradients[0])))

    def pulled(residual_at: Callable[[Any], Array], at: Any) -> tuple[Array, Any]:
        """The loss, by lanes, and its gradient."""
        residual, pull = jax.vjp(residual_at, at)
        return half_losses(*problem.rho, residual), pull(heard(residual))[0]

    def heard(residual: Array) -> Array:
        weight = reweight(*problem.rho, residual)
        return residual if weight is None else weight * residual

    total, gradient = over_views(problem, of_view, (jnp.zeros(LANES, values.dtype), jnp.zeros_like(values)))
    prior, prior_gradient = jax.value_and_grad(lambda v: prior_loss(problem, v))(values)
    return jnp.sum(total) + prior, gradient + prior_gradient


def normal_equations(problem: Problem, values: Float[Array, " parameters"]) -> NormalEquations:
    """Loss, gradient and Gauss-Newton matrix at these values, of the samples that `problem.every` chooses."""
    if problem.parameters.blocks:
        return texel_equations(problem, values)
    return equations_of(problem, values, model_moments(problem, values))


def no_moments(problem: Problem) -> Moments:
    """The moments of all directions over no tile."""
    return zero_moments(problem.columns, problem.parameters.start.dtype)


def model_moments(problem: Problem, values: Float[Array, " parameters"], share: Share | None = None) -> Moments:
    """The moments of all directions, over all tiles or a share of them."""
    return _moments(problem, values, problem.columns, share)


def equations_of(problem: Problem, values: Float[Array, " parameters"], moments: Moments) -> NormalEquations:
    """The normal equations at these values from their moments, priors included."""
    parameters = problem.parameters
    gradient = moments.slope + parameters.gaussian_slope(values)
    curvature = (moments.square + moments.square.T) / 2 + jnp.diag(parameters.prior_precision)
    return NormalEquations(_loss_of(problem, values, moments), gradient, curvature)


def settled(
    problem: Problem, values: Float[Array, " parameters"]
) -> tuple[Float[Array, " parameters"], Float[Array, ""]]:
    """The values with the numbers that are linear together at their best (variable projection), and the loss there.

    Of the samples that `problem.every` chooses. Where residuals are not linear (robust losses, sensor limits) or texels
    are eliminated anyway, the values stay.
    """
    return settled_by(problem, values, trial_moments(problem, values))


def trial_moments(problem: Problem, values: Float[Array, " parameters"], share: Share | None = None) -> Moments:
    """The moments of the directions that `settled_by` settles, over all tiles or a share of them."""
    return _moments(problem, values, _settling(problem), share)


def settled_by(
    problem: Problem, values: Float[Array, " parameters"], moments: Moments
) -> tuple[Float[Array, " parameters"], Float[Array, ""]]:
    """`settled` from its moments."""
    columns, parameters = _settling(problem), problem.parameters
    if columns.count == 0:
        return values, _loss_of(problem, values, moments)
    here, gradient, curvature = equations_of(problem, values, moments)
    moves = jnp.any(columns.channels > 0, axis=0)
    lower, upper = (jnp.where(moves, bound - values, 0) for bound in (parameters.lower, parameters.upper))
    lengths = jnp.sqrt(jnp.maximum(jnp.diagonal(curvature), 0))
    scale = jnp.where(lengths > 0, lengths, 1)
    change = DenseCurvature(curvature).minimise((), gradient, scale, jnp.zeros((), values.dtype), lower, upper).point
    best = jnp.clip(values + change, parameters.lower, parameters.upper)
    # The loss is the quadratic itself.
    change = jnp.where(moves, best - values, 0)
    there = here + _dot(change, gradient + _dot(curvature, change) / 2)
    usable = jnp.isfinite(there)
    return jnp.where(usable, best, values), jnp.where(usable, jnp.maximum(there, 0), here)


def _settling(problem: Problem) -> Columns:
    """The directions in which a trial is settled: those that are linear together, or none."""
    columns = problem.columns.linear()
    return columns if problem.settles else columns.first(0)


def _moments(problem: Problem, values: Array, columns: Columns, share: Share | None) -> Moments:
    def products_added(carry: Any, view: ViewData) -> Any:
        if view.pixel is not None:
            return add_terms(
                carry, products_of(problem.rho, columns, *pixel_derivatives(problem, view, values, columns))
            )
        derivatives = derivatives_by_tile(problem, view, values, columns, rows_of_products(columns))

        def of_tile(carry: Any, tile: Tile) -> Any:
            return add_products(carry, columns, products_of(problem.rho, columns, *derivatives(tile)), tile.material)

        return sum_over_tiles(problem, view, of_tile, carry, share)

    def view_added(view: ViewData, add: Adder, carry: Any) -> Any:
        products = added_up(products_added((zeros, jax.tree.map(jnp.zeros_like, zeros)), view))
        return add(carry, moments_of(columns.of_view(view.row), Products(*products)))

    zeros = tuple(zero_products(columns, values.dtype))
    if columns.by_view:
        return Moments(*over_views(problem, view_added, tuple(zero_moments(columns, values.dtype))))
    products = over_views(problem, lambda view, _, carry: products_added(carry, view), zeros)
    return moments_of(columns, Products(*products))


def _loss_of(problem: Problem, values: Array, moments: Moments) -> Array:
    return jnp.sum(moments.loss) + prior_loss(problem, values)


def residuals(problem: Problem, values: Float[Array, " parameters"]) -> tuple[Array, ...]:
    """All residuals, one array a stack of views, and the priors': the same sum of squares as `loss` for squares.

    What is minimised, as optimistix asks for it; of a fit it takes the shapes alone.
    """
    world = problem.at(values)
    parts = tuple(jax.vmap(lambda view: view_residual(world, view))(stack) for stack in problem.views)
    parameters = problem.parameters
    return (*parts, jnp.sqrt(parameters.prior_precision) * (values - parameters.prior_mean))


def view_residual(world: World, view: ViewData) -> Float[Array, "3 points"]:
    """The weighted residuals of one view, all points at once, in storage order."""
    color = view_model(world, view)
    return weighted_difference(color, view.target, view.root_weight, view.dark, view.saturated)


def view_model(world: World, view: ViewData) -> Float[Array, "3 points"]:
    """What the world looks like in one view, all points at once, in storage order."""
    return view_colors(scene_of_view(world, view), view, world.exposure[view.row])


def prior_loss(problem: Problem, values: Array) -> Array:
    parameters = problem.parameters
    return sum((neighbour_loss(block, values) for block in parameters.blocks), parameters.gaussian_loss(values))


def _dot(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision="highest")
