"""How far a field may move in one step: beyond it the linearised equation says nothing.

A highlight's exponent and a light's distance act through ratios: a step that makes shininess a tenth, or throws a
light behind the scene, lands where the picture no longer tells the way back. Such a step ends at its stride, and the
next one takes its slope from there. A light whose attenuation c0 + c1 d + c2 d^2 is below 1 shines as if it were 1: no
picture tells the way back from there either, and a step that leads towards it is shortened, all of it.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


class Stride(NamedTuple):
    """Largest change of a field in one step, relative to its size; the size is at least `floor`."""

    down: float = np.inf
    up: float = np.inf
    floor: float = 1.0


UNLIMITED = Stride()
_HALF_WAY = 0.5
"""How far of the way to an attenuation of 1 one step leads at most."""
_CLOSE = 0.1
"""By so much a step may lower an attenuation in any case: that close to 1 the linearised equation is right."""
_STRIDES = {
    "shininess": Stride(0.5, 1.0, 0.02),
    "visibility_range": Stride(0.5, 1.0, 1e-6),
    "location": Stride(0.5, 0.5, 1e-6),
    "direction": Stride(0.5, 0.5, 1e-6),
    "beam_width": Stride(0.3, 0.3, 0.5),
    "cut_off_angle": Stride(0.3, 0.3, 0.5),
}


def stride_of(field: str) -> Stride:
    """The stride of a field of the specification."""
    return _STRIDES.get(field, UNLIMITED)


class Strides(eqx.Module):
    """The strides of all parameters; a vector's components share one size, its length (from `origin`)."""

    down: Float[Array, " parameters"]
    up: Float[Array, " parameters"]
    floor: Float[Array, " parameters"]
    origin: Float[Array, " parameters"]
    """Where sizes are measured from: for a light's location the middle of what it lights, else 0."""
    group: Int[Array, " parameters"]
    """Components of one vector have the same number."""
    term: Float[Array, " parameters"]
    """Of a component of an attenuation 1, d or d^2, the distance d being that of the middle of what is lit; else 0."""
    held: Float[Array, " parameters"]
    """The sum of the attenuation's terms that are not free."""

    def limits(self, values: Float[Array, " parameters"]) -> tuple[Array, Array]:
        """(lower, upper) ends of the next step, relative to the present values."""
        size = jnp.maximum(self.sizes(values), self.floor)
        return -self.down * size, self.up * size

    def shortened(self, values: Float[Array, " parameters"], step: Float[Array, " parameters"]) -> Array:
        """The step from these values, as long as attenuations allow."""
        beyond = self._summed(self.term * values) + self.held - 1
        lowered = jnp.maximum(-self._summed(self.term * step), 0)
        allowed = jnp.maximum(_HALF_WAY * beyond, _CLOSE)
        return step * jnp.min(allowed / jnp.maximum(lowered, allowed), initial=1)

    def sizes(self, values: Float[Array, " parameters"]) -> Float[Array, " parameters"]:
        """The size of each parameter, of vectors the length of what is free."""
        return jnp.sqrt(self._summed((values - self.origin) ** 2))

    def _summed(self, own: Float[Array, " parameters"]) -> Float[Array, " parameters"]:
        """Of each parameter the sum over its group."""
        return jax.ops.segment_sum(own, self.group, num_segments=own.shape[0])[self.group]
