"""Fits that are killed: the log they leave, the checkpoint, and the resumed fit, equal to the last bit."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import optimistix as optx
import pytest

from fit_scenes import key_light, material, sphere_picture, sphere_samples, sphere_scene
from jaxlight import Fit, Scene, View, fit
from jaxlight.fit import CheckpointWarning, fitting
from jaxlight.fit.checkpoint import Checkpoint, digest
from jaxlight.fit.problem import make_problem
from jaxlight.fit.run import make_solver
from jaxlight.scene.flags import Flags
from leaves import same_leaves

SIZE = 16
FREE = ["Material[body].diffuse_color", "Material[body].shininess", "PointLight[key].location"]


def start(**changes: Any) -> Scene:
    """A start from which the fit takes six steps."""
    return sphere_scene(
        key_light(location=(0.3, 0.5, 2.5)), body=material(diffuse_color=(0.5, 0.5, 0.5), shininess=0.8, **changes)
    )


def view(**changes: Any) -> View:
    return View(sphere_samples(SIZE), sphere_picture(SIZE, noise=0.01), **changes)


def run(folder: Path, *, scene: Scene | None = None, seen: View | None = None, **options: Any) -> Fit:
    """The fit of this file, recorded in a folder, with a checkpoint after every step."""
    options = {"checkpoint": folder / "fit.npz", "checkpoint_seconds": 0, "log": folder / "log.jsonl", **options}
    return fit(scene or start(), seen or view(), options.pop("free", FREE), **options)


@pytest.fixture(scope="module")
def whole() -> Fit:
    """The fit without interruption or record."""
    result = fit(start(), view(), FREE)
    assert result.converged and len(result.history) > 5
    return result


def same(result: Fit, expected: Fit) -> bool:
    """Whether two fits agree in every bit of every number but the times."""
    assert result.message == expected.message
    steps = [[step._replace(seconds=0, seconds_left=0) for step in one.history] for one in (result, expected)]
    return result.values.tobytes() == expected.values.tobytes() and steps[0] == steps[1]


def events(folder: Path) -> list[dict[str, Any]]:
    """The log, every line of which must be whole."""
    text = (folder / "log.jsonl").read_text()
    assert text.endswith("\n")
    return [json.loads(line) for line in text.splitlines()]


# --- the log ----------------------------------------------------------------------------------------------------------


def test_the_log_says_what_the_run_is_each_step_and_how_it_ended(tmp_path: Path) -> None:
    result = run(tmp_path, checkpoint=None)
    first, *steps, last = events(tmp_path)
    assert first["event"] == "begin" and first["free"] == list(result.labels) and first["precision"] == "float32"
    assert {"jaxlight", "jax", "optimistix", "python"} <= set(first["versions"])
    assert first["scene"]["materials"] == 1 and first["residuals"] == result.description.residuals
    assert [line["event"] for line in steps] == ["step"] * len(result.history)
    for line, step in zip(steps, result.history, strict=True):
        assert line["loss"] == step.loss and line["accepted"] == step.accepted and line["step"] == step.step
        assert {"step_norm", "gradient", "damping", "seconds", "seconds_left"} <= set(line)
    assert steps[-1]["values"] == result.values.tolist() == last["values"]
    assert steps[0]["seconds_left"] is None and steps[-1]["seconds_left"] == 0 and steps[3]["seconds_left"] > 0
    assert last["event"] == "end" and last["outcome"] == "converged" and last["message"] == result.message


def test_the_log_of_a_fit_that_breaks_says_so(tmp_path: Path) -> None:
    def burst(step: Any) -> None:
        raise RuntimeError("burst")

    with pytest.raises(RuntimeError):
        run(tmp_path, progress=burst)
    assert events(tmp_path)[-1]["outcome"] == "error" and "burst" in events(tmp_path)[-1]["message"]


def test_a_fit_that_is_done_is_not_lost_with_its_last_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: Fit
) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device", "fit.npz")

    monkeypatch.setattr(Checkpoint, "save", full)
    with pytest.warns(CheckpointWarning, match="the last checkpoint could not be written: .*No space left"):
        result = run(tmp_path, checkpoint_seconds=1e9)
    assert same(result, whole)
    assert events(tmp_path)[-1]["outcome"] == "converged"


def test_another_minimiser_is_logged_but_has_no_checkpoints(tmp_path: Path) -> None:
    method = optx.LBFGS(1e-3, 1e-3)
    with pytest.raises(ValueError, match="checkpoint: only the bounded"):
        run(tmp_path, method=method)
    run(tmp_path, method=method, checkpoint=None, max_steps=2)
    assert [line["event"] for line in events(tmp_path)] == ["begin", "end"]
    assert events(tmp_path)[-1]["outcome"] == "max_steps"


def test_what_another_minimiser_cannot_do_is_refused_before_the_log_is_touched(tmp_path: Path) -> None:
    (tmp_path / "log.jsonl").write_text("an older log")
    for options, message in (
        ({"method": optx.LBFGS}, "method: expected an optimistix minimiser such as"),
        ({"method": "adam"}, "method: expected an optimistix minimiser such as"),
        ({"method": optx.LBFGS(1e-3, 1e-3), "starts": 8}, "starts: only the bounded Levenberg-Marquardt explores them"),
    ):
        with pytest.raises(ValueError, match=message):
            run(tmp_path, checkpoint=None, **options)
    assert (tmp_path / "log.jsonl").read_text() == "an older log"


@pytest.mark.parametrize(
    ("error", "outcome", "message"),
    [(RuntimeError("burst"), "error", "RuntimeError: burst"), (KeyboardInterrupt(), "interrupted", "nothing is kept")],
)
def test_the_log_of_another_minimiser_that_breaks_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, outcome: str, message: str
) -> None:
    def burst(*args: Any) -> None:
        raise error

    monkeypatch.setattr(fitting, "minimise", burst)
    with pytest.raises(type(error)):
        run(tmp_path, method=optx.LBFGS(1e-3, 1e-3), checkpoint=None)
    first, last = events(tmp_path)
    assert first["event"] == "begin" and last["outcome"] == outcome and message in last["message"]


# --- resumed ----------------------------------------------------------------------------------------------------------


class Killed(BaseException):
    """Stands for the end of the process: nothing catches it."""


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_that_dies_at_a_random_call_resumes_to_the_same_bits(
    tmp_path: Path, whole: Fit, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Every file operation of log and checkpoint is a place to die at; a dead process cleans nothing up.
    moment = random.Random(seed).randrange(3, 40)
    calls = itertools.count()

    def dying(name: str) -> Any:
        original = getattr(os, name)

        def call(*args: Any, **options: Any) -> Any:
            if next(calls) == moment:
                raise Killed
            return original(*args, **options)

        return call

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", lambda self, missing_ok=False: None)
        for name in ("fsync", "replace"):
            patch.setattr(os, name, dying(name))
        with pytest.raises(Killed):
            run(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CheckpointWarning)  # it may have died before the first checkpoint
        assert same(run(tmp_path, resume=True), whole)
    lines = events(tmp_path)
    assert lines[-1]["outcome"] == "converged"
    assert {line["step"] for line in lines if line["event"] == "step"} == {step.step for step in whole.history}
    assert sorted(os.listdir(tmp_path)) == ["fit.npz", "fit.previous.npz", "log.jsonl"]


CHILD = """
import os, signal, sys
sys.path[:0] = {paths!r}
from pathlib import Path
from test_fit_checkpoint import run

calls, original = 0, os.fsync

def fsync(handle):
    global calls
    calls += 1
    if calls == {moment}:
        os.kill(os.getpid(), signal.SIGKILL)
    original(handle)

os.fsync = fsync
run(Path({folder!r}), resume={resume})
"""


def test_a_fit_that_is_killed_twice_with_sigkill_resumes_to_the_same_bits(
    tmp_path: Path, whole: Fit, tmp_path_factory: pytest.TempPathFactory
) -> None:
    cached = {
        **os.environ,
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path_factory.mktemp("compiled")),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    for moment, resume in ((5, False), (4, True)):
        code = CHILD.format(paths=sys.path, moment=moment, folder=str(tmp_path), resume=resume)
        child = subprocess.run([sys.executable, "-c", code], env=cached, timeout=300, capture_output=True, text=True)
        assert child.returncode == -signal.SIGKILL, child.stderr
    done = events(tmp_path)
    assert [line["event"] for line in done].count("resume") == 1 and done[-1]["event"] == "step"
    with warnings.catch_warnings():
        warnings.simplefilter("error", CheckpointWarning)
        assert same(run(tmp_path, resume=True), whole)
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("stem", ["fit", "fit[1]", 48 * "a"])
def test_resuming_removes_its_own_drafts_and_no_other_file(tmp_path: Path, stem: str) -> None:
    problem, _ = make_problem(start(), view(), FREE)
    checkpoint = Checkpoint(tmp_path / f"{stem}.npz", problem, make_solver(problem))
    others = [
        f".{stem}.notes.npz",
        f".{stem}.b.0123456789abcdef.npz",
        f".{stem}.0123456789abcdef.txt",
        ".fit1.0123456789abcdef.npz",
    ]
    others += [".fit.previous.0123456789abcdef.npz", "notes.npz", f".{40 * 'a'}.0123456789abcdef.npz"]
    for name in others:
        (tmp_path / name).write_text("another's")
    (tmp_path / f".{stem}.0123456789abcdef.npz").write_text("a run was killed while it wrote")
    assert checkpoint.load() is None
    assert sorted(os.listdir(tmp_path)) == sorted(others)


def test_interrupted_and_unfinished_fits_resume_with_more_steps(tmp_path: Path, whole: Fit) -> None:
    def interrupt(step: Any) -> None:
        if step.step == 2:
            raise KeyboardInterrupt

    assert run(tmp_path, progress=interrupt).outcome == "interrupted"
    assert run(tmp_path, max_steps=4, resume=True).outcome == "max_steps"
    assert same(run(tmp_path, resume=True), whole)
    assert same(run(tmp_path, resume=True), whole)  # nothing left to do
    assert [line["outcome"] for line in events(tmp_path) if line["event"] == "end"] == [
        "interrupted",
        "max_steps",
        "converged",
        "converged",
    ]


def test_an_interrupt_that_somebody_swallows_ends_the_fit(tmp_path: Path) -> None:
    def swallow(step: Any) -> None:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background of a shell
    try:
        result = run(tmp_path, progress=swallow)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert result.outcome == "interrupted" and len(result.history) == 1


def test_an_interrupt_that_its_handler_deals_with_is_none_of_the_fit(tmp_path: Path, whole: Fit) -> None:
    """And a handler that somebody sets meanwhile stays."""
    heard: list[int] = []

    def own(number: int, frame: Any) -> None:
        heard.append(number)

    def progress(step: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        if step.step == 3:
            signal.signal(signal.SIGINT, later)

    def later(number: int, frame: Any) -> None:
        heard.append(-number)

    before = signal.signal(signal.SIGINT, own)
    try:
        result = run(tmp_path, progress=progress)
        assert signal.getsignal(signal.SIGINT) is later
    finally:
        signal.signal(signal.SIGINT, before)
    assert same(result, whole) and len(heard) == len(whole.history) and min(heard) < 0 < max(heard)


def test_an_interrupt_before_the_first_evaluation_claims_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*args: Any) -> None:
        raise KeyboardInterrupt

    for name, starts in (("explore", 2), ("advance", 1)):
        monkeypatch.setattr(fitting, name, interrupt)
        result = fit(start(), view(), FREE, starts=starts)
        assert result.outcome == "interrupted" and np.isnan(result.loss) and "unchanged" in result.message


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_a_fit_that_ends_while_it_explores_leaves_a_log_and_nothing_to_resume_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[BaseException]
) -> None:
    def burst(*args: Any) -> None:
        raise error

    monkeypatch.setattr(fitting, "explore", burst)
    with contextlib.nullcontext() if error is KeyboardInterrupt else pytest.raises(error):
        run(tmp_path, starts=2)
    first, last = events(tmp_path)
    assert first["event"] == "begin" and first["free"] and last["event"] == "end"
    assert last["outcome"] == ("interrupted" if error is KeyboardInterrupt else "error")
    assert os.listdir(tmp_path) == ["log.jsonl"]  # a checkpoint would say that the starts were explored


def test_random_starts_are_explored_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = run(tmp_path, starts=3, seed=1, checkpoint=None)
    run(tmp_path, starts=3, seed=1, max_steps=2)
    with pytest.raises(ValueError, match="another fit"):
        run(tmp_path, starts=3, seed=2, resume=True)
    monkeypatch.setattr(fitting, "explore", None)
    assert same(run(tmp_path, starts=3, seed=1, resume=True), expected)


def test_a_torn_line_of_the_log_is_cut_off(tmp_path: Path) -> None:
    run(tmp_path, max_steps=2)
    before = events(tmp_path)
    with (tmp_path / "log.jsonl").open("a") as log:
        log.write('{"event": "step", "loss": 0.')
    run(tmp_path, resume=True)
    assert events(tmp_path)[: len(before) + 1] == [*before, events(tmp_path)[len(before)]]
    assert events(tmp_path)[len(before)]["event"] == "resume"


# --- refused ----------------------------------------------------------------------------------------------------------


OTHERS = {
    "another start": {"scene": start(transparency=0.5)},
    "another picture": {"seen": View(sphere_samples(SIZE), sphere_picture(SIZE))},
    "another mask": {"seen": view(mask=np.arange(SIZE * SIZE).reshape(SIZE, SIZE) > 90)},
    "other free fields": {"free": FREE[:2]},
    "another tolerance": {"rtol": 1e-3},
    "another loss": {"loss": "huber", "loss_scale": 0.1},
}


@pytest.fixture(scope="module")
def half(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the checkpoints of a fit that was stopped in the middle."""
    folder = tmp_path_factory.mktemp("half")
    run(folder, max_steps=3)
    return folder


@pytest.mark.parametrize("case", OTHERS)
def test_the_checkpoint_of_another_fit_is_refused(half: Path, case: str) -> None:
    with pytest.raises(ValueError, match=r"fit\.npz: belongs to another fit: scene, views, free fields"):
        run(half, resume=True, log=None, **OTHERS[case])


def test_fits_under_many_lights_are_told_apart_by_which_are_on() -> None:
    assert digest(Flags(np.arange(12) == 5)) != digest(Flags(np.arange(12) == 6))


def test_resuming_needs_a_checkpoint(tmp_path: Path, whole: Fit) -> None:
    with pytest.raises(ValueError, match="resume: give `checkpoint` too"):
        run(tmp_path, checkpoint=None, resume=True)
    with pytest.raises(ValueError, match=r"ends in \.npz"):
        run(tmp_path, checkpoint=tmp_path / "a.pickle")
    with pytest.warns(CheckpointWarning, match="no checkpoint yet"):
        assert same(run(tmp_path, resume=True), whole)


def with_member(content: bytes, name: str, array: np.ndarray) -> bytes:
    """The archive with one array replaced, its checksums right."""
    import io

    with np.load(io.BytesIO(content)) as archive:
        arrays = dict(archive)
    data = io.BytesIO()
    np.savez(data, **{**arrays, name: array})
    return data.getvalue()


DAMAGES = {
    "truncated": lambda content: content[: len(content) // 2],
    "empty": lambda content: b"",
    "a flipped bit": lambda content: content[:900] + bytes([content[900] ^ 1]) + content[901:],
    "other bytes": lambda content: b"PK\x03\x04 no archive at all",
    "another shape": lambda content: with_member(content, ".values", np.zeros(99, np.float32)),
    "another type": lambda content: with_member(content, ".solver.loss", np.float64(0.0)),
    "another type of that size": lambda content: with_member(content, ".solver.loss", np.int32(0)),
    "pickled objects": lambda content: with_member(content, ".values", np.array([print], dtype=object)),
    "no header": lambda content: with_member(content, "header", np.zeros(4, np.uint8)),
    "a header that is no object": lambda content: with_member(content, "header", np.frombuffer(b"[1]", np.uint8)),
    "values that are none": lambda content: with_member(content, ".values", np.full(7, np.nan, np.float32)),
    "values without end": lambda content: with_member(content, ".values", np.full(7, np.inf, np.float32)),
    "a start beyond the bounds": lambda content: with_member(content, ".origin", np.full(7, -0.1, np.float32)),
    "a loss that is none": lambda content: with_member(content, ".solver.loss", np.float32(np.nan)),
    "a negative loss": lambda content: with_member(content, ".solver.loss", np.float32(-1)),
    "a broken history": lambda content: with_member(content, "history", np.zeros((2, 2))),
}


@pytest.mark.parametrize("case", DAMAGES)
def test_a_damaged_checkpoint_falls_back_to_the_one_before(half: Path, tmp_path: Path, whole: Fit, case: str) -> None:
    newest, before = ((half / name).read_bytes() for name in ("fit.npz", "fit.previous.npz"))
    (tmp_path / "fit.npz").write_bytes(DAMAGES[case](newest))
    with pytest.raises(ValueError, match=r"fit\.npz: not a whole checkpoint .*; remove what is damaged"):
        run(tmp_path, resume=True, log=None)
    (tmp_path / "fit.previous.npz").write_bytes(before)
    with pytest.warns(CheckpointWarning, match=r"resuming from the one before it, fit\.previous\.npz"):
        assert same(run(tmp_path, resume=True), whole)


def test_no_damage_goes_unseen(half: Path, tmp_path: Path) -> None:
    problem, description = make_problem(start(), view(), FREE)
    saved = Checkpoint(
        tmp_path / "fit.npz", problem, make_solver(problem), (1, 0, description.labels, description.view_names)
    )
    content = (half / "fit.npz").read_bytes()
    saved.path.write_bytes(content)
    whole = saved.load()
    assert whole is not None
    draw = random.Random(0)
    refused = 0
    for _ in range(200):
        place, length = draw.randrange(len(content)), draw.randrange(1, 50)
        other = draw.randbytes(length)
        end = draw.choice([place, place + length, len(content)])  # put in, overwritten, cut off
        saved.path.write_bytes(content[:place] + other + content[end:])
        try:
            read = saved.load()
        except ValueError as error:
            assert str(error).startswith(str(saved.path))
            refused += 1
        else:  # bytes that mean nothing: dates, names repeated
            assert read is not None and repr(read.history) == repr(whole.history)
            assert same_leaves(read.state, whole.state)
    assert refused > 150


def test_a_checkpoint_of_another_format_or_jax_says_so(half: Path, tmp_path: Path) -> None:
    content = (half / "fit.npz").read_bytes()
    with np.load(half / "fit.npz") as archive:
        header = json.loads(archive["header"].tobytes())
    for change, expected in (({"format": 1}, "format 1; this version reads 3"), ({"jax": "0.0.1"}, "jax 0.0.1")):
        changed = np.frombuffer(json.dumps({**header, **change}).encode(), np.uint8)
        (tmp_path / "fit.npz").write_bytes(with_member(content, "header", changed))
        with pytest.raises(ValueError) if "format" in change else pytest.warns(CheckpointWarning) as caught:
            run(tmp_path, resume=True)
        said = caught.value if isinstance(caught, pytest.ExceptionInfo) else caught[0].message
        assert expected in str(said)
