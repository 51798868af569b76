"""Which columns of the Jacobian are computed together: a colour's component reaches its own channel only.

One derivative along red, green and blue at once holds all three columns, a channel each (Curtis, Powell and Reid's
compression). And the equation weighs colours by factors of the geometry alone, so that derivatives by colours and
strengths leave the geometry untouched.

    weighing   colours and strengths: derivatives of sums and products
    shaping    places, directions, angles, exponents: derivatives through the whole equation
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


class Columns(eqx.Module):
    """Directions in which a fit is differentiated, and which channel of each is a number's column."""

    weighing: Float[Array, "weighing numbers"]
    """1 where a direction moves a number that weighs."""
    shaping: Float[Array, "shaping numbers"]
    own: Float[Array, "3 directions numbers"]
    """1 where a channel of a direction (weighing ones first) is that channel of a number's column."""
    mixed: bool = eqx.field(static=True)
    """True if a number both weighs and shapes (ties between such fields); it counts as shaping."""

    @property
    def count(self) -> int:
        """Number of directions."""
        return self.own.shape[1]

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
    groups: dict[Any, dict[int, int]] = {}
    weighs: dict[Any, bool] = {}
    mixed = False
    for number, elements in enumerate(sets):
        kinds = {_weighs(leaf) for leaf, _ in elements}
        mixed |= len(kinds) > 1
        channel = _channel(elements)
        key: Any = number if channel is None else tuple((leaf, element // 3) for leaf, element in elements)
        groups.setdefault(key, {})[-1 if channel is None else channel] = number
        weighs[key] = kinds == {True}
    keys = sorted(groups, key=lambda key: not weighs[key])
    directions, own = np.zeros((len(keys), len(sets))), np.zeros((3, len(keys), len(sets)))
    for row, key in enumerate(keys):
        for channel, number in groups[key].items():
            directions[row, number] = 1
            own[slice(None) if channel < 0 else channel, row, number] = 1
    weighing = sum(weighs.values())
    return Columns(
        jnp.asarray(directions[:weighing], dtype),
        jnp.asarray(directions[weighing:], dtype),
        jnp.asarray(own, dtype),
        mixed,
    )


def _weighs(leaf: Any) -> bool:
    return leaf is None or leaf.field in _COLORS or leaf.field in _STRENGTHS


def _channel(elements: list[tuple[Any, int]]) -> int | None:
    """The one channel that a number reaches; None: all."""
    if not all(leaf is not None and leaf.field in _COLORS for leaf, _ in elements):
        return None
    channels = {element % 3 for _, element in elements}
    return channels.pop() if len(channels) == 1 else None
