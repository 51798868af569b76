"""Minimum of a convex quadratic in a box: the step of a bounded fit is found exactly, active bounds and all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

HALVINGS = tuple(0.5**k for k in range(8))


class BoxMinimum(NamedTuple):
    """The point found, and whether the conditions of a minimum hold there to the tolerance."""

    point: Float[Array, " n"]
    solved: Bool[Array, ""]


class _Trial(NamedTuple):
    point: Float[Array, " n"]
    image: Float[Array, " n"]
    """H times the point."""
    value: Float[Array, ""]


class _State(NamedTuple):
    """A round tries up to three moves, one after the other, so that each part of it is compiled once."""

    point: Float[Array, " n"]
    image: Float[Array, " n"]
    round: Int[Array, ""]
    in_the_way: Bool[Array, " n"]
    """Bounds that the round's Newton step ran into at once."""
    downhill: Bool[Array, ""]
    """The Newton step led nowhere: the round goes on with the steepest descent."""
    solved: Bool[Array, ""]
    stuck: Bool[Array, ""]


def minimise_in_box(
    hessian: Float[Array, "n n"], gradient: Float[Array, " n"], lower: Float[Array, " n"], upper: Float[Array, " n"]
) -> BoxMinimum:
    """argmin of 1/2 z^T H z + g^T z subject to lower <= z <= upper, for a matrix H with unit diagonal or larger."""
    size = gradient.shape[0]

    def products(points: Array) -> Array:
        return jnp.matmul(points, hessian, precision="highest")

    def solve_free(right: Array, free: Array) -> Array:
        both = free[:, None] & free[None, :]
        system = jnp.where(both, hessian, jnp.eye(size, dtype=hessian.dtype))
        factor = jax.scipy.linalg.cho_factor(system, lower=True)
        return jax.scipy.linalg.cho_solve(factor, jnp.where(free, right, 0))

    return minimise_quadratic(products, solve_free, gradient, lower, upper, rounds=4 * size + 8)


def minimise_quadratic(
    products: Callable[[Array], Array],
    solve_free: Callable[[Array, Array], Array],
    gradient: Float[Array, " n"],
    lower: Float[Array, " n"],
    upper: Float[Array, " n"],
    *,
    rounds: int,
    fractions: Sequence[float] = HALVINGS,
    tolerance: float = 0.0,
) -> BoxMinimum:
    """argmin of 1/2 z^T H z + g^T z subject to lower <= z <= upper, H given by what it does.

    Projected Newton (Bertsekas 1982): hold the variables that press against a bound, solve for the others, follow the
    projected path and keep the best of a few points on it; the first bound met on the way is always among them, so
    the quadratic falls in every round and the set of held variables settles after a few. Where no part of that path
    leads down, and where H is singular to the precision at hand, the round falls back to the steepest descent; the
    point is then still an improvement.

    Args:
        products: [k, n], rows z -> rows H z.
        solve_free: (right, free) -> z with (H z)_free = right_free and z = 0 elsewhere.
        gradient: g, in variables in which H has a diagonal of about 1.
        lower, upper: the box; it contains 0.
        rounds: at most.
        fractions: of the Newton step that are tried.
        tolerance: of the slope that may be left, relative to g; rounding is always allowed.
    """
    eps = jnp.finfo(gradient.dtype).eps
    size = gradient.shape[0]

    def value(point: Array, image: Array) -> Array:
        return jnp.vdot(point, image / 2 + gradient, precision="highest")

    def pressing(point: Array, slope: Array) -> Array:
        """The variables on a bound that would leave the box against the slope."""
        return ((point <= lower) & (slope > 0)) | ((point >= upper) & (slope < 0))

    def best_along(point: Array, move: Array, length: Array) -> _Trial:
        """The lowest of some points on the path from `point` along `length` x `move`, bent by the box."""
        room = jnp.where(move > 0, upper - point, lower - point)
        limit = jnp.min(jnp.where(move != 0, room / jnp.where(move != 0, move, 1), jnp.inf))
        lengths = jnp.concatenate([length * jnp.asarray(fractions, move.dtype), jnp.minimum(limit, length)[None]])
        points = jnp.clip(point + lengths[:, None] * move, lower, upper)
        images = products(points)
        values = jax.vmap(value)(points, images)
        best = jnp.argmin(jnp.where(jnp.isnan(values), jnp.inf, values))
        return _Trial(points[best], images[best], values[best])

    def newton(grad: Array, held: Array) -> tuple[Array, Array]:
        """The Newton step of the variables that are not held; downhill where H is singular to the precision at hand."""
        move = solve_free(-grad, ~held)
        move = jnp.where(held, 0, jnp.where(jnp.all(jnp.isfinite(move)), move, -grad))
        return move, jnp.ones((), move.dtype)

    def steepest(grad: Array, held: Array) -> tuple[Array, Array]:
        """The direction of steepest descent among the variables that are not held, and how far its minimum lies."""
        move = jnp.where(held, 0, -grad)
        bend = jnp.vdot(move, products(move[None])[0], precision="highest")
        return move, jnp.vdot(move, move, precision="highest") / jnp.where(bend > 0, bend, 1)

    def moved(state: _State, move: Array, length: Array) -> _State:
        """After the best point along a move; where none is better, the round goes on downhill, or has got stuck."""
        here = value(state.point, state.image)
        best = best_along(state.point, move, length)
        better = best.value < here
        point, image = jnp.where(better, best.point, state.point), jnp.where(better, best.image, state.image)
        left = jnp.clip(point - image - gradient, lower, upper) - point
        largest = jnp.max(jnp.abs(gradient))
        enough = 8 * eps * (largest + size * jnp.max(jnp.abs(point))) + tolerance * largest
        over = better | state.downhill
        return _State(
            point=point,
            image=image,
            round=state.round + over,
            in_the_way=jnp.zeros_like(state.in_the_way),
            downhill=~over,
            solved=over & (jnp.max(jnp.abs(left)) <= enough),
            stuck=over & ~better,
        )

    def improve(state: _State) -> _State:
        grad = state.image + gradient
        held = pressing(state.point, grad) | state.in_the_way
        move, length = jax.lax.cond(state.downhill, steepest, newton, grad, held)
        # A bound whose own slope leads inwards may still be in the way of the Newton step: then it is held as well.
        out = pressing(state.point, -move)
        again = jnp.any(out) & ~jnp.any(state.in_the_way) & ~state.downhill
        return jax.lax.cond(again, lambda: state._replace(in_the_way=out), lambda: moved(state, move, length))

    no, none = jnp.array(False), jnp.zeros_like(gradient)
    start = _State(none, none, jnp.zeros((), jnp.int32), jnp.zeros(size, bool), no, no, no)
    end = jax.lax.while_loop(lambda s: ~s.solved & ~s.stuck & (s.round < rounds), improve, start)
    return BoxMinimum(end.point, end.solved)
