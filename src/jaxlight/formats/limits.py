"""What a file may be, and how large, before it is refused: files come from strangers."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from .errors import SceneFileError

MAX_FILE_BYTES = 256 * 2**20
MAX_ELEMENTS = 1_000_000
"""XML elements in one file."""
MAX_NESTING = 400
"""XML elements inside one another, and nodes inside one another when repeated nodes (USE) are counted."""
MAX_PIXELS = 2**26
"""Pixels of one image, and of all textures of one scene together."""

CIRCLE = "is a link that leads in a circle"


def as_path(where: str, path: Any) -> Path:
    """The path that somebody gives; raises ValueError that names what else it is."""
    try:
        name = os.fspath(path)
        is_path = isinstance(name, str) and b"\0" not in os.fsencode(name)
    except (TypeError, UnicodeEncodeError):
        is_path = False
    if not is_path or name == "":
        raise ValueError(f"{where}: expected a path, got {path!r:.60}")
    return Path(name)


def resolved(path: Path) -> Path:
    """The path behind all links.

    Raises:
        ValueError: links that lead in a circle.
    """
    try:
        place = path.resolve()
        if not place.is_symlink():  # from Python 3.13 on, such a link stays as it is
            return place
    except RuntimeError:
        pass
    raise ValueError(f"{path}: {CIRCLE}")


def what_it_is(path: Path) -> str:
    """What stands where a file is expected and is none."""
    if path.is_dir():
        return "is a folder"
    if path.exists():
        return "is a pipe or a device; only files are read"
    try:
        resolved(path)
    except ValueError:
        return CIRCLE
    return "no such file"


def check_no_other(path: Path) -> None:
    """Raise ValueError if something stands at the path that is no file."""
    if path.exists() and not path.is_file():
        raise ValueError(f"{path}: {what_it_is(path)}")


def read_bounded(path: Path) -> bytes:
    """The content of a file of at most MAX_FILE_BYTES.

    Raises:
        SceneFileError: there is no such file, it cannot be read, or it is too large.
    """
    try:
        if not path.is_file():
            raise SceneFileError(path, None, what_it_is(path))
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise SceneFileError(path, None, error.strerror or str(error)) from None
    if len(data) > MAX_FILE_BYTES:
        raise SceneFileError(path, None, f"larger than {MAX_FILE_BYTES // 2**20} MiB, the most that is read")
    return data
