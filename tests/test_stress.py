"""The stress command: a small run with a fixed seed holds its figures, and a broken one is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmarks.stress.draw import find
from benchmarks.stress.figures import LIMITS, Table
from benchmarks.stress.judge import Block

import answers
from jaxlight.cli import main, stress

ROOT = Path(__file__).resolve().parent.parent


def test_a_small_run_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(ROOT)
    words = "stress --cases 50 --shapes 1 --adversarial 0 --seed 1 --second 10 --precisions float64 --no-plot"
    status = main([*words.split(), "--output", str(tmp_path)])
    table = (tmp_path / "stress.md").read_text()
    assert status == 0, table
    assert "seed 1:" in capsys.readouterr().out
    assert "All figures hold." in table and "**float64, second derivatives" in table
    assert "| random: " in table


def test_a_case_is_found_by_its_label_and_explained(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    label = "adversarial:0:dead_light[0]"
    case = find(5, label, shapes=12)
    assert case.label == label and not case.lights[0].on
    assert main(["stress", "--seed", "5", "--case", label, "--precisions", "float32"]) == 0
    assert "well-conditioned True" in capsys.readouterr().out
    assert main(["stress", "--seed", "5", "--case", "random"]) == 2
    assert main(["stress", "--case", label]) == 2


@pytest.mark.parametrize(("factor", "holds"), [(1.0, True), (1 + 2.0**-15, False)])
def test_what_is_in_doubt_is_settled_by_fifty_digits(
    monkeypatch: pytest.MonkeyPatch, factor: float, holds: bool
) -> None:
    """A derivative that is wrong stays wrong, and the error of one that 80 bits do not know is its own."""
    block = Block([find(1, "random:0:3", shapes=1)], "float32")
    (exact,) = block.derivatives
    true = factor * ((exact.low + exact.high) / 2)[0].astype(np.float32)
    exact.low[...] = exact.high[...] = exact.high * 1.5
    monkeypatch.setattr(answers, "derivatives_with_rounding", lambda *_: ([true], [np.zeros_like(true)]))
    judged = block.judge_derivatives("reverse")
    assert (judged.relative[0] <= LIMITS["reverse"]) == holds


@pytest.mark.parametrize(
    "option",
    ["cases -1", "adversarial -1", "seed -1", "second -1", "shapes 0", "jobs 0", "minutes -0.5", "minutes nan"],
)
def test_numbers_that_an_option_does_not_take_are_refused(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    name, value = option.split()
    least = int(name in ("shapes", "jobs"))
    assert main(["stress", f"--{name}", value]) == 2
    assert capsys.readouterr().err == f"jaxlight: error: stress: --{name}: expected a number >= {least}, got {value}\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--precisions"], "--precisions: expected at least one of float32, float64"),
        (["--cases", "0", "--adversarial", "0"], "--cases, --adversarial: both are 0, there is nothing to judge"),
    ],
)
def test_a_run_of_nothing_is_refused(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stress", *words]) == 2
    assert capsys.readouterr().err == f"jaxlight: error: stress: {message}\n"


def test_without_a_checkout_one_sentence_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(stress, "__file__", str(tmp_path / "site/packages/jaxlight/cli/stress.py"))
    assert main(["stress"]) == 2
    assert "needs a source checkout" in capsys.readouterr().err


def test_figures_that_do_not_hold_are_told() -> None:
    found = Table("float32", "values")
    errors = np.array([1.0, 3.0, 5.0])
    found.row("spot").add(["a", "b", "c"], errors, errors, np.array([True, False, True]))
    said = "\n".join(found.violations())
    assert (
        "1 cases are not finite" in said and "5 ulp x condition, more than 4: c" in said and "33.33 % within 2" in said
    )
    assert not Table("float32", "values").violations()
