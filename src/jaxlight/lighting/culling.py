"""Many lights with a small reach: each tile computes only those that may reach it, exactly.

A light that reaches no sample of a tile contributes exactly 0 there, so leaving it out changes nothing. Which lights
may reach is decided from the tile's bounds, by radius and, for spots, by cone; when more than CAPACITY do, all lights
are computed, CHUNK at a time, and chunks of which none reaches are passed over.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from .elementary import arctangent
from .terms import Geometry, Received
from .vectors import Vector, cross, dot
from .world import WorldLights, in_chunks

CAPACITY = 256
CHUNK = 4


def received_from_near(of: Callable[[WorldLights], Received], lights: WorldLights, tile: Geometry) -> Received:
    """The sum of `of` over the lights that reach the tile."""
    reaches = lax.stop_gradient(may_reach(lights, tile))
    count = jnp.sum(reaches)
    capacity = min(CAPACITY, lights.count)

    def few() -> Received:
        _, nearest = lax.top_k(reaches.astype(jnp.float32), capacity)
        chosen = lights.with_planes(lambda plane: plane[nearest], lambda colors: colors[:, nearest])
        return _sum_over_chunks(of, chosen, reaches[nearest], tile)

    def all_of_them() -> Received:
        return _sum_over_chunks(of, lights, reaches, tile)

    if lights.count <= CAPACITY:
        return few()
    return lax.cond(count <= capacity, few, all_of_them)


def may_reach(lights: WorldLights, tile: Geometry) -> Bool[Array, " lights"]:
    """False only for lights that surely reach no sample of the tile."""
    assert lights.place is not None
    x, y, z = (component[:, 0, 0] for component in lights.place)
    reaches = jnp.ones(x.shape, dtype=bool)
    # Rounding of the bounds, of places and of distances in the equation, generously.
    slack = 64 * jnp.finfo(x.dtype).eps
    if lights.radius is not None and lights.to_local is None:
        radius = lights.radius[:, 0, 0]
        if lights.unit_length is not None:
            radius = radius * lights.unit_length[:, 0, 0]
        outside = [jnp.maximum(jnp.maximum(tile.low[i] - c, c - tile.high[i]), 0.0) for i, c in enumerate((x, y, z))]
        size = jnp.max(jnp.maximum(jnp.abs(tile.low), jnp.abs(tile.high)))
        margin = slack * (size + jnp.maximum(jnp.maximum(jnp.abs(x), jnp.abs(y)), jnp.abs(z)))
        # Compared without squares, which could overflow: the largest component is at most the distance.
        largest = jnp.maximum(jnp.maximum(outside[0], outside[1]), outside[2])
        distance = largest * jnp.sqrt(sum((c / jnp.where(largest > 0, largest, 1.0)) ** 2 for c in outside))
        reaches &= ~(distance > radius * (1 + slack) + margin)
    if lights.axis is not None and lights.cut_off_angle is not None:
        reaches &= _in_cone(lights, tile)
    return reaches


def _in_cone(lights: WorldLights, tile: Geometry) -> Bool[Array, " lights"]:
    """Whether a spot's cone may meet the sphere around the tile's bounds."""
    assert lights.place is not None and lights.axis is not None and lights.cut_off_angle is not None
    center, half = (tile.low + tile.high) / 2, (tile.high - tile.low) / 2
    radius = jnp.sqrt(jnp.sum(half * half))
    to_center = Vector(*(center[i] - c[:, 0, 0] for i, c in enumerate(lights.place)))
    axis = Vector(*(c[:, 0, 0] for c in lights.axis))
    aside = cross(axis, to_center)
    distance = jnp.sqrt(dot(to_center, to_center))
    angle = arctangent(jnp.sqrt(dot(aside, aside)), dot(axis, to_center))
    # The sphere's half angle, seen from the light, is asin(radius / distance) <= pi/2 * radius / distance.
    spread = 1.6 * radius / jnp.where(distance > 0, distance, 1.0)
    surely_outside = (distance > radius) & (angle - spread > lights.cut_off_angle[:, 0, 0] + 1e-3)
    return ~surely_outside


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

    first = jax.eval_shape(of_chunk, chunks, jnp.zeros((), jnp.int32))
    dark = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), first)
    total, _ = lax.scan(add, dark, jnp.arange(needed.shape[0]))
    return total
