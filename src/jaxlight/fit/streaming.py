"""Going over the views of a fit and over the tiles of a view, adding up what each gives.

One view and one tile are in memory at a time; sums carry their rounding errors along (Neumaier).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..lighting.one_tile import Color, tile_color
from ..lighting.plan import Plan
from ..lighting.prepared import Prepared, material_number, prepare
from ..lighting.stages import Stage
from ..lighting.tile_inputs import Run, tile_of
from ..lighting.tiles import Share, surface_runs
from ..lighting.totals import Carry, add_terms, added_up
from ..lighting.unstored import Inlined, stored
from ..scene import Surface
from .parameters import World
from .part import tiles_of_part
from .problem import Problem, scene_of_view
from .residuals import composited, parts_of_pixels, weighted_difference
from .views import ViewData

Adder = Callable[[Carry, tuple[Array, ...]], Carry]
"""Adds a tuple of terms to the running sums."""


class ViewInputs(eqx.Module):
    """What one view's colours depend on: small, done once a view; the tiles take it from here."""

    prepared: Prepared
    exposure: Float[Array, ""]


class Tile(NamedTuple):
    """One tile of a view."""

    color: Callable[..., Color]
    """color(inputs, plan), the colours as far as the plan computes them; with the keyword `single`, the inputs on one
    lane, if `inputs` are on all lanes."""
    residual_of: Callable[[Float[Array, ""], Color], Float[Array, "3 samples"]]
    """The weighted residuals as a function of exposure and colours; where pixels gather samples, what each adds."""
    run: Run
    index: Int[Array, ""]
    material: Int[Array, ""] | int
    """The material of its samples, a row of the scene's; 0 where there is none."""
    view: ViewData
    size: int
    """Samples; several of the buffer's tiles may be one here."""

    def residual(self, inputs: ViewInputs) -> Float[Array, "3 samples"]:
        """The weighted residuals as a function of the view's inputs."""
        return self.residual_of(inputs.exposure, self.color(inputs, self.view.plan))

    def cut(self, planes: Array) -> Array:
        """The tile's columns of planes [..., slots]."""
        return tile_of(planes, self.index, self.size)

    def turned(self, *planes: Float[Array, "colors rows samples"]) -> Float[Array, "samples colors rows"]:
        """All rows, sample after sample; in stages, or XLA would compute them element by element in that order."""
        stage = Stage(self.index >= 0)
        together = stage(lambda: jnp.concatenate(planes, axis=1), name="together")
        return stage(lambda: together.transpose(2, 0, 1), name="turned")


def view_inputs(problem: Problem, view: ViewData, values: Float[Array, " parameters"], together: int = 1) -> ViewInputs:
    """The inputs of a view's tiles at these values, `together` of them at once."""
    return inputs_of(problem.at(values), view, view.plan, together)


def inputs_of(world: World, view: ViewData, plan: Plan, together: int = 1) -> ViewInputs:
    """The inputs of a view's tiles, `together` of them at once, as far as a plan needs them."""
    scene = scene_of_view(world, view)
    return ViewInputs(prepare(scene, view.samples, plan, together), world.exposure[view.row])


def with_textures(inputs: ViewInputs, images: tuple[Array, ...]) -> ViewInputs:
    """The inputs with other texture images."""
    return eqx.tree_at(_textures, inputs, images)


def _textures(inputs: ViewInputs) -> Any:
    return inputs.prepared.textures


def over_views(problem: Problem, of_view: Callable[[ViewData, Adder, Carry], Carry], zeros: tuple[Array, ...]) -> Any:
    """Sums over all views; `of_view(view, add, carry)` adds what one view gives."""
    carry = (zeros, jax.tree.map(jnp.zeros_like, zeros))
    for stack in problem.views:
        carry, _ = jax.lax.scan(lambda carry, view: (of_view(view, add_terms, carry), None), carry, stack)
    return added_up(carry)


def sum_over_tiles(
    problem: Problem,
    view: ViewData,
    of_tile: Callable[[Carry, Tile], Carry],
    carry: Carry,
    share: Share | None = None,
) -> Carry:
    """Go over the tiles of a view that `problem.every` chooses, or a share of them; gives the last carry.

    Not differentiable in reverse; residuals are differentiated in forward mode only.
    """
    own, shares = (0, 1) if share is None else (share.number, share.shares)
    surfaces = problem.world.scene.surfaces
    for run in _runs_of(problem, view):
        first, count = tiles_of_part(run, problem.every)

        def step(number: Array, carry: Carry, run: Run = run, first: Array = first) -> Carry:
            index = first + (own + number * shares) * problem.every
            return of_tile(carry, _tile(surfaces, view, run, index, forward=True))

        carry = jax.lax.fori_loop(0, (count - own + shares - 1) // shares, step, carry)
    return carry


def over_tiles(
    problem: Problem,
    view: ViewData,
    of_tile: Callable[[Carry, Tile], tuple[Carry, Any]],
    carry: Carry,
    *,
    together: int = 1,
    forward: bool = False,
) -> tuple[Carry, list[Any]]:
    """Go over all tiles of a view; gives the last carry, and per run what `of_tile` gave beside it, stacked.

    `together`: so many neighbouring tiles are one to `of_tile`; `forward`: residuals are differentiated in forward mode
    only.
    """
    outputs, surfaces = [], problem.world.scene.surfaces
    for run in _runs_of(problem, view):

        def step(carry: Carry, index: Array, run: Run = run) -> tuple[Carry, Any]:
            return of_tile(carry, _tile(surfaces, view, run, index, forward, together))

        carry, output = jax.lax.scan(step, carry, jnp.arange(run.start // together, run.stop // together))
        outputs.append(output)
    return carry, outputs


def _runs_of(problem: Problem, view: ViewData) -> list[Run]:
    """A view's tiles, split where the code changes; where whole textures are free, also where textures do."""
    scene = problem.world.scene
    return surface_runs(scene.surfaces, view.samples, None if problem.parameters.blocks else scene.textures)


def _tile(
    surfaces: tuple[Surface, ...], view: ViewData, run: Run, index: Array, forward: bool, together: int = 1
) -> Tile:
    size = view.samples.tile * together
    material = material_number(surfaces, view.samples.tile_surface[index * together], run.single)

    def cut(plane: Array) -> Array:
        return cast(Array, Inlined(partial(tile_of, tile=size), (plane, index)))

    def color_of(inputs: ViewInputs, plan: Plan, single: ViewInputs | None = None) -> Color:
        own = None if single is None else single.prepared
        return tile_color(run, inputs.prepared, view.samples, plan, index, together, single=own, forward=forward)

    def part_of_pixel(exposure: Array, color: Color) -> Array:
        assert view.pixel is not None and view.share is not None
        pixel, share = (tile_of(plane, index, size) for plane in (view.pixel, view.share))
        rgb, alpha = stored((color.rgb, color.alpha))
        return parts_of_pixels(view, exposure, rgb, alpha, pixel, share)

    def residual_of(exposure: Array, color: Color) -> Array:
        background = None if view.background is None else cut(view.background)
        operands = (exposure, color, background, cut(view.target), cut(view.root_weight), view.dark, view.saturated)
        # Derivatives in forward mode move many planes at once: they are not worth a stage of their own.
        return _residual(*stored(operands)) if forward else Stage(index >= 0).each(_residual, *operands)

    of_exposure_and_color = residual_of if view.pixel is None else part_of_pixel
    return Tile(color_of, of_exposure_and_color, run, index, jnp.maximum(material, 0), view, size)


def _residual(
    exposure: Array,
    color: Color,
    background: Array | None,
    target: Array,
    root_weight: Array,
    dark: Array | None,
    saturated: Array | None,
) -> Float[Array, "3 samples"]:
    rgb = exposure * composited(color.rgb, color.alpha, background)
    return weighted_difference(rgb, target, root_weight, dark, saturated)
