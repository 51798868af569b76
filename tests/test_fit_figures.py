"""The figures that the documentation states for a well-posed fit: one material and one point light, one picture."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import key_light, material, precision, sphere_picture, sphere_samples, sphere_scene
from jaxlight import Fit, Free, View, fit
from jaxlight.fit.problem import make_problem
from jaxlight.fit.run import make_solver, solve

BODY = material(specular_color=(0.4, 0.4, 0.4))
# One colour channel of the light is known and the highlight is grey: that fixes what strength and albedo share.
FREE: list[Any] = [
    "Material[body].diffuse_color",
    Free("Material[body].specular_color", tied="all"),
    "Material[body].shininess",
    "PointLight[key].location",
    "PointLight[key].color.r",
    "PointLight[key].color.b",
]
TRUTH = np.array([0.6, 0.3, 0.2, 0.4, 0.3, 1.5, 2.0, 3.0, 1.0, 0.8])


@pytest.mark.parametrize(("bits", "tolerance"), [("float32", 1e-4), ("float64", 1e-6)])
def test_a_picture_of_256_by_256_gives_material_and_light_in_14_steps(bits: str, tolerance: float) -> None:
    start = material(diffuse_color=(0.5, 0.5, 0.5), specular_color=(0.2, 0.2, 0.2), shininess=0.1)
    lamp = key_light(location=(0.0, 0.0, 4.0), color=(0.5, 0.9, 0.5))
    with precision(bits) as dtype:
        view = View(sphere_samples(256, dtype=dtype), sphere_picture(256, body=BODY))
        result: Fit = fit(sphere_scene(lamp, body=start, dtype=dtype), view, FREE)
    assert result.converged and result.accepted_steps <= 14, result.message
    np.testing.assert_allclose(result.values, TRUTH, rtol=tolerance)


@pytest.mark.thorough
def test_of_64_random_starts_95_percent_find_the_optimum() -> None:
    random = np.random.default_rng(2024)
    starts = random.uniform(0.05, 0.95, (64, len(TRUTH)))
    towards = random.normal(size=(64, 3))
    towards[:, 2] = np.abs(towards[:, 2])
    towards *= random.uniform(2, 6, (64, 1)) / np.linalg.norm(towards, axis=1, keepdims=True)
    starts[:, 5:8] = towards
    with precision("float64") as dtype:
        view = View(sphere_samples(48, dtype=dtype), sphere_picture(48, body=BODY))
        problem, _ = make_problem(sphere_scene(body=BODY, dtype=dtype), view, FREE)
        solver = make_solver(problem)
        run = eqx.filter_vmap(solve, in_axes=(None, None, 0, None))
        solution = run(problem, solver, jnp.asarray(starts, dtype), 100)
        values, ended = np.asarray(solution.value), np.asarray(solution.state.terminate)
    found = np.all(np.abs(values / TRUTH - 1) < 1e-6, axis=1)
    assert np.mean(found) >= 0.95
    assert np.all(ended[found])
    assert np.median(np.asarray(solution.state.num_accepted_steps)[found]) <= 14
