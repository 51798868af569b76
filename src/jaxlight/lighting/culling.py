"""Many lights with a small reach: samples are shaded with those only that may reach them, exactly.

A light that does not reach a sample contributes exactly 0 to it, so leaving it out changes nothing. Each tile collects
the lights that may reach it, by radius and, for spots, by cone; from these each lane of samples draws its own list, and
the lanes work through their lists side by side, CHUNK entries at a time, until the longest is done. When more reach a
tile than it can collect, all lights are computed, and chunks of which none reaches it are passed over.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int, UInt32

from .elementary import arctangent
from .stages import Stage
from .terms import Geometry, Received
from .vectors import Vector, cross, dot, squares_in_range
from .world import WorldLights, in_chunks

CAPACITIES = (64, 256)
"""Lengths of a tile's collection of lights; the shorter, the quicker the lanes draw their lists from it."""
CHUNK = 8
GROUP = 4
"""Chunks that are passed over together where no list is so long."""

Bounds = tuple[Vector, Vector]
"""Lowest and highest coordinates of groups of samples; planes [groups]."""


def received_from_near(
    stage: Stage, of: Callable[[WorldLights, Geometry], Received], lights: WorldLights, tile: Geometry
) -> Received:
    """The sum of `of` over the lights that reach the samples of a tile."""
    whole = (Vector(*tile.low[:, None]), Vector(*tile.high[:, None]))
    reaches = lax.stop_gradient(may_reach(lights, whole))[:, 0]
    rank = _running_count(reaches)
    count = rank[-1]

    # Checkpoints: the branch that is not taken then leaves no zeros behind for what it would have kept. In loops they
    # are around branches, so that derivatives keep nothing of a turn, not even copies of what is the same in all.
    @partial(jax.checkpoint, static_argnums=0)
    def nearest(capacity: int, lights: WorldLights) -> Received:
        rows = jnp.minimum(jnp.searchsorted(rank, jnp.arange(1, capacity + 1)), lights.count - 1)
        chosen = lights.with_planes(lambda plane: plane[rows], lambda colors: colors[:, rows])
        return _sum_over_lists(stage, of, chosen, jnp.arange(capacity) < count, tile)

    @jax.checkpoint
    def all_chunks(lights: WorldLights) -> Received:
        return _sum_over_chunks(of, lights, reaches, tile)

    def from_capacity(position: int, lights: WorldLights) -> Received:
        """The sum, if more than the capacities before this position reach the tile."""
        if position == len(CAPACITIES):
            return all_chunks(lights)
        capacity = CAPACITIES[position]
        if lights.count <= capacity:
            return nearest(lights.count, lights)
        return lax.cond(count <= capacity, partial(nearest, capacity), partial(from_capacity, position + 1), lights)

    return from_capacity(0, lights)


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
    of: Callable[[WorldLights, Geometry], Received],
    lights: WorldLights,
    reaches: Bool[Array, " lights"],
    tile: Geometry,
) -> Received:
    """The sum over the lights, each lane taking only those that may reach its samples."""
    tile = _with_range_of(lights, reaches, tile)
    low = Vector(*(jnp.min(component, axis=0) for component in tile.position))
    high = Vector(*(jnp.max(component, axis=0) for component in tile.position))
    may = lax.stop_gradient(may_reach(lights, (low, high))) & reaches[:, None]
    words = _packed(may)
    length = jnp.sum(lax.population_count(words).astype(jnp.int32), axis=0)
    longest = jnp.max(length)

    def entries(number: Array) -> tuple[Array, Array]:
        """CHUNK entries of all lists, [CHUNK, lanes]: the row of the light, and whether the list is so long."""
        entry = (number * CHUNK + jnp.arange(CHUNK))[:, None]
        return jnp.minimum(_place_of_flag(words, entry), lights.count - 1), entry < length

    def of_entries(lights: WorldLights, row: Int[Array, "chunk lanes"], listed: Array) -> Received:
        def listed_lights() -> WorldLights:
            return lights.with_planes(
                lambda plane: plane[:, 0, 0][row][:, None],
                lambda colors: jnp.where(listed, colors[:, :, 0, 0][:, row], 0.0)[:, :, None],
            )

        return of(stage(listed_lights), tile)

    dark = _dark(jax.eval_shape(lambda: of_entries(lights, *entries(jnp.zeros((), jnp.int32)))))

    @jax.checkpoint
    def add(lights: WorldLights, total: Received, number: Array) -> Received:
        return lax.cond(number * CHUNK < longest, lambda: total + of_entries(lights, *entries(number)), lambda: total)

    @jax.checkpoint
    def add_group(lights: WorldLights, total: Received, first: Array) -> Received:
        numbers = first + jnp.arange(GROUP)

        def more() -> Received:
            return lax.scan(lambda total, number: (add(lights, total, number), None), total, numbers)[0]

        return lax.cond(first * CHUNK < longest, more, lambda: total)

    groups = jnp.arange(0, -(-lights.count // CHUNK), GROUP)
    return lax.scan(lambda total, first: (add_group(lights, total, first), None), dark, groups)[0]


def _with_range_of(lights: WorldLights, reaches: Bool[Array, " lights"], tile: Geometry) -> Geometry:
    """The tile, which knows too whether squared distances to the lights that reach it are normal numbers."""
    assert lights.place is not None
    place = Vector(*(component[:, 0, 0] for component in lights.place))
    in_range = squares_in_range(place, Vector(*tile.low), Vector(*tile.high))
    return tile._replace(in_range=tile.in_range & jnp.all(in_range | ~reaches))


def _packed(flags: Bool[Array, "lights lanes"]) -> UInt32[Array, "words lanes"]:
    """32 flags a word, the first in the lowest bit."""
    filled = jnp.pad(flags, ((0, -flags.shape[0] % 32), (0, 0)))
    bits = filled.reshape(-1, 32, flags.shape[1]).astype(jnp.uint32)
    return jnp.sum(bits << jnp.arange(32, dtype=jnp.uint32)[:, None], axis=1, dtype=jnp.uint32)


def _place_of_flag(words: UInt32[Array, "words lanes"], number: Int[Array, "chunk 1"]) -> Int[Array, "chunk lanes"]:
    """Where the flags number 0, 1, ... of each lane are; beyond the last, anywhere."""
    left = jnp.broadcast_to(number, (number.shape[0], words.shape[1]))
    word, place = jnp.zeros(left.shape, jnp.uint32), jnp.zeros_like(left)
    for i, own in enumerate(words):
        count = lax.population_count(own).astype(jnp.int32)
        here = (left >= 0) & (left < count)
        word, place = jnp.where(here, own, word), jnp.where(here, 32 * i + left, place)
        left = left - count  # negative from the word on that holds it
    left, place = place % 32, place - place % 32
    for half in (16, 8, 4, 2, 1):
        low = word & jnp.uint32((1 << half) - 1)
        count = lax.population_count(low).astype(jnp.int32)
        above = left >= count
        word = jnp.where(above, word >> half, low)
        left, place = jnp.where(above, left - count, left), jnp.where(above, place + half, place)
    return place


def _running_count(flags: Bool[Array, "lights ..."]) -> Int[Array, "lights ..."]:
    """How many of the flags up to and including each light's are true."""
    count, step = flags.astype(jnp.int32), 1
    while step < flags.shape[0]:
        count = count.at[step:].add(count[:-step])
        step *= 2
    return count


def _sum_over_chunks(
    of: Callable[[WorldLights, Geometry], Received],
    lights: WorldLights,
    reaches: Bool[Array, " lights"],
    tile: Geometry,
) -> Received:
    """The sum over the chunks in which some light reaches the tile."""
    tile = _with_range_of(lights, reaches, tile)
    lanes = tile.position.x.shape[-1]
    chunks = in_chunks(lights, CHUNK)
    padding = -lights.count % CHUNK
    needed = jnp.any(jnp.pad(reaches, (0, padding)).reshape(-1, CHUNK), axis=1)

    def spread(plane: Array) -> Array:
        return jnp.broadcast_to(plane, (*plane.shape[:-1], lanes)) if plane.ndim in (3, 4) else plane

    # One table, so that cutting a chunk out is cheap: thousands of chunks are passed over.
    leaves, tree = jax.tree.flatten(chunks)
    table = jnp.concatenate([leaf.reshape(leaf.shape[0], -1) for leaf in leaves], axis=1)
    ends = np.cumsum([math.prod(leaf.shape[1:]) for leaf in leaves]).tolist()

    def of_chunk(numbers: Array) -> Received:
        parts = jnp.split(numbers, ends[:-1])
        some = tree.unflatten([part.reshape(leaf.shape[1:]) for part, leaf in zip(parts, leaves, strict=True)])
        return of(some.with_planes(spread, spread), tile)

    @jax.checkpoint
    def add(total: Received, numbers: Array, is_needed: Array) -> Received:
        return lax.cond(is_needed, lambda: total + of_chunk(numbers), lambda: total)

    dark = _dark(jax.eval_shape(of_chunk, table[0]))
    return lax.scan(lambda total, chunk: (add(total, *chunk), None), dark, (table, needed))[0]


def _dark(shapes: Received) -> Received:
    return jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
