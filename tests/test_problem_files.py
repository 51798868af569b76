"""Problem files: what they say is what is fitted, and a mistake is named by file, line and key."""

from __future__ import annotations

import dataclasses
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from jaxlight.cli import main
from jaxlight.cli.fit import Fit
from jaxlight.cli.fit_job import loss_scale_of
from jaxlight.cli.fit_views import make_views
from jaxlight.cli.problem import CameraProblem, FitProblem, FitSettings, FreeProblem, MapsProblem, ViewProblem
from jaxlight.cli.problem_file import ProblemFile
from jaxlight.cli.toml_lines import key_lines
from jaxlight.formats.errors import SceneFileError

ROOT = Path(__file__).resolve().parent.parent
DOCUMENT = (ROOT / "docs" / "problem-files.md").read_text()
SMALL, FULL = re.findall(r"^```toml\n(.*?)^```$", DOCUMENT, re.M | re.S)
SIZE = 24
SIDEWAYS = [[0, 0, -1], [0, -1, 0], [-1, 0, 0]]
"""World to camera: along -x, y up."""

SCENE = """<X3D version="3.3"><Scene>
  <NavigationInfo headlight="false"/>
  <Viewpoint DEF="front" position="0 0 4"/>
  <PointLight DEF="key" location="2 3 4"/>
  <PointLight DEF="fill" location="-3 1 4"/>
  <Shape><Appearance><Material DEF="body" diffuseColor="0.6 0.4 0.3" specularColor="0.4 0.4 0.4" shininess="0.2"/>
  </Appearance><Sphere/></Shape>
</Scene></X3D>
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The files that the long example names, its pictures as the scene looks there."""
    import jaxlight as jl

    (tmp_path / "scene.x3d").write_text(SCENE)
    (tmp_path / "key.x3d").write_text(re.sub('<PointLight DEF="fill".*?/>', "", SCENE))
    scene, by_key = (jl.load(tmp_path / name) for name in ("scene.x3d", "key.x3d"))
    x, y = np.meshgrid(np.linspace(-1, 1, SIZE), np.linspace(1, -1, SIZE))
    seen = x**2 + y**2 < 0.9
    normal = np.stack([x, y, np.sqrt(np.where(seen, 1 - x**2 - y**2, 1))], axis=-1)
    jl.write_image(tmp_path / "normal.png", normal / 2 + 0.5)
    jl.write_image(tmp_path / "mask.png", seen.astype(float))
    jl.write_image(tmp_path / "noise.png", np.full((SIZE, SIZE), 0.02))
    aside = jl.Camera.from_intrinsics(fx=40, fy=40, cx=11.5, cy=11.5, R=SIDEWAYS, t=[0, 0, 4])
    mapped = jl.samples_from_maps(tmp_path / "normal.png", aside, depth=4.0, mask=seen, normal_frame="world")
    front = jl.render(by_key, jl.rasterize(by_key, None, SIZE, SIZE, samples=4))
    jl.write_image(tmp_path / "front.png", jl.encode(front, "srgb"))
    jl.write_image(tmp_path / "side.png", 0.6 * jl.render(scene, mapped))
    return tmp_path


# --- where keys stand -------------------------------------------------------------------------------------------------

AWKWARD = '''# a [comment] = 1
title = "a # b [c] = { d }" # e
"quoted.key" = 'C:\\'
dotted . name = 1
many = [ 1, # one ]
  [ "two", """
three ]
""" ], { four = 4, five.six = [5,
 6] },
]
when = 1979-05-27 07:32:00
text = \'\'\'
[no.table]
no = 1
\'\'\'

[table."x y"]   # [other]
escape = "\\"]"
[[array]]
a = 1
[array.sub]
b = 2
[[array.deep]]
c = 3
[[array.deep]]
c = 4
[[array]]
a = 5
'''


def _keys(content: Any, key: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return [inner for name, one in items for inner in [(*key, name), *_keys(one, (*key, name))]]


@pytest.mark.parametrize("text", [AWKWARD, SMALL, FULL, ""], ids=["awkward", "small", "full", "empty"])
def test_every_key_has_its_line(text: str) -> None:
    lines = key_lines(text)
    content = tomllib.loads(text)
    assert set(lines) == set(_keys(content))
    for key, line in lines.items():
        if isinstance(key[-1], str):
            assert key[-1] in text.splitlines()[line - 1]


def test_lines_are_those_that_a_person_counts() -> None:
    lines = key_lines(AWKWARD)
    assert lines["many", 2, "five", "six", 1] == 9
    assert lines["table", "x y", "escape"] == 18
    assert lines["array", 0, "deep", 1, "c"] == 26 and lines["array", 1, "a"] == 28


# --- what is refused --------------------------------------------------------------------------------------------------

GOOD = """scene = "scene.x3d"
free = ["Material[body].shininess",
    { path = "Material[body].diffuse_color", lower = 0.1 }]
[start]
"Material[body].shininess" = 0.5
[[views]]
picture = "front.png"
[[views]]
picture = "side.png"
mask = "mask.png"
"""
MISTAKES = {
    "unknown key": ("scene =", "scenes =", "1: scenes: there is no such key here; did you mean 'scene'?"),
    "unknown in a table": ("lower", "lowest", "3: free[1].lowest: there is no such key here; did you mean 'lower'?"),
    "unknown in a view": ("mask =", "masks =", "10: views[1].masks: there is no such key here; did you mean 'mask'?"),
    "nothing like it": ("mask =", "zzz =", "10: views[1].zzz: there is no such key here; known are picture, name,"),
    "a key of another table": (
        "mask =",
        "rtol = 1\nmask =",
        "10: views[1].rtol: there is no such key here; it belongs at",
    ),
    "a key of a view": (
        "free =",
        'decode = "srgb"\nfree =',
        "2: decode: there is no such key here; it belongs in an entry",
    ),
    "a reading": (
        "free =",
        'texture_mode = "replace"\nfree =',
        "2: texture_mode: there is no such key here; it belongs in the",
    ),
    "no quotes": ('"mask.png"', "mask.png", "10: Invalid value (texts and paths stand in quotes)"),
    "a path without quotes": (
        '"Material[body].shininess" =',
        "Material[body].shininess =",
        "5: Expected '=' after a key in a key/value pair (texts",
    ),
    "no picture": ('picture = "front.png"', "", "6: views[0]: the key 'picture' is missing"),
    "no scene": ('scene = "scene.x3d"', "", "the key 'scene' is missing"),
    "a number for a path": ('"mask.png"', "3", "10: views[1].mask: expected a path, got 3"),
    "a text for a number": ("0.1 }", '"a" }', "3: free[1].lower: expected a number or a list of numbers, got 'a'"),
    "true for a number": ("0.1 }", "true }", "3: free[1].lower: expected a number or a list of numbers, got true"),
    "not a number": ("0.1 }", "nan }", "3: free[1].lower: expected a number or a list of numbers, got nan"),
    "a list for a table": ("[start]", "start = [1]\n[reading]", "4: start: expected a table, got a list"),
    "no such choice": ("free =", 'loss = "hubert"\nfree =', "2: loss: expected 'squares' or 'huber' or 'cauchy'"),
    "no such level": ("[start]", "[reading]\nsupport_level = 4\n[start]", "5: reading.support_level: expected 1 or 2"),
    "half a step": ("free =", "max_steps = 1.5\nfree =", "2: max_steps: expected a whole number, got 1.5"),
    "two numbers of three": ("mask =", "background = [0, 0]\nmask =", "10: views[1].background: expected a list of 3"),
    "a number too large": ("mask =", f"exposure = 1{'0' * 400}\nmask =", "10: views[1].exposure: expected a number"),
    "a whole number too large": ("free =", f"seed = {2**63}\nfree =", "2: seed: expected a whole number, got a"),
    "a number of endless letters": ("0.1 }", f"0x{'f' * 9000} }}", "3: free[1].lower: expected a number or a list of"),
    "no such file": ('"mask.png"', '"no.png"', "10: views[1].mask: no.png: no such file beside the problem file"),
    "above the folder": ('"mask.png"', '"../mask.png"', "10: views[1].mask: ../mask.png is outside the folder"),
    "an absolute path": ('"scene.x3d"', '"/etc/passwd"', "1: scene: /etc/passwd is outside the folder"),
    "an output outside": ("free =", 'output = ".."\nfree =', "2: output: .. is outside the folder"),
    "no TOML": ("[start]", "[start", "4: Expected ']' at the end of a table declaration"),
    "named twice": ("[start]", 'scene = "a"\n[start]', "4: Cannot overwrite a value"),
    "no end": ('"mask.png"\n', '"mask.png', "10: "),
    "no such field": ("body].diff", "bady].diff", "3: free[1]: the scene has no field 'Material[bady].diffuse_color'"),
    "a start out of range": ("0.5", "5", '5: start."Material[body].shininess": expected numbers in [0, 1], got 5'),
    "no such start": ("].shin", "].shine", "no field 'Material[body].shineiness'"),
    "a mask of another size": ('"mask.png"', '"small.png"', "10: views[1].mask: "),
    "no picture in it": ('"front.png"', '"scene.x3d"', "7: views[0].picture: "),
    "no such viewpoint": ("mask =", 'viewpoint = "top"\nmask =', "10: views[1].viewpoint: the scene has no Viewpoint"),
    "two cameras": (
        "mask =",
        'viewpoint = "front"\ncamera = { fx = 1, fy = 1, cx = 0, cy = 0 }\nmask =',
        "11: views[1].camera: expected a camera or a viewpoint, not both",
    ),
    "a seed below 0": ("[start]", "seed = -1\n[start]", "4: seed: expected a whole number >= 0, got -1"),
    "no step": ("[start]", "max_steps = 0\n[start]", "4: max_steps: expected a whole number >= 1, got 0"),
    "a scale that is none": (
        "[start]",
        'loss = "huber"\nloss_scale = -1\n[start]',
        "5: loss_scale: for the huber loss: expected a finite number > 0, got -1",
    ),
    "bounds without the start": ("lower = 0.1", "lower = 0.99", "3: free[1]: Material[body].diffuse_color.r starts at"),
    "no exposure": ("mask =", "exposure = -1\nmask =", "10: views[1].exposure: expected a finite number > 0, got -1"),
    "no noise": (
        "mask =",
        "noise = 0\nmask =",
        "10: views[1].noise: expected a standard deviation, finite and > 0, got 0",
    ),
    "no such light": ("mask =", 'lights = ["PointLight[zz]"]\nmask =', "10: views[1].lights: the scene has no 'PointL"),
    "no such view": ("free = [", 'free = ["View[zz].exposure", ', "2: free[0]: there is no field 'View[zz].exposure'"),
    "no field of a view": (
        "free = [",
        'free = ["View[side].expo", ',
        "2: free[0]: there is no field 'View[side].expo'",
    ),
    "all masked": ("mask =", 'name = "lone"\nmask =', "11: views[1].mask: "),
    "one name for two": (
        '"mask.png"',
        '"mask.png"\nname = "front"\n[[views]]\npicture = "side.png"\nname = "front"',
        "14: views[2].name: 'front' is named twice",
    ),
    "no samples": (
        "mask =",
        "samples = 0\nmask =",
        "10: views[1].samples: expected a whole number of samples a pixel in [1, 256]",
    ),
    "full at a level": (
        "mask =",
        "saturated = 250\nmask =",
        "10: views[1].saturated: expected a number <= 1, where the numbers of side.png end, or inf for none, got 250",
    ),
    "a scale of squares": ("[start]", "loss_scale = 0\n[start]", "4: loss_scale: squares have none; leave it out"),
    "no path": ('"Material[body].diffuse_color"', "[]", "3: free[1]: expected a path or several, got ()"),
    "bounds of a pattern": ('[body].diffuse_color"', '[*].diffuse_color", upper = 0.2', "3: free[1]: Material[body]"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_one_line_with_file_line_and_key(
    folder: Path, case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new, expected = MISTAKES[case]
    assert old in GOOD
    Image.new("L", (4, 4), 255).save(folder / "small.png")
    path = folder / "problem.toml"
    path.write_text(GOOD.replace(old, new, 1))
    if case == "all masked":
        Image.new("L", (SIZE, SIZE), 0).save(folder / "mask.png")
    assert main(["fit", str(path), "--output", str(folder / "fitted")]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"jaxlight: error: {path}:") and said.count("\n") == 1
    assert expected in said
    assert not (folder / "fitted").exists()


def test_bytes_that_are_no_text_and_endless_nesting_and_digits(folder: Path) -> None:
    (folder / "a.toml").write_bytes(b"scene = '\xff'")
    with pytest.raises(SceneFileError, match=r"a\.toml: expected UTF-8"):
        ProblemFile(folder / "a.toml")
    (folder / "a.toml").write_text("free = " + "[" * 5000 + "]" * 5000)
    with pytest.raises(SceneFileError, match="nested too deep"):
        ProblemFile(folder / "a.toml")
    (folder / "a.toml").write_text("seed = " + "1" * 9000)
    with pytest.raises(SceneFileError, match=r"a\.toml: a number of too many digits"):
        ProblemFile(folder / "a.toml")


def test_a_byte_order_mark_before_the_text_is_no_text(folder: Path) -> None:
    (folder / "problem.toml").write_text(GOOD, encoding="utf-8-sig")
    file = ProblemFile(folder / "problem.toml")
    assert len(file.problem.views) == 2
    assert str(file.error(("scene",), "bad")).endswith("problem.toml:1: scene: bad")


def test_links_outside_and_in_a_circle_are_refused(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    outside = tmp_path_factory.mktemp("outside") / "mask.png"
    (folder / "mask.png").rename(outside)
    (folder / "mask.png").symlink_to(outside)
    (folder / "problem.toml").write_text(GOOD)
    with pytest.raises(SceneFileError, match=r"problem\.toml:10: views\[1\]\.mask: mask\.png is outside"):
        ProblemFile(folder / "problem.toml")
    (folder / "mask.png").unlink()
    (folder / "mask.png").symlink_to("mask.png")
    with pytest.raises(SceneFileError, match=r"mask: mask\.png: is a link that leads in a circle"):
        ProblemFile(folder / "problem.toml")


WORDS = {
    "an option that belongs in the file": (["--max-steps", "3"], "--max-steps: belongs in"),
    "a reading beside the file": (["--specular-gate"], "--specular-gate: belongs in"),
    "what goes with the file": (["--overwrite", "--output", "problem.toml"], "expected a folder, got a file"),
    "a picture beside the file": (["x.png"], "PICTURE: belongs in"),
    "no output": ([], "output: expected a folder for the results"),
    "a loop of links as an output": (["--output", "results"], "checkpoint.npz: is a link that leads in a circle"),
    "the problem as an output": (["--output", "."], "is an input of this command"),
}


@pytest.mark.parametrize("case", WORDS)
def test_options_beside_a_problem_file(
    folder: Path, case: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    (folder / "problem.toml").write_text(GOOD)
    (folder / "fit.json").symlink_to("problem.toml")
    (folder / "results").mkdir()
    (folder / "results" / "checkpoint.npz").symlink_to("checkpoint.npz")
    words, expected = WORDS[case]
    assert main(["fit", "problem.toml", *words]) == 2
    assert expected in capsys.readouterr().err


# --- what is meant ----------------------------------------------------------------------------------------------------


def test_options_and_a_file_of_the_same_words_are_the_same_problem(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    options = Fit(
        scene=Path("scene.x3d"),
        targets=(Path("front.png"), Path("side.png")),
        free=("Material[body].shininess",),
        start=("Material[body].shininess=0.5", "PointLight[key].location=1 2 3"),
        viewpoints=("front", "0"),
        masks=(Path("mask.png"), Path("mask.png")),
        decode="srgb",
        saturated=0.9,
        samples=4,
        settings=FitSettings(max_steps=7, rtol=1e-3),
        output=Path("out"),
    )
    view = 'decode = "srgb"\nsaturated = 0.9\nsamples = 4\nmask = "mask.png"'
    (folder / "problem.toml").write_text(
        f"""
        scene = "scene.x3d"
        output = "out"
        free = ["Material[body].shininess"]
        max_steps = 7
        rtol = 1e-3
        start = {{ "Material[body].shininess" = [0.5], "PointLight[key].location" = [1, 2, 3] }}
        [[views]]
        picture = "front.png"
        viewpoint = "front"
        {view}
        [[views]]
        picture = "side.png"
        viewpoint = "0"
        {view}
        """
    )
    by_file, _ = Fit(scene=Path("problem.toml"))._asked()
    assert options._asked()[0] == by_file


def test_a_view_says_what_the_library_is_given(folder: Path) -> None:
    import jaxlight as jl

    path = folder / "problem.toml"
    path.write_text(FULL)
    file = ProblemFile(path)
    scene = jl.load(file.problem.scene)
    front, side = make_views(file.problem, file, scene)
    assert (front.name, side.name) == ("front", "side")
    assert front.lights == ("PointLight[key]",) and front.saturated == 0.98 and front.dark == 0.002
    picture = jl.read_image(folder / "front.png")
    np.testing.assert_allclose(front.target, jl.decode(picture, "srgb"), rtol=1e-6)
    np.testing.assert_array_equal(front.mask, jl.read_image(folder / "mask.png")[..., 0] > 0.5)
    assert front.samples.count > side.samples.count > 100
    assert front.noise == 0.01 and side.exposure == 0.5 and side.saturated == 1.0
    np.testing.assert_allclose(side.noise, np.full((SIZE, SIZE), 0.02), atol=0.5 / 255)
    np.testing.assert_allclose(side.samples.eye, [4, 0, 0], atol=1e-6)
    np.testing.assert_allclose(np.asarray(side.samples.position)[:, 0], 0, atol=1e-6)  # the plane that depth says


def test_what_a_picture_cannot_show_is_left_out(folder: Path) -> None:
    """Numbers that end at 1 may have been larger; colours of an EXR are multiplied by alpha, those of a PNG are not."""
    import jaxlight as jl

    pytest.importorskip("OpenImageIO")
    rgba = np.full((SIZE, SIZE, 4), 0.5, np.float32)
    rgba[:, : SIZE // 2, 3] = 1
    rgba[0, :, 3] = 0
    for name in ("alpha.png", "alpha.exr"):
        jl.write_image(folder / name, rgba)
    (folder / "alpha.exr").rename(folder / "named.png")  # the content says what it is
    for name, brightest in (("dim.tif", 1.0), ("bright.tif", 1.5)):
        Image.fromarray(np.full((SIZE, SIZE), brightest, np.float32)).save(folder / name)
    names = ("alpha.png", "named.png", "dim.tif", "bright.tif")
    path = folder / "problem.toml"
    path.write_text(GOOD.partition("[[views]]")[0] + "".join(f'[[views]]\npicture = "{name}"\n' for name in names))
    file = ProblemFile(path)
    png, exr, dim, bright = make_views(file.problem, file, jl.load(file.problem.scene))
    np.testing.assert_array_equal(png.mask, rgba[..., 3] > 0)
    np.testing.assert_array_equal(exr.mask, rgba[..., 3] == 1)
    assert (png.saturated, exr.saturated, dim.saturated, bright.saturated) == (1.0, None, 1.0, None)


def test_pictures_of_floats_are_full_anywhere(folder: Path) -> None:
    """Also where no number of theirs is above 1; those of whole numbers end there, or nowhere."""
    import jaxlight as jl

    pytest.importorskip("OpenImageIO")
    Image.fromarray(np.full((SIZE, SIZE), 0.5, np.float32)).save(folder / "dim.tif")
    jl.write_image(folder / "dim.exr", np.full((SIZE, SIZE, 3), 0.5))
    entries = (("dim.tif", "3"), ("dim.exr", "3"), ("front.png", "inf"), ("front.png", "1"))
    views = [f'[[views]]\npicture = "{name}"\nsaturated = {limit}\n' for name, limit in entries]
    path = folder / "problem.toml"
    path.write_text(GOOD.partition("[[views]]")[0] + "".join(views))
    file = ProblemFile(path)
    made = make_views(file.problem, file, jl.load(file.problem.scene))
    assert [view.saturated for view in made] == [3, 3, np.inf, 1]


def test_a_picture_of_a_background_is_decoded_like_the_views(folder: Path) -> None:
    """Numbers are linear light as they stand."""
    import jaxlight as jl

    backgrounds = ('"front.png"', "[0.5, 0.5, 0.5]", '"front.png"')
    views = [
        f'[[views]]\npicture = "front.png"\nname = "{row}"\nbackground = {one}\ndecode = "srgb"\n'
        for row, one in enumerate(backgrounds)
    ]
    path = folder / "problem.toml"
    path.write_text(GOOD.partition("[[views]]")[0] + "".join(views)[: -len('decode = "srgb"\n')])
    file = ProblemFile(path)
    picture, numbers, plain = make_views(file.problem, file, jl.load(file.problem.scene))
    np.testing.assert_array_equal(picture.background, picture.target)
    assert numbers.background == (0.5, 0.5, 0.5)
    np.testing.assert_allclose(plain.background, jl.read_image(folder / "front.png"), rtol=1e-6)


@pytest.mark.parametrize(
    ("loss", "noises", "scale"),
    [
        ("squares", (None, 0.1), None),
        ("huber", (None, None), 0.02),
        ("huber", (0.1, Path("noise.png")), 1.345),
        ("cauchy", (0.1, 0.1), 2.385),
    ],
)
def test_a_robust_loss_forgives_by_the_noise_where_it_is_stated(loss: Any, noises: Any, scale: float | None) -> None:
    views = tuple(ViewProblem(picture=Path("front.png"), noise=noise) for noise in noises)
    problem = FitProblem(scene=Path("scene.x3d"), views=views, free=(), loss=loss)
    assert loss_scale_of(problem) == scale
    assert loss_scale_of(dataclasses.replace(problem, loss_scale=3.0)) == 3.0


def test_a_robust_loss_of_some_noise_needs_a_scale(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = folder / "problem.toml"
    path.write_text(GOOD.replace("mask =", "noise = 0.1\nmask =").replace("[start]", 'loss = "huber"\n[start]'))
    assert main(["fit", str(path), "--output", str(folder / "out")]) == 2
    said = "4: loss: where only some views state their noise, huber needs a loss_scale"
    assert said in capsys.readouterr().err


def test_maps_without_a_camera_are_seen_along_parallel_rays(folder: Path) -> None:
    import jaxlight as jl

    path = folder / "problem.toml"
    view = '[[views]]\npicture = "side.png"\nmaps = { normal = "normal.png", depth = 0, pixel_size = 0.1 }\n'
    path.write_text(GOOD + view)
    file = ProblemFile(path)
    samples = make_views(file.problem, file, jl.load(file.problem.scene))[2].samples
    np.testing.assert_allclose(np.ptp(np.asarray(samples.position), axis=0), [2.3, 2.3, 0], atol=1e-5)


def test_a_picture_says_which_surface_each_pixel_shows(folder: Path) -> None:
    import jaxlight as jl

    Image.fromarray(np.eye(SIZE, dtype=np.uint8)).save(folder / "surface.png")
    path = folder / "problem.toml"
    view = '[[views]]\npicture = "side.png"\nmaps = { normal = "normal.png", depth = 0, surface = "surface.png" }\n'
    path.write_text(GOOD + view)
    file = ProblemFile(path)
    samples = make_views(file.problem, file, jl.load(file.problem.scene))[2].samples
    np.testing.assert_array_equal(samples.surface, np.eye(SIZE).ravel()[np.asarray(samples.pixel)])


def test_the_long_example_fits(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "problem.toml").write_text(FULL)
    status = main(["fit", str(folder / "problem.toml")])
    said = capsys.readouterr()
    assert said.err.startswith(" step ") and status == 0, said.out
    numbers = json.loads((folder / "fitted" / "fit.json").read_text())
    assert numbers["outcome"] == "converged", numbers["message"]
    values = {label: entry["fitted"] for label, entry in numbers["values"].items()}
    assert abs(values["Material[body].diffuse_color.r"] - 0.6) < 0.02
    assert abs(values["View[side].exposure"] - 0.6) < 0.02 and "PointLight[fill].intensity" not in values  # tied
    first = json.loads((folder / "fitted" / "log.jsonl").read_text().splitlines()[0])
    assert first["precision"] == "float64" and first["loss"] == "huber" and first["max_steps"] == 60
    assert {"view_0.png", "view_1.png"} <= {path.name for path in (folder / "fitted").iterdir()}


def test_the_small_example_is_the_one_beside_the_cow() -> None:
    path = ROOT / "fitting" / "data" / "spot" / "spot.toml"
    assert path.read_text() == SMALL
    assert [view.picture.name for view in ProblemFile(path).problem.views] == ["spot_256.png"]


def test_every_key_is_documented() -> None:
    for kind in (FitProblem, FreeProblem, ViewProblem, CameraProblem, MapsProblem):
        for field in dataclasses.fields(kind):
            assert f"`{field.name}`" in DOCUMENT, f"{kind.__name__}.{field.name}"
