"""A light that is placed several times (USE) is one node: its fields have one value, in a fit and in the file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxlight
from jaxlight import Free, Scene, View, fit
from jaxlight.cli import main
from jaxlight.fit.problem import Problem, make_problem
from jaxlight.scene import paths

SCENE = """<X3D version="3.3"><Scene>
  <NavigationInfo headlight="false"/>
  <Viewpoint position="0 0 6"/>
  <PointLight DEF="fill" intensity="0.2" location="0 4 1"/>
  <Transform translation="2 2 3"><PointLight DEF="lamp" intensity="0.7"/></Transform>
  <Transform translation="-2 1 3"><PointLight USE="lamp"/></Transform>
  <Shape><Appearance><Material DEF="body" diffuseColor="0.5 0.4 0.3"/></Appearance><Sphere/></Shape>
</Scene></X3D>
"""
INTENSITY = "PointLight[lamp].intensity"


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Scene:
    """Of a file in the working directory, beside a picture of it with lamps that are twice as strong."""
    monkeypatch.chdir(tmp_path)
    Path("bright.x3d").write_text(SCENE.replace("0.7", "1.4"))
    Path("scene.x3d").write_text(SCENE)
    jaxlight.write_image("target.png", picture(jaxlight.load("bright.x3d")))
    return jaxlight.load("scene.x3d")


def picture(scene: Scene) -> np.ndarray:
    samples = jaxlight.rasterize(scene, jaxlight.Camera.default(scene), 24, 24)
    return np.asarray(jaxlight.encode(jaxlight.render(scene, samples), "none"))


def test_its_name_means_every_place(scene: Scene) -> None:
    (selection,) = paths.select(scene, INTENSITY)
    assert selection.mask.tolist() == [False, True, True]


def test_its_number_is_one_in_a_fit(scene: Scene) -> None:
    target = jaxlight.read_image("target.png")
    samples = jaxlight.rasterize(scene, jaxlight.Camera.default(scene), 24, 24)
    for free in ([INTENSITY], ["PointLight[1].intensity", "PointLight[2].intensity"]):
        result = fit(scene, View(samples, target), free)
        np.testing.assert_allclose(result.value(INTENSITY), 1.4, rtol=1e-2)
        assert result.value(INTENSITY) == result.value("PointLight[2].intensity")
        jaxlight.save(result.scene, "fitted.x3d")
        assert Path("fitted.x3d").read_text().count('USE="lamp"') == 1


@pytest.mark.parametrize("path", ["PointLight[1].color.g", "PointLight[2].color.g"])
def test_a_path_of_one_place_frees_it_at_every_place(path: str, scene: Scene) -> None:
    (leaf,) = problem_of(scene, [path]).parameters.leaves
    np.testing.assert_array_equal(np.reshape(leaf.source, (3, 3)), [[-1, -1, -1], [-1, 0, -1], [-1, 0, -1]])


FIRST, AGAIN = "PointLight[1].intensity", "PointLight[2].intensity"
LIKELY: dict[str, Any] = {"mean": 0.5, "deviation": 0.25}


@pytest.mark.parametrize("free", [
    [FIRST, Free(AGAIN, **LIKELY)],
    [Free(AGAIN, **LIKELY), FIRST],
    [Free(FIRST, **LIKELY), AGAIN],
    [Free(FIRST, **LIKELY), Free(AGAIN, **LIKELY)],
    [Free(FIRST, deviation=np.inf), Free(AGAIN, **LIKELY)],
])  # fmt: skip
def test_its_prior_counts_whichever_place_it_is_said_of(free: list[Any], scene: Scene) -> None:
    parameters = problem_of(scene, free).parameters
    assert parameters.prior_mean.tolist() == [0.5] and parameters.prior_precision.tolist() == [16.0]


@pytest.mark.parametrize(
    ("priors", "told"),
    [
        (({"mean": 0.5}, {"mean": 0.75}), "0.5 +- 0.25 and 0.75 +- 0.25"),
        (({"mean": 0.5}, {}), "0.5 +- 0.25 and 0.7 +-"),
    ],
)
def test_two_priors_of_its_one_number_are_refused(priors: Any, told: str, scene: Scene) -> None:
    free = [Free(place, deviation=0.25, **prior) for place, prior in zip((FIRST, AGAIN), priors, strict=True)]
    said = f"free: {FIRST} and {AGAIN} are one number, with two priors: {told}"
    with pytest.raises(ValueError, match=re.escape(said)):
        problem_of(scene, free)


def problem_of(scene: Scene, free: list[Any]) -> Problem:
    samples = jaxlight.rasterize(scene, jaxlight.Camera.default(scene), 24, 24)
    return make_problem(scene, View(samples, jaxlight.read_image("target.png")), free)[0]


@pytest.mark.parametrize("path", [INTENSITY, AGAIN])
def test_a_fit_of_the_command_line_writes_it(path: str, scene: Scene) -> None:
    assert main(["fit", "scene.x3d", "target.png", "--output", "fitted", "--free", path]) == 0
    fitted = jaxlight.load("fitted/scene.x3d")
    np.testing.assert_allclose(fitted.point.intensity, [0.2, 1.4, 1.4], rtol=1e-2)


def test_a_start_of_one_place_is_refused_before_the_work(scene: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--free", "Material[body].diffuse_color", "--start", "PointLight[1].intensity=0.3"]
    assert main(["fit", "scene.x3d", "target.png", "--output", "fitted", *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"jaxlight: error: --start: save: {INTENSITY}: the node is used 2 times (USE)")
    assert error.count("\n") == 1 and not Path("fitted").exists()


def test_a_start_of_the_headlight_is_refused_before_the_work(scene: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    Path("dark.x3d").write_text('<X3D version="3.3"><Scene><Shape><Appearance><Material DEF="m"/></Appearance>'
                                "<Sphere/></Shape></Scene></X3D>")  # fmt: skip
    words = ["--free", "Material[m].diffuse_color", "--start", "DirectionalLight[headlight].intensity=0.8"]
    assert main(["fit", "dark.x3d", "target.png", "--output", "fitted", *words]) == 2
    assert "no file can hold it" in capsys.readouterr().err and not Path("fitted").exists()


def test_its_derivatives_are_checked_place_by_place(scene: Scene) -> None:
    samples = jaxlight.rasterize(scene, jaxlight.Camera.default(scene), 8, 8)
    check = jaxlight.check_gradients(scene, samples, [INTENSITY])
    assert [row.path for row in check.rows] == ["PointLight[1].intensity", "PointLight[2].intensity"] and check.passed
