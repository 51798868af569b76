"""Bounded Levenberg-Marquardt on the normal equations, composed of optimistix's parts.

    descent   damped Newton step, exact within the box, Marquardt scaling (`BoxDampedNewton`)
    search    damping by the gain ratio (`GainRatio`)
    solver    evaluates the loss at every trial and the normal equations only where a trial is accepted

The derivatives come from functions in `options`, so that a problem with millions of residuals never forms its Jacobian.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from .curvature import Curvature, as_curvature
from .descent import BoxDampedNewton, DescentState, Operator
from .search import GainRatio, SearchState
from .strides import Strides

MAX_DAMPING = 1e8
"""From here on a fit is stuck: steps are too short to change anything."""
KINK_DAMPING = 1e3
"""Where steps as short as this lead upwards too, no slope leads down."""
KINK_OFFSET = 0.25
"""Standard errors that may be left to the optimum of the smooth model where a fit ends on a kink."""


class SolverState(eqx.Module):
    """All that the solver carries from step to step: arrays only, so that it can be saved and restored."""

    first_step: Bool[Array, ""]
    y_eval: Float[Array, " n"]
    loss: Float[Array, ""]
    descent_state: DescentState
    """The quadratic model at the last accepted point."""
    search_state: SearchState
    achievable: Float[Array, ""]
    """How much lower the undamped quadratic model thinks the loss can get."""
    step_norm: Float[Array, ""]
    """Undamped step relative to the tolerance: below 1 is converged."""
    accepted: Bool[Array, ""]
    num_steps: Int[Array, ""]
    num_accepted_steps: Int[Array, ""]
    at_kink: Bool[Array, ""]
    """Ended where the slope jumps across the optimum, closer to it than a quarter of a standard error."""
    terminate: Bool[Array, ""]
    result: Any
    """An `optimistix.RESULTS`."""

    @property
    def gradient(self) -> Float[Array, " n"]:
        """Slope of the loss at the last accepted point."""
        return self.descent_state.gradient

    @property
    def curvature(self) -> Curvature:
        """Gauss-Newton approximation of the second derivative there."""
        return self.descent_state.curvature


class BoundedLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt for least squares in a box, as an optimistix solver (y: one flat array).

    Done when the undamped step is below atol + rtol |y| in every component, or when the whole step would lower the
    loss by less than the precision can show. The first test does not depend on the damping, so that a solver that
    crawls is not taken for one that has arrived. A sum of residuals that are not 0 often has its optimum on a kink (a
    sample on the line where N . L = 0), where no slope vanishes: there the solver is done when even the shortest steps
    lead upwards, or one changes no more than the rounding of the loss, and the whole step left is a small part of the
    standard error that `freedom` (residuals less parameters) implies. And at a loss of `floor` or less, which is all
    rounding, it is done as soon as the loss stops falling.

    Takes the `options` `normal_equations(y, args) -> (loss, gradient, curvature)` and `settled(y, args) -> (y, loss)`,
    which may move the numbers in which the residuals are linear to their best. Each trial is settled before it is
    judged; with the joint step that is variable projection in Kaufman's form. `curvature(y, args)` is some matrix of
    the form that `normal_equations` gives.
    """

    rtol: Any
    atol: Any
    norm: Callable[[Any], Array]
    descent: BoxDampedNewton
    search: GainRatio

    freedom: Array
    floor: Array

    def __init__(
        self,
        rtol: Any,
        atol: Any,
        lower: Any,
        upper: Any,
        *,
        strides: Strides,
        freedom: Any,
        floor: Any,
        sampling: Any,
    ) -> None:
        # Arrays, so that a changed tolerance compiles nothing anew.
        self.rtol, self.atol = jnp.asarray(rtol), jnp.asarray(atol)
        self.freedom = jnp.asarray(freedom, self.rtol.dtype)
        self.floor = jnp.asarray(floor, self.rtol.dtype)
        self.norm = optx.max_norm
        self.descent = BoxDampedNewton(jnp.asarray(lower), jnp.asarray(upper), strides, sampling)
        self.search = GainRatio()

    def init(self, fn: Any, y: Array, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any) -> Any:
        zero = jnp.zeros((), y.dtype)
        shapes = eqx.filter_eval_shape(lambda y, args: as_curvature(options["curvature"](y, args)), y, args)
        curvature = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        return SolverState(
            first_step=jnp.array(True),
            y_eval=jnp.clip(y, self.descent.lower, self.descent.upper),
            loss=zero,
            descent_state=self.descent.init(y, self._model(zero, jnp.zeros_like(y), curvature)),
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
        proposed = state.y_eval
        trial, trial_loss = options["settled"](proposed, args)
        step_size, accept, result, search_state = self.judged(y, trial_loss, state)

        def accepted(_: None) -> tuple[Any, ...]:
            loss, gradient, matrix = options["normal_equations"](trial, args)
            curvature = as_curvature(matrix)
            model = self._model(loss, gradient, curvature)
            descent_state = self.descent.query(trial, model, state.descent_state)
            remaining, exact = self.descent.undamped(descent_state, loss)
            change = gradient + model.hessian.mv(remaining) / 2
            achievable = -jnp.vdot(remaining, change, precision="highest")
            step_norm = self.norm(remaining / (self.atol + self.rtol * jnp.abs(trial))).astype(trial.dtype)
            # Only an exact step can say that there is nothing left to do.
            achievable, step_norm = jnp.where(exact, achievable, jnp.inf), jnp.where(exact, step_norm, jnp.inf)
            return trial, loss, descent_state, achievable, step_norm

        def rejected(_: None) -> tuple[Any, ...]:
            return y, state.loss, state.descent_state, state.achievable, state.step_norm

        y, loss, descent_state, achievable, step_norm = jax.lax.cond(accept, accepted, rejected, None)
        eps = jnp.finfo(y.dtype).eps
        # Below the rounding of the loss, and no longer falling: nothing more to be had in this precision.
        lasting = (achievable > state.achievable / 4) & ~state.first_step
        exhausted = (achievable <= 4 * eps * loss) & lasting
        converged = (step_norm < 1) | (achievable <= 4 * eps**2 * loss) | exhausted
        offset_squared = achievable * self.freedom / (y.shape[0] * jnp.maximum(loss, jnp.finfo(y.dtype).tiny))
        idle = accept & lasting & (state.loss - loss <= 4 * eps * loss)
        no_way_down = idle | (~accept & (step_size < 1 / KINK_DAMPING))
        at_kink = no_way_down & (offset_squared < KINK_OFFSET**2) & ~converged
        finite = jnp.isfinite(loss) & descent_state.all_finite()
        falls = accept & (loss < state.loss / 4)
        only_rounding = ~falls & ~state.first_step & (loss <= self.floor)
        ended = converged | at_kink | only_rounding
        stuck = step_size < 1 / MAX_DAMPING
        result = optx.RESULTS.where(stuck & ~ended, optx.RESULTS.nonlinear_divergence, result)
        result = optx.RESULTS.where(finite, result, optx.RESULTS.nonfinite)
        move, descent_result = self.descent.step(step_size, descent_state)
        result = optx.RESULTS.where(result == optx.RESULTS.successful, descent_result, result)
        new_state = SolverState(
            first_step=jnp.array(False),
            y_eval=jnp.clip(y + move, self.descent.lower, self.descent.upper),
            loss=loss,
            descent_state=descent_state,
            search_state=search_state,
            achievable=achievable,
            step_norm=step_norm,
            accepted=accept,
            num_steps=state.num_steps + 1,
            # The evaluation of the start is no step.
            num_accepted_steps=state.num_accepted_steps + (accept & ~state.first_step),
            at_kink=at_kink,
            terminate=(((accept | (achievable <= 4 * eps * loss)) & converged) | at_kink | only_rounding) & finite,
            result=result,
        )
        return y, new_state, None

    def judged(self, y: Array, trial_loss: Array, state: SolverState) -> tuple[Array, Array, Any, SearchState]:
        """The step size from here on, whether the trial with this loss is accepted, and what the search remembers."""
        return self.search.step(
            state.first_step,
            y,
            state.y_eval,
            self._model(state.loss, state.gradient, state.curvature),
            optx.FunctionInfo.Eval(trial_loss),
            state.search_state,
        )

    def _model(self, loss: Array, gradient: Array, curvature: Curvature) -> Any:
        operator: Any = Operator(curvature, self.descent.sampling)
        return optx.FunctionInfo.EvalGradHessian(loss, gradient, operator)

    def terminate(self, fn: Any, y: Array, args: Any, options: Any, state: SolverState, tags: Any) -> Any:
        return state.terminate, state.result

    def postprocess(
        self, fn: Any, y: Array, aux: Any, args: Any, options: Any, state: SolverState, tags: Any, result: Any
    ) -> tuple[Array, Any, dict[str, Any]]:
        return y, aux, {"num_accepted_steps": state.num_accepted_steps}


def default_tolerance(dtype: Any) -> tuple[float, float]:
    """(rtol, atol) that this precision can reach: steps of 1e-9 in float64, 2e-6 in float32."""
    return (1e-9, 1e-11) if np.dtype(dtype) == np.float64 else (2e-6, 2e-8)
