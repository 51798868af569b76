"""Minimum of a convex quadratic in a box: the step of a bounded fit is found exactly, active bounds and all."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


class BoxMinimum(NamedTuple):
    """The point found, and whether the conditions of a minimum hold there to rounding."""

    point: Float[Array, " n"]
    solved: Bool[Array, ""]


class _State(NamedTuple):
    point: Float[Array, " n"]
    round: Int[Array, ""]
    solved: Bool[Array, ""]
    stuck: Bool[Array, ""]


def minimise_in_box(
    hessian: Float[Array, "n n"], gradient: Float[Array, " n"], lower: Float[Array, " n"], upper: Float[Array, " n"]
) -> BoxMinimum:
    """argmin of 1/2 z^T H z + g^T z subject to lower <= z <= upper, for H positive definite and well scaled.

    Projected Newton (Bertsekas 1982): hold the variables that press against a bound, solve for the others, follow the
    projected path and keep the best of a few points on it; the first bound met on the way is always among them, so
    the quadratic falls in every round and the set of held variables settles after a few. Where H is singular to the
    precision at hand, the round falls back to the steepest descent; the point is then still an improvement.

    Args:
        hessian: H, unit diagonal or larger.
        gradient: g.
        lower, upper: the box; it contains 0.
    """
    eps = jnp.finfo(gradient.dtype).eps
    size = gradient.shape[0]
    fractions = 0.5 ** jnp.arange(8, dtype=gradient.dtype)

    def slope(point: Array) -> Array:
        return jnp.matmul(hessian, point, precision="highest") + gradient

    def value(point: Array) -> Array:
        return jnp.vdot(point, slope(point) + gradient, precision="highest") / 2

    def improve(state: _State) -> _State:
        point, grad = state.point, slope(state.point)
        held = ((point <= lower) & (grad > 0)) | ((point >= upper) & (grad < 0))
        move = _solve_free(hessian, -grad, ~held)
        move = jnp.where(held, 0, jnp.where(jnp.all(jnp.isfinite(move)), move, -grad))
        room = jnp.where(move > 0, upper - point, lower - point)
        limit = jnp.min(jnp.where(move != 0, room / jnp.where(move != 0, move, 1), jnp.inf))
        lengths = jnp.concatenate([fractions, jnp.minimum(limit, 1)[None]])
        trials = jnp.clip(point + lengths[:, None] * move, lower, upper)
        values = jax.vmap(value)(trials)
        best = jnp.argmin(jnp.where(jnp.isnan(values), jnp.inf, values))
        better = values[best] < value(point)
        point = jnp.where(better, trials[best], point)
        left = jnp.clip(point - slope(point), lower, upper) - point
        rounding = 8 * eps * (jnp.max(jnp.abs(gradient)) + size * jnp.max(jnp.abs(point)))
        return _State(point, state.round + 1, jnp.max(jnp.abs(left)) <= rounding, ~better)

    start = _State(jnp.zeros_like(gradient), jnp.zeros((), jnp.int32), jnp.array(False), jnp.array(False))
    end = jax.lax.while_loop(lambda s: ~s.solved & ~s.stuck & (s.round < 4 * size + 8), improve, start)
    return BoxMinimum(end.point, end.solved)


def _solve_free(matrix: Array, right: Array, free: Array) -> Array:
    """Solution of the rows and columns in `free`; 0 elsewhere."""
    both = free[:, None] & free[None, :]
    system = jnp.where(both, matrix, jnp.eye(matrix.shape[0], dtype=matrix.dtype))
    factor = jax.scipy.linalg.cho_factor(system, lower=True)
    return jax.scipy.linalg.cho_solve(factor, jnp.where(free, right, 0))
