"""What a sample buffer is made of, as people give it: rows in any order, each checked by its name."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import known_numbers
from ..formats.levels import refuse_levels
from ..scene.fields import largest_of, whole

_INDICES = 2**31
"""How many there are in an int32."""


class SampleRows(NamedTuple):
    """The arguments of `SampleBuffer.create` that are numbers of samples or of their picture."""

    position: np.ndarray
    normal: np.ndarray
    eye: np.ndarray
    surface: np.ndarray
    """[N]; as it is given also one for all."""
    color: np.ndarray | None
    texel_index: np.ndarray | None
    texel_weight: np.ndarray | None
    pixel: np.ndarray | None
    coverage: np.ndarray | None
    width: int | None
    height: int | None
    camera_to_world: np.ndarray | None
    pixel_to_world: np.ndarray | None


def checked_rows(given: SampleRows, dtype: Any) -> SampleRows:
    """The same as arrays of one number of samples, which the type can hold.

    Raises:
        ValueError: a shape, a value or an index that does not fit; says which.
    """
    position = _rows("position", given.position, (3,))
    count = len(position)
    color, texel_index, texel_weight = given.color, given.texel_index, given.texel_weight
    pixel, coverage = given.pixel, given.coverage
    if color is not None:
        refuse_levels("SampleBuffer: color", known_numbers("SampleBuffer: color", color))
        color = _rows("color", color, (3, 4), count)
    if (texel_index is None) != (texel_weight is None):
        raise ValueError("SampleBuffer: texel_index and texel_weight go together; one of them is missing")
    width, height = (
        None if size is None else whole(f"SampleBuffer: {name}", size, at_least=1)
        for name, size in (("width", given.width), ("height", given.height))
    )
    if pixel is not None:
        if width is None or height is None:
            raise ValueError("SampleBuffer: pixel needs width and height")
        if width * height >= _INDICES:
            raise ValueError(f"SampleBuffer: pixel: expected fewer than {_INDICES} pixels, got {width} x {height}")
        pixel = _indices("pixel", pixel, (count,), below=width * height)
    coverage = None if coverage is None else _vector("coverage", coverage, (count,))
    if coverage is not None and np.any((coverage < 0) | (coverage > 1 + 1e-6)):
        least, most = coverage.min(), coverage.max()
        raise ValueError(f"SampleBuffer: coverage: expected shares in [0, 1], got {least} to {most}")
    if pixel is not None:
        _check_shares(pixel, coverage)
    camera_to_world, pixel_to_world = (
        None if matrix is None else _vector(name, matrix, (3, 3))
        for name, matrix in (("camera_to_world", given.camera_to_world), ("pixel_to_world", given.pixel_to_world))
    )
    rows = SampleRows(
        position=position,
        normal=_rows("normal", given.normal, (3,), count),
        eye=_vector("eye", given.eye, (3,)),
        surface=_indices("surface", given.surface, (count,), or_one=True),
        color=color,
        texel_index=None if texel_index is None else _indices("texel_index", texel_index, (count, 4)),
        texel_weight=None if texel_weight is None else _rows("texel_weight", texel_weight, (4,), count),
        pixel=pixel,
        coverage=coverage,
        width=width,
        height=height,
        camera_to_world=camera_to_world,
        pixel_to_world=pixel_to_world,
    )
    _check_sizes(rows, dtype)
    return rows


def _check_sizes(rows: SampleRows, dtype: Any) -> None:
    largest = largest_of(dtype)
    for name in ("position", "normal", "eye", "color", "texel_weight", "camera_to_world", "pixel_to_world"):
        numbers = getattr(rows, name)
        most = 0.0 if numbers is None else float(np.abs(numbers).max(initial=0.0))
        if most > largest:
            raise ValueError(f"SampleBuffer: {name}: {most:g} is larger than its type holds, {largest:g}")


def _rows(what: str, value: Any, columns: tuple[int, ...], count: int | None = None) -> np.ndarray:
    """`value` as finite floats [N, columns]; raises ValueError that names `what`."""
    array = _array(what, value)
    if array.ndim != 2 or array.shape[1] not in columns or (count is not None and len(array) != count):
        expected = f"[{'N' if count is None else count}, {' or '.join(map(str, columns))}]"
        raise ValueError(f"SampleBuffer: {what}: expected shape {expected}, got {list(array.shape)}")
    return array


def _vector(what: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = _array(what, value)
    if array.shape != shape:
        raise ValueError(f"SampleBuffer: {what}: expected shape {list(shape)}, got {list(array.shape)}")
    return array


def _array(what: str, value: Any) -> np.ndarray:
    array = known_numbers(f"SampleBuffer: {what}", value)
    array = array if array.dtype == np.float32 else array.astype(np.float64)
    check_finite(what, array)
    return array


def check_finite(what: str, array: np.ndarray) -> None:
    """Raise ValueError for the first number of what a buffer is given that is infinite or none."""
    if not np.all(np.isfinite(array)):
        bad = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"SampleBuffer: {what}: every number must be finite; {what}{bad} is {array[tuple(bad)]}")


def _check_shares(pixel: np.ndarray, coverage: np.ndarray | None) -> None:
    """Shares that were rounded to 8 bits may add up to a little more than 1."""
    covered = np.bincount(pixel, coverage)
    most = int(np.argmax(covered)) if covered.size else 0
    if covered.size and covered[most] > 1.01:
        hint = "; without coverage each sample stands for a whole pixel" if coverage is None else ""
        raise ValueError(
            "SampleBuffer: coverage: expected shares of a pixel that add up to at most 1, "
            f"got {covered[most]:g} in pixel {most}{hint}"
        )


def _indices(
    what: str, value: Any, shape: tuple[int, ...], *, below: int | None = None, or_one: bool = False
) -> np.ndarray:
    """`value` as integers >= 0 (and < below) of the given shape, or one for all."""
    expected = f"integers of shape {list(shape)}{' or one' if or_one else ''}"
    array = known_numbers(f"SampleBuffer: {what}", value, expected)
    if or_one and array.ndim == 0:
        array = np.full(shape, array)
    if array.shape != shape or not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"SampleBuffer: {what}: expected {expected}, got {array.dtype} {list(array.shape)}")
    if array.size and (array.min() < 0 or array.max() >= (_INDICES if below is None else below)):
        allowed = f">= 0 and below {_INDICES}" if below is None else f"in [0, {below})"
        raise ValueError(f"SampleBuffer: {what}: every index must be {allowed}; got {array.min()} to {array.max()}")
    return array.astype(np.int64)
