"""Ctrl-C on the command line, one line, and results that are written all the same; and readers that go away."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fit_scenes import sphere_picture
from jaxlight import write_image

SCENE = """<X3D version="3.3"><Scene>
  <NavigationInfo headlight="false"/>
  <Viewpoint position="0 0 4"/>
  <PointLight DEF="key" location="1.5 2 3" intensity="0.9" color="1 0.9 0.8"/>
  <Shape><Appearance><Material DEF="body" diffuseColor="0.5 0.5 0.5" shininess="0.2"/></Appearance><Sphere/></Shape>
</Scene></X3D>
"""
WORDS = ["fit", "scene.x3d", "target.png", "--free", "Material[body].diffuse_color", "--output", "fitted"]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the words name."""
    monkeypatch.chdir(tmp_path)
    Path("scene.x3d").write_text(SCENE)
    write_image("target.png", np.clip(sphere_picture(24), 0, 1))


LATE = """
import os, signal, sys
import jaxlight
from jaxlight.cli import main

signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of a shell start with it ignored
save = jaxlight.save

def interrupted(*args):
    for _ in range(3):
        os.kill(os.getpid(), signal.SIGINT)
    return save(*args)

jaxlight.save = interrupted
sys.argv = ["jaxlight", *{words!r}]
sys.exit(main())
"""


def test_ctrl_c_while_results_are_written_waits_for_them() -> None:
    words = [*WORDS, "--max-steps", "3"]
    done = subprocess.run([sys.executable, "-c", LATE.format(words=words)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 130 and "Traceback" not in done.stderr, done.stderr
    assert {"scene.x3d", "view_0.png", "report.html", "fit.json"} <= {path.name for path in Path("fitted").iterdir()}
    assert "written: fitted/scene.x3d" in done.stdout


EARLY = """
import os, signal, sys

signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of a shell start with it ignored

class Interrupting:
    def find_spec(self, name, path, target=None):
        if name == "{module}":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupting())
sys.argv = ["jaxlight", *{words!r}]
from jaxlight.cli import main
sys.exit(main())
"""


@pytest.mark.parametrize("module", ["tyro", "jax", "equinox", "jaxlight.fit"])
def test_ctrl_c_at_start_up_is_one_line(module: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", EARLY.format(module=module, words=WORDS)], capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stderr, done.stdout) == (130, "jaxlight: interrupted\n", "")


def test_the_library_leaves_interrupts_alone() -> None:
    code = "import signal, jaxlight, jaxlight.cli; from jaxlight import fit; jaxlight.cli.main(['--version']); "
    code += "assert signal.getsignal(signal.SIGINT) is before"
    code = "import signal; before = signal.getsignal(signal.SIGINT); " + code
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_ctrl_c_ends_with_130_and_one_line() -> None:
    code = """
import os, signal, sys, time
import jaxlight
from jaxlight.cli import main

signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs of a shell start with it ignored

def long_work(*args, **options):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(10)

jaxlight.rasterize = long_work
sys.exit(main("render scene.x3d --output a.png".split()))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 130
    assert done.stderr == "jaxlight: interrupted\n"
    assert not Path("a.png").exists()


def test_a_reader_that_goes_away_is_no_traceback() -> None:
    command = f"{sys.executable} -m jaxlight info scene.x3d | true"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=60)
    assert "Traceback" not in done.stderr and "BrokenPipe" not in done.stderr
