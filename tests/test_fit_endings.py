"""How fits begin and end: names of views, values by their paths, what no picture shows, and late interrupts."""

from __future__ import annotations

import os
import re
import signal
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import optimistix as optx
import pytest

from fit_scenes import key_light, material, precision, sphere_picture, sphere_samples, sphere_scene
from jaxlight import Fit, Free, View, fit, nodes, shade
from jaxlight.fit import fitting
from jaxlight.fit.problem import make_problem
from jaxlight.fit.uncertainty import uncertainty

SIZE = 24
FREE = ["Material[body].diffuse_color", "Material[body].shininess"]


def start(dtype: Any) -> Any:
    return sphere_scene(body=material(diffuse_color=(0.5, 0.5, 0.5), shininess=0.2), dtype=dtype)


def view_of(**changes: Any) -> View:
    picture = changes.pop("target", sphere_picture(SIZE))
    return View(sphere_samples(SIZE), picture, **changes)


def test_fits_of_a_cone_to_noisy_pictures_end_where_no_step_leads_down() -> None:
    """Its rim crosses samples: the optimum lies on a kink, from where steps change no more than the loss's rounding."""
    lamp = nodes.SpotLight(
        name="spot", location=(-2.0, 1.0, 4.0), direction=(2.0, -1.0, -4.0), beam_width=0.1, cut_off_angle=0.2
    )
    with precision("float32") as dtype:
        scene, samples = sphere_scene(lamp, dtype=dtype), sphere_samples(48, dtype=dtype)
        clean = np.asarray(shade(scene, samples))[:, :3]
        for seed in (6, 9, 12, 23, 44, 56):
            noisy = clean + np.random.default_rng(seed).normal(0, 0.01, clean.shape)
            free = [f"SpotLight[spot].{name}" for name in ("location", "cut_off_angle", "beam_width")]
            result = fit(scene, View(samples, noisy, noise=0.01), free)
            assert result.converged and len(result.history) < 40, result.message
            off = np.abs(result.values - result.start) / result.uncertainty.standard_error
            assert np.all(off < 4), off


@pytest.mark.parametrize("name", ["float32", "float64"])
@pytest.mark.parametrize("start", [(1, 0, 0.2), (1, 0.1, 0.1), (3, 0, 0), (2, 0, 0)])
def test_attenuations_that_begin_too_strong_do_not_end_where_all_are_1(name: str, start: tuple[float, ...]) -> None:
    """A sum of terms below 1 counts as 1: the whole linear step lands there, where no slope leads back."""
    with precision(name) as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE, key_light(attenuation=(1, 0, 0.02))))
        scene = sphere_scene(key_light(attenuation=start), dtype=dtype)
        for others in ([], ["Material[body].diffuse_color", "PointLight[key].location"]):
            result = fit(scene, view, ["PointLight[key].attenuation", *others])
            assert result.converged and result.accepted_steps < 16, result.message
            assert result.rms < 100 * np.finfo(dtype).eps


def test_an_attenuation_of_1_is_found_from_above() -> None:
    noise = np.random.default_rng(3).normal(0, 0.002, (SIZE, SIZE, 3))
    with precision("float64") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE) + noise, noise=0.002)
        scene = sphere_scene(key_light(attenuation=(1, 0, 0.2)), dtype=dtype)
        result = fit(scene, view, ["PointLight[key].attenuation", "Material[body].diffuse_color"])
    assert result.converged and 0.9 < result.rms < 1.1, result.message


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("a", "a"), "views[1].name: 'a' is named twice"),
        (("1", ""), "views[0].name: '1' is named twice"),
        (("a", 3), "views[1].name: expected text, got 3"),
    ],
)
def test_names_of_views_that_do_not_tell_them_apart_are_refused(names: tuple[Any, Any], said: str) -> None:
    with precision("float32") as dtype, pytest.raises(ValueError, match=re.escape(said)):
        fit(start(dtype), [view_of(name=name) for name in names], FREE)


def test_a_view_whose_name_has_brackets_is_found_by_it() -> None:
    """As pictures have that were stored twice; in patterns brackets mean one of several characters."""
    views = [view_of(name=name) for name in ("photo [1]", "photo 1", "photo 2")]
    found = []
    with precision("float32") as dtype:
        for path in ("View[photo [1]].exposure", "View[photo [12]].exposure"):
            problem, description = make_problem(start(dtype), views, [path])
            assert problem.parameters.few == len(description.labels)
            found.append(list(description.labels))
    assert found == [["View[photo [1]].exposure"], ["View[photo 1].exposure", "View[photo 2].exposure"]]


def test_values_are_found_by_every_path_that_means_them() -> None:
    with precision("float32") as dtype:
        result = fit(start(dtype), view_of(), ["Material[body].diffuse_color", "View[0].exposure"], max_steps=1)
    color = result.value("Material[body].diffuse_color")
    np.testing.assert_array_equal(result.value("Material[0].diffuse_color"), color)
    np.testing.assert_array_equal(result.value("Material[body].diffuse_color.g"), color[1])
    np.testing.assert_array_equal(result.value("Material[0].diffuse_color[2]"), color[2])
    assert result.value("View[0].exposure") > 0
    for path in ("Material[body].shininess", "Material[body].shine", "View[1].exposure"):
        with pytest.raises(ValueError, match="was not free; free: Material"):
            result.value(path)


def test_a_sensor_without_limits_is_one_of_which_none_are_known() -> None:
    with precision("float32") as dtype:
        for limits, settles in (
            ({}, True),
            ({"saturated": np.inf, "dark": -np.inf}, True),
            ({"saturated": 2.0}, False),
        ):
            assert make_problem(start(dtype), view_of(**limits), FREE)[0].settles is settles


def test_a_fit_of_what_no_picture_shows_is_no_success() -> None:
    """A lamp inside the sphere; unless nothing is left to be explained."""
    free = ["PointLight[key].location", "PointLight[key].intensity"]
    inside = sphere_scene(key_light(location=(0.0, 0.0, 0.0)), body=material(ambient_intensity=0.0))
    dark = np.zeros((SIZE, SIZE, 3))
    result = fit(inside, view_of(), free)
    assert result.outcome == "unseen" and not result.converged
    assert result.message.startswith("Not converged: after 0 steps")
    assert "no picture changes with any free number, near the start" in result.message
    assert fit(inside, view_of(target=dark), free).outcome == "converged"
    noisy = view_of(target=0.01 * np.random.default_rng(0).normal(size=dark.shape), noise=0.01)
    assert fit(inside, noisy, free).outcome == "converged"
    other = fit(inside, view_of(), free, method=optx.BFGS(rtol=1e-3, atol=1e-3))
    assert other.outcome == "unseen"
    assert other.message.startswith("Not converged: no picture changes with any free number where BFGS ended, after ")


def test_a_sum_of_which_no_picture_tells_the_parts_is_found_however_noisy_it_is() -> None:
    """Ambient light beside emission: at the optimum no slope is more than rounding, and the curvature is singular."""
    with precision("float64") as dtype:
        lamp, samples = key_light(ambient_intensity=0.5, attenuation=(1.0, 0.0, 0.0)), sphere_samples(20)
        clean = np.asarray(shade(sphere_scene(lamp, body=material(emissive_color=(0.2, 0.2, 0.2))), samples))[:, :3]
        random = np.random.default_rng(0)
        for _ in range(4):
            own = material(
                emissive_color=tuple(random.uniform(0.1, 0.5, 3)), ambient_intensity=random.uniform(0.1, 0.4)
            )
            view = View(samples, clean + random.normal(0, 0.01, clean.shape))
            free = ["Material[body].ambient_intensity", "Material[body].emissive_color"]
            result = fit(sphere_scene(lamp, body=own, dtype=dtype), view, free)
            assert result.converged and len(result.history) < 10, result.message
            assert result.uncertainty.ambiguities


def test_an_interrupt_after_the_last_step_loses_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Whoever handles it hears of it afterwards."""
    heard, make = [], fitting.make_fit

    def handler(*_: Any) -> None:
        heard.append(True)
        raise KeyboardInterrupt

    def interrupted(*args: Any, **options: Any) -> Fit:
        os.kill(os.getpid(), signal.SIGINT)
        return make(*args, **options)

    monkeypatch.setattr(fitting, "make_fit", interrupted)
    before = signal.signal(signal.SIGINT, handler)
    try:
        result = fit(start(np.float32), view_of(), FREE, max_steps=2, log=tmp_path / "log.jsonl")
        assert heard == [True] and signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert result.outcome == "max_steps" and '"max_steps"' in (tmp_path / "log.jsonl").read_text().splitlines()[-1]


def test_a_residual_says_what_it_counts_whatever_minimiser_left_it() -> None:
    """Of another minimiser too: a robust loss and priors are in the sum."""
    prior = Free("Material[body].shininess", mean=0.3, deviation=0.1)
    method = optx.BFGS(rtol=1e-3, atol=1e-3)
    with precision("float32") as dtype:
        result = fit(start(dtype), view_of(), [prior], loss="huber", loss_scale=0.02, method=method, max_steps=2)
    said = f"residual RMS {result.rms:.3g}, as the huber loss counts it, priors included."
    assert result.message.endswith(said)


def test_other_minimisers_leave_a_number_whose_bounds_are_one_where_it_is() -> None:
    pinned = [Free("Material[body].shininess", lower=0.2, upper=0.2), "View[0].exposure"]
    with precision("float32") as dtype:
        result = fit(start(dtype), view_of(), pinned, method=optx.BFGS(rtol=1e-3, atol=1e-3), max_steps=30)
    assert result.converged and result.value("Material[body].shininess") == np.float32(0.2)
    assert result.value("View[0].exposure") != 1


def test_other_minimisers_that_end_nowhere_keep_the_best_that_they_met() -> None:
    """Steps that are too long lead to exposures without end."""
    with precision("float32") as dtype:
        bright = view_of(target=4 * sphere_picture(SIZE))
        method = optx.GradientDescent(1e3, rtol=1e-3, atol=1e-3)
        result = fit(start(dtype), bright, "View[0].exposure", method=method)
    assert result.outcome == "nonfinite" and not result.converged
    assert result.message.startswith("Failed: GradientDescent came to what is not finite in ")
    assert np.isfinite([*result.values, result.loss]).all() and np.isfinite(result.exposure).all()


def test_other_minimisers_that_end_above_the_optimum_are_not_believed() -> None:
    """In float32 their line searches may come to nothing anywhere; where noise is what is left, all is well."""
    free = [
        "Material[body].diffuse_color",
        Free("Material[body].specular_color", deviation=0.35),
        "PointLight[key].intensity",
    ]
    with precision("float32") as dtype:
        view = view_of(target=sphere_picture(SIZE, noise=0.01), noise=0.01)
        body = material(diffuse_color=(0.68, 0.0, 0.69), specular_color=(0.0, 0.14, 0.94))
        scene = sphere_scene(key_light(intensity=0.45), body=body, dtype=dtype)
        best = fit(scene, view, free)
        short = fit(scene, view, free, method=optx.BFGS(1e-4, 1e-4), max_steps=2000)
        near = fit(best.scene, view, free[0], method=optx.BFGS(1e-4, 1e-4))
    assert best.converged and short.loss > best.loss + 10
    assert short.outcome == "stalled" and short.message.startswith("Not converged: BFGS ended after "), short.message
    assert near.converged, near.message


@pytest.mark.parametrize("case", ["noise", "target"])
def test_of_a_fit_that_failed_nothing_is_known(case: str) -> None:
    """Its squares are beyond float32, and still finite in float64, in which errors are computed."""
    changes = {"noise": {"noise": 1e-20}, "target": {"target": 1e30 * sphere_picture(SIZE)}}[case]
    free = [FREE[0], Free(FREE[1], lower=0.2, upper=0.2)]
    with precision("float32") as dtype, warnings.catch_warnings():
        warnings.simplefilter("error")
        result = fit(start(dtype), view_of(**changes), free)
        known = result.uncertainty
    assert result.outcome == "nonfinite" and not known.well_posed and known.rank == 0
    np.testing.assert_array_equal(known.standard_error, [np.inf, np.inf, np.inf, 0])
    assert known.messages() == ["nothing is known of the numbers: the fit failed"]
    assert str(result).startswith("Failed: ") and "nothing is known" not in str(result)


def test_values_at_which_nothing_can_be_computed_are_not_known() -> None:
    with precision("float32") as dtype:
        problem, description = make_problem(start(dtype), view_of(), FREE)
        known = uncertainty(problem, description, np.full(4, np.nan))
    assert not known.well_posed and np.isinf(known.standard_error).all()
    assert known.messages() == ["nothing is known of the numbers: the loss or its derivative is not finite at them"]


def test_a_fit_says_what_it_does_not_know() -> None:
    with precision("float32") as dtype:
        free = [FREE[0], "Material[body].specular_color", "PointLight[key].intensity"]
        result = fit(start(dtype), view_of(), free, max_steps=2)
    assert len(result.uncertainty.messages()) > 0
    assert str(result).endswith("\n".join(result.uncertainty.messages()))
