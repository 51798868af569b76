"""Views of a problem file that cannot be fitted: each mistake is called by the key that it is about."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fit_scenes import sphere_picture
from jaxlight import write_image
from jaxlight.cli import main
from test_cli_interrupts import SCENE

SIZE = 24
PROBLEM = """scene = "scene.x3d"
free = ["Material[body].diffuse_color"]
[[views]]
picture = "target.png"
"""
CAMERA = "[views.camera]\nfx = 27\nfy = 27\ncx = 11.5\ncy = 11.5\nt = [0, 0, 4]\n"
CORNER = np.zeros((SIZE, SIZE))
CORNER[:3, :3] = 1
BELOW = "what is below 0.5 is not fitted"
MASKS = {
    "black": (0 * CORNER, f"leaves nothing to fit: its brightest number is 0, and {BELOW}"),
    "of levels 0 and 1": (CORNER / 255, f"leaves nothing to fit: its brightest number is 0.00392, and {BELOW}"),
    "the wrong way round": (CORNER, f"leaves nothing to fit: it is dark wherever something is seen, and {BELOW}"),
}
SAMPLES = "expected a whole number of samples a pixel in [1, 256], got"
VIEWS = {
    "samples": ("samples = 1000000000\n" + CAMERA, f"5: views[0].samples: {SAMPLES} 1000000000"),
    "some samples": ("samples = 300\n" + CAMERA, f"5: views[0].samples: {SAMPLES} 300"),
    "fx below 0": (
        CAMERA.replace("fx = 27", "fx = -27"),
        "6: views[0].camera.fx: expected a finite number > 0, got -27",
    ),
    "fy 0": (CAMERA.replace("fy = 27", "fy = 0"), "7: views[0].camera.fy: expected a finite number > 0, got 0"),
    "endless cx": (CAMERA.replace("cx = 11.5", "cx = inf"), "8: views[0].camera.cx: expected a finite number, got inf"),
    "a turn": (CAMERA + "R = [[1, 0, 0], [0, 1, 0], [0, 0, 2]]\n", "11: views[0].camera.R: expected a rotation matrix"),
}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the problem names."""
    monkeypatch.chdir(tmp_path)
    Path("scene.x3d").write_text(SCENE)
    write_image("target.png", np.clip(sphere_picture(SIZE), 0, 1))


def refused(view: str, capsys: pytest.CaptureFixture[str]) -> str:
    """What is said of the problem with these lines in its view."""
    Path("problem.toml").write_text(PROBLEM + view)
    assert main(["fit", "problem.toml", "--output", "fitted"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("jaxlight: error: problem.toml:") and said.count("\n") == 1
    return said.removeprefix("jaxlight: error: problem.toml:")


@pytest.mark.parametrize("case", VIEWS)
def test_a_view_that_cannot_be_seen_is_called_by_its_key(case: str, capsys: pytest.CaptureFixture[str]) -> None:
    view, said = VIEWS[case]
    assert refused(view, capsys).startswith(said)


def test_more_samples_than_a_picture_may_have_are_called_so(capsys: pytest.CaptureFixture[str]) -> None:
    write_image("target.png", np.zeros((600, 600)))
    said = "5: views[0].samples: 600 x 600 pixels with 256 samples each exceed 67108864 samples"
    assert refused("samples = 256\n", capsys).startswith(said)


@pytest.mark.parametrize("case", MASKS)
def test_a_mask_that_leaves_nothing_is_called_by_its_name(case: str, capsys: pytest.CaptureFixture[str]) -> None:
    mask, said = MASKS[case]
    write_image("mask.png", mask)
    assert refused('mask = "mask.png"\n', capsys) == f"5: views[0].mask: mask.png: {said}\n"
    words = ["--masks", "mask.png", "--free", "Material[body].diffuse_color", "--output", "fitted"]
    assert main(["fit", "scene.x3d", "target.png", *words]) == 2
    assert capsys.readouterr().err == f"jaxlight: error: mask.png: {said}\n"
