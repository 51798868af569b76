"""Which tiles are ordinary: squared distances to the viewer and to all lights are normal numbers, and directions to
the viewer and to a light are less than 120 degrees apart. The equation takes care of all others, at a price.

Colours of samples that are ordinary themselves come from the same operations in both forms: they do not depend on their
neighbours. Rounding of what is computed here decides nothing.
"""

from __future__ import annotations

from functools import reduce

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from .vectors import Vector
from .world import WorldLights


def squares_in_range(place: Vector, low: Vector, high: Vector) -> Bool[Array, "..."]:
    """Whether the squared distance from `place` to whatever lies between `low` and `high` is surely a normal number."""
    nearest, farthest = [], []
    for component, below, above in zip(place, low, high, strict=True):
        before, behind = below - component, component - above
        nearest.append(jnp.maximum(before, behind))
        farthest.append(jnp.maximum(jnp.abs(before), jnp.abs(behind)))
    safe = jnp.finfo(low.x.dtype).max ** 0.4
    return (reduce(jnp.maximum, nearest) > 1 / safe) & (reduce(jnp.maximum, farthest) < safe)


def ordinary_lights(
    lights: WorldLights, viewer: Vector | None, low: Vector, high: Vector
) -> Bool[Array, "lights groups"]:
    """Which lights are surely ordinary to all samples within the bounds.

    Args:
        viewer: where it is, in range of the bounds; None: it does not matter where lights are seen from.
        low, high: lowest and highest coordinates of groups of samples, [groups] each.
    """
    found = jnp.ones((lights.count, low.x.shape[0]), dtype=bool)
    place = None if lights.place is None else _numbers(lights.place)
    if place is not None:
        found &= squares_in_range(place, low, high)
    if viewer is None:
        return found
    if place is None:
        assert lights.towards is not None
        towards = _numbers(lights.towards)
        # On its straight way between the bounds each product is least at an end.
        ends = [
            jnp.minimum(l * (eye - below), l * (eye - above))
            for l, eye, below, above in zip(towards, viewer, low, high, strict=True)
        ]
        return found & (sum(ends) > -0.5 * _least_distance(viewer, low, high))
    # (place - p) (viewer - p) is least half way between the two, or as near to there as the bounds allow.
    products = []
    for light, eye, below, above in zip(place, viewer, low, high, strict=True):
        nearest = jnp.clip(0.5 * (light + eye), below, above)
        products.append((light - nearest) * (eye - nearest))
    least = 0.5 * _least_distance(place, low, high) * _least_distance(viewer, low, high)
    return found & (sum(products) > -least)


def _numbers(planes: Vector) -> Vector:
    """Of [lights, 1, lanes], all lanes alike, [lights, 1]."""
    return Vector(*(plane[:, 0, :1] for plane in planes))


def _least_distance(place: Vector, low: Vector, high: Vector) -> Array:
    """From a place to what lies between the bounds."""
    outside = [
        jnp.maximum(jnp.maximum(below - component, component - above), 0.0)
        for component, below, above in zip(place, low, high, strict=True)
    ]
    return jnp.sqrt(sum(jnp.square(component) for component in outside))


@jax.custom_batching.custom_vmap
def for_all_mapped(flag: Bool[Array, ""]) -> Bool[Array, ""]:
    """The flag; mapped over, whether it is true for all: a tile's program takes one branch."""
    return flag


@for_all_mapped.def_vmap
def _for_all_mapped_rule(_: int, batched: list[bool], flag: Array) -> tuple[Array, bool]:
    return for_all_mapped(jnp.all(flag, axis=0) if batched[0] else flag), False
