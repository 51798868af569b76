"""The shapes of a scene as a camera sees them: triangles to test, and what they carry at the points that were hit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..scene import Scene, nodes
from ..scene.document import PlacedShape
from ..scene.transforms import apply_to_normals, apply_to_points, mirrors
from .camera import Camera
from .quadrics import onto_quadric
from .tessellate import SEGMENTS, segments_for, tessellate
from .texels import bilinear_texels
from .triangles import Triangles
from .visibility import Prepared, prepare

_CHUNK = 1 << 15
"""Samples whose attributes are worked out at a time."""

MAX_TRIANGLES = 1 << 25
"""Triangles of all placed shapes together; a shape used again counts every time."""


class Attributes(NamedTuple):
    """What samples carry, world space; colours and texels are None where no surface of the scene has any."""

    position: np.ndarray
    normal: np.ndarray
    color: np.ndarray | None
    texel_index: np.ndarray | None
    texel_weight: np.ndarray | None


@dataclasses.dataclass(frozen=True, eq=False)
class PlacedTriangles:
    """The triangles of all shapes, numbered in the order of the shapes."""

    scene: Scene
    triangles: tuple[Triangles, ...]
    """Of each placed shape, in its own coordinates."""
    first: np.ndarray
    """[shapes + 1], number of each shape's first triangle."""

    @classmethod
    def of(cls, scene: Scene, camera: Camera, width: int, height: int) -> PlacedTriangles:
        """Every shape cut into triangles, curved ones as finely as the picture asks for.

        Raises:
            ValueError: a geometry has an index that does not fit, or there are more than MAX_TRIANGLES.
        """
        known: dict[tuple[int, int], Triangles] = {}
        all_triangles, count = [], 0
        shapes = scene.document.shapes
        for number, placed in enumerate(shapes, start=1):
            segments = _segments(placed, camera, width, height)
            key = (id(placed.node), segments)
            if key not in known:
                known[key] = tessellate(placed.node, segments)
            all_triangles.append(known[key])
            count += len(known[key])
            if count > MAX_TRIANGLES:
                raise ValueError(
                    f"rasterize: the scene has more than {MAX_TRIANGLES} triangles: {count} up to {placed.node.label}, "
                    f"{number} of {len(shapes)} placed shapes (one used again counts every time)"
                )
        first = np.cumsum([0, *(len(triangles) for triangles in all_triangles)])
        return cls(scene, tuple(all_triangles), first)

    def prepared(self, camera: Camera, width: int, height: int) -> Prepared:
        """The triangles as the rasteriser tests them."""
        pixel_to_camera = camera.pixel_to_camera(width, height)
        parts = [prepare(np.zeros((3, 3, 0)), pixel_to_camera, width, height, cull=True)]
        for placed, triangles, first in zip(self.scene.document.shapes, self.triangles, self.first, strict=False):
            # Term by term: equal corners give bitwise equal results wherever they stand, which a blocked matrix
            # product does not promise, and without which a hair's breadth could open between triangles.
            world = [
                _row_times(row, triangles.position) + shift - eye
                for row, shift, eye in zip(placed.to_world[:, :3], placed.to_world[:, 3], camera.position, strict=True)
            ]
            seen = np.stack([sum(m * w for m, w in zip(axis, world, strict=True)) for axis in camera.rotation.T])
            corners = np.moveaxis(seen, 2, 0)
            if mirrors(placed.to_world):
                corners = corners[::-1]
            solid = getattr(placed.node.geometry, "solid", True)
            parts.append(prepare(corners, pixel_to_camera, width, height, cull=solid, first_number=int(first)))
        return Prepared.front_to_back(parts)

    def surface_of(self, number: np.ndarray) -> np.ndarray:
        """Row in Scene.surfaces of each triangle."""
        rows = np.array([placed.surface for placed in self.scene.document.shapes], dtype=np.int64)
        return rows[np.searchsorted(self.first, number, side="right") - 1]

    def attributes(self, eye: np.ndarray, number: np.ndarray, weight: np.ndarray, is_back: np.ndarray) -> Attributes:
        """What triangles `number` [N] carry where rays from `eye` meet them, at barycentric `weight` [N, 3].

        The normals of back faces are turned round.
        """
        found = self._blank(len(number))
        for which, here in self._by_shape(number):
            self._fill(found, which, here, number[here] - self.first[which], weight[here], eye, is_back[here])
        found.normal[is_back] *= -1.0
        return found

    def _blank(self, count: int) -> Attributes:
        surfaces = self.scene.surfaces
        components = max((surface.color_components for surface in surfaces), default=0)
        has_texture = any(surface.texture >= 0 for surface in surfaces)
        return Attributes(
            position=np.empty((count, 3)),
            normal=np.empty((count, 3)),
            color=np.ones((count, components)) if components else None,
            texel_index=np.zeros((count, 4), dtype=np.int64) if has_texture else None,
            texel_weight=np.zeros((count, 4)) if has_texture else None,
        )

    def _by_shape(self, number: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """Shapes and samples that lie on them, at most _CHUNK at a time so that the work stays in cache."""
        shape = np.searchsorted(self.first, number, side="right") - 1
        order = np.argsort(shape, kind="stable")
        hit, starts = np.unique(shape[order], return_index=True)
        for which, start, stop in zip(hit.tolist(), starts, [*starts[1:], len(number)], strict=False):
            for low in range(start, stop, _CHUNK):
                yield which, order[low : min(low + _CHUNK, stop)]

    def _fill(
        self,
        found: Attributes,
        which: int,
        here: np.ndarray,
        row: np.ndarray,
        weight: np.ndarray,
        eye: np.ndarray,
        is_back: np.ndarray,
    ) -> None:
        """Samples `here`, all on shape `which`, in its triangles `row`."""
        placed, triangles = self.scene.document.shapes[which], self.triangles[which]
        to_world = placed.to_world
        weight = weight[:, ::-1] if mirrors(to_world) else weight
        found.position[here] = apply_to_points(to_world, _interpolated(weight, triangles.position, row))
        found.normal[here] = apply_to_normals(to_world, _interpolated(weight, triangles.normal, row))
        if triangles.quadric is not None and triangles.curved is not None:
            on_it = triangles.curved[row]
            curved = here[on_it]
            found.position[curved], found.normal[curved] = onto_quadric(
                triangles.quadric, to_world, eye, found.position[curved], is_back[on_it]
            )
        if found.color is not None and triangles.color is not None:
            found.color[here, : triangles.color.shape[2]] = _interpolated(weight, triangles.color, row)
        texture = self.scene.surfaces[placed.surface].texture
        if texture >= 0 and found.texel_index is not None and found.texel_weight is not None:
            node = self.scene.document.textures[texture]
            assert node.image is not None  # a texture without an image is no texture of the scene
            found.texel_index[here], found.texel_weight[here] = bilinear_texels(
                _interpolated(weight, triangles.texcoord, row),
                node.image.shape[1],
                node.image.shape[0],
                repeat_s=node.repeat_s,
                repeat_t=node.repeat_t,
            )


def _segments(placed: PlacedShape, camera: Camera, width: int, height: int) -> int:
    """How finely a curved primitive must be cut, from its size in the picture."""
    match placed.node.geometry:
        case nodes.Sphere(radius=radius):
            extent = radius
        case nodes.Cylinder(radius=radius, height=length) | nodes.Cone(bottom_radius=radius, height=length):
            extent = math.hypot(radius, length / 2)
        case _:
            return SEGMENTS
    largest = float(np.linalg.norm(placed.to_world[:, :3], 2))
    distance = float(np.linalg.norm(placed.to_world[:, 3] - camera.position)) - extent * largest
    pixels_per_radian = 1 / np.abs(np.diag(camera.pixel_to_camera(width, height))[:2]).min()
    return segments_for(pixels_per_radian * radius * largest / max(distance, 1e-3 * radius * largest))


def _interpolated(weight: np.ndarray, values: np.ndarray, row: np.ndarray) -> np.ndarray:
    """[N, k], corner values [T, 3, k] of triangles `row` weighted by [N, 3]."""
    total = weight[:, :1] * values[row, 0]
    total += weight[:, 1:2] * values[row, 1]
    total += weight[:, 2:] * values[row, 2]
    return total


def _row_times(row: np.ndarray, points: np.ndarray) -> np.ndarray:
    return row[0] * points[..., 0] + row[1] * points[..., 1] + row[2] * points[..., 2]
