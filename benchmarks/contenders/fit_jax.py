"""Fits with the naive JAX renderer: optimistix's own solvers, SciPy's `least_squares`, optax's Adam."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..fit_problem import fit_arrays, fit_start
from ..workload import Arrays, Workload
from .base import Contender, FitResult, Operation, Run
from .naive_jax import scene_arrays, shade


def residuals(free: Any, arguments: Any) -> Any:
    """[3 N]: what optimistix calls."""
    fixed, scene = arguments
    return (shade({**fixed, **free}, scene) - scene["target"]).reshape(-1)


def half_sum_of_squares(free: Any, arguments: Any) -> Any:
    """What a minimiser calls."""
    return jnp.sum(residuals(free, arguments) ** 2) / 2


class JaxFit(Contender):
    """What the fits below share: the arrays in one precision, fields free and fixed.

    Args:
        work, arrays: the workload; its target is replaced by its own picture.
        precision: float type of everything.
    """

    def __init__(self, work: Workload, arrays: Arrays, precision: str = "float32") -> None:
        arrays = fit_arrays(work)
        dtype = np.dtype(precision)
        self._start = jax.tree.map(lambda a: jnp.asarray(a, dtype), fit_start(arrays))
        fixed = {name: value for name, value in arrays.parameters.items() if name not in self._start}
        self._arguments = jax.tree.map(lambda a: jnp.asarray(a, dtype), (fixed, scene_arrays(arrays)))
        self._double = dtype == np.float64

    def fitted(self, result: Any) -> FitResult:
        values, steps = result
        return FitResult({name: np.asarray(value) for name, value in values.items()}, int(steps))


class OptimistixFit(JaxFit):
    """optimistix's LevenbergMarquardt, compiled as a whole."""

    def prepare(self, operation: Operation) -> Run:
        import optimistix as optx

        tolerance = 1e-9 if self._double else 1e-5

        def solve(start: Any, arguments: Any) -> Any:
            solver = optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance)
            solution = optx.least_squares(residuals, solver, start, arguments, max_steps=200, throw=False)
            return solution.value, solution.stats["num_steps"]

        compiled = jax.jit(solve).lower(self._start, self._arguments).compile()
        return lambda: jax.block_until_ready(compiled(self._start, self._arguments))


class ScipyFit(JaxFit):
    """SciPy's `least_squares` ("trf" within the fields' ranges, or MINPACK's "lm") with JAX's Jacobian.

    Args:
        work, arrays, precision: as JaxFit.
        method: of `scipy.optimize.least_squares`.
    """

    def __init__(self, work: Workload, arrays: Arrays, precision: str = "float64", method: str = "trf") -> None:
        super().__init__(work, arrays, precision)
        self._method = method

    def prepare(self, operation: Operation) -> Run:
        from scipy.optimize import least_squares

        flat, unravel = ravel_pytree(self._start)
        residual = jax.jit(lambda x, a: residuals(unravel(x), a)).lower(flat, self._arguments).compile()
        jacobian = jax.jit(jax.jacfwd(lambda x, a: residuals(unravel(x), a))).lower(flat, self._arguments).compile()
        unbounded = {"lights.location": np.inf}
        box = {name: jnp.full_like(value, unbounded.get(name, 1.0)) for name, value in self._start.items()}
        low = {name: jnp.full_like(value, -unbounded.get(name, 0.0)) for name, value in self._start.items()}
        bounds = (np.asarray(ravel_pytree(low)[0]), np.asarray(ravel_pytree(box)[0]))

        def run() -> Any:
            found = least_squares(
                lambda x: np.asarray(residual(jnp.asarray(x, flat.dtype), self._arguments), np.float64),
                np.asarray(flat, np.float64),
                lambda x: np.asarray(jacobian(jnp.asarray(x, flat.dtype), self._arguments), np.float64),
                bounds=bounds if self._method == "trf" else (-np.inf, np.inf),
                method=self._method,
                xtol=1e-10,
                ftol=1e-14,
                gtol=1e-14,
                max_nfev=200,
            )
            return unravel(jnp.asarray(found.x, flat.dtype)), found.nfev

        return run


class OptaxFit(JaxFit):
    """optax's Adam with a cosine schedule, all steps in one compiled loop; values kept in the fields' ranges.

    Args:
        work, arrays, precision: as JaxFit.
        steps: of Adam.
    """

    def __init__(self, work: Workload, arrays: Arrays, precision: str = "float32", steps: int = 1000) -> None:
        super().__init__(work, arrays, precision)
        self._steps = steps

    def prepare(self, operation: Operation) -> Run:
        import optax

        adam = optax.adam(optax.cosine_decay_schedule(0.03, self._steps))

        def step(_: Any, carry: Any) -> Any:
            values, state, arguments = carry
            gradient = jax.grad(half_sum_of_squares)(values, arguments)
            updates, state = adam.update(gradient, state)
            values = optax.apply_updates(values, updates)
            clipped = {k: v if k == "lights.location" else jnp.clip(v, 1e-4, 1) for k, v in values.items()}
            return clipped, state, arguments

        def solve(start: Any, arguments: Any) -> Any:
            return jax.lax.fori_loop(0, self._steps, step, (start, adam.init(start), arguments))[0]

        compiled = jax.jit(solve).lower(self._start, self._arguments).compile()
        return lambda: (jax.block_until_ready(compiled(self._start, self._arguments)), self._steps)
