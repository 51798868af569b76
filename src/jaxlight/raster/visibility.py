"""What each primary ray meets first: an exact depth-buffer rasteriser in float64.

A ray d from the eye meets a triangle a, b, c (relative to the eye) where the three volumes d . (b x c), d . (c x a),
d . (a x b) have one sign. Written in pixel coordinates each is an affine function of (u, v), so the test needs neither
clipping nor division, triangles that reach behind the eye included; the volumes over their sum are the perspective-
correct barycentric coordinates, and det(a, b, c) over their sum is the depth. Two triangles that share an edge get
exactly opposite volumes for it, so no ray slips through between them; of two hits at the same depth the triangle of the
smaller number counts.

Triangles are taken front to back; large ones are cut into blocks of pixels, and what lies outside an edge or behind
what is already there is dropped block by block. All bounds are evaluated with the formulas of the test itself, whose
rounding is monotone: nothing that the test would accept is ever dropped.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from .embree_depth import likely_hits

_BLOCK = 64
_SMALL = 16
"""Triangles up to this many pixels across go straight to pixels."""
_CHUNK = 1 << 18
"""Pixels tested at a time: what stays in cache."""
_GUARD = 1e-3
"""Pixels that bounding boxes are widened by, far above their rounding error."""
_SLACK = 1e-9
"""By how much bounds of depth are lowered, far above the rounding error of a depth."""
_NOTHING = np.iinfo(np.int64).max


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """Triangles that may be seen, as functions of the pixel."""

    number: np.ndarray
    """[V], which of the given triangles."""
    edge: np.ndarray
    """[3 corners, 3, V]: a corner's volume is edge[c, 0] u + edge[c, 1] v + edge[c, 2], >= 0 inside."""
    volume: np.ndarray
    """[V], |det(a, b, c)|: depth is this over the sum of the three."""
    bounds: np.ndarray
    """[4, V], least and largest u, least and largest v, in pixels."""
    nearest: np.ndarray
    """[V], no point of the triangle is nearer."""
    is_back: np.ndarray
    """[V], the triangle is seen from behind."""

    @classmethod
    def front_to_back(cls, parts: Sequence[Prepared]) -> Prepared:
        """Several sets of triangles as one, nearest first (ties by number)."""
        number, edge, volume, bounds, nearest, is_back = (
            np.concatenate([getattr(part, field.name) for part in parts], axis=-1) for field in dataclasses.fields(cls)
        )
        order = np.argsort(nearest, kind="stable")
        return cls(number[order], edge[:, :, order], volume[order], bounds[:, order], nearest[order], is_back[order])


def prepare(
    corners: np.ndarray, pixel_to_camera: np.ndarray, width: int, height: int, *, cull: bool, first_number: int = 0
) -> Prepared:
    """Set up triangles for a picture; those that it cannot show are left out.

    Args:
        corners: [3 corners, 3 axes, T], in camera axes, relative to the eye, counterclockwise in front.
        pixel_to_camera: [3, 3], (u, v, 1) to the direction of a ray.
        width, height: pixels.
        cull: True: not seen from behind.
        first_number: number of the first triangle.
    """
    a, b, c = corners
    normal_a = _cross(b, c)
    det = a[0] * normal_a[0] + a[1] * normal_a[1] + a[2] * normal_a[2]
    depth = -corners[:, 2]
    keep = ((det < 0) if cull else (det != 0)) & np.isfinite(det) & np.any(depth > 0, axis=0)
    number = np.flatnonzero(keep)
    bounds = _bounds(corners[:, :, number], pixel_to_camera)
    on_picture = (bounds[0] <= width) & (bounds[1] >= 0) & (bounds[2] <= height) & (bounds[3] >= 0)
    number, bounds = number[on_picture], bounds[:, on_picture]
    (a, b, c), det = corners[:, :, number], det[number]
    sign = np.where(det > 0, 1.0, -1.0)
    edge = np.empty((3, 3, len(number)))
    for corner, normal in enumerate((_cross(b, c), _cross(c, a), _cross(a, b))):
        for axis in range(3):
            p, q, r = pixel_to_camera[:, axis]
            edge[corner, axis] = sign * (normal[0] * p + normal[1] * q + normal[2] * r)
    nearest = np.maximum(-corners[:, 2, number].max(axis=0), 0.0) * (1 - _SLACK)
    return Prepared(number + first_number, edge, np.abs(det), bounds, nearest, det > 0)


def first_hits(
    prepared: Prepared, width: int, height: int, offset: tuple[float, float] = (0.5, 0.5)
) -> tuple[np.ndarray, np.ndarray]:
    """The triangles that the rays through the pixels meet first: pixels that show one, and its row in `prepared`.

    `offset`: where in its pixel a ray goes through, right and down of its top left corner.
    """
    target = _Target(width, height)
    u, v = offset
    low_x = np.clip(np.ceil(prepared.bounds[0] - u), 0, width).astype(np.int64)
    high_x = np.clip(np.floor(prepared.bounds[1] - u), -1, width - 1).astype(np.int64)
    low_y = np.clip(np.ceil(prepared.bounds[2] - v), 0, height).astype(np.int64)
    high_y = np.clip(np.floor(prepared.bounds[3] - v), -1, height - 1).astype(np.int64)
    row = np.flatnonzero((low_x <= high_x) & (low_y <= high_y))
    boxes = Boxes(row, low_x[row], high_x[row], low_y[row], high_y[row])
    if (likely := likely_hits(prepared, boxes, width, height, offset)) is not None:
        box, x, y = likely
        target.draw(prepared, Boxes(row[box], x, x, y, y), offset)
        target.note_depths()
    for chunk in boxes.chunks():
        chunk = chunk.select(prepared.nearest[chunk.row] <= target.farthest(chunk))
        is_large = chunk.across > _SMALL
        target.draw(prepared, chunk.select(~is_large), offset)
        for blocks in chunk.select(is_large).split(_BLOCK):
            blocks = blocks.select(_may_touch(prepared, blocks, offset, target.farthest(blocks)))
            for small in blocks.split(_SMALL // 2):
                target.draw(prepared, small.select(_may_touch(prepared, small, offset, target.farthest(small))), offset)
        target.note_depths()
    numbers = target.numbers()
    pixel = np.flatnonzero(numbers != _NOTHING)
    row_of = np.zeros(int(prepared.number.max(initial=-1)) + 1, dtype=np.int64)
    row_of[prepared.number] = np.arange(len(prepared.number))
    return pixel, row_of[numbers[pixel]]


def barycentric(prepared: Prepared, row: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """[N, 3], weights of the three corners where the rays through (u, v), in pixels, meet triangles `row`."""
    weights = np.stack([_volume(prepared.edge[corner], row, u, v) for corner in range(3)], axis=1)
    return weights / weights.sum(axis=1, keepdims=True)


@dataclasses.dataclass(frozen=True, eq=False)
class Boxes:
    """Rectangles of pixels, bounds included, each of which a triangle may touch."""

    row: np.ndarray
    low_x: np.ndarray
    high_x: np.ndarray
    low_y: np.ndarray
    high_y: np.ndarray

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
        return np.where(self.across > _SMALL, _SMALL * self.across + self.area // _SMALL, self.area)

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
        which, within = _count_up(columns * rows)
        row, column = np.divmod(within, columns[which])
        x, y = (first_x[which] + column) * size, (first_y[which] + row) * size
        return Boxes(
            self.row[which],
            np.maximum(self.low_x[which], x),
            np.minimum(self.high_x[which], x + size - 1),
            np.maximum(self.low_y[which], y),
            np.minimum(self.high_y[which], y + size - 1),
        ).chunks()


class _Target:
    """The depth buffer: what is nearest so far. Padded to whole blocks; the padding counts as filled."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        rows, columns = -(-height // _BLOCK), -(-width // _BLOCK)
        self.stride = columns * _BLOCK
        depth = np.zeros((rows * _BLOCK, self.stride))
        depth[:height, :width] = np.inf
        self.depth = depth.ravel()
        self.number = np.full(self.depth.shape, _NOTHING)
        self.block_depth = np.full((rows, columns), np.inf)
        self.changes = 0

    def farthest(self, boxes: Boxes) -> np.ndarray:
        """For each box at most a block across a depth behind which it is filled; infinity for larger ones."""
        columns, rows = (boxes.low_x // _BLOCK, boxes.high_x // _BLOCK), (boxes.low_y // _BLOCK, boxes.high_y // _BLOCK)
        corners = [self.block_depth[row, column] for row in rows for column in columns]
        local = (columns[1] - columns[0] <= 1) & (rows[1] - rows[0] <= 1)
        return np.where(local, np.max(corners, axis=0, initial=0.0), np.inf)

    def draw(self, prepared: Prepared, boxes: Boxes, offset: tuple[float, float]) -> None:
        """Test every pixel of the boxes."""
        for chunk in boxes.chunks():
            width, height = chunk.high_x - chunk.low_x + 1, chunk.high_y - chunk.low_y + 1
            which, within = _count_up(width * height)
            down, right = np.divmod(within, width[which])
            x, y, row = chunk.low_x[which] + right, chunk.low_y[which] + down, chunk.row[which]
            u, v = x + offset[0], y + offset[1]
            volumes = [_volume(prepared.edge[corner], row, u, v) for corner in range(3)]
            inside = np.flatnonzero((volumes[0] >= 0) & (volumes[1] >= 0) & (volumes[2] >= 0))
            total = volumes[0][inside] + volumes[1][inside] + volumes[2][inside]
            inside, total = inside[total > 0], total[total > 0]
            row = row[inside]
            # Rounding may bring the depth of a sliver before `nearest`, by which triangles are dropped: then what is
            # seen would hang on the order of the work.
            depth = np.maximum(prepared.volume[row] / total, prepared.nearest[row])
            self._keep_nearest(y[inside] * self.stride + x[inside], depth, prepared.number[row])

    def note_depths(self) -> None:
        """Bring the depths of the blocks up to date, once enough has changed to be worth it."""
        if 16 * self.changes < len(self.depth):
            return
        self.changes = 0
        rows, columns = self.block_depth.shape
        across = self.depth.reshape(rows * _BLOCK, columns, _BLOCK).max(axis=2)
        self.block_depth = across.reshape(rows, _BLOCK, columns).max(axis=1)

    def numbers(self) -> np.ndarray:
        """[height * width], number of the triangle that each pixel shows, _NOTHING where there is none."""
        return self.number.reshape(-1, self.stride)[: self.height, : self.width].ravel()

    def _keep_nearest(self, pixel: np.ndarray, depth: np.ndarray, number: np.ndarray) -> None:
        """Of old and new hits of a pixel the nearest stays; at equal depth the triangle of the smallest number."""
        before = self.depth[pixel]
        np.minimum.at(self.depth, pixel, depth)
        wins = depth == self.depth[pixel]
        pixel, number, is_nearer = pixel[wins], number[wins], (depth < before)[wins]
        self.changes += len(pixel)
        self.number[pixel[is_nearer]] = _NOTHING
        np.minimum.at(self.number, pixel, number)


def _may_touch(prepared: Prepared, boxes: Boxes, offset: tuple[float, float], farthest: np.ndarray) -> np.ndarray:
    """Whether a triangle can be inside its three edges, and not behind `farthest`, somewhere in the box."""
    left, right = boxes.low_x + offset[0], boxes.high_x + offset[0]
    top, bottom = boxes.low_y + offset[1], boxes.high_y + offset[1]
    possible = np.ones(len(boxes.row), dtype=bool)
    total = np.full(len(boxes.row), np.finfo(np.float64).tiny)
    for corner in range(3):
        across, down, constant = (prepared.edge[corner, axis][boxes.row] for axis in range(3))
        largest = across * np.where(across > 0, right, left) + down * np.where(down > 0, bottom, top) + constant
        possible &= largest >= 0
        total += np.maximum(largest, 0.0)
    # The sum of the largest volumes bounds the largest sum, and so the least depth from below.
    with np.errstate(over="ignore"):
        return possible & (prepared.volume[boxes.row] / total * (1 - _SLACK) <= farthest)


def _volume(edge: np.ndarray, row: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return edge[0][row] * u + edge[1][row] * v + edge[2][row]


def _cross(p: tuple[np.ndarray, ...], q: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """p x q, exactly the negative of q x p (which fused or reordered sums would not be)."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


def _bounds(corners: np.ndarray, pixel_to_camera: np.ndarray) -> np.ndarray:
    """[4, T], least and largest u, least and largest v of each triangle; everything where it reaches behind the eye."""
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


def _count_up(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For counts (2, 3): which = 0 0 1 1 1, within = 0 1 0 1 2."""
    which = np.repeat(np.arange(len(counts)), counts)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
