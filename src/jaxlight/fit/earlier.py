"""What lies where a fit is to keep its checkpoints: nothing, a fit that is over, or work that must not be lost."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

from ..formats.limits import check_no_other
from .archive import array_in

LARGEST_HEADER = 1 << 16
"""Bytes of a checkpoint's header, at most."""
_NUMBER = 8
"""Bytes of a number, at most."""


def previous_of(checkpoint: Path) -> Path:
    """Where the checkpoint before the newest is kept."""
    return checkpoint.with_stem(f"{checkpoint.stem}.previous")


def spare_unfinished(*checkpoints: Path, fit: str | None = None) -> None:
    """Raise ValueError if the newest of these files, those that exist, is anything but the checkpoint of a fit that is
    over: that can be repeated, all else would be lost.

    Args:
        checkpoints: the newest first.
        fit: the digest of the fit that is to begin: what another one found would be lost too. None: it keeps no
            checkpoints, and is told from no other.
    """
    path = next((path for path in checkpoints if path.exists()), None)
    if path is None:
        return
    check_no_other(path)
    try:
        over, of_fit = _read(path)
    except Exception:  # archive and array readers stumble over other files in whatever way
        said = "is no checkpoint that can be read; overwrite=True (--overwrite) replaces it"
        raise ValueError(f"{path}: {said}") from None
    if not over:
        said = "resume=True (--resume) carries it on, overwrite=True (--overwrite) begins anew"
        raise ValueError(f"{path}: belongs to a fit that is not over: {said}")
    if fit not in (None, of_fit):
        said = "whose results would be lost; overwrite=True (--overwrite) replaces them"
        raise ValueError(f"{path}: belongs to another fit, {said}")


def _read(path: Path) -> tuple[bool, str]:
    """Whether the `FitState` in a checkpoint, of whatever problem, has nothing left to do; and the fit's digest."""
    with zipfile.ZipFile(path) as file:
        every, over = (array_in(file, name, _NUMBER).item() for name in (".every", ".over"))
        header = json.loads(array_in(file, "header", LARGEST_HEADER).tobytes())
    return every == 1 and bool(over), header["problem"]
