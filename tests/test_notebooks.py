"""Every notebook runs from its first cell to its last as Jupyter would run it, warns of nothing and shows pictures."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient
from traitlets.config import Config

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.py"))
LONGEST_CELL = 300
"""Seconds."""


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path) -> None:
    """The kernel is spoken to through files: of ports, one that was free may be taken before the kernel opens it."""
    notebook = jupytext.read(path)
    environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}  # pictures go to Jupyter
    with tempfile.TemporaryDirectory() as folder:  # near the root: the path of a socket may have some hundred letters
        channels = {"transport": "ipc", "ip": str(Path(folder) / "channel")}
        client = NotebookClient(notebook, timeout=LONGEST_CELL, config=Config({"KernelManager": channels}))
        client.execute(cwd=str(path.parent), env=environment)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert [output.text for output in outputs if output.get("name") == "stderr"] == []
    assert any("image/png" in output.get("data", {}) for output in outputs)
