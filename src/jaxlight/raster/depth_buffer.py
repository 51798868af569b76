"""The nearest that each pixel's ray meets: exact depths, whatever is drawn, in whatever order.

Of two hits at the same depth that of the smaller number counts. Depth is along the camera's view, in units of length.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Protocol

import numpy as np

BLOCK = 64
SMALL = 16
"""What is up to this many pixels across goes straight to pixels."""
_CHUNK = 1 << 18
"""Pixels tested at a time: what stays in cache."""
_GUARD = 1e-3
"""Pixels that bounds are widened by, far above their rounding error."""
SLACK = 1e-9
"""By how much bounds of depth are lowered, far above the rounding error of a depth."""
NOTHING = np.iinfo(np.int64).max


class Tested(Protocol):
    """What is drawn, by rows."""

    @property
    def number(self) -> np.ndarray:
        """[V], what a pixel shows that it is seen in."""
        ...

    @property
    def nearest(self) -> np.ndarray:
        """[V], no point of it is nearer."""
        ...

    def depths(self, row: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which of the rays [N] through (u, v), in pixels, meet their row, and at which depths > 0."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class Boxes:
    """Rectangles of pixels, bounds included, each of which something may touch."""

    row: np.ndarray
    """[B], of what, in the order in which it was prepared."""
    low_x: np.ndarray
    high_x: np.ndarray
    low_y: np.ndarray
    high_y: np.ndarray

    @classmethod
    def within(cls, bounds: np.ndarray, width: int, height: int, offset: tuple[float, float]) -> Boxes:
        """The pixels of a picture whose rays pass within bounds [4, V]; row by row, those that hold none left out.

        `offset`: where in its pixel a ray goes through, right and down of its top left corner.
        """
        u, v = offset
        low_x = np.clip(np.ceil(bounds[0] - u), 0, width).astype(np.int64)
        high_x = np.clip(np.floor(bounds[1] - u), -1, width - 1).astype(np.int64)
        low_y = np.clip(np.ceil(bounds[2] - v), 0, height).astype(np.int64)
        high_y = np.clip(np.floor(bounds[3] - v), -1, height - 1).astype(np.int64)
        row = np.flatnonzero((low_x <= high_x) & (low_y <= high_y))
        return cls(row, low_x[row], high_x[row], low_y[row], high_y[row])

    @property
    def across(self) -> np.ndarray:
        """Pixels along the longer side."""
        return np.maximum(self.high_x - self.low_x, self.high_y - self.low_y) + 1

    @property
    def area(self) -> np.ndarray:
        """Pixels."""
        return (self.high_x - self.low_x + 1) * (self.high_y - self.low_y + 1)

    @property
    def work(self) -> np.ndarray:
        """Roughly what a box costs, in pixels to test: its area, or less where blocks are looked at first."""
        return np.where(self.across > SMALL, SMALL * self.across + self.area // SMALL, self.area)

    def select(self, keep: np.ndarray | slice) -> Boxes:
        return Boxes(self.row[keep], self.low_x[keep], self.high_x[keep], self.low_y[keep], self.high_y[keep])

    def chunks(self) -> Iterator[Boxes]:
        """Runs of boxes of about _CHUNK pixels' work together, in order."""
        total = np.cumsum(self.work)
        start = 0
        while start < len(self.row):
            done = total[start - 1] if start else 0
            stop = max(int(np.searchsorted(total, done + _CHUNK, side="right")), start + 1)
            yield self.select(slice(start, stop))
            start = stop

    def split(self, size: int) -> Iterator[Boxes]:
        """The boxes cut along multiples of `size` pixels, in chunks."""
        first_x, first_y = self.low_x // size, self.low_y // size
        columns, rows = self.high_x // size - first_x + 1, self.high_y // size - first_y + 1
        which, within = count_up(columns * rows)
        row, column = np.divmod(within, columns[which])
        x, y = (first_x[which] + column) * size, (first_y[which] + row) * size
        return Boxes(
            self.row[which],
            np.maximum(self.low_x[which], x),
            np.minimum(self.high_x[which], x + size - 1),
            np.maximum(self.low_y[which], y),
            np.minimum(self.high_y[which], y + size - 1),
        ).chunks()


class DepthBuffer:
    """The depth buffer: what is nearest so far. Padded to whole blocks; the padding counts as filled."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        rows, columns = -(-height // BLOCK), -(-width // BLOCK)
        self.stride = columns * BLOCK
        depth = np.zeros((rows * BLOCK, self.stride))
        depth[:height, :width] = np.inf
        self.depth = depth.ravel()
        self.number = np.full(self.depth.shape, NOTHING)
        self.block_depth = np.full((rows, columns), np.inf)
        self.changes = 0

    def farthest(self, boxes: Boxes) -> np.ndarray:
        """For each box at most a block across a depth behind which it is filled; infinity for larger ones."""
        columns, rows = (boxes.low_x // BLOCK, boxes.high_x // BLOCK), (boxes.low_y // BLOCK, boxes.high_y // BLOCK)
        corners = [self.block_depth[row, column] for row in rows for column in columns]
        local = (columns[1] - columns[0] <= 1) & (rows[1] - rows[0] <= 1)
        return np.where(local, np.max(corners, axis=0, initial=0.0), np.inf)

    def draw(self, tested: Tested, boxes: Boxes, offset: tuple[float, float]) -> None:
        """Test every pixel of the boxes."""
        for chunk in boxes.chunks():
            width, height = chunk.high_x - chunk.low_x + 1, chunk.high_y - chunk.low_y + 1
            which, within = count_up(width * height)
            down, right = np.divmod(within, width[which])
            x, y, row = chunk.low_x[which] + right, chunk.low_y[which] + down, chunk.row[which]
            hit, depth = tested.depths(row, x + offset[0], y + offset[1])
            row = row[hit]
            # Rounding may bring the depth of a sliver before `nearest`, by which it is dropped: then what is seen would
            # hang on the order of the work.
            depth = np.maximum(depth, tested.nearest[row])
            self._keep_nearest(y[hit] * self.stride + x[hit], depth, tested.number[row])

    def note_depths(self) -> None:
        """Bring the depths of the blocks up to date, once enough has changed to be worth it."""
        if 16 * self.changes < len(self.depth):
            return
        self.changes = 0
        rows, columns = self.block_depth.shape
        across = self.depth.reshape(rows * BLOCK, columns, BLOCK).max(axis=2)
        self.block_depth = across.reshape(rows, BLOCK, columns).max(axis=1)

    def seen(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels, row by row, that show something, its number, and its depth."""
        number, depth = (
            of.reshape(-1, self.stride)[: self.height, : self.width].ravel() for of in (self.number, self.depth)
        )
        pixel = np.flatnonzero(number != NOTHING)
        return pixel, number[pixel], depth[pixel]

    def _keep_nearest(self, pixel: np.ndarray, depth: np.ndarray, number: np.ndarray) -> None:
        """Of old and new hits of a pixel the nearest stays; at equal depth that of the smallest number."""
        before = self.depth[pixel]
        np.minimum.at(self.depth, pixel, depth)
        wins = depth == self.depth[pixel]
        pixel, number, is_nearer = pixel[wins], number[wins], (depth < before)[wins]
        self.changes += len(pixel)
        self.number[pixel[is_nearer]] = NOTHING
        np.minimum.at(self.number, pixel, number)


def bounds_of(corners: np.ndarray, pixel_to_camera: np.ndarray) -> np.ndarray:
    """[4, V], least and largest u, least and largest v, in pixels; everything where a hull reaches behind the eye.

    `corners`: [C, 3 axes, V], of convex hulls, in camera axes, relative to the eye.
    """
    to_pixel = np.linalg.inv(pixel_to_camera)
    behind = np.any(corners[:, 2] >= 0, axis=0)
    bounds = np.empty((4, corners.shape[2]))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        scale = 1 / np.tensordot(to_pixel[2], corners, axes=(0, 1))
        for axis in range(2):
            place = np.tensordot(to_pixel[axis], corners, axes=(0, 1)) * scale
            low, high = place.min(axis=0), place.max(axis=0)
            guard = _GUARD + 1e-9 * np.maximum(np.abs(low), np.abs(high))
            unknown = behind | ~np.isfinite(guard)
            bounds[2 * axis] = np.where(unknown, -np.inf, low - guard)
            bounds[2 * axis + 1] = np.where(unknown, np.inf, high + guard)
    return bounds


def count_up(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For counts (2, 3): which = 0 0 1 1 1, within = 0 1 0 1 2."""
    which = np.repeat(np.arange(len(counts)), counts)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)


def rows_of(known: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Where each number stands among the known ones, which are all different; -1 for those that do not."""
    row = np.full(int(max(known.max(initial=-1), number.max(initial=-1))) + 1, -1)
    row[known] = np.arange(len(known))
    return row[number]
