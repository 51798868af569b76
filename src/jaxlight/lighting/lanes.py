"""Numbers on all lanes of a row of samples, so that their derivatives add up lane by lane, which the processor does at
once; and such derivatives in one array: of several, each would be added up by a loop of its own."""

from __future__ import annotations

import dataclasses
from functools import reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from . import own_sums
from .prepared import Prepared, is_only
from .world import WorldFog, WorldLights

FEWER_LANES = 16
"""Of whole vectors: to add up derivatives of many lights tile by tile on all lanes is to go through more memory."""


class Packed(NamedTuple):
    """Planes of `Prepared`, or of those leaves of it that move."""

    rows: Float[Array, "numbers lanes"] | None
    """Of what is spread over lanes: lights, fog and the only material; None: of these nothing moves."""
    others: Prepared
    """None where a plane is among the rows."""


def on_all_lanes(prepared: Prepared) -> Prepared:
    """The same numbers, and every lane has its own copy."""
    return _with_spread(prepared, lambda plane: jnp.broadcast_to(plane, (*plane.shape[:-1], prepared.lanes)))


def on_fewer_lanes(slope: Prepared) -> Prepared:
    """Of derivatives by the numbers on all lanes sums over some of the lanes each."""

    def folded(plane: Array) -> Array:
        lanes = plane.shape[-1]
        if lanes % FEWER_LANES or lanes == FEWER_LANES:
            return plane
        return reduce(jnp.add, [plane[..., first : first + FEWER_LANES] for first in range(0, lanes, FEWER_LANES)])

    return _with_spread(slope, folded)


def packed(planes: Prepared) -> Packed:
    """The planes, put together."""
    own, others = eqx.partition(planes, _is_spread(planes))
    rows = [plane.reshape(-1, plane.shape[-1]) for plane in jax.tree.leaves(own)]
    return Packed(jnp.concatenate(rows) if rows else None, others)


def spread(planes: Packed, lanes: int) -> Packed:
    """The same numbers on so many lanes, from one."""
    rows = planes.rows
    wide = None if rows is None else own_sums.spread(rows, (rows.shape[0], lanes))
    return Packed(wide, on_all_lanes(planes.others))


def summed(planes: Packed) -> Packed:
    """Sums over all lanes, on one lane."""

    def total(plane: Array) -> Array:
        return jnp.sum(plane, axis=-1, keepdims=True)

    return Packed(None if planes.rows is None else total(planes.rows), _with_spread(planes.others, total))


def unpacked(planes: Packed, like: Prepared) -> Prepared:
    """The planes that `packed` put together, those of `like` on any number of lanes."""
    if planes.rows is None:
        return planes.others
    leaves, tree = jax.tree.flatten(eqx.filter(like, _is_spread(like)))
    shapes = [plane.shape[:-1] for plane in leaves]
    parts = lax.split(planes.rows, [int(np.prod(shape)) for shape in shapes])
    own = [part.reshape(*shape, -1) for part, shape in zip(parts, shapes, strict=True)]
    return eqx.combine(tree.unflatten(own), planes.others)


def _with_spread(prepared: Prepared, function: Any) -> Prepared:
    """With a function of the planes that are spread over lanes in their places."""
    return jax.tree.map(
        lambda plane, is_spread: function(plane) if is_spread else plane, prepared, _is_spread(prepared)
    )


def _is_spread(prepared: Prepared) -> Prepared:
    """Which planes are: numbers of the only material, of fog and of lights that are not culled. Of several materials a
    tile spreads its own, and of frames derivatives are too many to be kept lane by lane."""

    def all_of(part: Any) -> Any:
        return jax.tree.map(lambda _: True, part)

    def none_of(part: Any) -> Any:
        return jax.tree.map(lambda _: False, part)

    def but_frame(part: Any) -> Any:
        if isinstance(part, WorldLights | WorldFog):
            return dataclasses.replace(all_of(part), to_local=none_of(part.to_local))
        return none_of(part)

    materials = prepared.materials
    return dataclasses.replace(
        none_of(prepared),
        materials=all_of(materials) if materials is None or is_only(materials) else none_of(materials),
        lights=tuple(map(but_frame, prepared.lights)),
        fog=but_frame(prepared.fog),
    )
