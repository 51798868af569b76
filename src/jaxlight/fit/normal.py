"""Loss, gradient and Gauss-Newton matrix of a fit, streamed over tiles of samples: J is never held.

This file is the seam between fitting and rendering: solvers know only `loss` and `normal_equations`.

With residuals r (weighted, one a colour of a sample or pixel) and a loss rho:
    loss = 1/2 sum rho(r^2),   gradient = sum rho' J r,   curvature = sum rho' J J^T   (J = dr/dparameters)
where rho(s) = s for squares. Gaussian priors add (x - mean)^2 / 2 variance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..lighting.prepared import Prepared, prepare
from ..lighting.tiles import surface_runs, tile_color, tile_of
from .parameters import World
from .problem import Problem, scene_of_view
from .residuals import composited, half_loss, reweight, view_colors, weighted_difference
from .views import ViewData


class NormalEquations(NamedTuple):
    """The quadratic model of a fit at one point."""

    loss: Float[Array, ""]
    gradient: Float[Array, " parameters"]
    curvature: Float[Array, "parameters parameters"]
    """Gauss-Newton approximation of the second derivative, J^T J with the loss's weights."""


class _ViewInputs(eqx.Module):
    """What one view's colours depend on: small, done once a view; the tiles take it from here."""

    prepared: Prepared
    exposure: Float[Array, ""]


def loss(problem: Problem, values: Float[Array, " parameters"]) -> Float[Array, ""]:
    """Half the sum of squares (or of the robust loss) at these values, priors included."""

    def of_view(view: ViewData, add: Callable[[Any, Any], Any], carry: Any) -> Any:
        if view.pixel is not None:
            return add(carry, (half_loss(*_rho(problem), view_residual(problem, problem.at(values), view)),))
        inputs = _view_inputs(problem, view, values)

        def of_tile(carry: Any, residual_of: Callable[[_ViewInputs], Array]) -> Any:
            return add(carry, (half_loss(*_rho(problem), residual_of(inputs)),))

        return _over_tiles(problem, view, of_tile, carry)

    (total,) = _over_views(problem, of_view, (jnp.zeros((), values.dtype),))
    return total + _prior_loss(problem, values)


def normal_equations(problem: Problem, values: Float[Array, " parameters"]) -> NormalEquations:
    """Loss, gradient and Gauss-Newton matrix at these values."""
    count = values.shape[0]
    directions = jnp.eye(count, dtype=values.dtype)

    def products(residual: Array, jacobian: Array) -> tuple[Array, Array, Array]:
        weight = reweight(*_rho(problem), residual)
        jacobian, flat = jacobian.reshape(count, -1), residual.reshape(-1)
        weighted = jacobian if weight is None else jacobian * weight.reshape(-1)
        return half_loss(*_rho(problem), residual), _dot(weighted, flat), _dot(weighted, jacobian.T)

    def of_view(view: ViewData, add: Callable[[Any, Any], Any], carry: Any) -> Any:
        if view.pixel is not None:
            residual, push = jax.linearize(lambda v: view_residual(problem, problem.at(v), view), values)
            return add(carry, products(residual, jax.lax.map(push, directions)))
        # The scene is linearised once a view, the tiles with respect to what the scene comes to.
        inputs, push = jax.linearize(lambda v: _moving(problem, _view_inputs(problem, view, v))[0], values)
        fixed = _moving(problem, _view_inputs(problem, view, values))[1]
        tangents = jax.vmap(push)(directions)

        def of_tile(carry: Any, residual_of: Callable[[_ViewInputs], Array]) -> Any:
            residual, push = jax.linearize(lambda moving: residual_of(eqx.combine(moving, fixed)), inputs)
            return add(carry, products(residual, jax.vmap(push)(tangents)))

        return _over_tiles(problem, view, of_tile, carry)

    zeros = (jnp.zeros((), values.dtype), jnp.zeros(count, values.dtype), jnp.zeros((count, count), values.dtype))
    total, gradient, curvature = _over_views(problem, of_view, zeros)
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


def _rho(problem: Problem) -> tuple[Any, Array]:
    return problem.loss_kind, problem.loss_scale


def _prior_loss(problem: Problem, values: Array) -> Array:
    parameters = problem.parameters
    return jnp.sum(parameters.prior_precision * (values - parameters.prior_mean) ** 2) / 2


def _dot(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision="highest")


def _view_inputs(problem: Problem, view: ViewData, values: Array) -> _ViewInputs:
    world = problem.at(values)
    return _ViewInputs(prepare(scene_of_view(world, view), view.samples, view.plan), world.exposure[view.row])


def _moving(problem: Problem, inputs: _ViewInputs) -> tuple[_ViewInputs, _ViewInputs]:
    """The inputs that derivatives go through, and the others: whole textures only when one of them is free."""
    moving, fixed = eqx.partition(inputs, eqx.is_inexact_array)
    if any(leaf.leaf is not None and leaf.leaf.kind == "Texture" for leaf in problem.parameters.leaves):
        return moving, fixed

    def textures(tree: _ViewInputs) -> Any:
        return tree.prepared.textures

    nothing = (None,) * len(inputs.prepared.textures)
    return eqx.tree_at(textures, moving, nothing), eqx.tree_at(textures, fixed, textures(inputs), is_leaf=_is_none)


def _is_none(leaf: Any) -> bool:
    return leaf is None


def _over_views(problem: Problem, of_view: Callable[..., Any], zeros: Any) -> Any:
    """Sum over all views with the rounding errors carried along (Neumaier): one view in memory at a time."""

    def add(carry: Any, terms: Any) -> Any:
        sums, errors = carry
        pairs = [_two_sum(a, b) for a, b in zip(sums, terms, strict=True)]
        return tuple(pair[0] for pair in pairs), tuple(e + pair[1] for e, pair in zip(errors, pairs, strict=True))

    carry = (zeros, jax.tree.map(jnp.zeros_like, zeros))
    for stack in problem.views:
        carry, _ = jax.lax.scan(lambda carry, view: (of_view(view, add, carry), None), carry, stack)
    sums, errors = carry
    return tuple(a + b for a, b in zip(sums, errors, strict=True))


def _over_tiles(problem: Problem, view: ViewData, of_tile: Callable[..., Any], carry: Any) -> Any:
    """Give `of_tile` each tile's residuals as a function of the view's inputs."""
    samples = view.samples
    for run in surface_runs(problem.world.scene.surfaces, samples):

        def step(carry: Any, index: Array, run: Any = run) -> tuple[Any, None]:
            def tile(plane: Array) -> Array:
                return tile_of(plane, index, samples.tile)

            def residual_of(inputs: _ViewInputs) -> Array:
                color = tile_color(run, inputs.prepared, samples, view.plan, index)
                background = None if view.background is None else tile(view.background)
                rgb = inputs.exposure * composited(color.rgb, color.alpha, background)
                return weighted_difference(rgb, tile(view.target), tile(view.root_weight), view)

            return of_tile(carry, residual_of), None

        carry, _ = jax.lax.scan(step, carry, jnp.arange(run.start, run.stop))
    return carry


def _two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """a + b as rounded, and what the rounding lost (exact)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)
