"""What is known of numbers by their priors, beside what pictures tell."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from fit_scenes import key_light, material, precision, sphere_picture, sphere_samples, sphere_scene
from jaxlight import Free, Scene, View, fit
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


@pytest.mark.parametrize("bits", ["float32", "float64"])
def test_a_prior_determines_what_pictures_do_not_however_precise_they_are(bits: str) -> None:
    """Strength against albedo; at last the prior is less than the rounding of the matrix."""
    free = [DIFFUSE, Free("PointLight[key].intensity", deviation=0.2)]
    body = material(specular_color=(0, 0, 0))
    expected = 0.2 * np.array([0.6 / 0.9, 0.3 / 0.9, 0.2 / 0.9, 1])
    with precision(bits) as dtype:
        for noise in (1e-3, 3e-5, 1e-6, 1e-8):
            view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, body=body), noise=noise)
            found = at_start(sphere_scene(body=body, dtype=dtype), view, free)
            assert found.well_posed and found.rank == 4
            np.testing.assert_allclose(found.standard_error, expected, rtol=1e-3)


def test_a_prior_determines_nothing_but_what_moves_its_number() -> None:
    """Two lights in one place stay unknown, while their sum is known from the exposure's prior."""
    lights = [key_light(), key_light(name="twin", intensity=0.4)]
    prior = Free("View[0].exposure", deviation=0.1)
    with precision("float64") as dtype:
        for noise in (1e-2, 1e-6):
            view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, *lights), noise=noise)
            found = at_start(sphere_scene(*lights, dtype=dtype), view, ["PointLight[*].intensity", prior])
            assert found.rank == 2 and len(found.ambiguities) == 1 and found.ambiguities[0].kept == "sum"
            np.testing.assert_allclose(found.standard_error, [np.inf, np.inf, 0.1], rtol=1e-3)


@pytest.mark.parametrize(("bits", "found"), [("float32", False), ("float64", True)])
def test_values_that_a_prior_did_not_draw_to_it_are_told(bits: str, found: bool) -> None:
    """Beside pictures as precise as these the prior is less than the rounding of float32."""
    free = [DIFFUSE, Free("PointLight[key].intensity", mean=1.1, deviation=0.1)]
    body = material(specular_color=(0, 0, 0))
    with precision(bits) as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, body=body, noise=1e-4), noise=1e-4)
        result = fit(sphere_scene(body=body, dtype=dtype), view, free)
    assert result.converged and "quarter of a standard error" not in result.message
    off = abs(result.value("PointLight[key].intensity") - 1.1) / 0.1
    said = f"the values are {off:.2g} standard errors from the best, in what priors tell"
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # what is known is found out here, in the fit's own precision or a wider one
        messages = result.uncertainty.messages()
    assert (off < 0.01) == found and any(said in line for line in messages) == (not found)


@pytest.mark.parametrize(("mean", "deviation", "told"), [(0.6, 0.01, False), (0.62, 0.01, False), (0.7, 0.01, True)])
def test_a_prior_that_the_pictures_contradict_is_told(mean: float, deviation: float, told: bool) -> None:
    """The truth is 0.6. Pictures know it to 0.002 or so: a prior that is 10 of its deviations off hardly moves it."""
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, noise=0.01, seed=1), noise=0.01)
        free = [Free(f"{DIFFUSE}.r", mean=mean, deviation=deviation)]
        result = fit(sphere_scene(dtype=dtype), view, free)
        said = [line for line in result.uncertainty.messages() if "from the prior's mean" in line]
        assert len(said) == told
        assert all(line.startswith(f"{DIFFUSE}.r is 9.") for line in said), said


def test_a_prior_that_outweighs_what_the_pictures_say_is_told() -> None:
    """The number moves by a hundredth of its deviations only; the pictures are as far from it as before."""
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, noise=0.01, seed=1), noise=0.01)
        for mean, told in ((0.6, False), (0.7, True)):
            free = [Free(f"{DIFFUSE}.r", mean=mean, deviation=1e-4)]
            result = fit(sphere_scene(dtype=dtype), view, free)
            assert abs(float(result.values[0]) - mean) < 1e-3
            assert ("from the prior's mean" in " ".join(result.uncertainty.messages())) == told


def test_a_noise_that_is_stated_far_too_large_is_told() -> None:
    with precision("float64") as dtype:
        picture = sphere_picture(SIZE, noise=0.01, seed=1)
        for noise, told in ((0.01, False), (0.015, False), (0.05, True)):
            view = View(sphere_samples(SIZE, dtype=dtype), picture, noise=noise)
            said = fit(sphere_scene(dtype=dtype), view, DIFFUSE).uncertainty.messages()
            assert [line.partition(" times")[0] for line in said] == ["what is left is 0.199"] * told, said


def test_limits_of_the_sensor_are_no_sign_of_a_noise_that_is_stated_too_large() -> None:
    with precision("float64") as dtype:
        picture = sphere_picture(SIZE, noise=0.01, seed=1)
        full = float(np.quantile(picture[picture > 0.05], 0.1))
        view = View(sphere_samples(SIZE, dtype=dtype), np.minimum(picture, full), noise=0.01, saturated=full)
        said = fit(sphere_scene(dtype=dtype), view, f"{DIFFUSE}.r").uncertainty.messages()
        assert not [line for line in said if "stated noise" in line], said


def test_limits_of_the_sensor_that_are_not_kept_tell_of_the_noise() -> None:
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), np.full((SIZE, SIZE, 3), 2.0), saturated=2.0)
        found = at_start(sphere_scene(dtype=dtype), view, [DIFFUSE])
    assert 1 < found.noise < 2


def test_an_error_of_half_of_the_range_is_hardly_seen() -> None:
    def known(noise: float) -> Uncertainty:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE), noise=noise)
        return at_start(sphere_scene(dtype=dtype), view, [f"{DIFFUSE}.r"])

    with precision("float64") as dtype:
        error = known(1.0).standard_error[0]
        assert not known(0.4 / error).hardly_seen and known(0.6 / error).hardly_seen
