"""Loss, gradient and Gauss-Newton matrix of a fit, streamed over tiles of samples: J is never held.

This file is the seam between fitting and rendering: solvers know only `loss` and `normal_equations`.

With residuals r (weighted, one a colour of a sample or pixel) and a loss rho:
    loss = 1/2 sum rho(r^2),   gradient = sum rho' J r,   curvature = sum rho' J J^T   (J = dr/dparameters)
where rho(s) = s for squares. Gaussian priors add (x - mean)^2 / 2 variance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .parameters import World
from .problem import LossKind, Problem, scene_of_view
from .views import ViewData


class NormalEquations(NamedTuple):
    """The quadratic model of a fit at one point."""

    loss: Float[Array, ""]
    gradient: Float[Array, " parameters"]
    curvature: Float[Array, "parameters parameters"]
    """Gauss-Newton approximation of the second derivative, J^T J with the loss's weights."""


def loss(problem: Problem, values: Float[Array, " parameters"]) -> Float[Array, ""]:
    """Half the sum of squares (or of the robust loss) at these values, priors included."""
    world = problem.at(values)

    def of_block(block: ViewData) -> tuple[Array]:
        residual = residual_of_view(problem, world, block)
        return (_half_loss(problem.loss_kind, problem.loss_scale, residual),)

    (total,) = _sum_over_blocks(problem, of_block, (jnp.zeros((), values.dtype),))
    return total + _prior_loss(problem, values)


def normal_equations(problem: Problem, values: Float[Array, " parameters"]) -> NormalEquations:
    """Loss, gradient and Gauss-Newton matrix at these values."""
    count = values.shape[0]
    directions = jnp.eye(count, dtype=values.dtype)

    def of_block(block: ViewData) -> tuple[Array, Array, Array]:
        residual, push = jax.linearize(lambda v: residual_of_view(problem, problem.at(v), block), values)
        jacobian = jax.vmap(push)(directions).reshape(count, -1)
        weight = _reweight(problem.loss_kind, problem.loss_scale, residual).reshape(-1)
        weighted = jacobian * weight
        return (
            _half_loss(problem.loss_kind, problem.loss_scale, residual),
            _dot(weighted, residual.reshape(-1)),
            _dot(weighted, jacobian.T),
        )

    zeros = (jnp.zeros((), values.dtype), jnp.zeros(count, values.dtype), jnp.zeros((count, count), values.dtype))
    total, gradient, curvature = _sum_over_blocks(problem, of_block, zeros)
    parameters = problem.parameters
    gradient = gradient + parameters.prior_precision * (values - parameters.prior_mean)
    curvature = curvature + jnp.diag(parameters.prior_precision)
    return NormalEquations(total + _prior_loss(problem, values), gradient, (curvature + curvature.T) / 2)


def residuals(values: Float[Array, " parameters"], problem: Problem) -> tuple[Array, ...]:
    """All residuals, one array a stack of views, and the priors': the same sum of squares as `loss` for squares.

    For optimistix's own solvers, implicit derivatives and residual pictures; a fit's steps never call it.
    """
    world = problem.at(values)
    parts = tuple(jax.vmap(lambda view: residual_of_view(problem, world, view))(stack) for stack in problem.views)
    parameters = problem.parameters
    return (*parts, jnp.sqrt(parameters.prior_precision) * (values - parameters.prior_mean))


def colors_of_view(problem: Problem, world: World, view: ViewData) -> Float[Array, "3 points"]:
    """What the model says this view's points look like, exposure included."""
    planes = problem.shade(scene_of_view(world, view), view.samples)
    color, alpha = planes[:3], planes[3]
    if view.pixel is None:
        if view.background is not None:
            color = alpha * color + (1 - alpha) * view.background
    else:
        assert view.share is not None
        points = view.target.shape[-1]
        share = view.share if view.background is None else view.share * alpha
        color = _gather(color * share, view.pixel, points)
        if view.background is not None:
            color = color + (1 - _gather(share[None], view.pixel, points)) * view.background
    return world.exposure[view.row] * color


def _gather(planes: Array, pixel: Array, points: int) -> Array:
    """Sums of [C, slots] over the slots of each point; padding goes to the row that is cut off."""
    sums = jax.ops.segment_sum(planes.T, pixel, num_segments=points + 1)
    return sums[:points].T


def residual_of_view(problem: Problem, world: World, view: ViewData) -> Float[Array, "3 points"]:
    """Weighted difference; values beyond the sensor's range count only when they are on the wrong side."""
    difference = colors_of_view(problem, world, view) - view.target
    difference = jnp.where(view.target >= view.saturated, jnp.minimum(difference, 0), difference)
    difference = jnp.where(view.target <= view.dark, jnp.maximum(difference, 0), difference)
    return difference * view.root_weight


def _half_loss(kind: LossKind, scale: Array, residual: Array) -> Array:
    if kind == "squares":
        return jnp.vdot(residual, residual, precision="highest") / 2
    size = jnp.abs(residual) / scale
    huber = jnp.where(size <= 1, size * size / 2, size - 0.5)
    each = huber if kind == "huber" else jnp.log1p(size * size) / 2
    return scale * scale * jnp.sum(each)


def _reweight(kind: LossKind, scale: Array, residual: Array) -> Array:
    """rho' at each residual: how much a robust loss still listens to it."""
    if kind == "squares":
        return jnp.ones_like(residual)
    size = jnp.abs(residual) / scale
    return 1 / jnp.maximum(size, 1) if kind == "huber" else 1 / (1 + size * size)


def _prior_loss(problem: Problem, values: Array) -> Array:
    parameters = problem.parameters
    return jnp.sum(parameters.prior_precision * (values - parameters.prior_mean) ** 2) / 2


def _dot(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision="highest")


def _sum_over_blocks(problem: Problem, of_block: Callable[[ViewData], Any], zeros: Any) -> Any:
    """Sum of `of_block` over all views and blocks, with the rounding errors carried along (Neumaier)."""
    sums, errors = zeros, jax.tree.map(jnp.zeros_like, zeros)

    def add(carry: Any, block: ViewData) -> tuple[Any, None]:
        sums, errors = carry
        pairs = jax.tree.map(_two_sum, sums, of_block(block))
        sums = jax.tree.map(lambda _, pair: pair[0], sums, pairs)
        errors = jax.tree.map(lambda error, pair: error + pair[1], errors, pairs)
        return (sums, errors), None

    def add_view(carry: Any, view: ViewData) -> tuple[Any, None]:
        for run in range(_runs(view)):
            carry, _ = jax.lax.scan(add, carry, _blocks(view, run))
        return carry, None

    for stack in problem.views:
        (sums, errors), _ = jax.lax.scan(add_view, (sums, errors), stack)
    return jax.tree.map(jnp.add, sums, errors)


def _two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """a + b as rounded, and what the rounding lost (exact)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _runs(view: ViewData) -> int:
    return 1 if view.pixel is not None else len(view.samples.runs)


def _blocks(view: ViewData, run: int) -> ViewData:
    """One run of tiles of a view with a leading axis over tiles; a view gathered into pixels is one block."""
    if view.pixel is not None:
        return jax.tree.map(lambda leaf: leaf[None], view)
    surface, first, last = view.samples.runs[run]
    tile, tiles = view.samples.tile, last - first

    def planes(array: Array | None) -> Any:
        if array is None:
            return None
        part = array[:, first * tile : last * tile]
        return part.reshape(part.shape[0], tiles, tile).swapaxes(0, 1)

    def alike(tree: Any) -> Any:
        return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (tiles, *leaf.shape)), tree)

    samples = dataclasses.replace(
        view.samples,
        position_planes=planes(view.samples.position_planes),
        normal_planes=planes(view.samples.normal_planes),
        eye=alike(view.samples.eye),
        camera_to_world=alike(view.samples.camera_to_world),
        color_planes=planes(view.samples.color_planes),
        texel_index=planes(view.samples.texel_index),
        texel_weight=planes(view.samples.texel_weight),
        pixel_slots=None,
        coverage_slots=None,
        slot=None,
        tile_surface=view.samples.tile_surface[first:last, None],
        runs=((surface, 0, 1),),
        count=tile,
        width=None,
        height=None,
    )
    return ViewData(
        samples=samples,
        target=planes(view.target),  # type: ignore[arg-type]
        root_weight=planes(view.root_weight),  # type: ignore[arg-type]
        saturated=alike(view.saturated),
        dark=alike(view.dark),
        row=alike(view.row),
        lights=alike(view.lights),
        background=planes(view.background),
        pixel=None,
        share=None,
    )
