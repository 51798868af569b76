"""What a fit cannot know is found and named; the errors that it states are the errors that it makes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import (
    key_light,
    material,
    precision,
    sphere_picture,
    sphere_points,
    sphere_samples,
    sphere_scene,
)
from jaxlight import Free, SampleBuffer, Scene, View, fit, nodes, shade, write_report
from jaxlight.fit.problem import Problem, make_problem
from jaxlight.fit.run import make_solver, solve
from jaxlight.fit.uncertainty import Uncertainty, uncertainty

SIZE = 32
DIFFUSE, SPECULAR = "Material[body].diffuse_color", "Material[body].specular_color"
TWIN = key_light(name="twin", intensity=0.4)
SUN = nodes.DirectionalLight(name="sun", direction=(1.0, -2.0, -3.0), global_=True)
FAR = nodes.PointLight(name="far", location=(50.0, 0.0, 0.0), radius=10.0)
STRENGTHS = [f"PointLight[{name}].intensity" for name in "abcd"]
TRADED, PRODUCT, SUM = "can be traded for", "only their product is seen", "only their sum is seen"

PLANTED: dict[str, tuple[list[Any], dict[str, Any], list[str], list[str]]] = {
    "strength against albedo": (
        [key_light()], {}, [DIFFUSE, SPECULAR, "PointLight[key].intensity"],
        [f"PointLight[key].intensity {TRADED} {DIFFUSE} and {SPECULAR}: {PRODUCT}"],
    ),
    "colour against albedo, a channel each": (
        [key_light()], {}, [DIFFUSE, SPECULAR, "PointLight[key].color"],
        [f"PointLight[key].color.{c} {TRADED} {DIFFUSE}.{c} and {SPECULAR}.{c}: {PRODUCT}" for c in "rgb"],
    ),
    "colour against strength": (
        [key_light()], {}, ["PointLight[key].color", "PointLight[key].intensity", SPECULAR + ".r"],
        [f"PointLight[key].intensity {TRADED} PointLight[key].color: {PRODUCT}"],
    ),
    "length of a direction, no highlight, no background, out of reach": (
        [SUN, FAR], {"specular_color": (0, 0, 0)},
        [
            DIFFUSE, "DirectionalLight[sun].direction", "Material[body].shininess", "Material[body].transparency",
            "PointLight[far].intensity",
        ],
        [
            "the length of DirectionalLight[sun].direction is not seen: only where it points",
            "Material[body].shininess is not seen: the pictures do not change with it near its value",
            "Material[body].transparency is not seen: the pictures do not change with it near its value",
            "PointLight[far].intensity is not seen: the pictures do not change with it near its value",
        ],
    ),
    "two lights in one place": (
        [key_light(), TWIN], {}, ["PointLight[*].intensity", "Material[body].shininess"],
        [f"PointLight[twin].intensity {TRADED} PointLight[key].intensity: {SUM}"],
    ),
    "two lights of one strength and place": (
        [key_light(), key_light(name="twin")], {}, ["PointLight[*].intensity", "Material[body].shininess"],
        [f"PointLight[twin].intensity {TRADED} PointLight[key].intensity: {SUM}"],
    ),
    "strength against an exposure as large": (
        [key_light(intensity=1.0)], {}, ["PointLight[key].intensity", "View[0].exposure", "Material[body].shininess"],
        [f"View[0].exposure {TRADED} PointLight[key].intensity: {PRODUCT}"],
    ),
    "strength against attenuation": (
        [key_light(attenuation=(1.0, 0.5, 0.2))], {}, ["PointLight[key].intensity", "PointLight[key].attenuation"],
        [f"PointLight[key].intensity {TRADED} PointLight[key].attenuation: only their ratio is seen"],
    ),
    "exposure against strength": (
        [key_light()], {}, ["PointLight[key].intensity", "View[0].exposure", "Material[body].shininess"],
        [f"View[0].exposure {TRADED} PointLight[key].intensity: {PRODUCT}"],
    ),
    "four strengths and an exposure": ([key_light(name=n, location=(2 * x, 2, 3)) for x, n in enumerate("abcd")], {},
        ["PointLight[*].intensity", "View[0].exposure"],
        [f"View[0].exposure {TRADED} {', '.join(STRENGTHS[:3])} and {STRENGTHS[3]}: {PRODUCT}"],
    ),
    "two factors of the ambient term": (
        [key_light(ambient_intensity=0.3)], {},
        ["Material[body].ambient_intensity", "PointLight[key].ambient_intensity", DIFFUSE],
        [f"PointLight[key].ambient_intensity {TRADED} Material[body].ambient_intensity: {PRODUCT}"],
    ),
}  # fmt: skip


def known(lights: list[Any], changes: dict[str, Any], free: list[Any], dtype: Any, light: float = 1.0) -> Uncertainty:
    """`light`: how bright the picture is, noise and all."""
    body = material(**changes)
    view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, *lights, body=body, noise=0.01 * light))
    return at_start(sphere_scene(*lights, body=body, dtype=dtype), view, free)


def at_start(scene: Scene, view: View, free: list[Any]) -> Uncertainty:
    """What a fit would know that had found what the scene holds."""
    problem, description = make_problem(scene, view, free)
    return uncertainty(problem, description, problem.parameters.start)


@pytest.mark.parametrize("kind", PLANTED)
def test_a_planted_ambiguity_is_named(kind: str) -> None:
    lights, changes, free, sentences = PLANTED[kind]
    with precision("float32") as dtype:
        found = known(lights, changes, free, dtype)
    assert not found.well_posed and not found.correlations
    assert sorted(line for line in found.messages() if "seen" in line) == sorted(sentences)
    assert found.rank == len(found.labels) - len(sentences)
    unknown = {found.labels[i] for a in found.ambiguities for i in np.flatnonzero(a.direction)} | set(found.unseen)
    assert {label for label, e in zip(found.labels, found.standard_error, strict=True) if np.isinf(e)} == unknown


@pytest.mark.parametrize("bits", ["float32", "float64"])
def test_a_well_posed_fit_has_none(bits: str) -> None:
    free = [DIFFUSE, SPECULAR, "Material[body].shininess", "PointLight[key].location"]
    with precision(bits) as dtype:
        found = known([key_light()], {}, free, dtype)
    assert found.well_posed and found.messages() == [] and found.rank == len(found.labels) == 10
    assert found.noise == pytest.approx(0.01, rel=0.05)
    assert np.all((found.standard_error > 0) & (found.standard_error < 0.02))


def test_errors_are_of_the_size_of_the_noise_however_small_it_is() -> None:
    free = [DIFFUSE, "Material[body].shininess"]
    with precision("float64") as dtype:
        found, expected = (known([key_light(intensity=light)], {}, free, dtype, light) for light in (1e-9, 1.0))
    np.testing.assert_allclose(found.standard_error, expected.standard_error, rtol=1e-6)


def test_a_direction_keeps_its_pictures() -> None:
    """Moving along a named direction does not change the picture: the claim itself, tested."""
    lights, changes, free, _ = PLANTED["strength against albedo"]
    body = material(**changes)
    with precision("float64") as dtype:
        samples = sphere_samples(SIZE, dtype=dtype)
        view = View(samples, sphere_picture(SIZE, *lights, body=body))
        problem, description = make_problem(sphere_scene(*lights, body=body, dtype=dtype), view, free)
        (ambiguity,) = uncertainty(problem, description, problem.parameters.start).ambiguities
        from jaxlight.fit.normal import loss

        moved = problem.parameters.start + 1e-4 * jnp.asarray(ambiguity.direction)
        # Second order: the product of two changes of 1e-4.
        assert float(loss(problem, moved)) < 1e-12 < float(loss(problem, problem.parameters.start + 1e-4))


def test_numbers_at_a_bound_are_told_and_taken_as_known() -> None:
    body = material(diffuse_color=(1.0, 0.5, 0.2), specular_color=(0.0, 0.3, 0.3))
    start = material(diffuse_color=(0.5, 0.5, 0.5), specular_color=(0.2, 0.2, 0.2))
    brighter = sphere_picture(SIZE, body=body, noise=0.001)
    brighter[..., 0] = 1.1 * sphere_picture(SIZE, key_light(), body=material(diffuse_color=(1, 0, 0)))[..., 0] - 0.01
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), brighter)
        result = fit(sphere_scene(body=start, dtype=dtype), view, [DIFFUSE, SPECULAR, "Material[body].shininess"])
    found = result.uncertainty
    assert (f"{DIFFUSE}.r", "upper") in found.at_bound
    assert found.standard_error[0] == 0 and np.all(found.standard_error[1:3] > 0)
    assert f"{DIFFUSE}.r lies on its upper bound, beyond which it would go: no error is given" in found.messages()


def test_a_number_of_which_both_bounds_are_one_is_known() -> None:
    """As if it were not free: its fit has the same errors, and nothing is traded for it."""
    strength, value = "PointLight[key].intensity", key_light().intensity
    pinned = Free(strength, lower=value, upper=value)
    component = Free(DIFFUSE, lower=(0.5, 0, 0), upper=(0.5, 1, 1))
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, noise=0.01))
        scene = sphere_scene(body=material(diffuse_color=(0.5, 0.4, 0.3)), dtype=dtype)
        alone, found, partly = (at_start(scene, view, free) for free in ([DIFFUSE], [DIFFUSE, pinned], [component]))
    np.testing.assert_allclose(found.standard_error, [*alone.standard_error, 0], rtol=1e-9)
    assert found.well_posed and found.at_bound == () and found.rank == 3
    assert partly.standard_error[0] == 0 and np.all(partly.standard_error[1:] > 0)
    assert not partly.hardly_seen


@pytest.mark.parametrize(("bits", "levels"), [("float32", 0), ("float64", 255)])
def test_an_ambiguity_is_named_where_one_of_its_numbers_lies_on_a_bound(bits: str, levels: int) -> None:
    """Whatever the rounding of the values, which the slope at the bound is made of."""
    free = ["PointLight[key].intensity", DIFFUSE, SPECULAR]
    sentence = f"{DIFFUSE} and {SPECULAR} {TRADED} PointLight[key].intensity: {PRODUCT}"
    picture = sphere_picture(SIZE)
    picture = np.round(picture * levels) / levels if levels else picture
    body = material(diffuse_color=(1.0, 0.5, 1 / 3), specular_color=(5 / 6, 2 / 3, 0.5))
    with precision(bits) as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), picture)
        start = sphere_scene(key_light(intensity=0.54), body=body, dtype=dtype)
        best = fit(start, view, free)
        assert best.labels[:2] == ("PointLight[key].intensity", f"{DIFFUSE}.r")
        values = best.values.astype(np.float64)
        values = np.array([values[0] * values[1], *values[1:] / values[1]])
        for rounding in (-16, -4, 4, 16):
            rounded = values * (1 + rounding * np.finfo(dtype).eps * np.eye(7)[0])
            found = uncertainty(best.problem, best.description, rounded.astype(dtype))
            assert sentence in found.messages() and (f"{DIFFUSE}.r", "upper") in found.at_bound
            assert found.rank == 6 and not found.well_posed and np.all(np.isinf(found.standard_error))


def test_lights_that_together_are_pressed_to_nothing_are_known() -> None:
    """They can be traded for each other, but neither can be less than 0."""
    dark = [key_light(intensity=0.0), key_light(name="twin", intensity=0.0)]
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, *dark, noise=0.01) - 0.1)
        found = at_start(sphere_scene(*dark, dtype=dtype), view, ["PointLight[*].intensity"])
    assert found.well_posed and found.rank == 0 and len(found.at_bound) == 2
    np.testing.assert_array_equal(found.standard_error, 0)


def test_a_bound_holds_only_what_the_pictures_want_beyond_it_by_more_than_their_noise() -> None:
    """The true value lies on the bound: noise decides on which side of it the optimum is."""
    body = material(diffuse_color=(1.0, 0.3, 0.2))
    errors = []
    with precision("float64") as dtype:
        for seed in range(8):
            view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, body=body, noise=0.01, seed=seed))
            errors.append(fit(sphere_scene(body=body, dtype=dtype), view, [DIFFUSE]).uncertainty.standard_error[0])
    np.testing.assert_allclose(errors, np.mean(errors), rtol=0.1)


def test_a_light_of_no_strength_is_nowhere() -> None:
    free = ["PointLight[key].location", "PointLight[key].intensity"]
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), np.zeros((SIZE, SIZE, 3)))
        problem, description = make_problem(sphere_scene(dtype=dtype), view, free)
        # What a fit of a black picture may end with, where it rounds to 0.
        found = uncertainty(problem, description, np.array([*np.asarray(problem.parameters.start)[:3], 4e-16]))
    assert found.unseen == tuple(f"PointLight[key].location.{axis}" for axis in "xyz")
    assert found.rank == 1 and np.all(np.isinf(found.standard_error[:3]))


def test_a_number_at_the_end_of_an_endless_range_is_not_called_hardly_seen() -> None:
    """The picture is brighter than the light without falloff: attenuation[1] is held at 0, and known."""
    path = "PointLight[key].attenuation[1]"
    with precision("float64") as dtype:
        picture = sphere_picture(SIZE, key_light(intensity=1.0, attenuation=(1.0, 0.0, 0.0)), noise=0.001)
        view = View(sphere_samples(SIZE, dtype=dtype), picture)
        darker = key_light(intensity=0.9, attenuation=(1.0, 0.0, 0.0))
        found = at_start(sphere_scene(darker, dtype=dtype), view, [path])
    assert found.at_bound == ((path, "lower"),)
    assert found.standard_error[0] == 0
    assert found.hardly_seen == ()


def test_a_lamp_that_is_found_to_be_off_is_not_called_hardly_seen() -> None:
    lamps = [key_light(), key_light(name="off", location=(-2.0, 1.0, 3.0), intensity=0.5)]
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, noise=0.01), noise=0.01)
        found = fit(sphere_scene(*lamps, dtype=dtype), view, "PointLight[off].intensity").uncertainty
    assert 0 < found.standard_error[0] < 0.01
    assert found.hardly_seen == ()


def test_what_is_hardly_seen_and_hardly_told_apart_is_said() -> None:
    far = key_light(location=(300.0, 400.0, 1200.0), radius=1e6)
    with precision("float64") as dtype:
        found = known([far], {}, ["PointLight[key].location", "PointLight[key].intensity"], dtype)
    assert found.well_posed
    assert any("is hardly seen: its standard error is" in line for line in found.messages())
    assert any("hard to tell apart" in line for line in found.messages())
    assert abs(found.correlations[0].value) > 0.99


@eqx.filter_jit
def fit_all(problem: Problem, targets: Any) -> Any:
    """The solutions for each of several pictures of one view."""
    solver = make_solver(problem)

    def one(target: Any) -> Any:
        noisy = eqx.tree_at(lambda p: p.views[0].target, problem, target[None])
        return solve(noisy, solver, noisy.parameters.start)

    return eqx.filter_vmap(one)(targets)


@pytest.mark.thorough
def test_intervals_of_95_percent_cover_the_truth_as_often_as_they_say() -> None:
    free = [DIFFUSE, SPECULAR, "Material[body].shininess", "PointLight[key].location", "PointLight[key].color.g"]
    free[1:2] = [Free(SPECULAR, tied="all")]
    fits, noise, size = 500, 0.02, 16
    body = material(specular_color=(0.4, 0.4, 0.4))
    pixel = sphere_points(size)[1]
    truth_picture = sphere_picture(size, body=body).reshape(-1, 3)[pixel]
    with precision("float64") as dtype:
        samples = sphere_samples(size, dtype=dtype)
        problem, description = make_problem(sphere_scene(body=body, dtype=dtype), View(samples, truth_picture), free)
        truth = np.asarray(problem.parameters.start)
        (view,) = problem.views
        clean = np.asarray(view.target)[0]
        random = np.random.default_rng(7)
        targets = jnp.asarray(clean + noise * random.normal(size=(fits, *clean.shape)))

        solution = fit_all(problem, targets)
        values = np.asarray(solution.value)
        assert np.all(np.asarray(solution.state.terminate))
        curvature = np.asarray(solution.state.curvature.matrix)
        freedom = description.residuals - len(truth)
        variance = 2 * np.asarray(solution.state.loss) / freedom
        deviations = np.sqrt(variance[:, None] * np.array([np.diagonal(np.linalg.inv(c)) for c in curvature]))
        # The same errors as those the library states, for one of the fits.
        noisy = eqx.tree_at(lambda p: p.views[0].target, problem, targets[:1])
        stated = uncertainty(noisy, description, values[0])
        np.testing.assert_allclose(stated.standard_error, deviations[0], rtol=1e-6)
    covered = np.abs(values - truth) <= 1.96 * deviations
    assert 0.93 <= covered.mean() <= 0.97
    assert np.all((covered.mean(axis=0) > 0.92) & (covered.mean(axis=0) < 0.98)), covered.mean(axis=0)


def test_a_stated_noise_makes_errors_absolute() -> None:
    free = [DIFFUSE, "Material[body].shininess"]
    with precision("float64") as dtype:
        samples, picture = sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE)
        scene = sphere_scene(dtype=dtype)
        errors, said = [], []
        for noise, weight in ((0.01, None), (0.02, None), (0.01, 0.25), (0.01, 1.0)):
            view = View(samples, picture, noise=noise, weight=weight and np.full((SIZE, SIZE), weight))
            problem, description = make_problem(scene, view, free)
            found = uncertainty(problem, description, problem.parameters.start)
            errors.append(found.standard_error)
            said.append([text for text in found.messages() if "weight" in text])
    assert jax.config.jax_enable_x64 is False
    for other, factor in ((1, 2), (2, 2), (3, 1)):
        np.testing.assert_allclose(errors[other], factor * errors[0], rtol=1e-9)
    assert [len(own) for own in said] == [0, 0, 1, 0] and "noise / sqrt(w)" in said[2][0]


def large(scale: float, dtype: Any, size: int = SIZE) -> Any:
    """Samples of the sphere in smaller units, and a light that is the same then; scale 1000: metres in millimetres."""
    points, pixel = sphere_points(size)
    eye = scale * np.array((0.0, 0.0, 4.0))
    samples = SampleBuffer.create(scale * points, points, eye, pixel=pixel, width=size, height=size, dtype=dtype)
    place = tuple(scale * x for x in key_light().location)
    return samples, key_light(location=place, attenuation=(1.0, 0.1 / scale, 0.05 / scale**2), radius=1e9)


def test_errors_do_not_depend_on_the_unit_of_length() -> None:
    free = ["PointLight[key].location", "PointLight[key].attenuation", "Material[body].shininess"]
    picture = sphere_picture(SIZE, key_light(attenuation=(1.0, 0.1, 0.05)), noise=0.003)
    with precision("float64") as dtype:
        errors = []
        for scale in (1.0, 1e6):
            samples, light = large(scale, dtype)
            view = View(samples, picture)
            found = at_start(sphere_scene(light, dtype=dtype), view, free)
            assert found.unseen == ()
            errors.append(found.standard_error / [scale, scale, scale, 1, 1 / scale, scale**-2, 1])
    np.testing.assert_allclose(errors[1], errors[0], rtol=1e-4)


def test_a_prior_is_as_good_as_it_says_whether_noise_is_stated_or_not() -> None:
    """Nothing in the picture tells strength from albedo: all that is known of it is the prior."""
    free = [DIFFUSE, SPECULAR, Free("PointLight[key].intensity", mean=0.9, deviation=0.2)]
    said = "priors are weighed as if the noise of a picture were 1: state the views' `noise`"
    with precision("float64") as dtype:
        for noise in (None, 0.02):
            view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, noise=0.02), noise=noise)
            found = at_start(sphere_scene(dtype=dtype), view, free)
            assert found.standard_error[-1] == pytest.approx(0.2, rel=1e-3)
            assert found.standard_error[0] == pytest.approx(0.2 * 0.6 / 0.9, rel=0.05)
            assert (said in found.messages()) == (noise is None)
            assert found.noise == pytest.approx(0.02 if noise is None else 1, rel=0.1)


def test_as_many_numbers_as_residuals_leave_no_error_to_be_stated() -> None:
    with precision("float64") as dtype:
        one = SampleBuffer.create([[0, 0, 1]], [[0, 0, 1]], (0, 0, 4), dtype=dtype)
        found = at_start(sphere_scene(dtype=dtype), View(one, np.array([[0.5, 0.4, 0.3]])), [DIFFUSE])
    assert np.all(np.isinf(found.standard_error)) and np.all(np.isnan(found.covariance))
    assert "the errors are not known: 3 residuals leave nothing" in str(found)


def test_what_exceeds_the_stated_noise_is_said() -> None:
    with precision("float64") as dtype:
        samples, picture = sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, noise=0.02)
        said = [
            at_start(sphere_scene(dtype=dtype), View(samples, picture, noise=noise), [DIFFUSE]).messages()
            for noise in (0.02, 0.01)
        ]
    assert said[0] == []
    assert len(said[1]) == 1 and said[1][0].startswith(("what is left is 1.9", "what is left is 2"))


@pytest.mark.parametrize(("loss", "scale", "known"), [("cauchy", 2e-3, False), ("huber", 0.02, True)])
def test_a_robust_loss_that_hears_hardly_a_residual_knows_no_error(loss: Any, scale: float, known: bool) -> None:
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, noise=0.02))
        problem, description = make_problem(sphere_scene(dtype=dtype), view, DIFFUSE, loss=loss, loss_scale=scale)
        found = uncertainty(problem, description, problem.parameters.start)
    assert np.isfinite(found.standard_error).tolist() == [known] * 3
    assert any("lie within the scale of the loss" in line for line in found.messages()) == (not known)


def test_residuals_that_a_fit_draws_to_0_tell_nothing_of_its_errors(tmp_path: Path) -> None:
    """Of a scale far below the noise they are all that lies within it."""
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, noise=0.02))
        found = fit(sphere_scene(dtype=dtype), view, DIFFUSE, loss="huber", loss_scale=1e-7)
        write_report(tmp_path / "report.html", found, view)
    assert np.all(np.isinf(found.uncertainty.standard_error))
    report = (tmp_path / "report.html").read_text()
    assert report.count("error not known") == 3 and "not determined" not in report


def test_priors_are_no_part_of_what_is_left_of_pictures() -> None:
    free = [Free(DIFFUSE, mean=0.1, deviation=0.01)]
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, noise=0.02), noise=0.02)
        assert not any("what is left" in line for line in at_start(sphere_scene(dtype=dtype), view, free).messages())


@pytest.mark.parametrize("loss", ["squares", "huber"])
def test_few_residuals_tell_their_errors_too(loss: Any) -> None:
    points = np.array([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8], [0.6, 0.0, 0.8]])
    with precision("float64") as dtype:
        scene, three = sphere_scene(dtype=dtype), SampleBuffer.create(points, points, (0, 0, 4), dtype=dtype)
        seen = np.asarray(shade(scene, three))[:, :3] + 0.01 * np.random.default_rng(0).normal(size=(3, 3))
        scale = None if loss == "squares" else 0.1
        problem, description = make_problem(scene, View(three, seen), [DIFFUSE], loss=loss, loss_scale=scale)
        found = uncertainty(problem, description, problem.parameters.start)
    assert np.all(np.isfinite(found.standard_error)) and found.messages() == []


def test_a_coordinate_near_0_is_seen_as_well_as_the_others() -> None:
    with precision("float64") as dtype:
        scene = sphere_scene(key_light(location=(2.0, 1e-4, 4.0)), dtype=dtype)
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, noise=0.003))
        found = at_start(scene, view, ["PointLight[key].location"])
    assert np.all(found.standard_error > 1e-4) and found.hardly_seen == ()


def test_limits_of_the_sensor_that_are_kept_tell_nothing_of_the_noise() -> None:
    with precision("float64") as dtype:
        picture = sphere_picture(SIZE, noise=0.02)
        view = View(sphere_samples(SIZE, dtype=dtype), np.minimum(picture, 0.15), saturated=0.15)
        found = at_start(sphere_scene(dtype=dtype), view, [DIFFUSE, "Material[body].shininess"])
    assert found.noise == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("texels", [24, 64])
def test_texels_that_nothing_shows_take_no_part(texels: int) -> None:
    """A quad of which samples show a quarter, each the nearest texel; then one whose texels hold each other."""
    across = (np.arange(32) + 0.5) / 32
    x, y = (w.ravel() for w in np.meshgrid(across, across))
    column, row = (np.floor(w / 2 * texels).astype(int) for w in (x, y))
    index = np.repeat((row * texels + column)[:, None], 4, axis=1)
    position = np.stack([x, y, np.zeros_like(x)], axis=1)
    image = np.random.default_rng(1).uniform(0.3, 0.6, (texels, texels, 3))
    texture = nodes.PixelTexture(image=image, name="skin")
    shape = nodes.Shape(appearance=nodes.Appearance(material=material(specular_color=(0, 0, 0)), texture=texture))
    noise = 0.01 * np.random.default_rng(2).normal(size=(1024, 3))
    with precision("float64") as dtype:
        scene = Scene.from_nodes([shape, key_light(location=(0.5, 0.5, 2.0), color=(1, 1, 1))], dtype=dtype)
        samples = SampleBuffer.create(
            position, np.tile([0.0, 0, 1], (1024, 1)), (0.5, 0.5, 3), dtype=dtype,
            texel_index=index, texel_weight=np.tile([1.0, 0, 0, 0], (1024, 1)),
        )  # fmt: skip
        view = View(samples, np.asarray(shade(scene, samples))[:, :3] + noise)
        found = fit(scene, view, ["Texture[skin].image"]).uncertainty
        if texels == 24:
            assert found.noise == pytest.approx(0.01, rel=0.1)
        else:  # each sample shows another texel: nothing is left to tell the noise from
            assert found.noise == np.inf
            held = fit(scene, view, [Free("Texture[skin].image", mean=image, deviation=1e-3)]).uncertainty
            assert held.noise == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize(
    ("loss", "outliers", "scale"),
    [
        ("huber", 0.0, 1.0),
        ("huber", 0.1, 1.0),
        pytest.param("huber", 0.0, 0.1, marks=pytest.mark.thorough),
        pytest.param("cauchy", 0.0, 1.0, marks=pytest.mark.thorough),
    ],
)
def test_errors_of_robust_losses_are_those_that_are_made(loss: Any, outliers: float, scale: float) -> None:
    """`scale`: of the loss, in standard deviations of the noise."""
    free, fits, noise, size = [DIFFUSE, "Material[body].shininess"], 400, 0.02, 16
    random = np.random.default_rng(5)
    with precision("float64") as dtype:
        view = View(sphere_samples(size, dtype=dtype), sphere_picture(size))
        problem, description = make_problem(sphere_scene(dtype=dtype), view, free, loss=loss, loss_scale=scale * noise)
        (stack,) = problem.views
        clean = np.asarray(stack.target)[0]
        errors = noise * random.normal(size=(fits, *clean.shape))
        errors += np.where(random.uniform(size=errors.shape) < outliers, random.choice([-0.5, 0.5], errors.shape), 0)
        targets = jnp.asarray(clean + errors)
        values = np.asarray(fit_all(problem, targets).value)
        # The same loss where the noise is stated: residuals and their scale are in units of it.
        view = View(view.samples, view.target, noise=noise)
        of_noise = make_problem(sphere_scene(dtype=dtype), view, free, loss=loss, loss_scale=scale)
        for own, described in ((problem, description), of_noise):
            stated = []
            for target, found in zip(targets[:10], values, strict=False):
                noisy = eqx.tree_at(lambda p: p.views[0].target, own, target[None])
                stated.append(uncertainty(noisy, described, found).standard_error)
            np.testing.assert_allclose(np.mean(stated, axis=0) / np.std(values, axis=0), 1, atol=0.12)
