"""What is known of numbers by their priors, beside what pictures tell."""

from __future__ import annotations

from typing import Any

import numpy as np

from fit_scenes import material, precision, sphere_picture, sphere_samples, sphere_scene
from jaxlight import Free, Scene, View
from jaxlight.fit.problem import make_problem
from jaxlight.fit.uncertainty import Uncertainty, uncertainty

SIZE = 24
DIFFUSE = "Material[body].diffuse_color"


def at_start(scene: Scene, view: View, free: list[Any]) -> Uncertainty:
    """What a fit would know that had found what the scene holds."""
    problem, description = make_problem(scene, view, free)
    return uncertainty(problem, description, problem.parameters.start)


def test_what_a_bound_holds_does_not_depend_on_priors_of_other_numbers() -> None:
    body = material(diffuse_color=(0.6, 0.28, 0.2))
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, noise=0.01))
        for deviation in (np.inf, 0.01):
            free = [Free(f"{DIFFUSE}.r", mean=0.9, deviation=deviation), Free(f"{DIFFUSE}.g", upper=0.28)]
            assert at_start(sphere_scene(body=body, dtype=dtype), view, free).standard_error[1] == 0
