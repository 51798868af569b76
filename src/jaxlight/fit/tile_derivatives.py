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
from jaxtyping import Array, Float

from ..lighting.changes import of_some
from ..lighting.lanes import Packed, on_all_lanes, on_fewer_lanes, packed, summed, unpacked
from ..lighting.moved import moved_by, moved_leaves
from ..lighting.one_tile import Color
from ..lighting.plan import Plan, number_of_lights, plan_of_lights
from ..lighting.stages import Stage
from ..lighting.world import WorldLights, one_by_one
from ..scene.paths import LIGHT_ATTRIBUTES
from .columns import Columns, Group, Rows
from .problem import Problem
from .streaming import Tile, ViewInputs, inputs_of
from .views import ViewData

ResidualChange = Callable[[Float[Array, ""] | None, Color], Float[Array, "3 samples"]]
"""The change of a tile's residuals by those of exposure (None: none) and colours."""


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
        moving, pull, inputs = jax.vjp(lambda values: _moving_and_all(inputs_at(values), which), values, has_aux=True)
        return GradientPart(plan, inputs, moving, lambda slope: pull(slope)[0])

    plan = _plan_of_moved(problem, view, problem.columns.lights)
    if plan == view.plan:
        return [part(plan, lights=True, others=True)]
    return [part(view.plan, lights=False, others=True), part(plan, lights=True, others=False)]


def _moved_of(which: ViewInputs, lights: bool, others: bool) -> ViewInputs:
    """Of the leaves that are moved (True) those of lights, of all else, or both."""
    own = jax.tree.map(lambda moved: moved and lights, which.prepared.lights)
    rest = jax.tree.map(lambda moved: moved and others, which)
    return dataclasses.replace(rest, prepared=dataclasses.replace(rest.prepared, lights=own))


def _moving_and_all(inputs: ViewInputs, which: ViewInputs) -> tuple[ViewInputs, ViewInputs]:
    return eqx.filter(inputs, which), inputs


class Need(NamedTuple):
    """What the derivatives of a group of directions need."""

    plan: Plan
    by_light: int | None
    """The kind of the lights that are moved, one by each direction, so that no direction needs the others."""


class GroupChanges(NamedTuple):
    """What a group of directions moves."""

    place: int
    """Of the group among all."""
    directions: int
    which: ViewInputs
    """Leaves True where they are moved."""
    changes: ViewInputs
    """The moved leaves' changes along the group's directions; or along sums of these over lights."""


class Changes(NamedTuple):
    """What the groups move that need the same."""

    need: Need
    inputs: ViewInputs
    """Of the plan."""
    which: ViewInputs
    """Leaves True where some group moves them."""
    groups: list[GroupChanges]

    @property
    def moving(self) -> ViewInputs:
        """Those of the inputs that some group moves; None elsewhere."""
        return eqx.filter(self.inputs, self.which)


def derivatives_by_tile(
    problem: Problem, view: ViewData, values: Float[Array, " parameters"], columns: Columns, rows: int | None = None
) -> Callable[[Tile], tuple[Array, Array]]:
    """A function of a tile: its residuals [3, samples], and the rows [3, rows, samples] of their derivatives, see
    `columns`, then the residuals, then zeros where more `rows` are asked for (default: directions + 1).

    The scene is linearised once a view, the tiles once for all groups of directions that need the same.
    """
    needs: dict[Need, list[int]] = {}
    for place, group in enumerate(columns.groups):
        needs.setdefault(_need(problem, view, group), []).append(place)
    every = {need: _changes(problem, view, values, columns, need, places) for need, places in needs.items()}
    whole = Need(view.plan, None)
    inputs = every[whole].inputs if whole in every else inputs_of(problem.at(values), view, view.plan)
    zeros = 0 if rows is None else rows - columns.count - 1

    def of_tile(tile: Tile) -> tuple[Array, Array]:
        linear = {need: _color_and_push(tile, moved) for need, moved in every.items() if need.by_light is None}
        # Maybe only lights are differentiated, some of them or one by one.
        color = linear[whole][0] if whole in linear else tile.color(inputs, view.plan)
        change = _residual_change(tile, inputs.exposure, color)
        residual = tile.residual_of(inputs.exposure, color)

        def all_rows() -> Array:
            found: dict[int, Array] = {}
            for need, moved in every.items():
                if need in linear:
                    own = [_rows(tile, moved, group, linear[need][1], change) for group in moved.groups]
                else:
                    own = _rows_by_light(tile, moved, change)
                found.update(zip((group.place for group in moved.groups), own, strict=True))
            last = [residual[:, None], jnp.zeros((3, zeros, tile.size), residual.dtype)]
            return jnp.concatenate([*(found[place] for place in range(len(columns.groups))), *last], axis=1)

        # In one stage: each row is written once, to its place.
        return residual, Stage(tile.index >= 0)(all_rows, name="rows")

    return of_tile


def _changes(
    problem: Problem,
    view: ViewData,
    values: Float[Array, " parameters"],
    columns: Columns,
    need: Need,
    places: list[int],
) -> Changes:
    """Of the groups in these places."""
    world, numbers = problem.at(values), values[: problem.parameters.few]
    leaves = sorted({leaf for place in places for leaf in columns.groups[place].leaves})
    here = [numbers] * len(leaves)

    def inputs_at(numbers: list[Array]) -> ViewInputs:
        """Each leaf is moved by numbers of its own."""
        moved = world
        for leaf, own in zip(leaves, numbers, strict=True):
            moved = problem.parameters.leaves[leaf].put(moved, own)
        return inputs_of(moved, view, need.plan)

    moved_by_some = moved_by(inputs_at, here)
    which = moved_by_some([True] * len(leaves))
    _, push, inputs = jax.linearize(lambda numbers: _moving_and_all(inputs_at(numbers), which), here, has_aux=True)

    def of_group(place: int) -> GroupChanges:
        group, directions = columns.groups[place], columns.directions_of(place)
        if need.by_light is not None:
            directions = jnp.sum(directions.reshape(-1, len(group.lights[need.by_light]), len(numbers)), axis=1)
        moves = [leaf in group.leaves for leaf in leaves]
        own, push_own = moved_by_some(moves), of_some(push, here, moves)
        changes = jax.vmap(lambda change: push_own([change if move else None for move in moves]))(directions)
        return GroupChanges(place, group.directions, own, eqx.filter(changes, own))

    return Changes(need, inputs, which, [of_group(place) for place in places])


def _need(problem: Problem, view: ViewData, group: Group) -> Need:
    plan = _plan_of_moved(problem, view, group.lights, by_light=group.by_light) if group.alone else view.plan
    return Need(plan, _kind_by_light(problem, group, plan))


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


def _color_and_push(tile: Tile, moved: Changes) -> tuple[Color, Callable[[ViewInputs], Color]]:
    """A tile's colours by the groups' plan, and how they change with all that they move."""
    return jax.linearize(lambda own: tile.color(eqx.combine(own, moved.inputs), moved.need.plan), moved.moving)


def _residual_change(tile: Tile, exposure: Array, color: Color) -> ResidualChange:
    by_color = jax.linearize(lambda color: tile.residual_of(exposure, color), color)[1]
    by_both = jax.linearize(tile.residual_of, exposure, color)[1]
    return lambda exposure, color: by_color(color) if exposure is None else by_both(exposure, color)


def _rows(
    tile: Tile,
    moved: Changes,
    group: GroupChanges,
    push: Callable[[ViewInputs], Color],
    change: ResidualChange,
) -> Float[Array, "3 directions samples"]:
    """The residuals' derivatives along the directions of a group."""
    if not any(jax.tree.leaves(group.which)):  # lights that this view does not show
        return jnp.zeros((3, group.directions, tile.size), moved.inputs.exposure.dtype)
    push_own = of_some(push, moved.moving, group.which)
    return jax.vmap(lambda own: change(own.exposure, push_own(own)), out_axes=1)(group.changes)


def _rows_by_light(tile: Tile, moved: Changes, change: ResidualChange) -> list[Float[Array, "3 directions samples"]]:
    """`_rows` of directions that move one light each."""
    kind, prepared = moved.need.by_light, moved.inputs.prepared
    assert kind is not None

    def own(inputs: ViewInputs) -> WorldLights:
        return cast(WorldLights, inputs.prepared.lights[kind])

    def with_light(light: WorldLights, in_scope: Array | None) -> ViewInputs:
        """The inputs with this light and no other."""
        lights, scopes = (tuple(own if row == kind else None for row in range(3)) for own in (light, in_scope))
        return dataclasses.replace(moved.inputs, prepared=dataclasses.replace(prepared, lights=lights, scopes=scopes))

    def of_light(light: WorldLights, in_scope: Array | None, changes: list[WorldLights]) -> list[Array]:
        moving = eqx.filter(light, own(moved.which))

        def color_at(moving: WorldLights) -> Color:
            return tile.color(with_light(eqx.combine(moving, light), in_scope), moved.need.plan)

        push = jax.linearize(color_at, moving)[1]

        def of_group(group: GroupChanges, changes: WorldLights) -> Array:
            push_own = of_some(push, moving, own(group.which))
            return jax.vmap(lambda own: change(None, push_own(own)), out_axes=1)(changes)

        return list(map(of_group, moved.groups, changes))

    scope = prepared.scopes[kind]
    in_scope = None if scope is None else scope.T[:, :, None]
    changes = [jax.vmap(one_by_one, out_axes=1)(own(group.changes)) for group in moved.groups]
    rows = jax.vmap(of_light, out_axes=2)(one_by_one(own(moved.inputs)), in_scope, changes)
    return [planes.reshape(3, -1, tile.size) for planes in rows]


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
