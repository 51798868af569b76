"""The folder of a fit's results: whose it is, and what lies there before."""

from __future__ import annotations

import errno
import fcntl
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fit_scenes import sphere_picture
from jaxlight import write_image
from jaxlight.cli import main
from jaxlight.fit.record import RunLog
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


def test_a_solver_without_checkpoints_replaces_results_only_if_told_to(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(WORDS) == 0
    before = contents("fitted")
    capsys.readouterr()
    words = [*WORDS, "--solver", "bfgs"]
    assert main(words) == 2
    said = "is there, and fits by bfgs keep no checkpoint that tells of which fit; --overwrite replaces it"
    assert capsys.readouterr().err == f"jaxlight: error: fitted/scene.x3d: {said}\n"
    assert contents("fitted") == before
    assert main([*words, "--overwrite"]) == 0
    assert "BFGS" in json.loads(Path("fitted/fit.json").read_text())["message"]
    assert not Path("fitted/checkpoint.npz").exists()
    assert main(WORDS) == 2
    said = "is there, and there is no checkpoint that tells of which fit; --overwrite replaces it"
    assert capsys.readouterr().err == f"jaxlight: error: fitted/scene.x3d: {said}\n"


def test_two_fits_at_once_do_not_share_a_folder(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write, tried, statuses = RunLog.write, [], []

    def another_meanwhile(log: RunLog, event: str, **content: Any) -> None:
        write(log, event, **content)
        if content.get("step") == 1 and not tried:
            tried.append(True)
            words = [*WORDS, PLACE]
            words[words.index("fitted")] = "fitted/../fitted"
            statuses.extend([main(words), main([*WORDS, "--resume"]), main([*WORDS, "--overwrite"])])

    monkeypatch.setattr(RunLog, "write", another_meanwhile)
    assert main(WORDS) == 0 and statuses == [2, 2, 2]
    refused = capsys.readouterr().err.splitlines()
    said = "another fit is running in this folder; wait for its end, or give another --output"
    assert refused == [f"jaxlight: error: {folder}: {said}" for folder in ("fitted/../fitted", "fitted", "fitted")]
    lines = [json.loads(line) for line in Path("fitted/log.jsonl").read_text().splitlines()]
    assert [line["event"] for line in lines if line["event"] != "step"] == ["begin", "end"]
    assert list(json.loads(Path("fitted/fit.json").read_text())["values"]) == [f"{COLOR}.{c}" for c in "rgb"]
    assert main(WORDS) == 0  # the folder is free again


KILLED = """
import os, signal, sys
from jaxlight.cli import main
from jaxlight.fit.record import RunLog

write = RunLog.write

def dying(log, event, **content):
    write(log, event, **content)
    if content.get("step") == 1:
        os.kill(os.getpid(), signal.SIGKILL)

RunLog.write = dying
main({words!r})
"""


def test_a_fit_that_is_killed_leaves_its_folder_free() -> None:
    words = [*WORDS, "--checkpoint-seconds", "0"]
    done = subprocess.run([sys.executable, "-c", KILLED.format(words=words)], capture_output=True, timeout=300)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert sorted(contents("fitted")) == ["checkpoint.npz", "log.jsonl"]
    assert main([*words, "--resume"]) == 0


def test_a_folder_that_was_made_for_nothing_goes_again(capsys: pytest.CaptureFixture[str]) -> None:
    Path("there").mkdir()
    for folder in ("there/new/one", "there"):
        words = [*WORDS, "--rtol", "nan"]
        words[words.index("fitted")] = folder
        assert main(words) == 2
        assert "--rtol" in capsys.readouterr().err and not list(Path("there").iterdir())


def test_where_folders_cannot_be_locked_fits_run_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def unable(*_: object) -> None:
        raise OSError(errno.EBADF, "as network file systems say")

    monkeypatch.setattr(fcntl, "flock", unable)
    assert main([*WORDS, "--max-steps", "1"]) == 1


@pytest.mark.parametrize("name", ["scene.x3d", "view_0.png", "report.html", "fit.json", "log.jsonl", "checkpoint.npz"])
@pytest.mark.parametrize("more", [[], ["--overwrite"]], ids=["plain", "overwrite"])
def test_a_folder_in_the_place_of_a_result_is_told_before_the_work(
    name: str, more: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("fitted", name).mkdir(parents=True)
    assert main([*WORDS, *more]) == 2
    assert capsys.readouterr().err == f"jaxlight: error: fitted/{name}: expected a file, got a folder\n"
    assert [path.name for path in Path("fitted").iterdir()] == [name] and not list(Path("fitted", name).iterdir())
