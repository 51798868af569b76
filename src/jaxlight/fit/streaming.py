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

from ..lighting.one_tile import Color, Run, tile_color, tile_of
from ..lighting.prepared import Prepared, prepare
from ..lighting.stages import Stage
from ..lighting.tiles import Share, surface_runs
from ..lighting.unstored import Inlined, stored
from .columns import Columns, Group
from .moved import moved_leaves
from .parameters import World
from .part import tiles_of_part
from .problem import Problem, scene_of_view
from .residuals import composited, weighted_difference
from .views import ViewData

Carry = Any
Adder = Callable[[Carry, tuple[Array, ...]], Carry]
"""Adds a tuple of terms to the running sums."""


class ViewInputs(eqx.Module):
    """What one view's colours depend on: small, done once a view; the tiles take it from here."""

    prepared: Prepared
    exposure: Float[Array, ""]


class Tile(NamedTuple):
    """One tile of a view."""

    residual: Callable[[ViewInputs], Float[Array, "3 samples"]]
    """The weighted residuals as a function of the view's inputs."""
    run: Run
    index: Int[Array, ""]
    view: ViewData
    size: int
    """Samples; several of the buffer's tiles may be one here."""

    def cut(self, planes: Array) -> Array:
        """The tile's columns of planes [..., slots]."""
        return tile_of(planes, self.index, self.size)


def view_inputs(problem: Problem, view: ViewData, values: Float[Array, " parameters"]) -> ViewInputs:
    """The inputs of a view's tiles at these values."""
    return _inputs_of(problem.at(values), view)


def _inputs_of(world: World, view: ViewData) -> ViewInputs:
    return ViewInputs(prepare(scene_of_view(world, view), view.samples, view.plan), world.exposure[view.row])


def with_textures(inputs: ViewInputs, images: tuple[Array, ...]) -> ViewInputs:
    """The inputs with other texture images."""
    return eqx.tree_at(_textures, inputs, images)


def _textures(inputs: ViewInputs) -> Any:
    return inputs.prepared.textures


def _is_none(leaf: Any) -> bool:
    return leaf is None


def derivatives_by_tile(
    problem: Problem, view: ViewData, values: Float[Array, " parameters"], columns: Columns
) -> Callable[[Tile], tuple[Array, Array]]:
    """A function of a tile: its residuals [3, samples], and the rows [3, directions + 1, samples] of their derivatives,
    see `columns`, with the residuals as the last.

    The scene is linearised once a view, the tiles with respect to what a group of directions moves.
    """
    inputs, first, groups = view_inputs(problem, view, values), 0, []
    for group in columns.groups:
        directions = columns.directions[first : first + group.directions]
        groups.append(_changes(problem, view, values, group, directions))
        first += group.directions

    def of_tile(tile: Tile) -> tuple[Array, Array]:
        residual, rows, stage = None, [], Stage(tile.index >= 0)
        for moved, changes in groups:
            residual, own = _rows(stage, tile, inputs, moved, changes)
            rows.append(own)
        if residual is None:
            residual = tile.residual(inputs)
        return residual, jnp.concatenate([*rows, residual[:, None]], axis=1)

    return of_tile


def _changes(
    problem: Problem,
    view: ViewData,
    values: Float[Array, " parameters"],
    group: Group,
    directions: Float[Array, "directions numbers"],
) -> tuple[ViewInputs, ViewInputs]:
    """Which of a view's inputs the group moves (leaves True or False), and how these change along its directions."""
    few = problem.parameters.few

    def inputs_at(numbers: Array) -> ViewInputs:
        world = problem.at(values)
        for place in group.leaves:
            world = problem.parameters.leaves[place].put(world, jnp.concatenate([numbers, values[few:]]))
        return _inputs_of(world, view)

    moved = moved_leaves(inputs_at, values[:few])
    push = jax.linearize(lambda numbers: eqx.filter(inputs_at(numbers), moved), values[:few])[1]
    return moved, jax.vmap(push)(directions)


def _rows(
    stage: Stage, tile: Tile, inputs: ViewInputs, moved: ViewInputs, changes: ViewInputs
) -> tuple[Float[Array, "3 samples"], Float[Array, "3 directions samples"]]:
    """A tile's residuals, and their derivatives along these changes of what is moved."""
    own, fixed = eqx.partition(inputs, moved)
    residual, push = jax.linearize(lambda own: tile.residual(eqx.combine(own, fixed)), own)
    return residual, stage(lambda: jax.vmap(push, out_axes=1)(changes), name="rows")


def over_views(problem: Problem, of_view: Callable[[ViewData, Adder, Carry], Carry], zeros: tuple[Array, ...]) -> Any:
    """Sums over all views; `of_view(view, add, carry)` adds what one view gives."""
    carry = (zeros, jax.tree.map(jnp.zeros_like, zeros))
    for stack in problem.views:
        carry, _ = jax.lax.scan(lambda carry, view: (of_view(view, add_terms, carry), None), carry, stack)
    return added_up(carry)


def add_terms(carry: Carry, terms: tuple[Array, ...]) -> Carry:
    """The running sums and their rounding errors with the terms added."""
    sums, errors = carry
    pairs = [_two_sum(a, b) for a, b in zip(sums, terms, strict=True)]
    return tuple(pair[0] for pair in pairs), tuple(e + pair[1] for e, pair in zip(errors, pairs, strict=True))


def added_up(carry: Carry) -> tuple[Array, ...]:
    """The sums, rounded once."""
    return tuple(a + b for a, b in zip(*carry, strict=True))


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
    for run in surface_runs(problem.world.scene.surfaces, view.samples):
        first, count = tiles_of_part(run, problem.every)

        def step(number: Array, carry: Carry, run: Run = run, first: Array = first) -> Carry:
            return of_tile(carry, _tile(view, run, first + (own + number * shares) * problem.every, forward=True))

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
    outputs = []
    for run in surface_runs(problem.world.scene.surfaces, view.samples):

        def step(carry: Carry, index: Array, run: Run = run) -> tuple[Carry, Any]:
            return of_tile(carry, _tile(view, run, index, forward, together))

        carry, output = jax.lax.scan(step, carry, jnp.arange(run.start // together, run.stop // together))
        outputs.append(output)
    return carry, outputs


def _tile(view: ViewData, run: Run, index: Array, forward: bool, together: int = 1) -> Tile:
    size = view.samples.tile * together

    def cut(plane: Array) -> Array:
        return cast(Array, Inlined(partial(tile_of, tile=size), (plane, index)))

    def residual(inputs: ViewInputs) -> Array:
        color = tile_color(run, inputs.prepared, view.samples, view.plan, index, together, forward=forward)
        background = None if view.background is None else cut(view.background)
        measured = (cut(view.target), cut(view.root_weight), view.dark, view.saturated)
        operands = (inputs.exposure, color, background, *measured)
        # Derivatives in forward mode move many planes at once: they are not worth a stage of their own.
        return _residual(*stored(operands)) if forward else Stage(index >= 0).each(_residual, *operands)

    return Tile(residual, run, index, view, size)


def _residual(
    exposure: Array,
    color: Color,
    background: Array | None,
    target: Array,
    root_weight: Array,
    dark: Array,
    saturated: Array,
) -> Float[Array, "3 samples"]:
    rgb = exposure * composited(color.rgb, color.alpha, background)
    return weighted_difference(rgb, target, root_weight, dark, saturated)


def _two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """a + b as rounded, and what the rounding lost (exact)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)
