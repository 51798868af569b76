"""The directions in which a fit is differentiated, and which column of the Jacobian is which part of them."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..scene.paths import LIGHT_ATTRIBUTES

Rows = tuple[tuple[int, ...], ...]
"""Rows of directional, point and spot lights."""


class Group(NamedTuple):
    """Consecutive directions of one kind, of lights of one kind if each moves one light."""

    directions: int
    leaves: tuple[int, ...]
    """Which of `Parameters.leaves` they move."""
    lights: Rows
    """Which lights they move."""
    alone: bool
    """Whether they move nothing else."""
    by_light: bool
    """Whether each moves one light, the same numbers of all: for one number after the other that of every light."""


class Columns(eqx.Module):
    """Directions in which a fit is differentiated, and which part of each is a number's column: some channels, in all
    samples or in those of one material or view."""

    directions: Float[Array, "directions numbers"]
    """1 where a direction moves a number."""
    direction: Int[Array, " numbers"]
    """Which direction moves a number."""
    channels: Float[Array, "3 numbers"]
    """1 where a channel of that direction is the number's."""
    material: Int[Array, " numbers"]
    """The material in whose samples the number's column is looked for; -1: in all."""
    view: Int[Array, " numbers"]
    """The view in whose samples it is; -1: in all."""
    groups: tuple[Group, ...] = eqx.field(static=True)
    together: int = eqx.field(static=True)
    """So many directions, the first ones, are linear together."""
    apart: tuple[int, ...] = eqx.field(static=True)
    """Directions that move numbers of several materials, which are told apart."""
    materials: int = eqx.field(static=True)
    """How many materials are told apart; 0: none."""
    by_view: bool = eqx.field(static=True)
    """Whether views are told apart."""

    @property
    def count(self) -> int:
        """Number of directions."""
        return self.directions.shape[0]

    @property
    def shared(self) -> tuple[int, ...]:
        """Directions that are not told apart by material."""
        return tuple(row for row in range(self.count) if row not in self.apart)

    @property
    def lights(self) -> Rows:
        """The lights that some direction moves."""
        kinds = range(len(LIGHT_ATTRIBUTES))
        return tuple(tuple(sorted({row for group in self.groups for row in group.lights[kind]})) for kind in kinds)

    def directions_of(self, place: int) -> Float[Array, "directions numbers"]:
        """Of the group in this place."""
        end = sum(group.directions for group in self.groups[: place + 1])
        return self.directions[end - self.groups[place].directions : end]

    def linear(self) -> Columns:
        """The directions that are linear together."""
        return self.first(self.together)

    def first(self, few: int) -> Columns:
        """The first of those that are linear together."""
        ends = np.cumsum([group.directions for group in self.groups])
        starts = [int(end) - group.directions for end, group in zip(ends, self.groups, strict=True)]
        groups = [
            group._replace(directions=min(group.directions, few - start))
            for start, group in zip(starts, self.groups, strict=True)
            if start < few
        ]
        apart = tuple(row for row in self.apart if row < few)
        return dataclasses.replace(
            self,
            directions=self.directions[:few],
            direction=jnp.minimum(self.direction, max(few - 1, 0)),
            channels=jnp.where(self.direction < few, self.channels, 0),
            groups=tuple(groups),
            together=few,
            apart=apart,
            materials=self.materials if apart else 0,
            by_view=self.by_view and few > 0,
        )

    def of_view(self, row: Int[Array, ""]) -> Columns:
        """Without columns that are looked for in other views."""
        return dataclasses.replace(
            self, channels=jnp.where((self.view < 0) | (self.view == row), self.channels, 0), by_view=False
        )

    def by_number(self, products: Float[Array, "... directions"]) -> Float[Array, "... numbers"]:
        """Of every number what there is of its direction."""
        return _taken(products, self.direction, -1)

    def jacobian(self, planes: Float[Array, "3 directions samples"]) -> Float[Array, "numbers 3 samples"]:
        """The columns, channel by channel, from the directions' derivatives, where nothing is told apart."""
        return jnp.swapaxes(_taken(planes, self.direction, 1) * self.channels[..., None], 0, 1)


def _taken(planes: Array, numbers: Array, axis: int) -> Array:
    """The planes of these numbers, which are known to be in bounds."""
    return jnp.take(planes, numbers, axis=axis, mode="clip")
