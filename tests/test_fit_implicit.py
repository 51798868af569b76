"""Derivatives through a fit: those of the answer, not of the steps."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import key_light, material, precision, sphere_picture, sphere_samples, sphere_scene
from jaxlight import Free, View, fit, fitted_values
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


@pytest.mark.parametrize("field", ["ambient_intensity", "attenuation"])
def test_fields_that_make_no_difference_yet_move_the_answer(field: str) -> None:
    """An ambient intensity of 0 and a constant attenuation are left out of the equation that is fitted."""
    with precision("float64") as dtype:
        start = sphere_scene(
            key_light(attenuation=(1, 0, 0)), body=material(diffuse_color=(0.5, 0.2, 0.3)), dtype=dtype
        )
        result = fit(start, View(sphere_samples(20, dtype=dtype), sphere_picture(20)), "Material[body].diffuse_color")
        assert result.converged
        added = (0, 0, 1.0) if field == "attenuation" else 1.0

        def answer(more: Any) -> Any:
            own = getattr(result.problem.world.scene.point, field)
            moved = eqx.tree_at(
                lambda p: getattr(p.world.scene.point, field), result.problem, own + more * jnp.array(added)
            )
            return fitted_values(moved)

        np.testing.assert_allclose(answer(0.0), result.values, rtol=1e-9)
        forward = jax.jacfwd(answer)(0.0)
        step = 1e-5
        expected = (answer(step) - answer(0.0)) / step
        assert np.all(np.abs(expected) > 1e-3)
        np.testing.assert_allclose(forward, expected, rtol=1e-3)
