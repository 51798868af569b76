"""The command line: what it prints, what it writes, and its exit status."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image

from jaxlight.cli import main
from jaxlight.cli.files import spare

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


@pytest.mark.parametrize("command", ["info", "render", "fit", "gradcheck"])
def test_help_of_every_command_shows_how_to_use_it(run, command: str) -> None:
    result = run(command, "--help")
    assert result.status == 0 and result.err == ""
    assert f"$ jaxlight {command} " in result.out


def test_help_and_version(run) -> None:
    result = run("--help")
    assert result.status == 0
    for command in ("info", "render", "fit", "gradcheck"):
        assert f"\n  {command} " in result.out
    assert run("--version").out.startswith("jaxlight ")


def test_help_does_not_load_jax() -> None:
    code = "import sys; from jaxlight.cli import main; main(['--help']); sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL, timeout=60).returncode == 0


BAD_WORDS = {
    "no command": ((), "jaxlight --help"),
    "unknown command": (("rendr",), "rendr"),
    "missing scene": (("info",), "SCENE"),
    "missing option": (("render", "scene.x3d"), "--output"),
    "unknown option": (("render", "scene.x3d", "--output", "a.png", "--wdth", "3"), "Perhaps you meant: --width"),
    "not a number": (("render", "scene.x3d", "--output", "a.png", "--width", "abc"), "'abc'"),
    "not a choice": (("render", "scene.x3d", "--output", "a.png", "--encode", "gamma"), "'srgb'"),
    "width 0": (("render", "scene.x3d", "--output", "a.png", "--width", "0"), "width"),
    "samples 0": (("render", "scene.x3d", "--output", "a.png", "--samples", "0"), "samples"),
    "huge image": (("render", "scene.x3d", "--output", "a.png", "--width", "10000000"), "width"),
    "no such file": (("info", "nope.x3d"), "nope.x3d: no such file"),
    "a folder": (("info", "."), "expected a file"),
    "no such viewpoint": (("render", "scene.x3d", "--output", "a.png", "--viewpoint", "back"), "front, side"),
    "not a picture": (("render", "scene.x3d", "--output", "a.xyz"), ".png"),
    "broken scene": (("info", "broken.x3d"), "broken.x3d"),
    "bad value": (("info", "bad.x3d"), "bad.x3d"),
    "not a scene": (("info", "notes.txt"), "notes.txt"),
}


@pytest.mark.parametrize("case", BAD_WORDS)
def test_bad_input_is_one_line_and_status_2(run, case: str) -> None:
    Path("broken.x3d").write_text(SCENE[: len(SCENE) // 2])
    Path("bad.x3d").write_text(SCENE.replace('shininess="0.3"', 'shininess="3"'))
    Path("notes.txt").write_text("dear diary")
    args, part = BAD_WORDS[case]
    result = run(*args)
    assert result.status == 2
    assert result.out == ""
    assert result.err.count("\n") == 1 and result.err.startswith("jaxlight: error: ")
    assert part in result.err
    assert not Path("a.png").exists()


# --- files ------------------------------------------------------------------------------------------------------------


def test_an_input_is_never_an_output(run) -> None:
    Path("link.png").symlink_to("scene.x3d")
    for name in ("scene.x3d", "./scene.x3d", "link.png"):
        result = run("render", "scene.x3d", "--output", name)
        assert result.status == 2 and "input" in result.err
    assert Path("scene.x3d").read_text() == SCENE


def test_spare_follows_links(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("")
    os.link(tmp_path / "a", tmp_path / "b")
    with pytest.raises(ValueError, match="input"):
        spare([tmp_path / "a"], [tmp_path / "b"])
    spare([tmp_path / "a"], [tmp_path / "c"])
