"""The quadratic in a box: the minimum, whichever bounds are active, in both precisions."""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import precision
from jaxlight.fit import box
from jaxlight.fit.curvature import ArrowCurvature

minimise_in_box = jax.jit(box.minimise_in_box)


def by_trying_all_faces(hessian: np.ndarray, gradient: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Every choice of free, lower and upper variables; the best feasible stationary point."""
    best, best_value = None, np.inf
    for choice in itertools.product((0, 1, 2), repeat=len(gradient)):
        free = np.array(choice) == 0
        point = np.where(np.array(choice) == 1, lower, np.where(np.array(choice) == 2, upper, 0.0))
        if not np.all(np.isfinite(point)):
            continue
        if np.any(free):
            right = -(gradient + hessian @ point)[free]
            point[free] = np.linalg.solve(hessian[np.ix_(free, free)], right)
        if np.any(point < lower - 1e-12) or np.any(point > upper + 1e-12):
            continue
        value = point @ hessian @ point / 2 + gradient @ point
        if value < best_value:
            best, best_value = point, value
    assert best is not None
    return best


def problem(seed: int) -> tuple[np.ndarray, ...]:
    """A unit-diagonal positive definite matrix, often nearly singular, and a box around 0, sometimes open or flat."""
    random = np.random.default_rng(seed)
    size = (1, 3, 5)[seed % 3]
    jacobian = random.normal(size=(size + int(random.integers(0, 3)), size))
    hessian = jacobian.T @ jacobian
    scale = np.sqrt(np.diagonal(hessian))
    hessian = hessian / np.outer(scale, scale) + 1e-3 * np.eye(size)
    lower, upper = -random.exponential(size=size), random.exponential(size=size)
    lower[random.random(size) < 0.2], upper[random.random(size) < 0.2] = -np.inf, np.inf
    lower[random.random(size) < 0.2] = 0.0
    return hessian, random.normal(size=size), lower, upper


@pytest.mark.parametrize(("kind", "tolerance"), [("float32", 2e-3), ("float64", 1e-9)])
def test_the_minimum_is_found(kind: str, tolerance: float) -> None:
    with precision(kind) as dtype:
        for seed in range(60):
            hessian, gradient, lower, upper = problem(seed)
            found = minimise_in_box(*(jnp.asarray(a, dtype) for a in (hessian, gradient, lower, upper)))
            best = by_trying_all_faces(hessian, gradient, lower, upper)
            assert bool(found.solved), f"seed {seed}"
            np.testing.assert_allclose(found.point, best, rtol=0, atol=tolerance * max(1, np.abs(best).max()))
            assert np.all(np.asarray(found.point) >= np.asarray(lower, dtype))
            assert np.all(np.asarray(found.point) <= np.asarray(upper, dtype))


def test_bounds_in_the_way_of_many_numbers_are_found_in_the_rounds_that_there_are() -> None:
    with precision("float64") as dtype:
        random = np.random.default_rng(0)
        for number in range(200):
            jacobian = (random.normal(size=(9, 5)) * np.logspace(0, -2, 5)) @ random.normal(size=(5, 5))
            scale = np.linalg.norm(jacobian, axis=0)
            hessian, gradient = (jacobian / scale).T @ (jacobian / scale), 3 * random.normal(size=5)
            lower, upper = -random.exponential(size=5), random.exponential(size=5)
            found = minimise_in_box(*(jnp.asarray(a, dtype) for a in (hessian, gradient, lower, upper)))
            assert bool(found.solved), f"box {number}"


def test_a_singular_matrix_is_not_called_solved() -> None:
    hessian = jnp.array([[1.0, 1.0], [1.0, 1.0 - 1e-6]])
    endless = jnp.full(2, jnp.inf)
    assert not bool(minimise_in_box(hessian, jnp.array([1.0, -1.0]), -endless, endless).solved)


def test_no_gradient_no_step() -> None:
    found = minimise_in_box(jnp.eye(3), jnp.zeros(3), -jnp.ones(3), jnp.ones(3))
    np.testing.assert_array_equal(found.point, np.zeros(3))
    assert bool(found.solved)


def test_large_boxes_that_start_on_their_bounds_are_solved() -> None:
    """A bound whose own slope leads inwards can be in the way of the Newton step; the conditions of a minimum tell."""
    with precision("float64") as dtype:
        random = np.random.default_rng(0)
        for number in range(150):
            jacobian = (random.normal(size=(20, 12)) * np.logspace(0, -2, 12)) @ random.normal(size=(12, 12))
            scale = np.linalg.norm(jacobian, axis=0)
            hessian = (jacobian / scale).T @ (jacobian / scale)
            gradient = 5 * random.normal(size=12)
            lower, upper = (sign * random.random(12) * (random.random(12) > 0.3) for sign in (-1, 1))
            found = minimise_in_box(*(jnp.asarray(a, dtype) for a in (hessian, gradient, lower, upper)))
            assert bool(found.solved), f"box {number}"
            point = np.asarray(found.point)
            downhill = np.clip(point - hessian @ point - gradient, lower, upper) - point
            assert np.abs(downhill).max() < 1e-11, f"box {number}"


def test_boxes_of_texels_and_numbers_are_solved() -> None:
    with precision("float64"):
        minimise = jax.jit(lambda arrow, *rest: arrow.minimise((), *rest))
        random, count, texels = np.random.default_rng(0), 9, 40
        for number in range(8):
            by_number = random.normal(size=(3 * texels, count))
            by_number[:, -1] = by_number[:, 0] + 0.05 * by_number[:, -1]
            by_texel = np.tile(np.eye(texels), (3, 1)) * random.uniform(0.2, 1.0, 3 * texels)[:, None]
            jacobian = np.concatenate([by_number, by_texel], axis=1)
            hessian, gradient = jacobian.T @ jacobian, jacobian.T @ random.normal(size=3 * texels)
            size, own = count + texels, np.diag(hessian)[count:]
            lower, upper = (sign * random.exponential(0.2, size) * (random.random(size) > 0.3) for sign in (-1, 1))
            arrow = ArrowCurvature(
                few=jnp.asarray(hessian[:count, :count]),
                cross=jnp.asarray(hessian[count:, :count]),
                row_sum=jnp.asarray(own),
                strengths=(),
                own=jnp.asarray(own),
                neighbours=(None,),
                shapes=((texels, 1, 1),),
            )
            found = minimise(arrow, gradient, np.sqrt(np.diag(hessian)), jnp.zeros(()), lower, upper)
            assert bool(found.solved), f"box {number}"
            point = np.asarray(found.point)
            downhill = np.clip(point - (hessian @ point + gradient) / np.diag(hessian), lower, upper) - point
            assert np.abs(downhill).max() < 1e-2 * np.abs(gradient / np.diag(hessian)).max(), f"box {number}"
