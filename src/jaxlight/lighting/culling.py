"""Many lights with a small reach: samples are shaded with those only that may reach them, exactly.

A light that does not reach a sample contributes exactly 0 to it, so leaving it out changes nothing. Some tiles together
collect the lights that may reach them, by radius and, for spots, by cone; from these each cluster, a few neighbouring
samples, draws its own list. Clusters with lists of about the same length work through them side by side, a few entries
at a time, until the longest is done: that is why samples are read in the order of those lengths.

Who reaches whom is kept as one bit a light: numbers are packed, counted and searched WORD lights at a time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt32

from .clusters import Steps
from .culled_lights import CulledLights, Form
from .elementary import arctangent, power_of_two_above, reciprocal_of_power_of_two
from .ordinary import for_all_mapped, ordinary_lights
from .stages import Stage
from .terms import Received
from .vectors import Vector, cross, dot, inverse_length
from .world import WorldLights

BATCH = 512
"""Lights that a tile collects at once: if more reach it, lists are drawn and worked through several times."""

WORD = 32
"""Bits of a number. Divides BATCH."""

WithLight = Callable[[Stage, Received | None, WorldLights, Int[Array, ""] | None], Received]
"""From what some clusters, from that one on (None: all), received so far what they do with some lights."""


class Bounds(NamedTuple):
    """Of groups of samples."""

    low: Vector
    """Lowest coordinates; planes [groups]."""
    high: Vector
    largest: Float[Array, ""]
    """No coordinate is larger, whatever its sign."""

    def of(self, order: Int[Array, " groups"]) -> Bounds:
        """With the groups in that order."""
        low, high = (Vector(*(component[order] for component in ends)) for ends in (self.low, self.high))
        return self._replace(low=low, high=high)


class Extent(NamedTuple):
    """Where a tile of samples is, and what it is seen from."""

    low: Float[Array, "3"]
    """Lowest coordinates."""
    high: Float[Array, "3"]
    """Highest coordinates."""
    clusters: Bounds
    """Of the tile's clusters."""
    viewer: Vector | None
    """Where the viewer is; None: it does not matter where lights are seen from."""


class Found(NamedTuple):
    """The lights that may reach a tile."""

    words: UInt32[Array, " words"]
    ends: Int[Array, " words"]
    """How many there are up to the end of each word."""
    lists: UInt32[Array, "words clusters"]
    """Which of those that are collected first may reach each cluster."""

    def of(self, order: Int[Array, " clusters"]) -> Found:
        """With the clusters in that order."""
        return self._replace(lists=self.lists[:, order])


def find_near(stage: Stage, lights: CulledLights, in_scope: Bool[Array, " lights"] | None, extent: Extent) -> Found:
    """The lights, of those in scope (None: all), that may reach the samples of a tile."""
    words = _packed(stage(_reaches_tile, *lax.stop_gradient((lights.planes.planes, in_scope, extent))))
    ends = jnp.cumsum(_count_of_flags(words))
    first, count = _batch(stage, stage.clusters.form_of(lights), words, ends, jnp.zeros((), jnp.int32))
    return Found(words, ends, _lists(stage, first, count, extent.clusters))


def by_length(lists: Sequence[UInt32[Array, "words clusters"]]) -> Int[Array, " clusters"]:
    """The clusters in the order of how many lights are on their lists."""
    length = reduce(jnp.add, map(_lengths, lists))
    clusters = length.shape[0]
    return jnp.sort(length * clusters + jnp.arange(clusters, dtype=length.dtype)) % clusters


def _lengths(lists: UInt32[Array, "words clusters"]) -> Int[Array, " clusters"]:
    return jnp.sum(_count_of_flags(lists), axis=0)


def received_from_near(
    stage: Stage,
    with_light: WithLight,
    total: Received | None,
    lights: Form,
    found: Found,
    extent: Extent,
) -> Received:
    """`total` and the light of those lights that were found."""
    at_once = _collected_at_once(lights)

    def with_batch(total: Received | None, number: Array) -> Received:
        batch, count = _batch(stage, lights, found.words, found.ends, number)
        lists = found.lists
        if lights.count > at_once:
            lists = lax.cond(number == 0, lambda: lists, lambda: _lists(stage, batch, count, extent.clusters))
        own = _received_from_listed(stage, with_light, batch, count, lists, extent)
        return own if total is None else jax.tree.map(partial(_added, stage), total, own)

    return stage.sum(with_batch, total, 1 if lights.count <= at_once else _parts(found.ends[-1], at_once))


def _added(stage: Stage, total: Array, own: Array) -> Array:
    # Behind a boundary and without their axes, or XLA would look for the place of every number in its part.
    return stage(jnp.add, total.reshape(-1), own.reshape(-1), name="added").reshape(total.shape)


def _batch(
    stage: Stage,
    lights: Form,
    words: UInt32[Array, " words"],
    ends: Int[Array, " words"],
    number: Int[Array, ""],
) -> tuple[Form, Int[Array, ""]]:
    """As many of the lights that were found as are collected at once, filled up with any, and a black one; how many
    were found of them."""
    size = _collected_at_once(lights)
    first = number * size

    def rows_of_batch(words: Array, ends: Array, first: Array) -> Int[Array, " batch"]:
        rows = _rows_of_flags(words, ends, first + jnp.arange(size + 1), lights.count)
        return jnp.where(jnp.arange(size + 1) < size, rows, lights.count)

    batch = lights.of(stage(rows_of_batch, words, ends, first))
    return batch, jnp.minimum(ends[-1] - first, size)


def _collected_at_once(lights: Form) -> int:
    """Whole words."""
    return min(BATCH, -(-lights.count // WORD) * WORD)


def _reaches_tile(
    lights: WorldLights, in_scope: Bool[Array, " lights"] | None, extent: Extent
) -> Bool[Array, " lights"]:
    reaches = may_reach(lights, _bounds(extent))[:, 0]
    return reaches if in_scope is None else reaches & in_scope


def _bounds(extent: Extent) -> Bounds:
    """Of the tile, as those of a single group."""
    return Bounds(Vector(*extent.low[:, None]), Vector(*extent.high[:, None]), extent.clusters.largest)


def may_reach(lights: WorldLights, bounds: Bounds) -> Bool[Array, "lights groups"]:
    """False only for lights that surely reach no sample within the bounds."""
    assert lights.place is not None
    low, high, largest = bounds
    place = Vector(*(component[:, 0] for component in lights.place))
    reaches = jnp.ones((lights.count, low.x.shape[0]), dtype=bool)
    # Rounding of the bounds, of places and of distances in the equation, generously.
    slack = 64 * float(jnp.finfo(low.x.dtype).eps)
    if lights.radius is not None and lights.to_local is None:
        radius = lights.radius[:, 0]
        if lights.unit_length is not None:
            radius = radius * lights.unit_length[:, 0]
        outside = [jnp.maximum(jnp.maximum(a - c, c - b), 0.0) for a, b, c in zip(low, high, place, strict=True)]
        margin = slack * (largest + _largest(place))
        within = jnp.square(radius * (1 + slack) + margin) + jnp.finfo(low.x.dtype).tiny
        # Squares that overflow or underflow say that a light reaches, or say it rightly that it does not.
        reaches &= ~(sum(jnp.square(c) for c in outside) > within)
    if lights.axis is not None and lights.cut_off_angle is not None:
        axis = Vector(*(component[:, 0] for component in lights.axis))
        reaches &= _in_cone(place, axis, lights.cut_off_angle[:, 0], bounds, slack)
    return reaches


def _largest(components: tuple[Array, ...] | Vector | list[Array]) -> Array:
    """The largest absolute value."""
    return reduce(jnp.maximum, [jnp.abs(component) for component in components])


def _in_cone(
    place: Vector, axis: Vector, cut_off_angle: Array, bounds: Bounds, slack: float
) -> Bool[Array, "lights groups"]:
    """Whether a spot's cone may meet the sphere around the bounds, which is larger by `slack` of all coordinates.

    In units of about the largest coordinate: what is so small that its square is lost is less than the slack.
    """
    low, high, largest = bounds
    size = largest + _largest(place)
    unit = reciprocal_of_power_of_two(power_of_two_above(size))
    half = (high - low).scaled(jnp.asarray(0.5, low.x.dtype))
    reach = jnp.where(_largest(half) > 0, 1 / inverse_length(half), 0)
    radius = (reach + slack * size) * unit
    to_center = ((low + half) - place).scaled(unit)
    aside = cross(axis, to_center)
    distance = jnp.sqrt(dot(to_center, to_center))
    angle = arctangent(jnp.sqrt(dot(aside, aside)), dot(axis, to_center))
    # The sphere's half angle, seen from the light, is asin(radius / distance) <= pi/2 * radius / distance.
    spread = 1.6 * radius / distance
    surely_outside = (distance > radius) & (angle - spread > cut_off_angle + 1e-3)
    return ~surely_outside


def _received_from_listed(
    stage: Stage,
    with_light: WithLight,
    lights: Form,
    count: Int[Array, ""],
    lists: UInt32[Array, "words clusters"],
    extent: Extent,
) -> Received:
    """The light of the first `count` lights, each cluster taking those on its list; the last is black."""
    ordinary = stage(_all_ordinary, *lax.stop_gradient((lights, count, extent)))
    stage = dataclasses.replace(stage, ordinary=stage.ordinary & for_all_mapped(ordinary))
    length = _lengths(lists)
    at_once = stage.clusters.at_once()

    def of_some(first: Int[Array, ""] | None) -> Received:
        own_lists, own_length = lists, length
        if first is not None:
            own_lists, own_length = (lax.dynamic_slice_in_dim(own, first, at_once, -1) for own in (lists, length))

        def with_entries(steps: Steps, total: Received | None, number: Array) -> Received:
            entry = (steps.first + number * steps.entries + jnp.arange(steps.entries))[:, None]
            row = stage(_listed_rows, own_lists, own_length, entry, lights.count)
            return with_light(stage, total, stage.clusters.listed(stage, lights, row), first)

        total: Any = None
        for steps in stage.clusters.steps(jnp.max(own_length)):
            total = stage.sum(partial(with_entries, steps), total, steps.count)
        return total

    (clusters,) = length.shape
    if clusters <= at_once:
        return of_some(None)
    return stage.clusters.in_parts(of_some, jnp.arange(0, clusters, at_once))


def _lists(stage: Stage, lights: Form, count: Int[Array, ""], clusters: Bounds) -> UInt32[Array, "words lanes"]:
    """Which of the first `count` lights may reach each cluster's samples."""
    lights, clusters = lax.stop_gradient((lights, clusters))

    def word(number: Array) -> UInt32[Array, " lanes"]:
        def may() -> Bool[Array, "lights lanes"]:
            some = lights.lights(number * WORD, WORD)
            return may_reach(some, clusters) & (number * WORD + jnp.arange(WORD) < count)[:, None]

        return stage(_packed, stage(may))[0]

    nothing = jnp.zeros((lights.count // WORD, clusters.low.x.shape[0]), jnp.uint32)
    return lax.fori_loop(0, _parts(count, WORD), lambda number, words: words.at[number].set(word(number)), nothing)


def _all_ordinary(lights: Form, count: Int[Array, ""], extent: Extent) -> Bool[Array, ""]:
    """Whether a tile is ordinary as far as the first `count` lights go."""
    found = ordinary_lights(lights.lights(0, lights.count), extent.viewer, *_bounds(extent)[:2])[:, 0]
    return jnp.all(found | (jnp.arange(lights.count) >= count))


def _parts(count: Int[Array, ""], size: int) -> Int[Array, ""]:
    """Into how many parts of this size a count is divided."""
    return lax.div(count + (size - 1), jnp.asarray(size, count.dtype))


def _packed(flags: Bool[Array, "lights ..."]) -> UInt32[Array, "words ..."]:
    """One bit a light, in the order of `_row_of`."""

    def word_of(groups: list[Array]) -> Array:
        return reduce(jnp.bitwise_or, [group.astype(jnp.uint32) << bit for bit, group in enumerate(groups)])

    full = flags.shape[0] // WORD
    words = word_of([flags[bit * full : (bit + 1) * full] for bit in range(WORD)])
    rest = flags[WORD * full :]
    return jnp.concatenate([words, word_of(list(rest))[None]]) if len(rest) else words


def _row_of(word: Int[Array, "..."], bit: Int[Array, "..."], lights: int) -> Int[Array, "..."]:
    """The light that has this bit: neighbours have the same bit of neighbouring words, so that one loop packs them."""
    full = lights // WORD
    return jnp.minimum(jnp.where(word < full, bit * full + word, WORD * full + bit), lights - 1)


def _count_of_flags(words: UInt32[Array, "..."]) -> Int[Array, "..."]:
    return lax.population_count(words).astype(jnp.int32)


def _rows_of_flags(
    words: UInt32[Array, " words"], ends: Int[Array, " words"], number: Int[Array, " batch"], lights: int
) -> Int[Array, " batch"]:
    """The rows of the lights whose flags are set, by their number; beyond the last, any.

    `ends`: how many flags are set up to the end of each word.
    """
    at = jnp.minimum(jnp.sum(ends[:, None] <= number, axis=0), len(words) - 1)
    word = words[at]
    return _row_of(at, _bit_of_flag(word, number - ends[at] + _count_of_flags(word)), lights)


def _listed_rows(
    words: UInt32[Array, "words lanes"], length: Int[Array, " lanes"], number: Int[Array, "chunk 1"], beyond: int
) -> Int[Array, "chunk lanes"]:
    """The rows of the lights that are in each lane's list at these places, and a row for what is beyond its end."""
    left = jnp.broadcast_to(number, (number.shape[0], words.shape[1]))
    word, at, before = jnp.zeros(left.shape, jnp.uint32), jnp.zeros_like(left), jnp.zeros_like(left)
    for i, own in enumerate(words):
        here = left >= 0
        word, at, before = jnp.where(here, own, word), jnp.where(here, i, at), jnp.where(here, left, before)
        left = left - _count_of_flags(own)  # negative from the word on that holds it
    return jnp.where(number < length, WORD * at + _bit_of_flag(word, before), beyond)


def _bit_of_flag(word: UInt32[Array, "..."], number: Int[Array, "..."]) -> Int[Array, "..."]:
    """Which bit of the word is the set one of this number, from the lowest."""
    bit = jnp.zeros_like(number)
    for half in (16, 8, 4, 2, 1):
        low = word & jnp.uint32((1 << half) - 1)
        count = _count_of_flags(low)
        above = number >= count
        word = jnp.where(above, word >> half, low)
        number, bit = jnp.where(above, number - count, number), jnp.where(above, bit + half, bit)
    return bit
