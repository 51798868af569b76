"""Which columns of the Jacobian are computed together: a colour's component reaches its own channel only.

One derivative along red, green and blue at once holds all three columns, a channel each (Curtis, Powell and Reid's
compression). And the equation weighs colours by factors of the geometry alone, so that derivatives by colours and
strengths leave the geometry untouched.

    weighing   colours and strengths: derivatives of sums and products
    shaping    places, directions, angles, exponents: derivatives through the whole equation

Among those that weigh, some are linear together: all colours of materials, or the colours of lights, or their
strengths, or the exposures, but no two of these, since they multiply each other.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .parameters import Parameters

_COLORS = ("diffuse_color", "specular_color", "emissive_color", "color")
_STRENGTHS = ("ambient_intensity", "intensity", "transparency")
_ADDED = (("materials", "emissive_color"), ("fog", "color"))
_LIGHTS = ("directional", "point", "spot")
_TOGETHER: tuple[frozenset[tuple[str, str]], ...] = (
    frozenset([("materials", "diffuse_color"), ("materials", "specular_color"), *_ADDED]),
    frozenset([*((kind, "color") for kind in _LIGHTS), *_ADDED]),
    frozenset([*((kind, field) for kind in _LIGHTS for field in ("intensity", "ambient_intensity")), *_ADDED]),
    frozenset([("views", "exposure")]),
)
"""Fields in which the equation is linear as long as all others are fixed."""


class Columns(eqx.Module):
    """Directions in which a fit is differentiated, and which channel of each is a number's column."""

    weighing: Float[Array, "weighing numbers"]
    """1 where a direction moves a number that weighs."""
    shaping: Float[Array, "shaping numbers"]
    own: Float[Array, "3 directions numbers"]
    """1 where a channel of a direction (weighing ones first) is that channel of a number's column."""
    mixed: bool = eqx.field(static=True)
    """True if a number both weighs and shapes (ties between such fields); it counts as shaping."""
    together: int = eqx.field(static=True)
    """So many directions, the first of the weighing ones, are linear together."""

    @property
    def count(self) -> int:
        """Number of directions."""
        return self.own.shape[1]

    def linear(self) -> Columns:
        """The directions that are linear together."""
        return self.first(self.together)

    def first(self, few: int) -> Columns:
        """The first of those that are linear together."""
        return Columns(self.weighing[:few], self.shaping[:0], self.own[:, :few], mixed=False, together=few)

    def gathered(self, products: Float[Array, "3 directions directions"]) -> Float[Array, "numbers numbers"]:
        """J^T J from the products of the directions' derivatives, channel by channel."""
        return jnp.einsum("cip,cij,cjq->pq", self.own, products, self.own, precision="highest")

    def gathered_slope(self, products: Float[Array, "3 directions"]) -> Float[Array, " numbers"]:
        """J^T r from the products of the directions' derivatives with the residuals, channel by channel."""
        return jnp.einsum("cip,ci->p", self.own, products, precision="highest")

    def jacobian(self, planes: Float[Array, "3 directions samples"]) -> Float[Array, "numbers 3 samples"]:
        """The columns, channel by channel, from the directions' derivatives."""
        return jnp.einsum("cip,cis->pcs", self.own, planes, precision="highest")


def columns_of(parameters: Parameters, dtype: Any) -> Columns:
    """The directions for these parameters (texels of blocks are none of them)."""
    sets: list[list[tuple[Any, int]]] = [[] for _ in range(parameters.few)]
    for part in parameters.leaves:
        for element, number in zip(np.asarray(part.elements).tolist(), np.asarray(part.sources).tolist(), strict=True):
            sets[number].append((part.leaf, element))
    together = _most_together(sets)
    groups: dict[Any, dict[int, int]] = {}
    rank: dict[Any, int] = {}
    mixed = False
    for number, elements in enumerate(sets):
        kinds = {_weighs(leaf) for leaf, _ in elements}
        mixed |= len(kinds) > 1
        channel = _channel(elements)
        key: Any = number if channel is None else tuple((leaf, element // 3) for leaf, element in elements)
        groups.setdefault(key, {})[-1 if channel is None else channel] = number
        rank[key] = 0 if number in together else 1 if kinds == {True} else 2
    keys = sorted(groups, key=lambda key: rank[key])
    directions, own = np.zeros((len(keys), len(sets))), np.zeros((3, len(keys), len(sets)))
    for row, key in enumerate(keys):
        for channel, number in groups[key].items():
            directions[row, number] = 1
            own[slice(None) if channel < 0 else channel, row, number] = 1
    ranks = list(rank.values())
    weighing = ranks.count(0) + ranks.count(1)
    return Columns(
        jnp.asarray(directions[:weighing], dtype),
        jnp.asarray(directions[weighing:], dtype),
        jnp.asarray(own, dtype),
        mixed,
        ranks.count(0),
    )


def _most_together(sets: list[list[tuple[Any, int]]]) -> set[int]:
    """The largest set of numbers that are linear together; the first of equal ones."""
    names = [{("views", "exposure") if leaf is None else (leaf.attribute, leaf.field) for leaf, _ in e} for e in sets]
    choices = [{number for number, fields in enumerate(names) if fields <= group} for group in _TOGETHER]
    return max(choices, key=len)


def _weighs(leaf: Any) -> bool:
    return leaf is None or leaf.field in _COLORS or leaf.field in _STRENGTHS


def _channel(elements: list[tuple[Any, int]]) -> int | None:
    """The one channel that a number reaches; None: all."""
    if not all(leaf is not None and leaf.field in _COLORS for leaf, _ in elements):
        return None
    channels = {element % 3 for _, element in elements}
    return channels.pop() if len(channels) == 1 else None
