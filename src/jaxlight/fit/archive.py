"""Arrays of a checkpoint, which is an archive as `numpy.savez` writes it."""

from __future__ import annotations

import io
import zipfile

import numpy as np

_HEADING = 4096
"""Bytes before an array's numbers, at most."""


def array_in(file: zipfile.ZipFile, name: str, largest: int) -> np.ndarray:
    """A member of the archive, read whole so that its checksum is checked; never unpickled.

    Raises:
        ValueError: it has more than `largest` bytes of numbers.
        KeyError: there is none of this name.
    """
    member = file.getinfo(f"{name}.npy")
    if member.file_size > largest + _HEADING:
        raise ValueError(f"{name}: {member.file_size} bytes, more than it can hold")
    return np.load(io.BytesIO(file.read(member)), allow_pickle=False)
