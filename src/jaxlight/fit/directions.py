"""In which directions a fit is differentiated: which columns of the Jacobian are computed together.

A colour's component reaches its own channel only: one derivative along red, green and blue at once holds all three
columns, a channel each (Curtis, Powell and Reid's compression). A sample has one material and is of one view: one
derivative along a number of every material, or the exposures of all views, or numbers of lights that shone in one view
each, holds the columns of all, each in its own samples. And what a number moves passes through part of the equation
only, so that directions are taken in groups:

    surfaces   colours of surfaces and fog, exposures: products with light that stays
    materials  exponents and ambient intensities of materials: factors of every light
    strengths  colours and strengths of lights: sums and products with factors of the geometry
    reach      attenuation, radii, cones: factors of distances and angles that stay
    places     places and directions of lights: the whole equation

Light adds up: what moves some lights only is differentiated without the others, and the same numbers of several lights
of a kind are differentiated light by light.

Some numbers are linear together: all colours of materials, or the colours of lights, or their strengths, or the
exposures, but no two of these, since they multiply each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from itertools import groupby
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from ..arrays import array_of
from ..scene.paths import ATTRIBUTES, LIGHT_ATTRIBUTES
from .columns import Columns, Group
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
Element = tuple[Any, int]
"""A leaf of the scene (None: the exposures) and one of its elements."""


class Apart(NamedTuple):
    """What may be told apart in sums over samples."""

    materials: bool
    """Not where a residual gathers samples of several."""
    views: bool
    lights: bool
    """Whether all views show all lights, which are the same to all then."""
    only_view: OnlyView


class Kind(IntEnum):
    """What a number moves."""

    SURFACES = 0
    MATERIALS = 1
    STRENGTHS = 2
    REACH = 3
    PLACES = 4
    SEVERAL = 5
    """Ties between numbers of several kinds."""


class _LightNumber(NamedTuple):
    """A number, or a colour, of one light."""

    kind: int
    leaf: int
    """Which of `Parameters.leaves`."""
    component: int
    light: int


_NO_LIGHT = _LightNumber(-1, -1, -1, -1)


class _Direction(NamedTuple):
    """One direction; they come in the order of their fields."""

    later: bool
    """Whether it is not among those that are linear together."""
    kind: Kind
    light: _LightNumber
    """What it moves, if that is of one light among several of a kind."""
    first: int
    """The first of its numbers."""
    numbers: tuple[tuple[int, int], ...]
    """With the channel of each; -1: all."""
    elements: tuple[Element, ...]


def columns_of(parameters: Parameters, dtype: Any, apart: Apart) -> Columns:
    """The directions for these parameters (texels of blocks are none of them)."""
    sets: list[list[Element]] = [[] for _ in range(parameters.few)]
    for part in parameters.leaves:
        for element, number in enumerate(np.asarray(part.source).tolist()):
            if number >= 0:
                sets[number].append((part.leaf, element))
    owners = np.array([_owner(elements, apart.only_view) for elements in sets], np.int32).reshape(-1, 2)
    for own, told_apart in zip(owners.T, (apart.materials, apart.views), strict=True):
        if not told_apart or len(set(own[own >= 0].tolist())) < 2:
            own[:] = -1
    ordered = _in_order(_directions(parameters, sets, owners, apart))
    directions, channels = np.zeros((len(ordered), len(sets))), np.zeros((3, len(sets)))
    direction = np.zeros(len(sets), np.int32)
    for row, own in enumerate(ordered):
        for number, channel in own.numbers:
            directions[row, number] = 1
            direction[number] = row
            channels[slice(None) if channel < 0 else channel, number] = 1
    groups = [list(group) for _, group in groupby(ordered, key=lambda own: (own.kind, own.light.kind))]
    return Columns(
        directions=array_of(directions, dtype),
        direction=array_of(direction, jnp.int32),
        channels=array_of(channels, dtype),
        material=array_of(owners[:, 0], jnp.int32),
        view=array_of(owners[:, 1], jnp.int32),
        groups=tuple(_group(parameters, group) for group in groups),
        together=sum(not own.later for own in ordered),
        apart=tuple(sorted(set(direction[owners[:, 0] >= 0].tolist()))),
        materials=int(owners[:, 0].max(initial=-1)) + 1,
        by_view=bool(np.any(owners[:, 1] >= 0)),
    )


def _owner(elements: Sequence[Element], only_view: OnlyView) -> tuple[int, int]:
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


def _directions(
    parameters: Parameters, sets: Sequence[Sequence[Element]], owners: np.ndarray, apart: Apart
) -> list[_Direction]:
    """The directions, each of numbers whose columns are in different channels or samples."""
    numbers: dict[Any, list[tuple[int, int]]] = {}
    for number, elements in enumerate(sets):
        channel, owned = _channel(elements), tuple(owners[number] >= 0)
        places = [
            (leaf, _place(leaf, element, apart.only_view) if any(owned) else element) for leaf, element in elements
        ]
        key = (owned, channel < 0, *((leaf, place if channel < 0 else place // 3) for leaf, place in places))
        numbers.setdefault(key, []).append((number, channel))
    together, found = _most_together(sets), []
    for own in numbers.values():
        elements = tuple(element for number, _ in own for element in sets[number])
        kinds = {_kind(leaf) for leaf, _ in elements}
        kind = kinds.pop() if len(kinds) == 1 else Kind.SEVERAL
        light = _light_number(parameters, elements) if apart.lights else _NO_LIGHT
        found.append(_Direction(own[0][0] not in together, kind, light, own[0][0], tuple(own), elements))
    lights = {own.light for own in found}
    several = {kind for kind in range(len(LIGHT_ATTRIBUTES)) if len({l.light for l in lights if l.kind == kind}) > 1}
    return [own if own.light.kind in several else own._replace(light=_NO_LIGHT) for own in found]


def _in_order(directions: Sequence[_Direction]) -> list[_Direction]:
    """First those that are linear together, and of the others those of the same kind: they are one group then."""
    first = {own.kind for own in directions if not own.later}
    return sorted(directions, key=lambda own: (own.later, own.kind not in first, *own[1:4]))


def _channel(elements: Sequence[Element]) -> int:
    """The one channel that a number reaches; -1: all."""
    if not all(leaf is not None and leaf.field in _COLORS for leaf, _ in elements):
        return -1
    channels = {element % 3 for _, element in elements}
    return channels.pop() if len(channels) == 1 else -1


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


def _most_together(sets: Sequence[Sequence[Element]]) -> set[int]:
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


def _light_number(parameters: Parameters, elements: Sequence[Element]) -> _LightNumber:
    """The number, or the colour by its first component, if one light's is all that is moved."""
    leaf, element = min(elements, key=lambda one: one[1])
    if leaf is None or leaf.attribute not in LIGHT_ATTRIBUTES:
        return _NO_LIGHT
    row, component = divmod(element, _width(leaf))
    if any(other != leaf or place // _width(leaf) != row for other, place in elements):
        return _NO_LIGHT
    leaves = [part.leaf for part in parameters.leaves]
    return _LightNumber(LIGHT_ATTRIBUTES.index(leaf.attribute), leaves.index(leaf), component, row)


def _group(parameters: Parameters, directions: Sequence[_Direction]) -> Group:
    elements = {element for own in directions for element in own.elements}
    owners = {leaf for leaf, _ in elements}
    leaves = tuple(place for place, part in enumerate(parameters.leaves) if part.leaf in owners)
    rows: dict[str, set[int]] = {attribute: set() for attribute in LIGHT_ATTRIBUTES}
    alone = True
    for leaf, element in elements:
        if leaf is None or leaf.attribute not in LIGHT_ATTRIBUTES:
            alone = False
        else:
            rows[leaf.attribute].add(element // _width(leaf))
    lights = tuple(tuple(sorted(rows[attribute])) for attribute in LIGHT_ATTRIBUTES)
    return Group(len(directions), leaves, lights, alone, _is_by_light([own.light for own in directions]))


def _is_by_light(numbers: Sequence[_LightNumber]) -> bool:
    """Whether directions that move these are those of the same lights for one number after the other."""
    rows = [[own.light for own in group] for _, group in groupby(numbers, key=lambda number: number[:3])]
    return numbers[0] != _NO_LIGHT and all(own == rows[0] for own in rows)
