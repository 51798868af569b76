"""Files that are written whole or not at all: what they may be read by, and what is left behind."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from jaxlight.cli.files import spare
from jaxlight.formats.safe_write import written_whole


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_a_new_file_has_the_permissions_of_any_new_file(
    tmp_path: Path, mask: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mask is of the whole process: to change it, if only to read it, would reach the files of other threads."""
    before = os.umask(mask)
    try:
        with monkeypatch.context() as patch:
            patch.delattr(os, "umask")
            with written_whole(tmp_path / "a.txt") as draft:
                draft.write_text("new")
    finally:
        os.umask(before)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o666 & ~mask


def test_what_will_be_secret_is_so_from_the_beginning(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    path.chmod(0o600)
    with written_whole(path) as draft:
        assert draft.stat().st_mode & 0o777 == 0o600
        draft.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new" and path.stat().st_mode & 0o777 == 0o600


def test_a_draft_takes_no_name_that_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tokens = iter(["taken", "free"])
    monkeypatch.setattr("secrets.token_hex", lambda size: next(tokens))
    (tmp_path / ".a.taken.txt").write_text("somebody's")
    with written_whole(tmp_path / "a.txt") as draft:
        assert draft == tmp_path / ".a.free.txt"
    assert (tmp_path / ".a.taken.txt").read_text() == "somebody's"


@pytest.mark.parametrize("there", [True, False])
def test_an_error_leaves_what_there_was(tmp_path: Path, there: bool) -> None:
    path = tmp_path / "a.txt"
    if there:
        path.write_text("old")
    with pytest.raises(RuntimeError), written_whole(path) as draft:
        draft.write_text("half")
        raise RuntimeError
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == ([("a.txt", "old")] if there else [])


def test_a_full_disk_is_said_with_the_name_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with pytest.raises(OSError, match="No space left") as caught, written_whole(path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(path))
    with pytest.raises(PermissionError) as refused, written_whole(path) as draft:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(draft))
    assert refused.value.filename == str(path)
    with pytest.raises(FileNotFoundError) as other, written_whole(path):
        (tmp_path / "other.txt").read_text()
    assert str(other.value.filename) == str(tmp_path / "other.txt")
    assert os.listdir(tmp_path) == []


def test_spare_follows_links(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("")
    os.link(tmp_path / "a", tmp_path / "b")
    with pytest.raises(ValueError, match="input"):
        spare([tmp_path / "a"], [tmp_path / "b"])
    spare([tmp_path / "a"], [tmp_path / "c"])
    with pytest.raises(ValueError, match="input"):
        spare([tmp_path / "a"], [tmp_path / "not there yet" / ".." / "a"])
