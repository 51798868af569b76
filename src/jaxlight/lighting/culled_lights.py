"""Lights of which every sample is shaded with a few only, in the two forms in which these are read.

Loops over samples read them from a table, which has no derivatives: a row holds all that a light is made of, side by
side, and is copied at once. Derivatives are those of planes, number by number, so that only what moves has any.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from .picking import picked
from .world import WorldLights

_VECTOR = 16
"""Numbers of float32 that a processor copies at once."""


class LightTable(eqx.Module):
    """Lights row by row, and one that is black; without derivatives."""

    rows: Float[Array, "rows numbers"]
    """Filled up to whole vectors; the last one is black."""
    components: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """Of the leaves of `WorldLights`, whose numbers follow one another: (3,) of colours, else ()."""
    tree: Any = eqx.field(static=True)

    @property
    def count(self) -> int:
        """How many lights, without the black one, whose row this is."""
        return self.rows.shape[0] - 1

    def of(self, row: Int[Array, " some"]) -> LightTable:
        """The lights in these rows, the last of which is that of the black one; none is out of range."""
        return dataclasses.replace(self, rows=self.read(row))

    def lights(self, first: Int[Array, ""] | int, count: int) -> WorldLights:
        """So many lights from the first on; planes [lights, 1, 1]."""
        rows = lax.dynamic_slice_in_dim(self.rows, first, count)
        leaves, number = [], 0
        for own in self.components:
            columns = rows[:, number : number + math.prod(own)].T
            leaves.append(columns.reshape(*own, -1, 1, 1))
            number += math.prod(own)
        return self.tree.unflatten(leaves)

    def read(self, row: Int[Array, "*rows"]) -> Float[Array, "*rows numbers"]:
        """All numbers of the lights in these rows; none is out of range."""
        return self.rows.at[row].get(mode="promise_in_bounds")


class LightPlanes(eqx.Module):
    """Lights number by number, and one that is black."""

    planes: WorldLights
    """On one lane; the black one is the last, or follows the last."""
    count: int = eqx.field(static=True)
    """How many lights, without the black one, whose row this is."""

    def of(self, row: Int[Array, " some"]) -> LightPlanes:
        """The lights in these rows, the last of which is that of the black one."""
        colored = (row < self.count)[:, None, None]
        there = jnp.minimum(row, self.count - 1)
        some = self.planes.with_planes(
            lambda plane: plane[there], lambda colors: jnp.where(colored, colors[:, there], 0.0)
        )
        return LightPlanes(some, row.shape[0] - 1)

    def lights(self, first: Int[Array, ""] | int, count: int) -> WorldLights:
        """So many lights from the first on; planes [lights, 1, 1], without derivatives."""
        return jax.tree.map(
            lambda plane: lax.dynamic_slice_in_dim(plane, first, count, axis=-3), lax.stop_gradient(self.planes)
        )

    def read(self, row: Int[Array, "*rows"]) -> list[Float[Array, "*components *rows"]]:
        """The numbers of the lights in these rows, by leaf of `WorldLights`; none is out of range."""
        return picked([plane[..., 0, 0] for plane in jax.tree.leaves(self.planes)], row)


Form = LightTable | LightPlanes


class CulledLights(eqx.Module):
    """Lights of one kind, of which some are found and read."""

    planes: LightPlanes
    table: LightTable

    @property
    def count(self) -> int:
        """How many lights."""
        return self.planes.count


def culled_lights(lights: WorldLights) -> CulledLights:
    """Of lights on one lane."""
    known = lax.stop_gradient(lights)
    leaves, tree = jax.tree.flatten(known)
    columns = jnp.concatenate([leaf.reshape(-1, lights.count) for leaf in leaves])
    of_color = np.concatenate([np.full(math.prod(leaf.shape[:-3]), leaf is known.color) for leaf in leaves])
    black = jnp.where(of_color[:, None], 0.0, columns[:, -1:])
    filled = jnp.pad(jnp.concatenate([columns, black], axis=1), ((0, -len(columns) % _VECTOR), (0, 0)))
    table = LightTable(filled.T, tuple(leaf.shape[:-3] for leaf in leaves), tree)
    return CulledLights(LightPlanes(lights, lights.count), table)
