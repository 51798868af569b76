"""Where the clusters of a tile stand in its planes, which of them are worked on at once, and how their lights are read.

A cluster is a few neighbouring samples that share a list of lights (see `culling`). In stages each has a lane: what its
lights are made of is spread over lanes, and derivatives add up over rows. In loops over samples each has a row: what a
light is made of is read once for all samples of the cluster.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol, cast

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental.layout import Layout, with_layout_constraint
from jaxtyping import Array, Float, Int

from ..processor import sizes
from .picking import picked
from .unstored import Inlined, is_unstored, stored

Pick = Callable[[Int[Array, "entries clusters"]], list[Array]]
"""From the rows of lights their numbers: planes [..., entries, rows or 1, lanes or 1]."""


class Arrangement(Protocol):
    """Of clusters in planes."""

    entries: int
    """Of its list that each works through at once."""

    @staticmethod
    def at_once() -> int:
        """How many clusters work through their lists side by side."""
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
    def in_parts(function: Callable[[Array, Any], Any], total: Any, firsts: Int[Array, " parts"]) -> Any:
        """function(first, its part of `total`) of every `at_once` clusters, put together to one for all of them."""
        ...

    @staticmethod
    def picking(boundary: Callable[..., Any], numbers: Sequence[Float[Array, "*components lights"]]) -> Pick:
        """For lists of lights, of each of these arrays the numbers of lights, which are picked behind a boundary."""
        ...


class InLanes:
    """Planes [samples of a cluster, clusters]."""

    entries = 4

    @staticmethod
    def at_once() -> int:
        return sizes().derived_clusters

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
    def in_parts(function: Callable[[Array, Any], Any], total: Any, firsts: Array) -> Any:
        assert total is None  # is added where derivatives pass a sum and not its terms

        # Checkpoint: what derivatives need of a part is computed anew, and never stored for all.
        parts = lax.map(jax.checkpoint(lambda first: stored(function(first, None))), firsts)

        def joined(part: Array) -> Array:
            whole = jnp.moveaxis(part, 0, -2)
            return whole.reshape(*whole.shape[:-2], -1)

        return jax.tree.map(joined, parts)

    @staticmethod
    def picking(boundary: Callable[..., Any], numbers: Sequence[Array]) -> Pick:
        def pick(row: Array) -> list[Array]:
            return [_with_rows(plane) for plane in boundary(picked, numbers, row, name="listed_lights")]

        return pick


class InRows:
    """Planes [clusters, samples of a cluster]; nothing is differentiated."""

    entries = 8

    @staticmethod
    def at_once() -> int:
        return sizes().clusters

    @staticmethod
    def arranged(planes: Array, order: Array | None) -> Array:
        return planes if order is None else planes.at[..., order, :].get(mode="promise_in_bounds", unique_indices=True)

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
    def in_parts(function: Callable[[Array, Any], Any], total: Any, firsts: Array) -> Any:
        own = jax.tree.map(lambda rows: rows.reshape(len(firsts), -1, *rows.shape[1:]), _rows_first(total))
        parts = lax.map(lambda part: _rows_first(function(part[0], _rows_in_place(part[1]))), (firsts, own))
        return _rows_in_place(jax.tree.map(lambda part: part.reshape(-1, *part.shape[2:]), parts))

    @staticmethod
    def picking(boundary: Callable[..., Any], numbers: Sequence[Array]) -> Pick:
        # All numbers of a light side by side, in whole vectors: they are copied at once.
        columns = jnp.concatenate([plane.reshape(-1, plane.shape[-1]) for plane in numbers])
        table = jnp.pad(columns, ((0, -len(columns) % _VECTOR), (0, 0))).T

        def pick(row: Array) -> list[Array]:
            listed = boundary(lambda: table.at[row].get(mode="promise_in_bounds"), name="listed_lights")
            planes, first = [], 0
            for plane in numbers:
                components = plane.shape[:-1]
                planes.append(cast(Array, Inlined(partial(_columns, first, components), (listed,))))
                first += math.prod(components)
            return planes

        return pick


_VECTOR = 16
"""Numbers of float32 that a processor copies at once."""


def inverse(order: Int[Array, " clusters"]) -> Int[Array, " clusters"]:
    """Where each of the clusters went that are in this order."""
    count = jnp.arange(order.shape[0], dtype=order.dtype)
    return jnp.zeros_like(order).at[order].set(count, unique_indices=True, mode="promise_in_bounds")


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


def _columns(
    first: int, components: tuple[int, ...], listed: Float[Array, "entries clusters numbers"]
) -> Float[Array, "*components entries clusters 1"]:
    own = jnp.moveaxis(listed[..., first : first + math.prod(components)], -1, 0)
    return own.reshape(*components, *own.shape[1:], 1)
