"""Derivatives of the residuals of a tile by the free numbers, and by nothing else.

The scene is differentiated once a view, the tiles by what of a view's inputs the numbers move. Light adds up, so that
what moves some of the lights only is differentiated without the others.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..lighting.lanes import Packed, on_all_lanes, on_fewer_lanes, packed, summed, unpacked
from ..lighting.moved import moved_leaves
from ..lighting.one_tile import Color
from ..lighting.plan import Plan, number_of_lights, plan_of_lights
from ..lighting.stages import Stage
from ..lighting.world import WorldLights, one_by_one
from ..scene.paths import LIGHT_ATTRIBUTES
from .columns import Columns, Group, Rows
from .problem import Problem
from .streaming import Tile, ViewInputs, inputs_of
from .views import ViewData


class Slope(NamedTuple):
    """The gradient by what moves of a view's inputs, in parts to be added up lane by lane."""

    of_prepared: Packed
    exposure: Float[Array, ""] | None


class GradientPart(NamedTuple):
    """What a gradient differentiates together: all lights and the rest, or some of the lights."""

    plan: Plan
    inputs: ViewInputs
    """Of the plan."""
    moving: ViewInputs
    """Those of the inputs that follow from the numbers; None elsewhere."""
    pull_moving: Callable[[ViewInputs], Float[Array, " parameters"]]
    """From the gradient by these to that by the numbers."""

    @property
    def zeros(self) -> Slope:
        """Of no tile."""
        return jax.tree.map(jnp.zeros_like, _slope(self._on_all_lanes))

    def color_and_slope(self, tile: Tile) -> tuple[Color, Callable[[Color], Slope]]:
        """The colours of a tile, and from their cotangents the slope."""

        def color_at(moving: ViewInputs) -> Color:
            return tile.color(eqx.combine(moving, self.inputs), self.plan, single=self.inputs)

        color, pull = jax.vjp(color_at, self._on_all_lanes)
        return color, lambda cotangent: _slope(pull(cotangent)[0])

    def pull(self, slope: Slope) -> Float[Array, " parameters"]:
        """From the sum of the slopes of tiles the gradient by the numbers."""
        prepared = unpacked(summed(slope.of_prepared), self.moving.prepared)
        return self.pull_moving(dataclasses.replace(self.moving, prepared=prepared, exposure=slope.exposure))

    @property
    def _on_all_lanes(self) -> ViewInputs:
        return dataclasses.replace(self.moving, prepared=on_all_lanes(self.moving.prepared))


def _slope(inputs: ViewInputs) -> Slope:
    return Slope(packed(on_fewer_lanes(inputs.prepared)), inputs.exposure)


def parts_of(
    problem: Problem, view: ViewData, values: Float[Array, " parameters"], together: int
) -> list[GradientPart]:
    """The parts of a gradient at these values, for tiles `together` at once; of the first, the plan is the view's.

    Of lights that are few of the view's a part of their own: light adds up, and the others need no derivatives.
    """

    def part(plan: Plan, *, lights: bool, others: bool) -> GradientPart:
        def inputs_at(values: Array) -> ViewInputs:
            return inputs_of(problem.at(values), view, plan, together)

        which = _moved_of(moved_leaves(inputs_at, values), lights, others)
        moving, pull = jax.vjp(lambda values: eqx.filter(inputs_at(values), which), values)
        return GradientPart(plan, inputs_at(values), moving, lambda slope: pull(slope)[0])

    plan = _plan_of_moved(problem, view, problem.columns.lights)
    if plan == view.plan:
        return [part(plan, lights=True, others=True)]
    return [part(view.plan, lights=False, others=True), part(plan, lights=True, others=False)]


def _moved_of(which: ViewInputs, lights: bool, others: bool) -> ViewInputs:
    """Of the leaves that are moved (True) those of lights, of all else, or both."""
    own = jax.tree.map(lambda moved: moved and lights, which.prepared.lights)
    rest = jax.tree.map(lambda moved: moved and others, which)
    return dataclasses.replace(rest, prepared=dataclasses.replace(rest.prepared, lights=own))


class GroupChanges(NamedTuple):
    """What a group of directions moves."""

    plan: Plan
    """What its derivatives need."""
    inputs: ViewInputs
    """Of the plan."""
    which: ViewInputs
    """Leaves True where they are moved."""
    changes: ViewInputs
    """The moved leaves' changes along the group's directions; or along sums of these over lights."""
    directions: int
    """Of the group."""
    by_light: int | None
    """The kind of the lights that are moved, one by each direction, so that no direction needs the others."""


def derivatives_by_tile(
    problem: Problem, view: ViewData, values: Float[Array, " parameters"], columns: Columns
) -> Callable[[Tile], tuple[Array, Array]]:
    """A function of a tile: its residuals [3, samples], and the rows [3, directions + 1, samples] of their derivatives,
    see `columns`, with the residuals as the last.

    The scene is linearised once a view, the tiles with respect to what a group of directions moves.
    """
    plans = [
        _plan_of_moved(problem, view, group.lights, by_light=group.by_light) if group.alone else view.plan
        for group in columns.groups
    ]
    # Shared by groups of one plan, or XLA would not see that their tiles are the same.
    inputs = {plan: inputs_of(problem.at(values), view, plan) for plan in dict.fromkeys([view.plan, *plans])}
    ends = np.cumsum([group.directions for group in columns.groups]).tolist()
    groups = [
        _changes(problem, view, values, group, plan, inputs[plan], columns.directions[end - group.directions : end])
        for group, plan, end in zip(columns.groups, plans, ends, strict=True)
    ]

    def of_tile(tile: Tile) -> tuple[Array, Array]:
        stage, pushes, color = Stage(tile.index >= 0), [], None
        for moved in groups:
            own, push = (None, None) if moved.by_light is not None else _color_and_push(tile, moved)
            pushes.append(push)
            color = own if own is not None and moved.plan == view.plan else color
        if color is None:  # only lights are differentiated, some of them or one by one
            color = tile.color(inputs[view.plan], view.plan)
        exposure = inputs[view.plan].exposure
        residual = tile.residual_of(exposure, color)
        rows = [_rows(stage, tile, exposure, color, moved, push) for moved, push in zip(groups, pushes, strict=True)]
        return residual, jnp.concatenate([*rows, residual[:, None]], axis=1)

    return of_tile


def _changes(
    problem: Problem,
    view: ViewData,
    values: Float[Array, " parameters"],
    group: Group,
    plan: Plan,
    inputs: ViewInputs,
    directions: Float[Array, "directions numbers"],
) -> GroupChanges:
    few = problem.parameters.few

    def inputs_at(numbers: Array) -> ViewInputs:
        world = problem.at(values)
        for place in group.leaves:
            world = problem.parameters.leaves[place].put(world, jnp.concatenate([numbers, values[few:]]))
        return inputs_of(world, view, plan)

    by_light = _kind_by_light(problem, group, plan)
    if by_light is not None:
        lights = len(group.lights[by_light])
        directions = jnp.sum(directions.reshape(-1, lights, few), axis=1)
    which = moved_leaves(inputs_at, values[:few])
    push = jax.linearize(lambda numbers: eqx.filter(inputs_at(numbers), which), values[:few])[1]
    return GroupChanges(plan, inputs, which, jax.vmap(push)(directions), group.directions, by_light)


def _kind_by_light(problem: Problem, group: Group, plan: Plan) -> int | None:
    """The kind of the group's lights, if they can be differentiated one by one: those of the plan are these lights."""
    if not group.by_light:
        return None
    (kind,) = (kind for kind, rows in enumerate(group.lights) if rows)
    own, rows = plan.lights[kind], group.lights[kind]
    if own is None or own.culled:
        return None
    lights = getattr(problem.world.scene, LIGHT_ATTRIBUTES[kind])
    return kind if rows == (tuple(range(len(lights.names))) if own.rows is None else own.rows) else None


def _color_and_push(tile: Tile, moved: GroupChanges) -> tuple[Color, Callable[[ViewInputs], Color]]:
    """A tile's colours by the group's plan, and how they change with what it moves."""
    own, fixed = eqx.partition(moved.inputs, moved.which)
    return jax.linearize(lambda own: tile.color(eqx.combine(own, fixed), moved.plan), own)


def _rows(
    stage: Stage,
    tile: Tile,
    exposure: Array,
    color: Color,
    moved: GroupChanges,
    push: Callable[[ViewInputs], Color] | None,
) -> Float[Array, "3 directions samples"]:
    """The residuals' derivatives along the directions of a group; `push` None: of lights that are moved one by one."""
    if not any(jax.tree.leaves(moved.which)):  # lights that this view does not show
        return jnp.zeros((3, moved.directions, tile.size), color.rgb.dtype)
    if push is not None and moved.which.exposure:
        by_both = jax.linearize(tile.residual_of, exposure, color)[1]
        return stage(lambda: jax.vmap(lambda c: by_both(c.exposure, push(c)), out_axes=1)(moved.changes), name="rows")
    by_color = jax.linearize(lambda color: tile.residual_of(exposure, color), color)[1]
    if push is None:
        return stage(lambda: _rows_by_light(tile, moved, by_color), name="rows")
    return stage(lambda: jax.vmap(lambda c: by_color(push(c)), out_axes=1)(moved.changes), name="rows")


def _rows_by_light(
    tile: Tile, moved: GroupChanges, by_color: Callable[[Color], Array]
) -> Float[Array, "3 directions samples"]:
    """`_rows` of directions that move one light each."""
    kind, prepared = moved.by_light, moved.inputs.prepared
    assert kind is not None
    all_lights, which, changes = (
        cast(WorldLights, own.prepared.lights[kind]) for own in (moved.inputs, moved.which, moved.changes)
    )

    def with_light(light: WorldLights, in_scope: Array | None) -> ViewInputs:
        """The inputs with this light and no other."""
        lights, scopes = (tuple(own if row == kind else None for row in range(3)) for own in (light, in_scope))
        own = dataclasses.replace(prepared, lights=lights, scopes=scopes)
        return dataclasses.replace(moved.inputs, prepared=own)

    def of_light(light: WorldLights, in_scope: Array | None, changes: WorldLights) -> Array:
        own, fixed = eqx.partition(light, which)

        def color_at(own: WorldLights) -> Color:
            return tile.color(with_light(eqx.combine(own, fixed), in_scope), moved.plan)

        push = jax.linearize(color_at, own)[1]
        return jax.vmap(lambda change: by_color(push(change)), out_axes=1)(changes)

    scope = prepared.scopes[kind]
    in_scope = None if scope is None else scope.T[:, :, None]
    each = (one_by_one(all_lights), in_scope, jax.vmap(one_by_one, out_axes=1)(changes))
    return jax.vmap(of_light, out_axes=2)(*each).reshape(3, -1, tile.size)


def _plan_of_moved(problem: Problem, view: ViewData, rows: Rows, *, by_light: bool = False) -> Plan:
    """What derivatives of a view's colours by fields of these lights need.

    Less than the view's plan only if lights are differentiated one by one, or if it saves half of them or more, for
    they are evaluated once more.
    """
    if any(chosen is not None for chosen in view.lights):
        return view.plan
    kinds = [getattr(problem.world.scene, kind) for kind in LIGHT_ATTRIBUTES]
    counts = tuple(0 if lights is None else len(lights.names) for lights in kinds)
    plan = plan_of_lights(view.plan, rows, counts)
    kept, all_lights = number_of_lights(plan, counts), number_of_lights(view.plan, counts)
    return plan if 2 * kept <= all_lights or (by_light and kept < all_lights) else view.plan
