"""What each primary ray meets first: an exact depth-buffer rasteriser in float64.

A ray d from the eye meets a triangle a, b, c (relative to the eye) where the three volumes d . (b x c), d . (c x a),
d . (a x b) have one sign. Written in pixel coordinates each is an affine function of (u, v), so the test needs neither
clipping nor division, triangles that reach behind the eye included; the volumes over their sum are the perspective-
correct barycentric coordinates, and det(a, b, c) over their sum is the depth. Two triangles that share an edge get
exactly opposite volumes for it, so no ray slips through between them; of two hits at the same depth the triangle of the
smaller number counts. Polygons are cut so that all their corners are corners of triangles with an area, but where a
file's own faces without area stand between others, these share no edge, and rays may slip through.

Triangles are taken front to back; large ones are cut into blocks of pixels, and what lies outside an edge or behind
what is already there is dropped block by block. All bounds are evaluated with the formulas of the test itself, whose
rounding is monotone: nothing that the test would accept is ever dropped.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from .depth_buffer import BLOCK, SLACK, SMALL, Boxes, DepthBuffer, bounds_of
from .embree_depth import likely_hits
from .face_depth import PreparedFaces, draw_faces


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

    def depths(self, row: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which of the rays [N] through (u, v), in pixels, meet their triangle, and at which depths."""
        volumes = [_volume(self.edge[corner], row, u, v) for corner in range(3)]
        inside = np.flatnonzero((volumes[0] >= 0) & (volumes[1] >= 0) & (volumes[2] >= 0))
        total = volumes[0][inside] + volumes[1][inside] + volumes[2][inside]
        inside, total = inside[total > 0], total[total > 0]
        return inside, self.volume[row[inside]] / total


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
    bounds = bounds_of(corners[:, :, number], pixel_to_camera)
    on_picture = (bounds[0] <= width) & (bounds[1] >= 0) & (bounds[2] <= height) & (bounds[3] >= 0)
    number, bounds = number[on_picture], bounds[:, on_picture]
    (a, b, c), det = corners[:, :, number], det[number]
    sign = np.where(det > 0, 1.0, -1.0)
    edge = np.empty((3, 3, len(number)))
    for corner, normal in enumerate((_cross(b, c), _cross(c, a), _cross(a, b))):
        for axis in range(3):
            p, q, r = pixel_to_camera[:, axis]
            edge[corner, axis] = sign * (normal[0] * p + normal[1] * q + normal[2] * r)
    nearest = np.maximum(-corners[:, 2, number].max(axis=0), 0.0) * (1 - SLACK)
    return Prepared(number + first_number, edge, np.abs(det), bounds, nearest, det > 0)


def first_hits(
    triangles: Prepared,
    faces: PreparedFaces | None,
    width: int,
    height: int,
    offset: tuple[float, float] = (0.5, 0.5),
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the rays through the pixels meet first: pixels that show something, row by row, its number and its depth.

    `offset`: where in its pixel a ray goes through, right and down of its top left corner.
    """
    target = DepthBuffer(width, height)
    if faces is not None:
        draw_faces(target, faces, width, height, offset)
    _draw(target, triangles, width, height, offset)
    return target.seen()


def barycentric(prepared: Prepared, row: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """[N, 3], weights of the three corners where the rays through (u, v), in pixels, meet triangles `row`."""
    weights = np.stack([_volume(prepared.edge[corner], row, u, v) for corner in range(3)], axis=1)
    return weights / weights.sum(axis=1, keepdims=True)


def _draw(target: DepthBuffer, prepared: Prepared, width: int, height: int, offset: tuple[float, float]) -> None:
    """Test all triangles where they may be seen."""
    boxes = Boxes.within(prepared.bounds, width, height, offset)
    if (likely := likely_hits(prepared, boxes, width, height, offset)) is not None:
        box, x, y = likely
        target.draw(prepared, Boxes(boxes.row[box], x, x, y, y), offset)
        target.note_depths()
    for chunk in boxes.chunks():
        chunk = chunk.select(prepared.nearest[chunk.row] <= target.farthest(chunk))
        is_large = chunk.across > SMALL
        target.draw(prepared, chunk.select(~is_large), offset)
        for blocks in chunk.select(is_large).split(BLOCK):
            blocks = blocks.select(_may_touch(prepared, blocks, offset, target.farthest(blocks)))
            for small in blocks.split(SMALL // 2):
                target.draw(prepared, small.select(_may_touch(prepared, small, offset, target.farthest(small))), offset)
        target.note_depths()


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
        return possible & (prepared.volume[boxes.row] / total * (1 - SLACK) <= farthest)


def _volume(edge: np.ndarray, row: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return edge[0][row] * u + edge[1][row] * v + edge[2][row]


def _cross(p: tuple[np.ndarray, ...], q: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """p x q, exactly the negative of q x p (which fused or reordered sums would not be)."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]
