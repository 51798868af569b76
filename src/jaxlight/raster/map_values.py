"""Maps as people have them: arrays, .npy, .npz and image files -> float64 arrays with their shape checked."""

from __future__ import annotations

import os
from typing import Any, Literal

import numpy as np

from ..arrays import FILL, GIVE_MASK, known_numbers
from ..formats import read_image
from ..formats.images import is_exr, read_levels
from ..formats.levels import is_chosen, is_levels, refuse_levels
from ..formats.limits import as_path
from .array_files import Fits, read_array_file

_ARRAYS = (".npy", ".npz")


def map_values(what: str, value: Any, fits: Fits) -> tuple[np.ndarray, Literal["vector", "color"]]:
    """A map's numbers, and whether they are plain numbers or the [0, 1] of an image file.

    Args:
        what: the argument's name; also the array's in an .npz that holds several.
        value: an array, or the path of an .npy, .npz or image file.
        fits: raises ValueError for a shape that the map may not have; asked before its numbers are copied.

    Raises:
        ValueError: a shape that does not fit, not numbers, normals or colours as levels (depths may be whole
            millimetres), a file that cannot be read, an .npz without an array of that name.
    """
    where = f"samples_from_maps: {what}"
    if not is_path(value):
        return _numbers(where, what, value, fits), "vector"
    path = as_path(where, value)
    where = f"{where}: {path}"
    if path.suffix.lower() not in _ARRAYS:
        image = read_image(path)
        _check(where, image, fits)
        return image, "vector" if is_exr(path) else "color"
    return _numbers(where, what, read_array_file(where, what, path, fits), fits), "vector"


def is_path(value: Any) -> bool:
    """Whether a map is given by the path of its file."""
    return isinstance(value, (str, os.PathLike))


def surface_numbers(value: Any, fits: Fits) -> np.ndarray:
    """Rows of `Scene.surfaces` as somebody gives them: the integers of an array or of a file as they stand there.

    Args:
        value: as of `map_values`.
        fits: of an .npy or .npz, likewise.

    Raises:
        ValueError: not numbers, or a file that cannot be read or holds no whole numbers.
    """
    where = "samples_from_maps: surface"
    if is_path(value):
        path = as_path(where, value)
        is_array = path.suffix.lower() in _ARRAYS
        value = read_array_file(f"{where}: {path}", "surface", path, fits) if is_array else read_levels(path)
    return known_numbers(where, value, "integers", instead=GIVE_MASK)


def check_shape(shape: tuple[int, ...], height: int, width: int, channels: int | None) -> None:
    """Raise ValueError if a map of this shape is not one of these: `fitted` makes [height, width(, channels)] of it."""
    expected = (height, width) if channels is None else (height, width, channels)
    channels_held = (1, 2, 3, 4) if channels is None else (channels, 4)
    if shape != expected and (shape[:2] != (height, width) or len(shape) != 3 or shape[2] not in channels_held):
        raise ValueError(f"expected shape {list(expected)}, got {list(shape)}")


def fitted(what: str, array: np.ndarray, channels: int | None) -> np.ndarray:
    """`array` as [height, width, channels], or [height, width] if `channels` is None; raises ValueError for colours
    where one channel is expected."""
    if channels is None and array.ndim == 3:
        grey = np.broadcast_to(array[..., :1], (*array.shape[:2], 3))
        if array.shape[2] > 2 and not np.array_equal(array[..., :3], grey, equal_nan=True):
            raise ValueError(f"samples_from_maps: {what}: expected one channel, got a colour image")
        array = array[..., 0]
    return array if channels is None else array[..., :channels]


def _check(where: str, array: np.ndarray, fits: Fits) -> None:
    try:
        fits(array.shape)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _numbers(where: str, what: str, value: Any, fits: Fits) -> np.ndarray:
    array = known_numbers(where, value, "numbers", instead=FILL if what == "mask" else GIVE_MASK)
    _check(where, array, fits)
    if what == "color" or (what == "normal" and is_levels(array)):  # a normal of wider integers can be a vector
        said = "; with normal_encoding='color'" if what == "normal" else ""
        refuse_levels(where, array, f"{said}, or give the image file's path")
    return (is_chosen(array, where) if what == "mask" else array).astype(np.float64)
