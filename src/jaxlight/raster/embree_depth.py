"""What the rays through the pixels probably meet first, by embree: a head start for the exact depth buffer.

Embree works in float32 and gets some pixels wrong, so nothing here is believed: `visibility` draws each guess with its
own float64 test before all else. A guess that passes is a hit that it would have found later; one that fails is
nothing. The picture is the same with guesses, without them, and with wrong ones; only the work behind them is saved.

Only the frontmost triangles go into embree's hierarchy. Building it over all of them costs more than they save, and
even so guesses pay only where many small triangles lie over each other and leave no gap: see `_is_closed`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .depth_buffer import Boxes
    from .visibility import Prepared

_OVERDRAW = 150
"""Bounding boxes over a pixel, on average, from which guesses can pay."""
_FRONT = 48
"""Bounding boxes over a pixel that count as the front; about what NumPy draws before it can drop the rest."""
_LARGEST = 8192
"""Mean pixels of a box of the front; what is larger, NumPy drops block by block without help."""
_LAYERS = 4
"""Triangles of the front that must lie over a pixel of a block, on average, to close it."""
_CLOSED = 0.9
"""Part of the picture's blocks that must be closed: nothing can be dropped behind a gap."""
_BLOCK = 64


def likely_hits(
    prepared: Prepared, boxes: Boxes, width: int, height: int, offset: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Which box [N] the ray through pixel x [N], y [N] probably meets first; None without embreex or where it is slow.

    Args:
        prepared: the triangles, front to back.
        boxes: the pixels that each may touch, front to back; all guesses lie within.
        width, height: pixels.
        offset: where in its pixel a ray goes through.
    """
    area = boxes.area
    if area.sum() < _OVERDRAW * width * height:
        return None
    count = int(np.searchsorted(np.cumsum(area), _FRONT * width * height)) + 1
    if area[:count].mean() > _LARGEST:
        return None
    front = boxes.select(slice(count))
    corners = _corners(prepared, front.row, width, height)
    if not _is_closed(corners, front, width, height):
        return None
    embree = _embree()
    if embree is None:
        return None
    guess = _cast(*embree, corners, width, height, offset)
    pixel = np.flatnonzero((guess >= 0) & (guess < count))
    guess = guess[pixel]
    y, x = np.divmod(pixel, width)
    within = (front.low_x[guess] <= x) & (x <= front.high_x[guess])
    within &= (front.low_y[guess] <= y) & (y <= front.high_y[guess])
    return guess[within], x[within], y[within]


def _embree() -> tuple[Any, Any] | None:
    """Embree's scene and mesh classes; None where embreex is not installed."""
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError:
        return None
    return EmbreeScene, TriangleMesh


def _corners(prepared: Prepared, row: np.ndarray, width: int, height: int) -> np.ndarray:
    """[V, 3 corners, 3], depth times (x, y, 1), up to one factor; x and y run over [-1, 1] along the longer side.

    With the rows of `edge` the normals of the planes through the eye, a corner is where the other two planes meet.
    """
    half = max(width, height) / 2
    across, down, constant = (prepared.edge[:, axis][:, row] for axis in range(3))
    planes = np.stack([across * half, down * half, constant + across * (width / 2) + down * (height / 2)], axis=-1)
    det = np.where(prepared.is_back[row], prepared.volume[row], -prepared.volume[row])
    corners = np.empty((len(row), 3, 3))
    with np.errstate(all="ignore"):
        for corner in range(3):
            corners[:, corner] = np.cross(planes[(corner + 1) % 3], planes[(corner + 2) % 3]) / det[:, None]
        corners /= np.median(np.abs(corners[:, :, 2]))
    return corners


def _is_closed(corners: np.ndarray, front: Boxes, width: int, height: int) -> bool:
    """Whether the triangles lie over most blocks of the picture several times; those that reach behind the eye do not
    count."""
    half = max(width, height) / 2
    with np.errstate(all="ignore"):
        x, y = np.moveaxis(corners[:, :, :2] / corners[:, :, 2:] * half, 2, 0)
        area = np.abs((x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])) / 2
    area = np.where(np.all(corners[:, :, 2] > 0, axis=1), np.fmin(area, front.area), 0.0)
    rows, columns = -(-height // _BLOCK), -(-width // _BLOCK)
    block = (front.low_y + front.high_y) // 2 // _BLOCK * columns + (front.low_x + front.high_x) // 2 // _BLOCK
    covered = np.bincount(block, weights=area, minlength=rows * columns).reshape(rows, columns)
    across = np.minimum(width - _BLOCK * np.arange(columns), _BLOCK)
    down = np.minimum(height - _BLOCK * np.arange(rows), _BLOCK)
    return float(np.mean(covered >= _LAYERS * down[:, None] * across)) >= _CLOSED


def _cast(
    scene_class: Any, mesh_class: Any, corners: np.ndarray, width: int, height: int, offset: tuple[float, float]
) -> np.ndarray:
    """[height * width], the triangle that each ray meets first in float32, -1 for none."""
    with np.errstate(all="ignore"):
        vertices = np.nan_to_num(corners.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    scene = scene_class()
    mesh = mesh_class(scene, vertices)
    half = max(width, height) / 2
    direction = np.ones((height, width, 3), dtype=np.float32)
    direction[:, :, 0] = (np.arange(width) + offset[0] - width / 2) / half
    direction[:, :, 1] = ((np.arange(height) + offset[1] - height / 2) / half)[:, None]
    direction = direction.reshape(-1, 3)
    guess = scene.run(np.zeros_like(direction), direction)
    del mesh  # it must outlive the rays
    return np.asarray(guess, dtype=np.int64)
