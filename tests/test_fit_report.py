"""The report page of a fit: what it shows is what was fitted."""

from __future__ import annotations

import base64
import dataclasses
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import jaxlight as jl
from jaxlight import nodes
from jaxlight.fit import view_pictures
from jaxlight.fit.pictures import ViewPictures
from jaxlight.fit.report import report_page
from jaxlight.formats.quantize import quantize
from jaxlight.image import resolve
from jaxlight.image.encode import Transfer

SIZE = 16


def make_scene(intensity: float = 1.0, *, on: bool = True, **changes: Any) -> jl.Scene:
    """A ball and two lamps, one on either side."""
    material = nodes.Material(**{"name": "<ball>", "diffuse_color": (0.8, 0.5, 0.2), **changes})
    return jl.Scene.from_nodes(
        [
            nodes.Viewpoint(position=(0, 0, 4)),
            nodes.Shape(appearance=nodes.Appearance(material=material), geometry=nodes.Sphere()),
            nodes.PointLight(name="left", location=(-3, 1, 3), intensity=intensity, on=on),
            nodes.PointLight(name="right", location=(3, 1, 3), intensity=intensity, on=on),
        ]
    )


@pytest.fixture(scope="module")
def fitted() -> tuple[jl.Fit, list[jl.View], jl.Scene]:
    """Two pictures, each with one lamp, the second exposed twice as long, its upper half masked and spoilt."""
    truth = make_scene(0.7)
    samples = jl.rasterize(truth, None, SIZE, SIZE)
    dark = jl.Scene.from_nodes([node for node in truth.document.children if getattr(node, "name", "") != "right"])
    left = np.asarray(jl.render(dark, samples))
    mask = np.zeros((SIZE, SIZE), bool)
    mask[SIZE // 2 :] = True
    right = np.where(mask[..., None], 2 * left[:, ::-1], 7.0)
    views = [
        jl.View(samples, left, lights=["PointLight[left]"], name="a"),
        jl.View(samples, right, lights=["PointLight[right]"], mask=np.where(mask, 0.9, 0.1), exposure=2.0, name="b"),
    ]
    return jl.fit(make_scene(), views, "PointLight[*].intensity"), views, truth


def test_models_show_each_view_with_its_own_lamp_and_exposure(fitted) -> None:
    result, views, _ = fitted
    np.testing.assert_allclose(result.values, 0.7, rtol=1e-5)
    first, second = view_pictures(result, views)
    assert (first.name, second.name) == ("View[a]", "View[b]")
    for pictures in (first, second):
        assert pictures.used.sum() > 20
        np.testing.assert_allclose(pictures.model[pictures.used], pictures.target[pictures.used], atol=1e-5)
    assert not second.used[: SIZE // 2].any() and first.used[: SIZE // 2].any()


def test_a_channel_that_the_fit_did_not_look_at_shows_the_model(fitted) -> None:
    result, views, _ = fitted
    target = np.array(views[0].target)
    target[..., 1] = np.inf
    view = dataclasses.replace(views[0], target=target, weight=np.isfinite(target).astype(float))
    pictures = view_pictures(result, [view, views[1]])[0]
    np.testing.assert_allclose(pictures.model[pictures.used], pictures.target[pictures.used], atol=1e-5)


SKY = (0.2, 0.4, 0.75)
DIFFERING: dict[str, tuple[dict[str, Any], dict[str, Any], int]] = {
    "a background": ({}, {"background": SKY}, 1),
    "a background behind rims": ({}, {"background": SKY, "exposure": 2.0}, 4),
    "a transparent shape before a picture of a background": (
        {"transparency": 0.5},
        {"background": np.broadcast_to(SKY, (SIZE, SIZE, 3))},
        1,
    ),
    "a transparent shape whose alpha is ignored": ({"transparency": 0.5}, {}, 1),
    "lamps that the scene has switched off": ({"on": False}, {"lights": ["PointLight[*]"]}, 1),
}
"""What a view and the scene see differently: the start, the view, and samples a pixel."""


@pytest.mark.parametrize("case", DIFFERING)
def test_the_model_is_what_the_fit_made_of_the_view(case: str) -> None:
    changes, seen, count = DIFFERING[case]
    scene = make_scene(diffuse_color=(0.5, 0.5, 0.5), **changes)
    samples = jl.rasterize(scene, None, SIZE, SIZE, samples=count)
    background, exposure = seen.get("background"), seen.get("exposure", 1.0)
    opacity = 1.0 if background is None else 1 - changes.get("transparency", 0.0)
    target = opacity * np.asarray(jl.render(make_scene(), samples))
    if background is not None:
        covered = np.asarray(resolve(np.ones(samples.count), samples))[..., None]
        target = target + (1 - opacity * covered) * np.asarray(background)
    view = jl.View(samples, exposure * target, **seen)
    result = jl.fit(scene, view, "Material[<ball>].diffuse_color")
    assert result.rms < 1e-6
    (pictures,) = view_pictures(result, view)
    np.testing.assert_allclose(pictures.model, pictures.target, atol=1e-5)  # also where no sample is


def test_without_a_background_the_scenes_sky_is_behind_the_model() -> None:
    sky = nodes.Background(sky_color=(SKY,))
    scene = jl.Scene.from_nodes([*make_scene().document.children, sky])
    samples = jl.rasterize(scene, None, SIZE, SIZE, samples=4)
    target = np.asarray(jl.render(scene, samples))
    view = jl.View(samples, target)
    (pictures,) = view_pictures(jl.fit(scene, view, "PointLight[left].intensity"), view)
    np.testing.assert_allclose(pictures.model, target, atol=1e-5)
    assert not pictures.used.all() and pictures.used.any()


@pytest.mark.parametrize("count", [16, 107])
def test_what_is_shown_as_used_is_what_the_fit_used(count: int) -> None:
    """In float32, 107 shares of 1 / 107 add up to less than 1."""
    scene = make_scene()
    samples = jl.rasterize(scene, None, 8, 8, samples=count)
    view = jl.View(samples, np.asarray(jl.render(scene, samples)))
    result = jl.fit(scene, view, "PointLight[left].intensity", max_steps=1)
    (pictures,) = view_pictures(result, view)
    whole = np.bincount(np.asarray(samples.pixel), minlength=64).reshape(8, 8) == count
    assert np.count_nonzero(np.asarray(result.problem.views[0].root_weight)) == np.count_nonzero(whole) > 0
    np.testing.assert_array_equal(pictures.used, whole)


def test_rims_over_a_background_are_shown_as_used() -> None:
    scene = make_scene()
    samples = jl.rasterize(scene, None, 8, 8, samples=4)
    view = jl.View(samples, np.full((8, 8, 3), 0.5), background=(0.2, 0.3, 0.4))
    (pictures,) = view_pictures(jl.fit(scene, view, "PointLight[left].intensity", max_steps=1), view)
    seen = np.bincount(np.asarray(samples.pixel), minlength=64).reshape(8, 8)
    assert np.any((seen > 0) & (seen < 4))
    np.testing.assert_array_equal(pictures.used, seen > 0)


def test_limits_of_the_sensor_that_are_kept_are_no_differences(tmp_path: Path) -> None:
    scene = make_scene()
    samples = jl.rasterize(scene, None, SIZE, SIZE)
    true = np.asarray(jl.render(scene, samples))
    full, black = np.quantile(true[true > 0], [0.5, 0.2])
    view = jl.View(samples, np.clip(true, black, full) + 0.001, saturated=full, dark=black + 0.001)
    result = jl.fit(scene, view, "PointLight[left].intensity", max_steps=1)
    (pictures,) = view_pictures(result, view)
    assert np.max(np.abs(pictures.model - pictures.target)) > 0.1
    np.testing.assert_allclose(pictures.difference[pictures.used], result.residual_image()[pictures.used], atol=1e-6)
    assert np.all(pictures.difference[~pictures.used] == 0) and np.max(np.abs(pictures.difference)) < 0.01
    jl.write_report(tmp_path / "a.html", result, view)
    assert "0 where a limit of the sensor is kept" in (tmp_path / "a.html").read_text()


def test_other_views_than_the_fits_are_refused(fitted) -> None:
    result, views, _ = fitted
    with pytest.raises(ValueError, match="views: expected the 2 that were fitted, got 1"):
        view_pictures(result, views[:1])


def test_a_target_in_sample_order_is_shown_where_it_belongs(fitted) -> None:
    result, views, _ = fitted
    rows = np.asarray(views[0].target).reshape(-1, 3)[np.asarray(views[0].samples.pixel)]
    by_rows = jl.View(views[0].samples, rows, lights=views[0].lights, name="a")
    shown = view_pictures(result, [by_rows, views[1]])[0]
    np.testing.assert_allclose(shown.target[shown.used], np.asarray(views[0].target)[shown.used], atol=1e-6)


def test_the_page_is_one_file_with_pictures_steps_and_numbers(fitted, tmp_path: Path) -> None:
    result, views, _ = fitted
    path = tmp_path / "report.html"
    jl.write_report(path, result, views, title="A & B")
    page = path.read_text()
    images = [
        np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))) for data in re.findall(r"base64,([^\"]+)", page)
    ]
    assert [image.shape for image in images] == [(SIZE, SIZE, 3)] * 6
    levels = np.rint(np.clip(np.asarray(views[0].target), 0, 1) * 255)
    np.testing.assert_array_equal(images[0], levels)
    assert "A &amp; B" in page and result.message in page
    for label in result.labels:
        assert label in page
    assert not re.search(r"(src|href)=\"(?!data:)", page)
    assert len(list(tmp_path.iterdir())) == 1


def test_pictures_and_the_chart_can_be_told_apart_without_being_seen(fitted, tmp_path: Path) -> None:
    result, views, _ = fitted
    steps = tuple(result.history[0]._replace(step=i, rms=0.1**i) for i in range(4))
    jl.write_report(tmp_path / "a.html", dataclasses.replace(result, history=steps), views)
    page = (tmp_path / "a.html").read_text()
    described = re.findall(r'<img[^>]* alt="([^"]*)"', page)
    assert len(set(described)) == len(described) == page.count("<img ") == 6
    assert described[0] == "View[a]: target" and described[5].startswith("View[b]: model - target, blue -")
    chart = re.search(r"<svg.*</svg>", page)
    assert chart is not None and ">step</text>" in chart[0] and ">residual RMS</text>" in chart[0]
    assert '<meta name="viewport" content="width=device-width">' in page


def test_a_chart_of_steps_that_change_nothing_has_a_height(fitted, tmp_path: Path) -> None:
    result, views, _ = fitted
    steps = tuple(result.history[0]._replace(step=i, rms=0.1) for i in range(2))
    jl.write_report(tmp_path / "a.html", dataclasses.replace(result, history=steps), views)
    assert "<svg" in (tmp_path / "a.html").read_text()


def test_linear_light_is_shown_as_srgb(fitted, tmp_path: Path) -> None:
    result, views, _ = fitted
    jl.write_report(tmp_path / "a.html", result, views, transfer="srgb")
    data = re.search(r"base64,([^\"]+)", (tmp_path / "a.html").read_text())
    assert data is not None
    shown = np.asarray(Image.open(io.BytesIO(base64.b64decode(data[1]))), float) / 255
    expected = np.clip(np.asarray(jl.encode(views[0].target, "srgb")), 0, 1)
    np.testing.assert_allclose(shown, expected, atol=0.5001 / 255)


def test_what_is_uncertain_and_what_was_warned_of_is_said(fitted, tmp_path: Path) -> None:
    result, views, _ = fitted
    jl.write_report(tmp_path / "a.html", result, views, warnings=["scene.x3d:3: <Script> is left out"])
    page = (tmp_path / "a.html").read_text()
    assert "<p>The pictures determine every free number.</p>" in page
    assert "<li>scene.x3d:3: &lt;Script&gt; is left out</li>" in page and "from 0" in page
    jl.write_report(tmp_path / "a.html", result, views)
    assert "<h2>Warnings" not in (tmp_path / "a.html").read_text()


def test_one_bad_pixel_does_not_hide_the_other_differences(fitted) -> None:
    target = np.full((64, 64, 3), 0.5)
    model = target + 0.01
    model[5, 7] += 5
    page = report_page(fitted[0], [ViewPictures("a", target, model, np.ones((64, 64), bool))], ["none"], title="a")
    assert "largest 5.01" in page and "red +0.01," in page
    data = re.findall(r"base64,([^\"]+)", page)[2]
    shown = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))), float)
    assert np.all(shown[..., 0] > shown[..., 2] + 100)  # red, where the model is brighter


def test_every_view_is_shown_by_its_own_transfer(fitted, tmp_path: Path) -> None:
    result, views, _ = fitted
    transfers: list[Transfer] = ["none", "srgb"]
    jl.write_report(tmp_path / "a.html", result, views, transfer=transfers)
    embedded = re.findall(r"base64,([^\"]+)", (tmp_path / "a.html").read_text())
    for transfer, view, shown in zip(transfers, view_pictures(result, views), embedded[::3], strict=True):
        levels = np.asarray(Image.open(io.BytesIO(base64.b64decode(shown))))
        np.testing.assert_array_equal(levels, quantize(jl.encode(view.target, transfer)))
    with pytest.raises(ValueError, match="transfer: expected one for each of 2 views, got 1"):
        jl.write_report(tmp_path / "b.html", result, views, transfer=["srgb"])


def test_arguments_in_another_order_are_refused(fitted, tmp_path: Path) -> None:
    result, views, _ = fitted
    with pytest.raises(ValueError, match="result: expected a Fit, got str"):
        jl.write_report(result, str(tmp_path / "report.html"), views)


def test_a_step_that_no_tolerance_measures_has_no_number(fitted) -> None:
    result, _, _ = fitted
    history = tuple(result.history[0]._replace(step_norm=norm) for norm in (np.nan, np.inf, 2.0))
    page = report_page(dataclasses.replace(result, history=history), [], [], title="a")
    rows = re.findall(r"<tr><td>\d+</td><td>(?:taken|refused)</td>.*?</tr>", page)
    assert [re.findall("<td>(.*?)</td>", row)[5] for row in rows] == ["-", "-", "2.00e+00"]


def test_names_from_files_are_escaped(tmp_path: Path) -> None:
    scene = make_scene()
    samples = jl.rasterize(scene, None, SIZE, SIZE)
    view = jl.View(samples, jl.render(scene, samples), name="<img src=x>")
    result = jl.fit(scene, view, "Material[<ball>].diffuse_color")
    jl.write_report(tmp_path / "a.html", result, view)
    page = (tmp_path / "a.html").read_text()
    assert "<img src=x>" not in page and 'alt="View[&lt;img src=x&gt;]: target"' in page and "<ball>" not in page
    assert "Material[&lt;ball&gt;].diffuse_color.r" in page


def test_samples_without_pixels_have_no_pictures_but_a_report(tmp_path: Path) -> None:
    scene = make_scene()
    samples = jl.SampleBuffer.create(position=np.eye(3), normal=np.eye(3), eye=[0, 0, 4])
    view = jl.View(samples, np.asarray(jl.shade(scene, samples))[:, :3])
    result = jl.fit(scene, view, "PointLight[left].intensity")
    assert view_pictures(result, view) == []
    jl.write_report(tmp_path / "a.html", result, view)
    assert "nothing to show" in (tmp_path / "a.html").read_text()
