"""Bounded Levenberg-Marquardt on the normal equations, composed of optimistix's parts.

    descent   damped Newton step, exact within the box, Marquardt scaling (`BoxDampedNewton`)
    search    damping by the gain ratio (`GainRatio`)
    solver    evaluates the loss at every trial and the normal equations only where a trial is accepted

The derivatives come from two functions in `options` (`loss`, `normal_equations`), so that a problem with millions of
residuals never forms its Jacobian; without them they are taken from the residual function.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from .box import minimise_in_box
from .strides import Strides

MAX_DAMPING = 1e8
KINK_DAMPING = 1e3
KINK_OFFSET = 0.1


class DescentState(eqx.Module):
    """The quadratic model in scaled variables, and the largest column norms met so far."""

    point: Float[Array, " n"]
    gradient: Float[Array, " n"]
    curvature: Float[Array, "n n"]
    scale: Float[Array, " n"]


class BoxDampedNewton(optx.AbstractDescent):
    """argmin of g^T d + 1/2 d^T (H + D^2 / step_size) d with lower <= x + d <= upper.

    D^2 is the running maximum of diag H (Marquardt, More); `lower` and `upper` are arrays
    (-inf and inf where there is no bound).
    """

    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    strides: Strides

    def init(self, y: Array, f_info_struct: Any) -> DescentState:
        zeros = jnp.zeros_like(y)
        return DescentState(zeros, zeros, jnp.zeros((y.shape[0], y.shape[0]), y.dtype), zeros)

    def query(self, y: Array, f_info: Any, state: DescentState) -> DescentState:
        curvature = f_info.hessian.as_matrix()
        scale = jnp.maximum(state.scale, jnp.sqrt(jnp.maximum(jnp.diagonal(curvature), 0)))
        return DescentState(y, f_info.grad, curvature, scale)

    def step(self, step_size: Array, state: DescentState) -> tuple[Array, Any]:
        below, above = self.strides.limits(state.point)
        lower = jnp.maximum(self.lower, state.point + below)
        upper = jnp.minimum(self.upper, state.point + above)
        return self._step(1 / step_size, state, lower, upper)[0], optx.RESULTS.successful

    def undamped(self, state: DescentState) -> tuple[Array, Array]:
        """The step without damping, as far as the matrix can be trusted in this precision; and whether it is exact."""
        return self._step(jnp.zeros((), state.point.dtype), state, self.lower, self.upper)

    def _step(self, damping: Array, state: DescentState, lower: Array, upper: Array) -> tuple[Array, Array]:
        # A column of zeros (a field that nothing depends on here) gets scale 1: its gradient is 0, so it stays.
        scale = jnp.where(state.scale > 0, state.scale, 1)
        size = scale.shape[0]
        floor = size * jnp.finfo(scale.dtype).eps
        hessian = state.curvature / (scale[:, None] * scale[None, :])
        hessian = hessian + jnp.maximum(damping, floor) * jnp.eye(size, dtype=scale.dtype)
        lower, upper = (lower - state.point) * scale, (upper - state.point) * scale
        scaled = minimise_in_box(hessian, state.gradient / scale, jnp.minimum(lower, 0), jnp.maximum(upper, 0))
        return scaled.point / scale, scaled.solved


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


class SolverState(eqx.Module):
    """All that the solver carries from step to step: arrays only, so that it can be saved and restored."""

    first_step: Bool[Array, ""]
    y_eval: Float[Array, " n"]
    loss: Float[Array, ""]
    gradient: Float[Array, " n"]
    curvature: Float[Array, "n n"]
    descent_state: DescentState
    search_state: SearchState
    achievable: Float[Array, ""]
    """How much lower the undamped quadratic model thinks the loss can get."""
    step_norm: Float[Array, ""]
    """Undamped step relative to the tolerance: below 1 is converged."""
    accepted: Bool[Array, ""]
    num_steps: Int[Array, ""]
    num_accepted_steps: Int[Array, ""]
    at_kink: Bool[Array, ""]
    """Ended where the slope jumps across the optimum, closer to it than a tenth of a standard error."""
    terminate: Bool[Array, ""]
    result: Any
    """An `optimistix.RESULTS`."""


class BoundedLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt for least squares in a box, as an optimistix solver (y: one flat array).

    Done when the undamped step is below atol + rtol |y| in every component, or when the whole step would lower the
    loss by less than the precision can show. The first test does not depend on the damping, so that a solver that
    crawls is not taken for one that has arrived. A sum of residuals that are not 0 often has its optimum on a kink (a
    sample on the line where N . L = 0), where no slope vanishes: there the solver is done when even the shortest steps
    lead upwards and the whole step left is a small part of the standard error that `freedom` (residuals less
    parameters) implies; without `freedom` this test is off.

    Takes the `options` `loss(y, args)` and `normal_equations(y, args) -> (loss, gradient, curvature)`.
    """

    rtol: Any
    atol: Any
    norm: Callable[[Any], Array]
    descent: BoxDampedNewton
    search: GainRatio

    freedom: Array

    def __init__(
        self,
        rtol: Any,
        atol: Any,
        lower: Any,
        upper: Any,
        *,
        strides: Strides | None = None,
        freedom: Any = 0,
    ) -> None:
        # Arrays, so that a changed tolerance compiles nothing anew.
        self.rtol, self.atol = jnp.asarray(rtol), jnp.asarray(atol)
        self.freedom = jnp.asarray(freedom, self.rtol.dtype)
        self.norm = optx.max_norm
        lower, upper = jnp.asarray(lower), jnp.asarray(upper)
        strides = Strides.none(lower.shape[0], lower.dtype) if strides is None else strides
        self.descent = BoxDampedNewton(lower, upper, strides)
        self.search = GainRatio()

    def init(self, fn: Any, y: Array, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any) -> Any:
        zero = jnp.zeros((), y.dtype)
        return SolverState(
            first_step=jnp.array(True),
            y_eval=jnp.clip(y, self.descent.lower, self.descent.upper),
            loss=zero,
            gradient=jnp.zeros_like(y),
            curvature=jnp.zeros((y.shape[0], y.shape[0]), y.dtype),
            descent_state=self.descent.init(y, None),
            search_state=self.search.init(y, None),
            achievable=zero,
            step_norm=zero,
            accepted=jnp.array(False),
            num_steps=jnp.zeros((), jnp.int32),
            num_accepted_steps=jnp.zeros((), jnp.int32),
            at_kink=jnp.array(False),
            terminate=jnp.array(False),
            result=optx.RESULTS.successful,
        )

    def step(
        self, fn: Any, y: Array, args: Any, options: Any, state: SolverState, tags: Any
    ) -> tuple[Array, SolverState, Any]:
        loss_at, model_at = _evaluators(fn, options)
        trial = state.y_eval
        trial_loss = loss_at(trial, args)
        step_size, accept, result, search_state = self.search.step(
            state.first_step,
            y,
            trial,
            _model(state.loss, state.gradient, state.curvature),
            optx.FunctionInfo.Eval(trial_loss),
            state.search_state,
        )

        def accepted(_: None) -> tuple[Any, ...]:
            loss, gradient, curvature = model_at(trial, args)
            descent_state = self.descent.query(trial, _model(loss, gradient, curvature), state.descent_state)
            remaining, exact = self.descent.undamped(descent_state)
            achievable = -jnp.vdot(remaining, gradient + curvature @ remaining / 2, precision="highest")
            step_norm = self.norm(remaining / (self.atol + self.rtol * jnp.abs(trial))).astype(trial.dtype)
            # Only an exact step can say that there is nothing left to do.
            achievable, step_norm = jnp.where(exact, achievable, jnp.inf), jnp.where(exact, step_norm, jnp.inf)
            return trial, loss, gradient, curvature, descent_state, achievable, step_norm

        def rejected(_: None) -> tuple[Any, ...]:
            kept = (state.loss, state.gradient, state.curvature, state.descent_state)
            return (y, *kept, state.achievable, state.step_norm)

        y, loss, gradient, curvature, descent_state, achievable, step_norm = jax.lax.cond(
            accept, accepted, rejected, None
        )
        eps = jnp.finfo(y.dtype).eps
        # Below the rounding of the loss, and no longer falling: nothing more to be had in this precision.
        exhausted = (achievable <= 4 * eps * loss) & (achievable > state.achievable / 4) & ~state.first_step
        converged = (step_norm < 1) | (achievable <= 4 * eps**2 * loss) | exhausted
        offset_squared = achievable * self.freedom / (y.shape[0] * jnp.maximum(loss, jnp.finfo(y.dtype).tiny))
        near = (self.freedom > 0) & (offset_squared < KINK_OFFSET**2)
        at_kink = ~accept & (step_size < 1 / KINK_DAMPING) & near & ~converged
        finite = jnp.isfinite(loss) & jnp.all(jnp.isfinite(gradient)) & jnp.all(jnp.isfinite(curvature))
        stuck = step_size < 1 / MAX_DAMPING
        result = optx.RESULTS.where(stuck & ~converged & ~at_kink, optx.RESULTS.nonlinear_divergence, result)
        result = optx.RESULTS.where(finite, result, optx.RESULTS.nonfinite)
        move, descent_result = self.descent.step(step_size, descent_state)
        result = optx.RESULTS.where(result == optx.RESULTS.successful, descent_result, result)
        new_state = SolverState(
            first_step=jnp.array(False),
            y_eval=jnp.clip(y + move, self.descent.lower, self.descent.upper),
            loss=loss,
            gradient=gradient,
            curvature=curvature,
            descent_state=descent_state,
            search_state=search_state,
            achievable=achievable,
            step_norm=step_norm,
            accepted=accept,
            num_steps=state.num_steps + 1,
            # The evaluation of the start is no step.
            num_accepted_steps=state.num_accepted_steps + (accept & ~state.first_step),
            at_kink=at_kink,
            terminate=(((accept | (achievable <= 4 * eps * loss)) & converged) | at_kink) & finite,
            result=result,
        )
        return y, new_state, None

    def terminate(self, fn: Any, y: Array, args: Any, options: Any, state: SolverState, tags: Any) -> Any:
        return state.terminate, state.result

    def postprocess(
        self, fn: Any, y: Array, aux: Any, args: Any, options: Any, state: SolverState, tags: Any, result: Any
    ) -> tuple[Array, Any, dict[str, Any]]:
        return y, aux, {"num_accepted_steps": state.num_accepted_steps}


def _model(loss: Array, gradient: Array, curvature: Array) -> Any:
    return optx.FunctionInfo.EvalGradHessian(loss, gradient, lx.MatrixLinearOperator(curvature))


def _evaluators(fn: Any, options: dict[str, Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """(loss, normal equations), from the options or from the residual function."""
    if "normal_equations" in options:
        return options["loss"], options["normal_equations"]

    def flat(y: Array, args: Any) -> Array:
        return ravel_pytree(fn(y, args)[0])[0]

    def loss(y: Array, args: Any) -> Array:
        residual = flat(y, args)
        return jnp.vdot(residual, residual) / 2

    def normal_equations(y: Array, args: Any) -> tuple[Array, Array, Array]:
        residual = flat(y, args)
        jacobian = jax.jacfwd(flat)(y, args)
        return jnp.vdot(residual, residual) / 2, jacobian.T @ residual, jacobian.T @ jacobian

    return loss, normal_equations


def default_tolerance(dtype: Any) -> tuple[float, float]:
    """(rtol, atol) that this precision can reach: steps of 1e-9 in float64, 2e-6 in float32."""
    return (1e-9, 1e-11) if np.dtype(dtype) == np.float64 else (2e-6, 2e-8)
