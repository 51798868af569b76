"""README.md keeps its promises: its commands run, its Python runs, its links and names exist."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

import jaxlight

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text()


class Block(NamedTuple):
    """A fenced block; `mark` is the name in the `<!-- ci: NAME -->` line before it."""

    language: str
    code: str
    mark: str


BLOCKS = [
    Block(match["language"], match["code"], match["mark"] or "")
    for match in re.finditer(
        r"(?:<!-- ci: (?P<mark>[\w ]+) -->\n)?^```(?P<language>\w+)\n(?P<code>.*?)^```$", README, re.M | re.S
    )
]
COMMANDS = [block.code.strip() for block in BLOCKS if block.language == "bash" and not block.mark]


@pytest.fixture
def clone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which the README's relative paths work and into which its outputs go."""
    (tmp_path / "fitting").symlink_to(ROOT / "fitting")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_two_commands_are_marked_for_ci() -> None:
    assert [block.mark for block in BLOCKS if block.mark] == ["main job", "tests"]


def test_ci_finds_the_same_two_commands() -> None:
    script = (ROOT / ".ci" / "run").read_text()
    function = re.search(r"^readme_command\(\).*?^}", script, re.M | re.S)
    assert function is not None
    for block in BLOCKS:
        if block.mark:
            call = f"{function[0]}\nreadme_command {shlex.quote(block.mark)}"
            found = subprocess.run(["bash", "-c", call], cwd=ROOT, capture_output=True, text=True, check=True).stdout
            assert found == block.code


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: " ".join(command.split()[:2]))
def test_commands_run(clone: Path, command: str) -> None:
    name, *args = shlex.split(command)
    assert name == "jaxlight"
    done = subprocess.run([sys.executable, "-m", "jaxlight", *args], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    if "--output" in args:
        assert Path(args[args.index("--output") + 1]).exists()


def test_python_runs(clone: Path) -> None:
    code = "\n".join(block.code for block in BLOCKS if block.language == "python")
    assert "jl.fit(" in code
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "Converged" in done.stdout
    assert (clone / "fitted.x3d").is_file()


@pytest.mark.parametrize("page", ["data-model.md", "fitting.md"])
def test_python_of_the_documentation_runs(clone: Path, page: str) -> None:
    code = "\n".join(re.findall(r"^```python\n(.*?)^```$", (ROOT / "docs" / page).read_text(), re.M | re.S))
    assert code.count("import jaxlight as jl") == 1
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_links_lead_somewhere() -> None:
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        targets = re.findall(r"\]\(([^)#:]+)\)", page.read_text())
        assert targets or page.name != "README.md"
        for target in targets:
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_name_in_the_table_is_at_the_door() -> None:
    rows = re.findall(r"^\| (`.*?) \|", README, re.M)
    names = [name for row in rows for name in re.findall(r"`(\w+)[`(.]", row)]
    assert "shade" in names and "Camera" in names
    missing = [name for name in names if name not in jaxlight.__all__]
    assert missing == []


def test_the_readings_name_code_that_exists() -> None:
    references = re.findall(r"`([\w/]+\.py)::(\w+)`", (ROOT / "docs" / "readings.md").read_text())
    assert len(references) > 20
    for path, name in references:
        folder = ROOT if path.startswith("tests/") else ROOT / "src" / "jaxlight"
        assert re.search(rf"^(def|class) {name}\b", (folder / path).read_text(), re.M), f"{path}::{name}"


def test_the_recipes_and_notebooks_are_all_listed() -> None:
    listed = set(re.findall(r"^\| `((?:fitting|notebooks)/\w+\.py)` \|", README, re.M))
    there = [*ROOT.glob("fitting/[0-9]*.py"), *ROOT.glob("notebooks/*.py")]
    assert listed == {path.relative_to(ROOT).as_posix() for path in there}


def test_the_readings_name_cases_of_the_equation() -> None:
    from test_equation import CASES

    text = (ROOT / "docs" / "readings.md").read_text()
    names = re.findall(r"case `([^`]+)`", text)
    assert len(names) > 20
    assert [name for name in names if name not in CASES] == []
    rows = re.findall(r"^\| \d+ \|.*", text, re.M)
    assert len(rows) == 30
    for row in rows:
        assert re.search(r"`[\w/]+\.py::\w+`.*(case `|`tests/)", row), row
