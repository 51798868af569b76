"""The public door: every name it promises is there, and opening it touches nothing."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

import jaxlight


def run_python(code: str) -> str:
    """The output of `code` in a fresh interpreter."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_loads_neither_jax_nor_numpy() -> None:
    code = "import sys, jaxlight; print([m for m in ('jax', 'numpy', 'equinox', 'trimesh') if m in sys.modules])"
    assert run_python(code).strip() == "[]"


def test_help_does_not_load_jax() -> None:
    code = "import sys; from jaxlight.cli import main; main(['--help']); sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL, timeout=60).returncode == 0


def test_using_every_name_starts_no_device_and_changes_no_setting() -> None:
    code = """
import json, jax
before = dict(jax.config.values)
import jaxlight
for name in jaxlight.__all__:
    getattr(jaxlight, name)
from jax._src import xla_bridge
changed = [key for key, value in jax.config.values.items() if before.get(key, value) != value]
print(json.dumps([sorted(xla_bridge._backends), changed]))
"""
    backends, changed = json.loads(run_python(code))
    assert backends == []
    assert changed == []


@pytest.mark.parametrize("name", jaxlight.__all__)
def test_every_name_resolves(name: str) -> None:
    assert getattr(jaxlight, name) is not None
    assert name in dir(jaxlight)


def test_only_public_names_are_listed() -> None:
    assert {name for name in dir(jaxlight) if not name.startswith("__")} == set(jaxlight.__all__)
    assert {"__all__", "__doc__", "__version__"} <= set(dir(jaxlight))


def test_type_checkers_see_the_same_names() -> None:
    tree = ast.parse(Path(jaxlight.__file__).read_text())
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    imported = {
        (str(node.module), alias.name)
        for node in ast.walk(block)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    promised = {(stage, name) for stage, names in jaxlight._STAGES.items() for name in names}
    assert imported == promised


def test_a_function_named_like_a_folder_stays_the_function() -> None:
    code = "import jaxlight.fit, jaxlight; from jaxlight.fit import Fit; print(callable(jaxlight.fit), Fit.__name__)"
    assert run_python(code).strip() == "True Fit"


def test_unknown_names_are_attribute_errors() -> None:
    with pytest.raises(AttributeError, match="no attribute 'rendr'"):
        jaxlight.rendr  # noqa: B018  # the access is the test


def test_version_is_that_of_the_distribution() -> None:
    assert jaxlight.__version__.count(".") == 2
