"""The command line: what it prints, what it writes, and its exit status."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from jaxlight.cli import main

SCENE = """<?xml version="1.0" encoding="UTF-8"?>
<X3D profile="Interchange" version="3.2"><Scene>
  <NavigationInfo headlight="false"/>
  <Viewpoint DEF="front" position="0 0 4"/>
  <Viewpoint DEF="side" position="4 0 0" orientation="0 1 0 1.5707963"/>
  <PointLight DEF="key" location="2 3 4" attenuation="0.5 0 0.02"/>
  <SpotLight DEF="rim" location="-3 2 -1" direction="3 -2 1" intensity="0.6" cutOffAngle="0.7" beamWidth="0.3"/>
  <Shape><Appearance><Material DEF="red" diffuseColor="0.8 0.2 0.1" specularColor="0.4 0.4 0.4" shininess="0.3"/>
  </Appearance><Sphere/></Shape>
</Scene></X3D>
"""


class Result(NamedTuple):
    status: int
    out: str
    err: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Runs `jaxlight ARGS` in an empty folder that holds scene.x3d."""
    (tmp_path / "scene.x3d").write_text(SCENE)
    monkeypatch.chdir(tmp_path)

    def call(*args: object) -> Result:
        try:
            status = main([str(arg) for arg in args])
        except SystemExit as stop:  # --help
            status = int(stop.code or 0)
        out, err = capsys.readouterr()
        return Result(status, out, err)

    return call


# --- words ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["info", "render", "fit", "gradcheck", "stress"])
def test_help_of_every_command_shows_how_to_use_it(run, command: str) -> None:
    result = run(command, "--help")
    assert result.status == 0 and result.err == ""
    assert f"$ jaxlight {command} " in result.out


def test_help_and_version(run) -> None:
    result = run("--help")
    assert result.status == 0
    for command in ("info", "render", "fit", "gradcheck", "stress"):
        assert f"\n  {command} " in result.out
    assert run("--version").out.startswith("jaxlight ")


BAD_WORDS = {
    "no command": ((), "jaxlight --help"),
    "unknown command": (
        ("rendr", "scene.x3d", "--output", "a.png"),
        "error: 'rendr' is no command; expected one of info, render, fit, gradcheck, stress (see jaxlight --help)",
    ),
    "missing scene": (("info",), "SCENE"),
    "missing option": (("render", "scene.x3d"), "--output"),
    "unknown option": (("render", "scene.x3d", "--output", "a.png", "--wdth", "3"), "Perhaps you meant: --width"),
    "not a number": (("render", "scene.x3d", "--output", "a.png", "--width", "abc"), "'abc'"),
    "not a whole number": (
        ("render", "scene.x3d", "--output", "a.png", "--height", "1.5"),
        "error: --height: expected a whole number, got '1.5'",
    ),
    "not a choice": (("render", "scene.x3d", "--output", "a.png", "--encode", "gamma"), "'srgb'"),
    "width 0": (("render", "scene.x3d", "--output", "a.png", "--width", "0"), "width"),
    "samples 0": (("render", "scene.x3d", "--output", "a.png", "--samples", "0"), "samples"),
    "huge image": (("render", "scene.x3d", "--output", "a.png", "--width", "10000000"), "width"),
    "no such file": (("info", "nope.x3d"), "nope.x3d: no such file"),
    "a folder": (("info", "."), "expected a file"),
    "a pipe": (("info", "pipe.x3d"), "pipe.x3d: is a pipe or a device; only files are read"),
    "no such viewpoint": (("render", "scene.x3d", "--output", "a.png", "--viewpoint", "back"), "front, side"),
    "a loop": (("render", "scene.x3d", "--output", "loop.png"), "loop.png: is a link that leads in a circle"),
    "a loop as a folder": (("render", "scene.x3d", "--output", "loop.png/a.png"), "a.png: is a link that leads in a"),
    "a loop as a scene": (("info", "loop.png"), "loop.png: is a link that leads in a circle"),
    "not a picture": (("render", "scene.x3d", "--output", "a.xyz"), ".png"),
    "in a file": (
        ("render", "scene.x3d", "--output", "scene.x3d/b/a.png"),
        "error: scene.x3d: expected a folder, got a",
    ),
    "broken scene": (("info", "broken.x3d"), "broken.x3d"),
    "bad value": (("info", "bad.x3d"), "bad.x3d:8: "),
    "not a scene": (("info", "notes.txt"), "notes.txt"),
}


@pytest.mark.parametrize("case", BAD_WORDS)
def test_bad_input_is_one_line_and_status_2(run, case: str) -> None:
    Path("broken.x3d").write_text(SCENE[: len(SCENE) // 2])
    Path("bad.x3d").write_text(SCENE.replace('shininess="0.3"', 'shininess="much"'))
    Path("notes.txt").write_text("dear diary")
    os.mkfifo("pipe.x3d")
    Path("loop.png").symlink_to("loop.png")
    args, part = BAD_WORDS[case]
    result = run(*args)
    assert result.status == 2
    assert result.out == ""
    assert result.err.count("\n") == 1 and result.err.startswith("jaxlight: error: ")
    assert part in result.err
    assert not Path("a.png").exists()


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_mistakes_are_one_line_in_any_terminal(encoding: str) -> None:
    args = [sys.executable, "-m", "jaxlight", "render", "a.x3d", "--output", "a.png", "--widht", "3"]
    environment = {**os.environ, "PYTHONIOENCODING": encoding, "COLUMNS": "60", "FORCE_COLOR": "1"}
    done = subprocess.run(args, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith("jaxlight: error: Unrecognized options: --widht") and done.stderr.count("\n") == 1
    assert "Perhaps you meant: --width" in done.stderr and "\x1b" not in done.stderr


# --- files ------------------------------------------------------------------------------------------------------------


def test_an_input_is_never_an_output(run) -> None:
    Path("link.png").symlink_to("scene.x3d")
    for name in ("scene.x3d", "./scene.x3d", "link.png"):
        result = run("render", "scene.x3d", "--output", name)
        assert result.status == 2 and "input" in result.err
    assert Path("scene.x3d").read_text() == SCENE


# --- info -------------------------------------------------------------------------------------------------------------


def test_info_names_what_can_be_fitted(run) -> None:
    result = run("info", "scene.x3d")
    assert result.status == 0 and result.err == ""
    assert "PointLight[key], on, 1 of 1 shapes in scope" in result.out
    assert "Viewpoint[front], position 0 0 4" in result.out
    row = next(line for line in result.out.splitlines() if "Material[red].diffuse_color" in line)
    assert row.split() == ["Material[red].diffuse_color", "0.8", "0.2", "0.1", "[0,", "1]"]


def test_info_lists_no_headlight_and_says_what_has_no_slope(run) -> None:
    Path("dark.x3d").write_text("<X3D><Scene><Shape><Sphere/></Shape></Scene></X3D>")
    result = run("info", "dark.x3d")
    assert "the headlight stands in no file and cannot be fitted" in result.out
    assert "DirectionalLight[headlight]." not in result.out
    rows = [line for line in run("info", "scene.x3d").out.splitlines() if "no slope" in line]
    assert [row.split()[0] for row in rows] == ["PointLight[key].radius", "SpotLight[rim].radius"]


def test_info_as_json(run) -> None:
    description = json.loads(run("info", "scene.x3d", "--json").out)
    assert description["nodes"]["PointLight"] == 1
    assert description["headlight"] is False
    fields = {field["path"]: field["value"] for field in description["fields"]}
    without = [field["path"] for field in description["fields"] if not field["has_slope"]]
    assert without == ["PointLight[key].radius", "SpotLight[rim].radius"]
    assert fields["SpotLight[rim].cut_off_angle"] == 0.7
    assert fields["PointLight[key].location"] == [2, 3, 4]


def test_info_counts_a_node_that_is_used_twice_once(run) -> None:
    shape = "<Transform translation='3 0 0'><Shape><Appearance USE='look'/><Sphere/></Shape></Transform>"
    text = SCENE.replace("<Appearance>", "<Appearance DEF='look'>").replace("</Scene>", f"{shape}</Scene>")
    Path("twice.x3d").write_text(text)
    result = run("info", "twice.x3d")
    assert "1 Material" in result.out and "2 Sphere" in result.out and "2 x Sphere, Material[red]" in result.out


def test_warnings_are_one_line(run) -> None:
    Path("more.x3d").write_text(SCENE.replace("</Scene>", "<Script/><WorldInfo/></Scene>"))
    result = run("info", "more.x3d")
    assert result.status == 0
    assert result.err.startswith("jaxlight: warning: more.x3d: ") and result.err.count("\n") == 1
    assert "Script" in result.err


# --- render -----------------------------------------------------------------------------------------------------------


def test_render_writes_the_picture(run) -> None:
    result = run("render", "scene.x3d", "--output", "new/a.png", "--width", 40, "--height", 30)
    assert result == (0, "", "")
    pixels = np.asarray(Image.open("new/a.png"))
    assert pixels.shape == (30, 40, 3)
    assert pixels[0, 0].tolist() == [0, 0, 0]  # the background
    red, green, blue = pixels[15, 20].tolist()
    assert red > 2 * green > 2 * blue > 0


def test_render_equals_the_library(run) -> None:
    import jaxlight as jl

    run("render", "scene.x3d", "--output", "a.png", "--width", 32, "--samples", 4, "--viewpoint", "side")
    scene = jl.load("scene.x3d")
    camera = jl.Camera.from_viewpoint(scene.document.viewpoints[1])
    picture = jl.render(scene, jl.rasterize(scene, camera, 32, 32, samples=4))
    expected = np.rint(np.clip(np.asarray(picture), 0, 1) * 255)
    np.testing.assert_allclose(np.asarray(Image.open("a.png"), float), expected, atol=1)


@pytest.mark.parametrize("viewpoint", ["1", "side"])
def test_a_viewpoint_by_name_or_number(run, viewpoint: str) -> None:
    run("render", "scene.x3d", "--output", "side.png", "--width", 16, "--height", 16, "--viewpoint", "side")
    run("render", "scene.x3d", "--output", "other.png", "--width", 16, "--height", 16, "--viewpoint", viewpoint)
    run("render", "scene.x3d", "--output", "front.png", "--width", 16, "--height", 16)
    assert Path("side.png").read_bytes() == Path("other.png").read_bytes() != Path("front.png").read_bytes()


def test_srgb_encoding_brightens_mid_tones(run) -> None:
    size = ("--width", 16, "--height", 16)
    run("render", "scene.x3d", "--output", "raw.png", *size)
    run("render", "scene.x3d", "--output", "srgb.png", *size, "--encode", "srgb")
    raw, srgb = (np.asarray(Image.open(name), float)[8, 8] / 255 for name in ("raw.png", "srgb.png"))
    np.testing.assert_allclose(srgb, 1.055 * raw ** (1 / 2.4) - 0.055, atol=0.01)


# --- fit --------------------------------------------------------------------------------------------------------------

FREE = ("--free", "Material[red].diffuse_color", "Material[red].shininess")
START = ("--start", "Material[red].diffuse_color=0.5", "Material[red].shininess=0.5")


@pytest.fixture
def target(run) -> Path:
    """A picture of the scene, to be fitted."""
    assert run("render", "scene.x3d", "--output", "target.png", "--width", 48, "--height", 48).status == 0
    return Path("target.png")


def test_fit_finds_the_material_and_writes_everything(run, target: Path) -> None:
    result = run("fit", "scene.x3d", target, "--output", "fitted", *FREE, *START)
    assert result.status == 0, result.err
    assert result.out.startswith("Converged in ")
    steps = [line for line in result.err.splitlines() if line.split()[0].isdigit()]
    heading = "step loss residual gradient step/tol damping seconds left"
    assert " ".join(result.err.splitlines()[0].split()) == heading
    residuals = [float(line.split()[2]) for line in steps]
    assert len(steps) >= 3 and residuals[-1] < 0.05 * residuals[0]

    numbers = json.loads(Path("fitted/fit.json").read_text())
    assert numbers["outcome"] == "converged"
    fitted = {label: value["fitted"] for label, value in numbers["values"].items()}
    # An 8-bit picture of 48 x 48 pixels tells colours to about 1e-3.
    assert abs(fitted["Material[red].diffuse_color.r"] - 0.8) < 2e-3
    assert abs(fitted["Material[red].shininess"] - 0.3) < 5e-3
    difference = np.asarray(Image.open("fitted/view_0.png"), float) - np.asarray(Image.open(target), float)
    assert np.abs(difference).max() <= 1

    scene = Path("fitted/scene.x3d").read_text()
    assert len([1 for new, old in zip(scene.splitlines(), SCENE.splitlines(), strict=True) if new != old]) == 1
    page = Path("fitted/report.html").read_text()
    assert page.count("data:image/png;base64,") == 3 and "Material[red].shininess" in page
    assert "The pictures determine every free number." in page and "<h2>Warnings</h2><p>None.</p>" in page
    assert "http" not in page.replace("http-equiv", "")
    kept = ["checkpoint.npz", "checkpoint.previous.npz", "log.jsonl"]
    assert sorted(os.listdir("fitted")) == sorted(["fit.json", "report.html", "scene.x3d", "view_0.png", *kept])


TWO_BALLS = """<X3D version="3.2"><Scene>
  <NavigationInfo headlight="false"/>
  <Viewpoint position="0 1.2 6" orientation="1 0 0 -0.2" fieldOfView="0.7"/>
  <PointLight DEF="key" location="2 3 4" ambientIntensity="0.4"/>
  <SpotLight DEF="rim" location="-3 3 2" direction="3 -3 -2" color="0.9 0.7 0.5" cutOffAngle="0.6" beamWidth="0.2"/>
  <Transform translation="-1.1 0 0"><Shape><Appearance>
    <Material DEF="a" diffuseColor="0.7 0.2 0.1" specularColor="0.4 0.5 0.3" shininess="0.3"/>
  </Appearance><Sphere/></Shape></Transform>
  <Transform translation="1.1 0 0.3"><Shape><Appearance>
    <Material DEF="b" diffuseColor="0.2 0.5 0.6" specularColor="0.3 0.3 0.3" shininess="0.15" ambientIntensity="0.3"/>
  </Appearance><Sphere/></Shape></Transform>
</Scene></X3D>
"""
TWENTY_TWO_NUMBERS = {
    "Material[a].diffuse_color": ("0.5", (0.7, 0.2, 0.1)),
    "Material[a].specular_color": ("0.3", (0.4, 0.5, 0.3)),
    "Material[a].shininess": ("0.2", (0.3,)),
    "Material[b].diffuse_color": ("0.5", (0.2, 0.5, 0.6)),
    "Material[b].shininess": ("0.2", (0.15,)),
    "Material[b].ambient_intensity": ("0.5", (0.3,)),
    "PointLight[key].location": ("1 4 3", (2.0, 3.0, 4.0)),
    "SpotLight[rim].location": ("-2.6 3.2 2.4", (-3.0, 3.0, 2.0)),
    "SpotLight[rim].color": ("0.7", (0.9, 0.7, 0.5)),
    "SpotLight[rim].cut_off_angle": ("0.7", (0.6,)),
}


@pytest.mark.thorough
def test_fit_of_twelve_material_and_ten_light_numbers_to_512_by_512_pixels(run) -> None:
    Path("balls.x3d").write_text(TWO_BALLS)
    assert run("render", "balls.x3d", "--output", "balls.png", "--width", 512, "--height", 512).status == 0
    start = [f"{path}={text}" for path, (text, _) in TWENTY_TWO_NUMBERS.items()]
    result = run(
        "fit", "balls.x3d", "balls.png", "--output", "fitted", "--free", *TWENTY_TWO_NUMBERS, "--start", *start
    )
    assert result.status == 0, result.out
    numbers = json.loads(Path("fitted/fit.json").read_text())
    assert numbers["cautions"] == []
    fitted = {label: value["fitted"] for label, value in numbers["values"].items()}
    truth = [number for _, values in TWENTY_TWO_NUMBERS.values() for number in values]
    assert len(fitted) == 22 and fitted["SpotLight[rim].cut_off_angle"] == pytest.approx(0.6, abs=1e-3)
    # Rounded to 8 bits, the shades of one colour in the dark halves are all off by the same share of a level.
    np.testing.assert_allclose([*fitted.values()], truth, atol=4e-3)


def test_a_fit_that_does_not_converge_says_so_with_status_1(run, target: Path) -> None:
    result = run("fit", "scene.x3d", target, "--output", "fitted", *FREE, *START, "--max-steps", 1, "--quiet")
    assert result.status == 1
    assert result.err == ""
    assert "Not converged" in result.out
    assert json.loads(Path("fitted/fit.json").read_text())["outcome"] == "max_steps"
    assert "Not converged" in Path("fitted/report.html").read_text()


def test_a_fit_that_is_not_over_is_replaced_only_if_told_to(run, target: Path) -> None:
    words = ["fit", "scene.x3d", target, "--output", "fitted", *FREE, *START, "--quiet"]
    assert run(*words, "--max-steps", 1).status == 1
    before = {path.name: path.read_bytes() for path in Path("fitted").iterdir()}
    refused = run(*words)
    assert refused.status == 2 and refused.err.startswith("jaxlight: error: fitted/checkpoint.npz: belongs to a fit")
    assert "--resume" in refused.err and "--overwrite" in refused.err and refused.err.count("\n") == 1
    assert {path.name: path.read_bytes() for path in Path("fitted").iterdir()} == before
    assert run(*words, "--overwrite").status == 0
    assert run(*words).status == 0  # over, and so repeated


def test_masked_pixels_are_not_fitted(run, target: Path) -> None:
    pixels = np.array(Image.open(target))
    pixels[:24] = 255 - pixels[:24]  # nonsense
    Image.fromarray(pixels).save("spoilt.png")
    mask = np.zeros((48, 48), np.uint8)
    mask[24:] = 255
    Image.fromarray(mask).save("mask.png")
    result = run(
        "fit", "scene.x3d", "spoilt.png", "--masks", "mask.png", "--output", "fitted", *FREE, *START, "--quiet"
    )
    assert result.status == 0
    values = json.loads(Path("fitted/fit.json").read_text())["values"]
    assert abs(values["Material[red].diffuse_color.r"]["fitted"] - 0.8) < 5e-3


BAD_FITS = {
    "no picture": ((), FREE, "at least one picture"),
    "no such field": (("target.png",), ("--free", "Material[blue].diffuse_color"), "Material[red].diffuse_color"),
    "no field": (("target.png",), (), "--free"),
    "no such picture": (("nope.png",), FREE, "nope.png: no such file"),
    "two masks": (("target.png",), (*FREE, "--masks", "target.png", "target.png"), "expected one for each of 1"),
    "bad start": (("target.png",), (*FREE, "--start", "Material[red].shininess=2"), "[0, 1]"),
    "start without value": (("target.png",), (*FREE, "--start", "Material[red].shininess"), "PATH=NUMBERS"),
    "start of three": (("target.png",), (*FREE, "--start", "Material[red].shininess=1 0 1"), "expected 1"),
    "random starts by lbfgs": (
        ("target.png",),
        (*FREE, "--solver", "lbfgs", "--starts", 8),
        "--starts: the solver lbfgs",
    ),
    "a mask of another size": (("target.png",), (*FREE, "--masks", "small.png"), "small.png: expected 48 x 48"),
    "a seed below 0": (("target.png",), (*FREE, "--seed", "-1", "--starts", "2"), "error: --seed: expected a whole"),
    "no step": (
        ("target.png",),
        (*FREE, "--max-steps", "0"),
        "error: --max-steps: expected a whole number >= 1, got 0",
    ),
    "a tolerance that is none": (("target.png",), (*FREE, "--rtol", "nan"), "error: --rtol: expected a finite number"),
}


@pytest.mark.parametrize("case", BAD_FITS)
def test_a_bad_fit_is_refused_in_one_line(run, target: Path, case: str) -> None:
    Image.new("L", (4, 4), 255).save("small.png")
    pictures, options, part = BAD_FITS[case]
    result = run("fit", "scene.x3d", *pictures, "--output", "fitted", *options)
    assert (result.status, result.out) == (2, "")
    assert result.err.count("\n") == 1 and part in result.err
    assert not Path("fitted").exists()


def test_the_headlight_is_refused_before_the_work(run, target: Path) -> None:
    Path("dark.x3d").write_text(re.sub("<(NavigationInfo|PointLight|SpotLight) .*?/>", "", SCENE))
    result = run("fit", "dark.x3d", target, "--output", "fitted", "--free", "DirectionalLight[headlight].intensity")
    assert result.status == 2 and result.err.startswith("jaxlight: error: --free: the headlight")
    assert not Path("fitted").exists()


def test_fit_never_writes_over_its_inputs(run, target: Path) -> None:
    Path("fitted").mkdir()
    target.rename("fitted/view_0.png")
    result = run("fit", "scene.x3d", "fitted/view_0.png", "--output", "fitted", *FREE)
    assert result.status == 2 and "input" in result.err
    assert run("fit", "scene.x3d", "fitted/view_0.png", "--output", "scene.x3d", *FREE).status == 2
    assert Path("scene.x3d").read_text() == SCENE


# --- gradcheck --------------------------------------------------------------------------------------------------------


def test_textures_of_the_scene_are_never_outputs(run, target: Path) -> None:
    picture = np.random.default_rng(1).integers(0, 255, (4, 4, 3), dtype=np.uint8)
    text = Path("scene.x3d").read_text()
    for name, words in (
        ("wood.png", ["render", "wood.x3d", "--output", "wood.png"]),
        ("view_0.png", ["fit", "wood.x3d", target, *FREE, *START, "--output", "."]),
    ):
        Image.fromarray(picture).save(name)
        Path("wood.x3d").write_text(text.replace("</Appearance>", f"<ImageTexture url='\"{name}\"'/></Appearance>", 1))
        result = run(*words)
        assert result.status == 2 and f"{name}: is an input of this command" in result.err
        assert np.array_equal(np.asarray(Image.open(name)), picture)


def test_an_interrupt_before_the_first_step_leaves_results_alone(run, target: Path, monkeypatch: Any) -> None:
    words = ["fit", "scene.x3d", target, *FREE, *START, "--output", "done"]
    assert run(*words).status == 0
    before = {path: path.read_bytes() for path in Path("done").iterdir() if path.name != "log.jsonl"}
    monkeypatch.setattr(sys.modules["jaxlight.fit.fitting"], "advance", Mock(side_effect=KeyboardInterrupt))
    result = run(*words)
    assert result.status == 130 and "Interrupted before the start values were evaluated" in result.err
    assert {path: path.read_bytes() for path in before} == before


def test_names_that_are_no_text_are_written_about_all_the_same(run, target: Path) -> None:
    name = os.fsdecode(b"s\xff.x3d")
    Path(name).write_bytes(Path("scene.x3d").read_bytes())
    assert run("fit", name, target, *FREE, *START, "--output", "out").status == 0
    assert Path("out/scene.x3d").exists() and "s?.x3d fitted to" in Path("out/report.html").read_text()


def test_gradcheck_prints_a_row_a_field(run) -> None:
    result = run("gradcheck", "scene.x3d", "--width", 12, "--height", 12, "--precision", "float32")
    assert result.status == 0, result.out
    for path in ("Material[red].shininess", "PointLight[key].attenuation", "SpotLight[rim].beam_width"):
        assert path in result.out


def test_gradcheck_fails_where_the_tolerance_is_not_met(run) -> None:
    options = ("--width", 12, "--height", 12, "--precision", "float32", "--fields", "Material[red].shininess")
    result = run("gradcheck", "scene.x3d", *options, "--tolerance", "1e-30")
    assert result.status == 1


def test_gradcheck_says_that_it_checked_nothing(run) -> None:
    Path("fog.x3d").write_text(SCENE.replace("</Scene>", "<Fog/></Scene>"))
    result = run("gradcheck", "fog.x3d", "--width", 12, "--height", 12, "--fields", "Fog.visibilityRange")
    assert result.status == 0
    assert "switched off" in result.out and "nothing was checked" in result.out and "within" not in result.out


# --- the process ------------------------------------------------------------------------------------------------------


def test_ctrl_c_keeps_the_best_so_far_and_resume_ends_where_the_whole_fit_does(run, target: Path) -> None:
    words = ["fit", "scene.x3d", str(target), *FREE, *START, "--output"]
    code = f"""
import os, signal, sys
from jaxlight.cli import main
from jaxlight.fit.record import RunLog

signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of a shell start with it ignored
write = RunLog.write

def interrupting(log, event, **content):
    write(log, event, **content)
    if content.get("step") == 2:
        os.kill(os.getpid(), signal.SIGINT)

RunLog.write = interrupting
sys.exit(main({[*words, "parts"]!r}))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.returncode == 130, done.stderr
    assert done.stdout.startswith("Interrupted after 2 steps (2 tried), not converged;")
    assert json.loads(Path("parts/fit.json").read_text())["outcome"] == "interrupted"
    assert "Interrupted" in Path("parts/report.html").read_text() and Path("parts/scene.x3d").exists()

    assert run(*words, "whole").status == 0
    assert run(*words, "parts", "--resume").status == 0
    whole, parts = (json.loads(Path(name, "fit.json").read_text()) for name in ("whole", "parts"))
    assert whole["values"] == parts["values"] and whole["message"] == parts["message"]
    ends = [json.loads(line) for line in Path("parts/log.jsonl").read_text().splitlines()]
    assert [line["event"] for line in ends if line["event"] != "step"] == ["begin", "end", "resume", "end"]
    result = run(*words, "parts", "--resume", "--seed", 1)
    assert result.status == 2 and "belongs to another fit" in result.err and result.err.count("\n") == 1
