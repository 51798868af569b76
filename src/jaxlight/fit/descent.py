"""The step of a bounded fit: damped Newton, exact within the box."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from .curvature import Curvature
from .strides import Strides

ROUNDED = 16
"""Units in the last place by which the slope of a column of length 1 may be wrong, for residuals of length 1."""


class DescentState(eqx.Module):
    """The quadratic model at a point, and the largest column norms met so far."""

    point: Float[Array, " n"]
    gradient: Float[Array, " n"]
    curvature: Curvature
    scale: Float[Array, " n"]

    def all_finite(self) -> Array:
        """[]: True if the model is made of numbers."""
        return jnp.all(jnp.isfinite(self.gradient)) & jnp.all(jnp.isfinite(self.curvature.diagonal()))


class Operator(NamedTuple):
    """A curvature as optimistix's searches take one: by its product with a vector."""

    curvature: Curvature
    sampling: Any

    def mv(self, vector: Array) -> Array:
        return self.curvature.product(vector, self.sampling)


class BoxDampedNewton(optx.AbstractDescent):
    """argmin of g^T d + 1/2 d^T (H + D^2 / step_size) d with lower <= x + d <= upper.

    D^2 is the running maximum of diag H (Marquardt, More); `lower` and `upper` are arrays
    (-inf and inf where there is no bound).
    """

    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    strides: Strides
    sampling: Any

    def init(self, y: Array, f_info_struct: Any) -> DescentState:
        return DescentState(y, jnp.zeros_like(y), f_info_struct.hessian.curvature, jnp.zeros_like(y))

    def query(self, y: Array, f_info: Any, state: DescentState) -> DescentState:
        curvature = f_info.hessian.curvature
        scale = jnp.maximum(state.scale, jnp.sqrt(jnp.maximum(curvature.diagonal(), 0)))
        return DescentState(y, f_info.grad, curvature, scale)

    def step(self, step_size: Array, state: DescentState) -> tuple[Array, Any]:
        below, above = self.strides.limits(state.point)
        lower = jnp.maximum(self.lower, state.point + below)
        upper = jnp.minimum(self.upper, state.point + above)
        move = self._step(1 / step_size, state, lower, upper)[0]
        return self.strides.shortened(state.point, move), optx.RESULTS.successful

    def undamped(self, state: DescentState, loss: Array) -> tuple[Array, Array]:
        """The step without damping, as far as the matrix can be trusted in this precision; and whether it is exact.

        Where no slope of this loss is more than rounding, so is every step that a singular matrix makes of it.
        """
        point, eps = state.point, jnp.finfo(state.point.dtype).eps
        move, exact = self._step(jnp.zeros((), point.dtype), state, self.lower, self.upper)
        scale = _scale(state)
        downhill = jnp.clip(-state.gradient / scale, scale * (self.lower - point), scale * (self.upper - point))
        at_rest = jnp.max(jnp.abs(downhill)) <= ROUNDED * eps * jnp.sqrt(2 * loss)
        return jnp.where(exact | ~at_rest, move, 0), exact | at_rest

    def _step(self, damping: Array, state: DescentState, lower: Array, upper: Array) -> tuple[Array, Array]:
        scale = _scale(state)
        lower, upper = jnp.minimum(lower - state.point, 0), jnp.maximum(upper - state.point, 0)
        return state.curvature.minimise(self.sampling, state.gradient, scale, damping, lower, upper)


def _scale(state: DescentState) -> Array:
    """Of a column of zeros (a field that nothing depends on here) 1: its gradient is 0, so it stays."""
    return jnp.where(state.scale > 0, state.scale, 1)
