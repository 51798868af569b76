"""Where the clusters of a tile stand in its planes, which of them are worked on at once, and how their lights are read.

A cluster is a few neighbouring samples that share a list of lights (see `culling`). In stages each has a lane: what its
lights are made of is spread over lanes, and derivatives add up over rows. In loops over samples each has a row: what a
light is made of is read once for all samples of the cluster.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol, cast

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental.layout import Layout, with_layout_constraint
from jaxtyping import Array, Float, Int

from ..processor import sizes
from .culled_lights import CulledLights, Form, LightPlanes, LightTable
from .unstored import Inlined, Stacked, is_unstored, stored
from .world import WorldLights


class Steps(NamedTuple):
    """Some that follow one another through lists."""

    entries: int
    """Of its list that each cluster works through in a step."""
    first: Int[Array, "..."] | int
    """Entry of the first step."""
    count: Int[Array, "..."]


class Arrangement(Protocol):
    """Of clusters in planes."""

    @staticmethod
    def at_once() -> int:
        """How many clusters work through their lists side by side."""
        ...

    @staticmethod
    def steps(longest: Int[Array, "..."]) -> list[Steps]:
        """In which steps lists are worked through, of which the longest is so long."""
        ...

    @staticmethod
    def arranged(planes: Float[Array, "components clusters samples"], order: Array | None) -> Array:
        """[components, rows, lanes], the clusters in that order; None: as they are."""
        ...

    @staticmethod
    def as_stored(plane: Float[Array, "*components #rows #lanes"], order: Array | None) -> Array:
        """[*components, clusters, samples], as they were before they were `arranged`."""
        ...

    @staticmethod
    def some(planes: Any, first: Int[Array, ""]) -> Any:
        """Planes [rows, lanes] of `at_once` clusters from the first on, left where they lie."""
        ...

    @staticmethod
    def numbers_of_some(planes: Any) -> Any:
        """Of planes [..., 1, lanes or 1] that hold the same numbers for all clusters as many as `some` has."""
        ...

    @staticmethod
    def in_parts(function: Callable[[Array], Any], firsts: Int[Array, " parts"]) -> Any:
        """function(first) of every `at_once` clusters, put together to one for all of them."""
        ...

    @staticmethod
    def form_of(lights: CulledLights) -> Form:
        """In which lights are read."""
        ...

    @staticmethod
    def listed(boundary: Callable[..., Any], lights: Any, row: Int[Array, "entries clusters"]) -> WorldLights:
        """The lights in these rows, which are read behind a boundary: planes [..., entries, rows or 1, lanes or 1]."""
        ...


class InLanes:
    """Planes [samples of a cluster, clusters]."""

    @staticmethod
    def at_once() -> int:
        return sizes().derived_clusters

    @staticmethod
    def steps(longest: Array) -> list[Steps]:
        return [Steps(4, 0, _quotient(longest + 3, 4))]

    @staticmethod
    def arranged(planes: Array, order: Array | None) -> Array:
        return jnp.swapaxes(InRows.arranged(planes, order), -1, -2)

    @staticmethod
    def as_stored(plane: Array, order: Array | None) -> Array:
        return InRows.as_stored(jnp.swapaxes(plane, -1, -2), order)

    @staticmethod
    def some(planes: Any, first: Array) -> Any:
        return _cut(planes, first, InLanes.at_once(), -1)

    @staticmethod
    def numbers_of_some(planes: Any) -> Any:
        return jax.tree.map(lambda plane: plane[..., : InLanes.at_once()], planes)

    @staticmethod
    def in_parts(function: Callable[[Array], Any], firsts: Array) -> Any:
        # Checkpoint: what derivatives need of a part is computed anew, and never stored for all.
        parts = lax.map(jax.checkpoint(lambda first: stored(function(first))), firsts)

        def joined(part: Array) -> Array:
            whole = jnp.moveaxis(part, 0, -2)
            return whole.reshape(*whole.shape[:-2], -1)

        return jax.tree.map(joined, parts)

    @staticmethod
    def form_of(lights: CulledLights) -> LightPlanes:
        return lights.planes

    @staticmethod
    def listed(boundary: Callable[..., Any], lights: LightPlanes, row: Array) -> WorldLights:
        planes = boundary(LightPlanes.read, lights, row, name="listed_lights")
        return jax.tree.structure(lights.planes).unflatten([_with_rows(plane) for plane in planes])


class InRows:
    """Planes [clusters, samples of a cluster]; nothing is differentiated."""

    @staticmethod
    def at_once() -> int:
        return sizes().clusters

    @staticmethod
    def steps(longest: Array) -> list[Steps]:
        # Of what is left at the end, half a step often holds all.
        whole = _quotient(longest + 3, 8)
        return [Steps(8, 0, whole), Steps(4, 8 * whole, (longest > 8 * whole).astype(longest.dtype))]

    @staticmethod
    def arranged(planes: Array, order: Array | None) -> Array:
        if order is None:
            return planes
        # One row after the other of all components, or XLA would lay them out cluster by cluster.
        *components, clusters, samples = planes.shape
        first = clusters * jnp.arange(math.prod(components), dtype=order.dtype).reshape(*components, 1)
        rows = planes.reshape(-1, samples)
        return rows.at[first + order].get(mode="promise_in_bounds", unique_indices=True)

    @staticmethod
    def as_stored(plane: Array, order: Array | None) -> Array:
        return plane if order is None or plane.shape[-2] == 1 else InRows.arranged(plane, inverse(order))

    @staticmethod
    def some(planes: Any, first: Array) -> Any:
        return _cut(planes, first, InRows.at_once(), -2)

    @staticmethod
    def numbers_of_some(planes: Any) -> Any:
        return planes

    @staticmethod
    def in_parts(function: Callable[[Array], Any], firsts: Array) -> Any:
        parts = lax.map(lambda first: _rows_first(function(first)), firsts)
        return _rows_in_place(jax.tree.map(lambda part: part.reshape(-1, *part.shape[2:]), parts))

    @staticmethod
    def form_of(lights: CulledLights) -> LightTable:
        return lights.table

    @staticmethod
    def listed(boundary: Callable[..., Any], lights: LightTable, row: Array) -> WorldLights:
        rows = boundary(LightTable.read, lights, row, name="listed_lights")
        numbers = iter(range(rows.shape[-1]))

        def column() -> Array:
            return cast(Array, Inlined(partial(_column, next(numbers)), (rows,)))

        leaves = [Stacked(tuple(column() for _ in range(*own))) if own else column() for own in lights.components]
        return lights.tree.unflatten(leaves)


def inverse(order: Int[Array, " clusters"]) -> Int[Array, " clusters"]:
    """Where each of the clusters went that are in this order."""
    count = jnp.arange(order.shape[0], dtype=order.dtype)
    return jnp.zeros_like(order).at[order].set(count, unique_indices=True, mode="promise_in_bounds")


def _quotient(count: Int[Array, "..."], size: int) -> Int[Array, "..."]:
    return lax.div(count, jnp.full_like(count, size))


def _cut(planes: Any, first: Array, size: int, axis: int) -> Any:
    def of(plane: Any) -> Any:
        return Inlined(partial(lax.dynamic_slice_in_dim, slice_size=size, axis=axis), (plane, first))

    return jax.tree.map(of, planes, is_leaf=is_unstored)


def _rows_first(planes: Any) -> Any:
    """Planes [..., rows, lanes] with rows as the first axis, as numbers side by side have them."""
    return planes if is_unstored(planes) else jax.tree.map(lambda plane: jnp.moveaxis(plane, -2, 0), planes)


def _rows_in_place(planes: Any) -> Any:
    """What was given to `_rows_first`."""
    return planes if is_unstored(planes) else jax.tree.map(lambda plane: jnp.moveaxis(plane, 0, -2), planes)


def _with_rows(plane: Float[Array, "*components entries lanes"]) -> Float[Array, "*components entries 1 lanes"]:
    """With an axis for rows, laid out as all planes are, or else XLA would copy it in every stage."""
    plane = jnp.expand_dims(plane, -2)
    return with_layout_constraint(plane, Layout(tuple(range(plane.ndim))))


def _column(number: int, rows: Float[Array, "entries clusters numbers"]) -> Float[Array, "entries clusters 1"]:
    return rows[..., number : number + 1]
