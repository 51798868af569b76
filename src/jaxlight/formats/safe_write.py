"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import re
import secrets
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, of the same suffix, that takes its place when the block ends without an error.

    A reader sees the old file or the whole new one; also after a crash or a power cut.

    Raises:
        OSError: nothing can be written at `path`; names it, not the temporary one.
    """
    check_place(path)
    mode = path.stat().st_mode & 0o777 if path.exists() else None
    draft = _new_file_beside(path, 0o666 if mode is None else mode)
    try:
        if mode is not None:
            draft.chmod(mode)
        yield draft
        with draft.open("rb") as content:
            os.fsync(content.fileno())
        draft.replace(path)
        _flush_folder(path.parent)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(draft)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        draft.unlink(missing_ok=True)


def _new_file_beside(path: Path, mode: int) -> Path:
    """An empty file of a name that nothing had before; the system takes from the mode what the process's mask says."""
    while True:
        draft = path.parent / f".{path.stem[:40]}.{secrets.token_hex(8)}{path.suffix}"
        try:
            os.close(os.open(draft, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode))
        except FileExistsError:
            continue
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from None
        return draft


def drafts_of(path: Path) -> list[Path]:
    """What was begun for this file by a process that was killed.

    Names are cut after 40 characters: such drafts may be another file's, and are none of these.
    """
    name = re.compile(re.escape(f".{path.stem}.") + r"[0-9a-f]{16}" + re.escape(path.suffix))
    return [draft for draft in path.parent.glob(".*") if name.fullmatch(draft.name)]


def check_place(path: Path) -> None:
    """Raise OSError if `path` is a folder or lies in none."""
    if path.is_dir():
        raise IsADirectoryError(f"{path}: expected a file, got a folder")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {path.parent}")


def _flush_folder(folder: Path) -> None:
    """Make the new name of a file last: without it a power cut can bring the old file back."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
