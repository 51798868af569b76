"""The folder of a fit's results: whose it is, and what lies there before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fit_scenes import sphere_picture
from jaxlight import write_image
from jaxlight.cli import main
from test_cli_interrupts import SCENE

COLOR, PLACE = "Material[body].diffuse_color", "PointLight[key].location"
WORDS = ["fit", "scene.x3d", "target.png", "--output", "fitted", "--quiet", "--free", COLOR]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the words name."""
    monkeypatch.chdir(tmp_path)
    Path("scene.x3d").write_text(SCENE)
    write_image("target.png", np.clip(sphere_picture(24), 0, 1))


def contents(folder: str) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


def test_the_results_of_another_fit_are_replaced_only_if_told_to(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(WORDS) == 0
    before = contents("fitted")
    capsys.readouterr()
    assert main([*WORDS, PLACE]) == 2
    said = "jaxlight: error: fitted/checkpoint.npz: belongs to another fit, whose results would be lost; "
    assert capsys.readouterr().err == f"{said}overwrite=True (--overwrite) replaces them\n"
    assert contents("fitted") == before
    assert main([*WORDS, PLACE, "--resume"]) == 2
    assert "; overwrite=True (--overwrite) begins anew\n" in capsys.readouterr().err
    assert main([*WORDS, PLACE, "--overwrite"]) == 0
    assert main([*WORDS, PLACE]) == 0  # the same again
