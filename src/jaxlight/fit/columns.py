"""Which columns of the Jacobian are computed together: a colour's component reaches its own channel only.

One derivative along red, green and blue at once holds all three columns, a channel each (Curtis, Powell and Reid's
compression). A sample has one material and is of one view, so that one derivative along a number of every material at
once, or along the exposures of all views, or numbers of lights that shone in one view each, holds the columns of all,
each in its own samples. And what a number moves passes through part of the equation only, so that directions are taken
in groups:

    surfaces   colours of surfaces and fog, exposures: products with light that stays
    materials  exponents and ambient intensities of materials: factors of every light
    strengths  colours and strengths of lights: sums and products with factors of the geometry
    reach      attenuation, radii, cones: factors of distances and angles that stay
    places     places and directions of lights: the whole equation

Light adds up: what moves some lights only is differentiated without the others.

Some numbers are linear together: all colours of materials, or the colours of lights, or their strengths, or the
exposures, but no two of these, since they multiply each other.
"""

from __future__ import annotations

import dataclasses
from enum import IntEnum
from itertools import groupby
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..arrays import array_of
from ..scene.paths import ATTRIBUTES, LIGHT_ATTRIBUTES
from .parameters import Parameters

_COLORS = ("diffuse_color", "specular_color", "emissive_color", "color")
_PLACES = ("location", "direction")
_VECTORS = (*_COLORS, "attenuation", *_PLACES)
"""Fields of materials and lights with three numbers."""
_ADDED = (("materials", "emissive_color"), ("fog", "color"))
_TOGETHER: tuple[frozenset[tuple[str, str]], ...] = (
    frozenset([("materials", "diffuse_color"), ("materials", "specular_color"), *_ADDED]),
    frozenset([*((kind, "color") for kind in LIGHT_ATTRIBUTES), *_ADDED]),
    frozenset([*((kind, field) for kind in LIGHT_ATTRIBUTES for field in ("intensity", "ambient_intensity")), *_ADDED]),
    frozenset([("views", "exposure")]),
)
"""Fields in which the equation is linear as long as all others are fixed."""


OnlyView = dict[str, Int[np.ndarray, " lights"]]
"""By where a Scene keeps the lights of a kind: the only view in which each of them shone; -1: in several, or none."""


class Kind(IntEnum):
    """What a number moves."""

    SURFACES = 0
    MATERIALS = 1
    STRENGTHS = 2
    REACH = 3
    PLACES = 4
    SEVERAL = 5
    """Ties between numbers of several kinds."""


Rows = tuple[tuple[int, ...], ...]
"""Rows of directional, point and spot lights."""


class Group(NamedTuple):
    """Consecutive directions of one kind."""

    directions: int
    leaves: tuple[int, ...]
    """Which of `Parameters.leaves` they move."""
    lights: Rows
    """Which lights they move."""
    alone: bool
    """Whether they move nothing else."""


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


def columns_of(parameters: Parameters, dtype: Any, only_view: OnlyView, *, by_material: bool, by_view: bool) -> Columns:
    """The directions for these parameters (texels of blocks are none of them).

    `by_material`, `by_view`: sums over samples may be told apart so; not by material where a residual gathers samples
    of several.
    """
    sets: list[list[tuple[Any, int]]] = [[] for _ in range(parameters.few)]
    for part in parameters.leaves:
        for element, number in enumerate(np.asarray(part.source).tolist()):
            if number >= 0:
                sets[number].append((part.leaf, element))
    owners = np.array([_owner(elements, only_view) for elements in sets], np.int32).reshape(-1, 2)
    for own, told_apart in zip(owners.T, (by_material, by_view), strict=True):
        if not told_apart or len(set(own[own >= 0].tolist())) < 2:
            own[:] = -1
    together = _most_together(sets)
    # Of each direction: the numbers that it moves, with their channels; where it comes in the order; the elements.
    columns: dict[Any, list[tuple[int, int]]] = {}
    order: dict[Any, tuple[bool, Kind]] = {}
    moved: dict[Any, set[tuple[Any, int]]] = {}
    for number, elements in enumerate(sets):
        channel = _channel(elements)
        owned = (owners[number] >= 0).tolist()
        places = [(leaf, _place(leaf, element, only_view) if any(owned) else element) for leaf, element in elements]
        key = (*owned, channel is None, *((leaf, place if channel is None else place // 3) for leaf, place in places))
        columns.setdefault(key, []).append((-1 if channel is None else channel, number))
        moved.setdefault(key, set()).update(elements)
        kinds = {_kind(leaf) for leaf, _ in elements}
        order[key] = (number not in together, kinds.pop() if len(kinds) == 1 else Kind.SEVERAL)
    first = {kind for later, kind in order.values() if not later}
    # Of the others those first that are of the same kind: they are one group then.
    keys = sorted(columns, key=lambda key: (order[key][0], order[key][1] not in first, order[key][1]))
    directions, channels = np.zeros((len(keys), len(sets))), np.zeros((3, len(sets)))
    direction = np.zeros(len(sets), np.int32)
    for row, key in enumerate(keys):
        for channel, number in columns[key]:
            directions[row, number] = 1
            direction[number] = row
            channels[slice(None) if channel < 0 else channel, number] = 1
    groups = [list(group) for _, group in groupby(keys, key=lambda key: order[key][1])]
    return Columns(
        directions=array_of(directions, dtype),
        direction=array_of(direction, jnp.int32),
        channels=array_of(channels, dtype),
        material=array_of(owners[:, 0], jnp.int32),
        view=array_of(owners[:, 1], jnp.int32),
        groups=tuple(_group(parameters, len(group), set().union(*(moved[key] for key in group))) for group in groups),
        together=sum(not later for later, _ in order.values()),
        apart=tuple(sorted(set(direction[owners[:, 0] >= 0].tolist()))),
        materials=int(owners[:, 0].max(initial=-1)) + 1,
        by_view=bool(np.any(owners[:, 1] >= 0)),
    )


def _owner(elements: list[tuple[Any, int]], only_view: OnlyView) -> tuple[int, int]:
    """The only material or the only view in whose samples these are seen; -1: no such."""
    owners = set()
    for leaf, element in elements:
        if leaf is None:
            owners.add((-1, element))
        elif leaf.attribute == ATTRIBUTES["Material"]:
            owners.add((element // _width(leaf), -1))
        elif leaf.attribute in LIGHT_ATTRIBUTES:
            owners.add((-1, int(only_view[leaf.attribute][element // _width(leaf)])))
        else:
            owners.add((-1, -1))
    return owners.pop() if len(owners) == 1 else (-1, -1)


def _place(leaf: Any, element: int, only_view: OnlyView) -> int:
    """Of a number that is seen in the samples of one material or view only: which of these it is in its leaf."""
    if leaf is None:
        return 0
    row, component = divmod(element, _width(leaf))
    if leaf.attribute in LIGHT_ATTRIBUTES:
        view = only_view[leaf.attribute]
        return int(np.count_nonzero(view[:row] == view[row])) * _width(leaf) + component
    return component


def _width(leaf: Any) -> int:
    """Numbers of the field in each row."""
    return 3 if leaf.field in _VECTORS else 1


def _most_together(sets: list[list[tuple[Any, int]]]) -> set[int]:
    """The largest set of numbers that are linear together; the first of equal ones."""
    names = [{("views", "exposure") if leaf is None else (leaf.attribute, leaf.field) for leaf, _ in e} for e in sets]
    choices = [{number for number, fields in enumerate(names) if fields <= group} for group in _TOGETHER]
    return max(choices, key=len)


def _kind(leaf: Any) -> Kind:
    if leaf is not None and leaf.attribute in LIGHT_ATTRIBUTES:
        if leaf.field in ("color", "intensity", "ambient_intensity"):
            return Kind.STRENGTHS
        return Kind.PLACES if leaf.field in _PLACES else Kind.REACH
    return Kind.MATERIALS if leaf is not None and leaf.field in ("shininess", "ambient_intensity") else Kind.SURFACES


def _group(parameters: Parameters, directions: int, elements: set[tuple[Any, int]]) -> Group:
    """The group of so many directions that move these elements of leaves."""
    owners = {leaf for leaf, _ in elements}
    leaves = tuple(place for place, part in enumerate(parameters.leaves) if part.leaf in owners)
    rows: dict[str, set[int]] = {attribute: set() for attribute in LIGHT_ATTRIBUTES}
    alone = True
    for leaf, element in elements:
        if leaf is None or leaf.attribute not in LIGHT_ATTRIBUTES:
            alone = False
        else:
            rows[leaf.attribute].add(element // _width(leaf))
    return Group(directions, leaves, tuple(tuple(sorted(rows[attribute])) for attribute in LIGHT_ATTRIBUTES), alone)


def _channel(elements: list[tuple[Any, int]]) -> int | None:
    """The one channel that a number reaches; None: all."""
    if not all(leaf is not None and leaf.field in _COLORS for leaf, _ in elements):
        return None
    channels = {element % 3 for _, element in elements}
    return channels.pop() if len(channels) == 1 else None


def _taken(planes: Array, numbers: Array, axis: int) -> Array:
    """The planes of these numbers, which are known to be in bounds."""
    return jnp.take(planes, numbers, axis=axis, mode="clip")
