"""How much a step is damped: by how well the last one kept what its quadratic model promised."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float


class SearchState(NamedTuple):
    """Present step size (1 / damping), and the factor that the next rejection divides it by."""

    step_size: Float[Array, ""]
    penalty: Float[Array, ""]


class GainRatio(optx.AbstractSearch):
    """Damping from the gain ratio, actual over predicted reduction: Nielsen's rule, bolder where the model is right.

    The ratio is taken within the rounding of the loss: a change that the precision cannot resolve is no failure.
    """

    first_step_size: float = 1e3
    accept_above: float = 1e-3

    def init(self, y: Array, f_info_struct: Any) -> SearchState:
        return SearchState(jnp.asarray(self.first_step_size, y.dtype), jnp.asarray(2.0, y.dtype))

    def step(
        self, first_step: Any, y: Array, y_eval: Array, f_info: Any, f_eval_info: Any, state: SearchState
    ) -> tuple[Array, Array, optx.RESULTS, SearchState]:
        step = y_eval - y
        predicted = jnp.vdot(step, f_info.grad + f_info.hessian.mv(step) / 2, precision="highest")
        actual = f_eval_info.as_min() - f_info.as_min()
        noise = 4 * jnp.finfo(y.dtype).eps * jnp.abs(f_info.as_min())
        ratio = (actual - noise) / jnp.minimum(predicted - noise, -jnp.finfo(y.dtype).tiny)
        accept = first_step | ((ratio > self.accept_above) & jnp.isfinite(f_eval_info.as_min()))
        bolder = jnp.where(ratio > 0.9, 0.03, jnp.maximum(0.1, 1 - (2 * ratio - 1) ** 3))
        step_size = jnp.where(accept, state.step_size / bolder, state.step_size / state.penalty)
        penalty = jnp.where(accept, 2.0, state.penalty * 2).astype(y.dtype)
        step_size = jnp.where(first_step, state.step_size, jnp.minimum(step_size, 1 / jnp.finfo(y.dtype).eps))
        return step_size, accept, optx.RESULTS.successful, SearchState(step_size, penalty)
