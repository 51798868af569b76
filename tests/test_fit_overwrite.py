"""A fit begins anew only where nothing is lost: beside the checkpoints of one that is not over it must be told to."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from test_fit_checkpoint import FREE, OTHERS, run, with_member

NOT_OVER = "belongs to a fit that is not over: resume=True (--resume) carries it on, overwrite=True (--overwrite)"


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_fit_that_is_not_over_is_not_replaced(tmp_path: Path) -> None:
    run(tmp_path, max_steps=2)
    before = contents(tmp_path)
    assert sorted(before) == ["fit.npz", "fit.previous.npz", "log.jsonl"]
    with pytest.raises(ValueError, match=re.escape(f"{tmp_path / 'fit.npz'}: {NOT_OVER}")):
        run(tmp_path)
    with pytest.raises(ValueError, match="overwrite: expected resume or overwrite, not both"):
        run(tmp_path, resume=True, overwrite=True)
    assert contents(tmp_path) == before
    assert run(tmp_path, overwrite=True, max_steps=3).history[0].step == 0


def test_the_one_before_counts_where_the_newest_is_missing(tmp_path: Path) -> None:
    run(tmp_path, max_steps=2)
    os.unlink(tmp_path / "fit.npz")  # as after a kill between two renames
    with pytest.raises(ValueError, match=re.escape(f"{tmp_path / 'fit.previous.npz'}: {NOT_OVER}")):
        run(tmp_path)


def test_a_fit_that_is_over_can_be_repeated(tmp_path: Path) -> None:
    first, again = (run(tmp_path) for _ in range(2))
    assert first.converged and first.values.tobytes() == again.values.tobytes()


@pytest.mark.parametrize("name", ["fit.npz", "fit.previous.npz"])
def test_a_file_that_is_no_checkpoint_is_not_replaced(tmp_path: Path, name: str) -> None:
    np.savez(tmp_path / name, pixels=np.zeros(3))
    with pytest.raises(ValueError, match=re.escape(f"{name}: is no checkpoint that can be read; overwrite=True")):
        run(tmp_path)
    assert list(contents(tmp_path)) == [name]


@pytest.mark.filterwarnings("ignore:.*no checkpoint yet")
@pytest.mark.parametrize("resume", [False, True])
@pytest.mark.parametrize("name", ["fit.npz", "fit.previous.npz", "log.jsonl"])
def test_pipes_and_devices_are_neither_read_nor_written(tmp_path: Path, name: str, resume: bool) -> None:
    for make in (os.mkfifo, lambda path: path.symlink_to("/dev/zero")):
        make(tmp_path / name)
        with pytest.raises(ValueError, match=re.escape(f"{name}: is a pipe or a device; only files are read")):
            run(tmp_path, resume=resume)
        (tmp_path / name).unlink()


@pytest.fixture(scope="module")
def over(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the checkpoints of a fit that is over."""
    folder = tmp_path_factory.mktemp("over")
    assert run(folder).converged
    return folder


@pytest.mark.parametrize("case", OTHERS)
def test_what_another_fit_found_is_not_replaced(over: Path, case: str) -> None:
    before = contents(over)
    said = f"{over / 'fit.npz'}: belongs to another fit, whose results would be lost; overwrite=True (--overwrite)"
    with pytest.raises(ValueError, match=re.escape(said)):
        run(over, **OTHERS[case])
    assert contents(over) == before


def test_a_fit_that_is_done_with_a_part_of_the_samples_is_not_over(over: Path, tmp_path: Path) -> None:
    (tmp_path / "fit.npz").write_bytes(with_member((over / "fit.npz").read_bytes(), ".every", np.int32(4)))
    with pytest.raises(ValueError, match=re.escape(NOT_OVER)):
        run(tmp_path)


def test_what_another_fit_found_is_replaced_if_told_to(tmp_path: Path) -> None:
    run(tmp_path)
    assert run(tmp_path, free=FREE[:1], overwrite=True).converged
    assert run(tmp_path, free=FREE[:1], max_steps=200, checkpoint_seconds=1).converged  # the same fit, which is over
