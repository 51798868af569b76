"""Maps as people have them: arrays, .npy, .npz and image files -> float64 arrays with their shape checked."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..arrays import FILL, GIVE_MASK, known_numbers
from ..formats import read_image
from ..formats.images import is_exr, read_levels
from ..formats.levels import is_chosen, is_levels, refuse_levels

MAX_BYTES = 1 << 31
_ARRAYS = (".npy", ".npz")


def map_values(what: str, value: Any) -> tuple[np.ndarray, Literal["vector", "color"]]:
    """A map's numbers, and whether they are plain numbers or the [0, 1] of an image file.

    Args:
        what: the argument's name; also the array's in an .npz that holds several.
        value: an array, or the path of an .npy, .npz or image file.

    Raises:
        ValueError: not numbers, normals or colours as levels (depths may be whole millimetres), a file that cannot be
            read, an .npz without an array of that name.
    """
    if not isinstance(value, (str, Path)):
        return _numbers(f"samples_from_maps: {what}", what, value), "vector"
    path = Path(value)
    if path.suffix.lower() not in _ARRAYS:
        image = read_image(path)
        return image, "vector" if is_exr(path) else "color"
    return _numbers(f"samples_from_maps: {what}: {path}", what, _of_array_file(what, path)), "vector"


def surface_numbers(value: Any) -> np.ndarray:
    """Rows of `Scene.surfaces` as somebody gives them: the integers of an array or of a file as they stand there.

    Raises:
        ValueError: not numbers, or a file that cannot be read or holds no whole numbers.
    """
    if isinstance(value, (str, Path)):
        path = Path(value)
        value = _of_array_file("surface", path) if path.suffix.lower() in _ARRAYS else read_levels(path)
    return known_numbers("samples_from_maps: surface", value, "integers", instead=GIVE_MASK)


def _of_array_file(what: str, path: Path) -> np.ndarray:
    where = f"samples_from_maps: {what}: {path}"
    try:
        return _stored(what, path)
    except (OSError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        reason = getattr(error, "strerror", None) or f"not an array file: {error}"
        raise ValueError(f"{where}: {reason}") from None
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _stored(what: str, path: Path) -> np.ndarray:
    """The array of an .npy, or the one of an .npz that is named `what` or stands alone."""
    _check_size(path.stat().st_size)
    with path.open("rb") as file:
        content = _read(lambda: np.load(file, allow_pickle=False))
        if isinstance(content, np.ndarray):
            return content
        names = list(content.files)
        name = what if what in names else names[0] if len(names) == 1 else None
        if name is None:
            raise ValueError(f"holds {', '.join(names)}; none is named {what!r}")
        if content.zip is not None:
            _check_size(sum(member.file_size for member in content.zip.infolist()))
        return _read(lambda: content[name])


def _read(load: Callable[[], Any]) -> Any:
    """What NumPy loads; its own words for what it does not take advise to trust the file."""
    try:
        return load()
    except ValueError:
        raise ValueError("not a NumPy array file of numbers") from None


def _check_size(size: int) -> None:
    if size > MAX_BYTES:
        raise ValueError(f"holds {size >> 20} MiB; at most {MAX_BYTES >> 20} are read")


def fitted(what: str, array: np.ndarray, height: int, width: int, channels: int | None) -> np.ndarray:
    """`array` as [height, width, channels], or [height, width] if `channels` is None; raises ValueError otherwise."""
    expected = (height, width) if channels is None else (height, width, channels)
    if channels is None and array.ndim == 3 and array.shape[2] in (1, 2, 3, 4):
        grey = np.broadcast_to(array[..., :1], (*array.shape[:2], 3))
        if array.shape[2] > 2 and not np.array_equal(array[..., :3], grey, equal_nan=True):
            raise ValueError(f"samples_from_maps: {what}: expected one channel, got a colour image")
        array = array[..., 0]
    if channels == 3 and array.ndim == 3 and array.shape[2] == 4:
        array = array[..., :3]
    if array.shape != expected:
        raise ValueError(f"samples_from_maps: {what}: expected shape {list(expected)}, got {list(array.shape)}")
    return array


def _numbers(where: str, what: str, value: Any) -> np.ndarray:
    array = known_numbers(where, value, "numbers", instead=FILL if what == "mask" else GIVE_MASK)
    if what == "color" or (what == "normal" and is_levels(array)):  # a normal of wider integers can be a vector
        said = "; with normal_encoding='color'" if what == "normal" else ""
        refuse_levels(where, array, f"{said}, or give the image file's path")
    return (is_chosen(array, where) if what == "mask" else array).astype(np.float64)
