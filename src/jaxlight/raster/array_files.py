"""Arrays of numbers in .npy and .npz files, of which the header is judged before the numbers are read."""

from __future__ import annotations

import math
import tokenize
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..formats.limits import MAX_PIXELS, what_it_is

MAX_NUMBERS = 4 * MAX_PIXELS
"""In one array: those of the largest image."""
_NO_NUMBERS = "not a NumPy array file of numbers"
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
"""By the version of the format; a later one only holds what has names that are not ASCII."""
Fits = Callable[[tuple[int, ...]], None]
"""Raises ValueError for a shape that an array may not have."""


def read_array_file(where: str, what: str, path: Path, fits: Fits) -> np.ndarray:
    """The array of an .npy, or the one of an .npz that is named `what` or stands alone.

    Args:
        where: what messages begin with.
        what: the array's name in an .npz that holds several.
        path: of the file.
        fits: asked before the numbers are read.

    Raises:
        ValueError: no such file, no file, damaged, no numbers or too many of them, or a shape that does not fit.
    """
    try:
        if not path.is_file():
            raise ValueError(what_it_is(path))
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's own word on files of Python 2, which are read all the same
            return _stored(what, file, fits)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
    except Exception as error:  # NumPy and the archive's decoders stumble over damaged files in many ways
        reason = getattr(error, "strerror", None) or f"not an array file: {error or type(error).__name__}"
        raise ValueError(f"{where}: {reason}") from None


def _stored(what: str, file: IO[bytes], fits: Fits) -> np.ndarray:
    is_archive = file.read(2) == b"PK"
    file.seek(0)
    if not is_archive:
        _check_header(file, fits)
        file.seek(0)
        return _numbers_of(file)
    with zipfile.ZipFile(file) as archive:
        members = {name.removesuffix(".npy"): name for name in archive.namelist()}
        if not members:
            raise ValueError("holds no array")
        if what not in members and len(members) > 1:
            raise ValueError(f"holds {', '.join(members)}; none is named {what!r}")
        member = members.get(what) or next(iter(members.values()))
        with archive.open(member) as stream:
            _check_header(stream, fits)
        with archive.open(member) as stream:
            return _numbers_of(stream)


def _check_header(stream: IO[bytes], fits: Fits) -> None:
    """Refuse what the header announces, if it is not to be read."""
    shape, kind = _header(stream)
    if kind.kind not in "biufc" or not all(type(size) is int and size >= 0 for size in shape):
        raise ValueError(_NO_NUMBERS)
    fits(shape)
    if math.prod(shape) > MAX_NUMBERS:
        raise ValueError(f"shape {list(shape)} has {math.prod(shape)} numbers; at most {MAX_NUMBERS} are read")


def _header(stream: IO[bytes]) -> tuple[tuple[Any, ...], np.dtype[Any]]:
    """The shape and the type that an .npy states; NumPy's own words for what it does not take name no file."""
    try:
        shape, _, kind = _HEADERS[np.lib.format.read_magic(stream)](stream)
    except (ValueError, KeyError, tokenize.TokenError):
        raise ValueError(_NO_NUMBERS) from None
    return shape, kind


def _numbers_of(stream: IO[bytes]) -> np.ndarray:
    try:
        return np.lib.format.read_array(stream, allow_pickle=False)
    except ValueError:
        raise ValueError(f"{_NO_NUMBERS}: truncated?") from None
