"""Derivatives through a fit: those of the answer, not of the steps."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fit_scenes import key_light, material, precision, sphere_picture, sphere_samples, sphere_scene
from jaxlight import Free, View
from jaxlight.fit.implicit import fitted_values
from jaxlight.fit.problem import Problem, make_problem
from jaxlight.fit.run import make_solver

FREE = [Free("Material[body].diffuse_color.g", upper=0.3), "Material[body].shininess", "PointLight[key].location"]
"""The truth of the first is 0.35: its bound holds it."""


def made(dtype: Any) -> Problem:
    start = sphere_scene(key_light(location=(1.2, 1.8, 3.2)), body=material(shininess=0.25), dtype=dtype)
    picture = sphere_picture(20, body=material(diffuse_color=(0.6, 0.35, 0.2)), noise=0.01)
    return make_problem(start, View(sphere_samples(20, dtype=dtype), picture), FREE)[0]


def with_strength(problem: Problem, strength: Any) -> Problem:
    """The problem with another intensity, which is not free, and a picture that is brighter on one side."""
    target = problem.views[0].target
    side = jnp.linspace(0.0, 0.1, target.shape[-1]).astype(target.dtype)
    return eqx.tree_at(
        lambda p: (p.world.scene.point.intensity, p.views[0].target),
        problem,
        (problem.world.scene.point.intensity * strength, target + (strength - 1) * side),
    )


def test_forward_and_reverse_mode_are_the_differences_of_fits() -> None:
    with precision("float64") as dtype:
        problem = made(dtype)
        solver = make_solver(problem)

        @jax.jit
        def answer(strength: Any) -> Any:
            return fitted_values(with_strength(problem, strength), solver)

        step = 1e-4
        expected = (answer(1 + step) - answer(1 - step)) / (2 * step)
        forward = jax.jit(jax.jacfwd(answer))(1.0)
        reverse = jax.jit(jax.jacrev(answer))(1.0)
        assert abs(float(expected[0])) < 1e-12 and np.all(np.abs(expected[1:]) > 1e-3)
        np.testing.assert_allclose(forward, expected, rtol=2e-5, atol=1e-12)
        np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-12)
