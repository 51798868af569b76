"""Many lights with a small reach: samples are shaded with those only that may reach them, exactly.

A light that does not reach a sample contributes exactly 0 to it, so leaving it out changes nothing. Each tile collects
the lights that may reach it, by radius and, for spots, by cone; from these each lane of samples draws its own list, and
the lanes work through their lists side by side, CHUNK entries at a time, until the longest is done. When more reach a
tile than it can collect, all lights are computed, and chunks of which none reaches it are passed over.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from .elementary import arctangent
from .stages import Stage
from .terms import Geometry, Received
from .vectors import Vector, cross, dot
from .world import WorldLights, in_chunks

CAPACITIES = (64, 256)
"""Lengths of a tile's collection of lights; the shorter, the quicker the lanes draw their lists from it."""
CHUNK = 8

Bounds = tuple[Vector, Vector]
"""Lowest and highest coordinates of groups of samples; planes [groups]."""


def received_from_near(
    stage: Stage, of: Callable[[WorldLights], Received], lights: WorldLights, tile: Geometry
) -> Received:
    """The sum of `of` over the lights that reach the samples of a tile."""
    whole = (Vector(*tile.low[:, None]), Vector(*tile.high[:, None]))
    reaches = lax.stop_gradient(may_reach(lights, whole))[:, 0]
    count = jnp.sum(reaches)

    def nearest(capacity: int) -> Received:
        _, rows = lax.top_k(reaches.astype(jnp.float32), capacity)
        chosen = lights.with_planes(lambda plane: plane[rows], lambda colors: colors[:, rows])
        return _sum_over_lists(stage, of, chosen, reaches[rows], tile)

    def from_capacity(position: int) -> Received:
        """The sum, if more than the capacities before this position reach the tile."""
        if position == len(CAPACITIES):
            return _sum_over_chunks(of, lights, reaches, tile)
        capacity = CAPACITIES[position]
        if lights.count <= capacity:
            return nearest(lights.count)
        return lax.cond(count <= capacity, lambda: nearest(capacity), lambda: from_capacity(position + 1))

    return from_capacity(0)


def may_reach(lights: WorldLights, bounds: Bounds) -> Bool[Array, "lights groups"]:
    """False only for lights that surely reach no sample within the bounds."""
    assert lights.place is not None
    low, high = bounds
    place = Vector(*(component[:, 0] for component in lights.place))
    reaches = jnp.ones((lights.count, low.x.shape[0]), dtype=bool)
    # Rounding of the bounds, of places and of distances in the equation, generously.
    slack = 64 * jnp.finfo(low.x.dtype).eps
    if lights.radius is not None and lights.to_local is None:
        radius = lights.radius[:, 0]
        if lights.unit_length is not None:
            radius = radius * lights.unit_length[:, 0]
        outside = [jnp.maximum(jnp.maximum(a - c, c - b), 0.0) for a, b, c in zip(low, high, place, strict=True)]
        margin = slack * (_largest((*low, *high)) + _largest(place))
        # Compared without squares, which could overflow: the largest component is at most the distance.
        largest = _largest(outside)
        distance = largest * jnp.sqrt(sum((c / jnp.where(largest > 0, largest, 1.0)) ** 2 for c in outside))
        reaches &= ~(distance > radius * (1 + slack) + margin)
    if lights.axis is not None and lights.cut_off_angle is not None:
        axis = Vector(*(component[:, 0] for component in lights.axis))
        reaches &= _in_cone(place, axis, lights.cut_off_angle[:, 0], bounds)
    return reaches


def _largest(components: tuple[Array, ...] | Vector | list[Array]) -> Array:
    """The largest absolute value."""
    return jnp.max(jnp.stack([jnp.abs(component) for component in components]), axis=0)


def _in_cone(place: Vector, axis: Vector, cut_off_angle: Array, bounds: Bounds) -> Bool[Array, "lights groups"]:
    """Whether a spot's cone may meet the sphere around the bounds."""
    low, high = bounds
    half = (high - low).scaled(jnp.asarray(0.5, low.x.dtype))
    radius = jnp.sqrt(dot(half, half))
    to_center = (low + half) - place
    aside = cross(axis, to_center)
    distance = jnp.sqrt(dot(to_center, to_center))
    angle = arctangent(jnp.sqrt(dot(aside, aside)), dot(axis, to_center))
    # The sphere's half angle, seen from the light, is asin(radius / distance) <= pi/2 * radius / distance.
    spread = 1.6 * radius / jnp.where(distance > 0, distance, 1.0)
    surely_outside = (distance > radius) & (angle - spread > cut_off_angle + 1e-3)
    return ~surely_outside


def _sum_over_lists(
    stage: Stage,
    of: Callable[[WorldLights], Received],
    lights: WorldLights,
    reaches: Bool[Array, " lights"],
    tile: Geometry,
) -> Received:
    """The sum over the lights, each lane taking only those that may reach its samples."""
    low = Vector(*(jnp.min(component, axis=0) for component in tile.position))
    high = Vector(*(jnp.max(component, axis=0) for component in tile.position))
    may = lax.stop_gradient(may_reach(lights, (low, high))) & reaches[:, None]
    rank = _running_count(may)
    length = rank[-1]

    def entries(number: Array) -> tuple[Array, Array]:
        """CHUNK entries of all lists, [CHUNK, lanes]: the row of the light, and whether the list is so long."""
        entry = number * CHUNK + jnp.arange(CHUNK)
        row = jnp.minimum(jnp.sum(rank[:, None] <= entry[:, None], axis=0), lights.count - 1)
        return row, entry[:, None] < length

    @jax.checkpoint
    def of_entries(lights: WorldLights, row: Int[Array, "chunk lanes"], listed: Array) -> Received:
        def listed_lights() -> WorldLights:
            return lights.with_planes(
                lambda plane: plane[:, 0, 0][row][:, None],
                lambda colors: jnp.where(listed, colors[:, :, 0, 0][:, row], 0.0)[:, :, None],
            )

        return of(stage(listed_lights))

    def add(total: Received, number: Array) -> tuple[Received, None]:
        def more() -> Received:
            return total + of_entries(lights, *entries(number))

        return lax.cond(number * CHUNK < jnp.max(length), more, lambda: total), None

    dark = _dark(jax.eval_shape(lambda: of_entries(lights, *entries(jnp.zeros((), jnp.int32)))))
    return lax.scan(add, dark, jnp.arange(-(-lights.count // CHUNK)))[0]


def _running_count(flags: Bool[Array, "lights lanes"]) -> Int[Array, "lights lanes"]:
    """How many of the flags up to and including each light's are true."""
    count, step = flags.astype(jnp.int32), 1
    while step < flags.shape[0]:
        count = count.at[step:].add(count[:-step])
        step *= 2
    return count


def _sum_over_chunks(
    of: Callable[[WorldLights], Received], lights: WorldLights, reaches: Bool[Array, " lights"], tile: Geometry
) -> Received:
    """The sum over the chunks in which some light reaches the tile."""
    lanes = tile.position.x.shape[-1]
    chunks = in_chunks(lights, CHUNK)
    padding = -lights.count % CHUNK
    needed = jnp.any(jnp.pad(reaches, (0, padding)).reshape(-1, CHUNK), axis=1)

    def spread(plane: Array) -> Array:
        return jnp.broadcast_to(plane, (*plane.shape[:-1], lanes)) if plane.ndim in (3, 4) else plane

    @jax.checkpoint
    def of_chunk(chunks: WorldLights, number: Array) -> Received:
        some = jax.tree.map(lambda leaf: lax.dynamic_index_in_dim(leaf, number, keepdims=False), chunks)
        return of(some.with_planes(spread, spread))

    def add(total: Received, number: Array) -> tuple[Received, None]:
        # Cut out only where needed: thousands of chunks are passed over.
        return lax.cond(needed[number], lambda: total + of_chunk(chunks, number), lambda: total), None

    dark = _dark(jax.eval_shape(of_chunk, chunks, jnp.zeros((), jnp.int32)))
    return lax.scan(add, dark, jnp.arange(needed.shape[0]))[0]


def _dark(shapes: Received) -> Received:
    return jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
