"""Words of `jaxlight fit` that are refused by the name of their option, and start values."""

from __future__ import annotations

import dataclasses
import errno
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxlight
from fit_scenes import sphere_picture
from jaxlight import LightingOptions, Scene, nodes, write_image
from jaxlight.cli import main
from jaxlight.cli.options import Reading
from jaxlight.cli.start_values import with_start_values

SCENE = """<X3D version="3.3"><Scene>
  <NavigationInfo headlight="false"/>
  <Viewpoint position="0 0 4"/>
  <PointLight DEF="key" location="1.5 2 3"/>
  <Shape><Appearance><Material DEF="body" shininess="0.2"/></Appearance><Sphere/></Shape>
</Scene></X3D>
"""
BAD: dict[str, tuple[list[str], str]] = {
    "no samples": (["--samples", "0"], "--samples: expected a whole number of samples a pixel in [1, 256], got 0"),
    "no saturation": (["--saturated", "nan"], "--saturated: expected a number, got nan"),
    "full below black": (["--saturated", "-1"], "--saturated: expected a number > 0, got -1"),
    "full at a level": (
        ["--saturated", "250"],
        "--saturated: expected a number <= 1, where the numbers of target.png end, or inf for none, got 250",
    ),
    "begin and go on": (["--resume", "--overwrite"], "--overwrite: expected --resume or --overwrite, not both"),
    "a scale of squares": (["--loss-scale", "3"], "--loss-scale: squares have none; leave it out"),
    "steps in words": (["--max-steps", "abc"], "--max-steps: expected a whole number, got 'abc'"),
    "a tolerance in words": (["--rtol", "abc"], "--rtol: expected a number, got 'abc'"),
    "a start twice": (
        ["--start", "Material[body].shininess=0.1", "Material[body].shininess=0.2"],
        "--start: Material[body].shininess is given twice",
    ),
    "a start beyond the type": (
        ["--start", "PointLight[key].location=0 -1e39 0"],
        "--start: PointLight[key].location: -1e+39 is larger than 3.4e+38, the most that the type holds",
    ),
    "a scene that is none": ([], "bad.x3d:5: "),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_called_by_its_option(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.x3d").write_text(SCENE)
    Path("bad.x3d").write_text(SCENE.replace('shininess="0.2"', 'shininess="much"'))
    write_image("target.png", np.clip(sphere_picture(24), 0, 1))
    options, said = BAD[case]
    scene = "scene.x3d" if options else "bad.x3d"
    words = [scene, "target.png", "--output", "fitted", "--free", "Material[body].diffuse_color"]
    assert main(["fit", *words, *options]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"jaxlight: error: {said}") and error.count("\n") == 1
    assert not Path("fitted").exists()


def test_other_minimisers_spare_a_fit_that_is_not_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.x3d").write_text(SCENE)
    write_image("target.png", np.clip(sphere_picture(24), 0, 1))
    words = "fit scene.x3d target.png --output fitted --free Material[body].diffuse_color PointLight[key].location"
    assert main([*words.split(), "--max-steps", "1"]) == 1
    before = {path.name: path.read_bytes() for path in Path("fitted").iterdir()}
    assert main([*words.split(), "--solver", "lbfgs"]) == 2
    assert "belongs to a fit that is not over" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in Path("fitted").iterdir()} == before


@pytest.mark.parametrize("name", ["scene.x3d", "view_0.png", "report.html", "fit.json"])
def test_files_that_no_fit_wrote_are_spared(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Names of results are names that people give to files of their own."""
    monkeypatch.chdir(tmp_path)
    Path("fitted").mkdir()
    Path("ball.x3d").write_text(SCENE)
    write_image("target.png", np.clip(sphere_picture(24), 0, 1))
    Path("fitted", name).write_text("mine")
    words = ["fit", "ball.x3d", "target.png", "--output", "fitted", "--free", "Material[body].diffuse_color"]
    assert main(words) == 2
    file = Path("fitted", name)
    said = "is there, and there is no checkpoint that tells of which fit; --overwrite replaces it"
    assert capsys.readouterr().err == f"jaxlight: error: {file}: {said}\n"
    assert [path.name for path in Path("fitted").iterdir()] == [name] and file.read_text() == "mine"
    if name == "scene.x3d":
        assert main([*words, "--overwrite"]) == 0
        assert file.read_text() != "mine"


def test_every_file_that_a_fit_wrote_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also the textures beside the scene: one that is as it was, and one that was free."""
    monkeypatch.chdir(tmp_path)
    inner = "<Shape><Appearance><ImageTexture url='inner.png'/></Appearance><Box size='0.1 0.1 0.1'/></Shape>"
    text = SCENE.replace("</Appearance>", "<ImageTexture url='skin.png'/></Appearance>")
    Path("scene.x3d").write_text(text.replace("</Scene>", f"{inner}</Scene>"))
    for name in ("skin", "inner"):
        write_image(f"{name}.png", np.full((2, 2, 3), 0.5))
    write_image("target.png", np.clip(sphere_picture(24), 0, 1))
    words = ["scene.x3d", "target.png", "--output", "fitted", "--free", "Texture[0].image", "--max-steps", "1"]
    assert main(["fit", *words]) == 1
    written = capsys.readouterr().out.partition("\nwritten: ")[2].strip().split(", ")
    there = {str(path) for path in Path("fitted").iterdir() if path.suffix not in (".jsonl", ".npz")}
    assert set(written) == there and len(written) == len(there) == 6


def test_start_values_are_counted_node_by_node() -> None:
    balls = [nodes.Appearance(material=nodes.Material()), nodes.Appearance(material=nodes.Material())]
    shapes = [nodes.Shape(appearance=one, geometry=nodes.Sphere()) for one in balls]
    scene = Scene.from_nodes([*shapes, nodes.PointLight(), nodes.Fog()])
    for path, given in (("Material[*].diffuse_color", (0.1, 0.2, 0.9)), ("Material[*].shininess", (0.3,))):
        changed = with_start_values(scene, path, given)
        name = path.partition(".")[2]
        np.testing.assert_allclose(getattr(changed.materials, name).reshape(2, -1), [given, given], rtol=1e-6)
    np.testing.assert_allclose(with_start_values(scene, "Fog.color", (0.1, 0.2, 0.3)).fog.color, (0.1, 0.2, 0.3))
    np.testing.assert_allclose(
        with_start_values(scene, "Material[1].diffuse_color.g", (0.1,)).materials.diffuse_color[:, 1], (0.8, 0.1)
    )
    for path, given in (
        ("Material[*].diffuse_color", (0.1, 0.9)),
        ("Material[*].diffuse_color", (0.1,) * 6),
        ("Material[*].shininess", (0.1, 0.9)),
    ):
        with pytest.raises(ValueError, match=f"expected 1.* number.*, got {len(given)}"):
            with_start_values(scene, path, given)


def test_readings_are_the_options_of_the_library_with_its_defaults() -> None:
    fields = {field.name: (field.type, field.default) for field in dataclasses.fields(Reading)}
    assert fields == {field.name: (field.type, field.default) for field in dataclasses.fields(LightingOptions)}
    changed = Reading(texture_mode="modulate", fog_unlit=False, specular_gate=True, support_level=1, accuracy="fast")
    for field in dataclasses.fields(Reading):
        assert getattr(changed, field.name) == getattr(changed.lighting_options(), field.name) != field.default


def test_without_a_tolerance_a_step_has_no_share_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.x3d").write_text(SCENE)
    write_image("target.png", np.clip(sphere_picture(24), 0, 1))
    words = "fit scene.x3d target.png --output fitted --free Material[body].diffuse_color --rtol 0 --atol 0"
    main([*words.split(), "--max-steps", "3"])
    heading, *steps = capsys.readouterr().err.splitlines()
    column = heading.split().index("step/tol")
    assert [line.split()[column] for line in steps] == ["-"] * len(steps) and steps


def test_numbers_are_printed_also_where_the_results_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "fitted/scene.x3d")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(jaxlight, "save", full)
    Path("scene.x3d").write_text(SCENE)
    write_image("target.png", np.clip(sphere_picture(24), 0, 1))
    words = "fit scene.x3d target.png --output fitted --quiet --free Material[body].diffuse_color"
    assert main(words.split()) == 2
    said = capsys.readouterr()
    assert said.err == "jaxlight: error: fitted/scene.x3d: No space left on device\n"
    assert said.out.startswith("Converged in ") and "Material[body].diffuse_color.r" in said.out
    assert "written:" not in said.out
