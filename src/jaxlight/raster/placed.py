"""The shapes of a scene as a camera sees them: what is to be tested, and what the points that were hit carry."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..scene import Scene
from ..scene.document import PlacedShape
from ..scene.transforms import apply_to_normals, apply_to_points, compose, mirrors
from .camera import Camera
from .face_depth import PreparedFaces, prepare_faces
from .primitives import Primitive
from .shapes import geometries_of, numbers_of, texture_transformed, world_bounds
from .texels import bilinear_texels
from .triangles import Triangles
from .visibility import Prepared, prepare

_CHUNK = 1 << 15
"""Samples whose attributes are worked out at a time."""


class Attributes(NamedTuple):
    """What samples carry, world space; colours and texels are None where no surface of the scene has any."""

    position: np.ndarray
    normal: np.ndarray
    """Of length 1, which every float type holds; or zero."""
    color: np.ndarray | None
    texel_index: np.ndarray | None
    texel_weight: np.ndarray | None


class Hits(NamedTuple):
    """Rays and what they meet; N of them."""

    number: np.ndarray
    """Which triangle or face, numbered in the order of the shapes."""
    ray: np.ndarray
    """[N, 3], from the eye to the point that is met, world space."""
    weight: np.ndarray
    """[N, 3], of the corners of a triangle."""
    is_back: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class PlacedShapes:
    """The triangles and faces of all shapes, numbered in the order of the shapes; from inside a face is one more."""

    scene: Scene
    geometry: tuple[Triangles | Primitive, ...]
    """Of each placed shape, in its own coordinates."""
    first: np.ndarray
    """[shapes + 1], each shape's first number."""

    @classmethod
    def of(cls, scene: Scene) -> PlacedShapes:
        """Every shape of a scene.

        Raises:
            ValueError: a geometry has an index that does not fit, or lies too far away, or there are too many.
        """
        shapes = scene.document.shapes
        geometry = geometries_of(shapes)
        for placed, own in zip(shapes, geometry, strict=True):
            world_bounds(placed, own)  # refuses what lies too far away
        return cls(scene, geometry, np.cumsum([0, *map(numbers_of, geometry)]))

    def prepared(self, camera: Camera, width: int, height: int) -> tuple[Prepared, PreparedFaces | None]:
        """The triangles and the faces as the rasteriser tests them."""
        pixel_to_camera = camera.pixel_to_camera(width, height)
        triangles = [prepare(np.zeros((3, 3, 0)), pixel_to_camera, width, height, cull=True)]
        faces: list[PreparedFaces] = []
        for placed, own, first in zip(self.scene.document.shapes, self.geometry, self.first, strict=False):
            cull, number = getattr(placed.node.geometry, "solid", True), int(first)
            if isinstance(own, Primitive):
                to_camera = compose(_to_camera(camera), own.unit_to(placed.to_world))
                faces.append(
                    prepare_faces(own.faces, to_camera, pixel_to_camera, width, height, cull=cull, first_number=number)
                )
            else:
                corners = _seen_corners(own.position, placed, camera)
                triangles.append(prepare(corners, pixel_to_camera, width, height, cull=cull, first_number=number))
        return Prepared.front_to_back(triangles), PreparedFaces.front_to_back(faces)

    def surface_of(self, number: np.ndarray) -> np.ndarray:
        """Row in Scene.surfaces of each triangle or face."""
        rows = np.array([placed.surface for placed in self.scene.document.shapes], dtype=np.int64)
        return rows[np.searchsorted(self.first, number, side="right") - 1]

    def attributes(self, eye: np.ndarray, hits: Hits) -> Attributes:
        """What the points that were hit carry. The normals of back faces are turned round."""
        found = self._blank(len(hits.number))
        for which, here in self._by_shape(hits.number):
            self._fill(found, which, here, eye, Hits(*(part[here] for part in hits)))
        found.normal[hits.is_back] *= -1.0
        return found

    def _blank(self, count: int) -> Attributes:
        surfaces = self.scene.surfaces
        components = max((surface.color_components for surface in surfaces), default=0)
        has_texture = any(surface.textured for surface in surfaces)
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

    def _fill(self, found: Attributes, which: int, here: np.ndarray, eye: np.ndarray, hits: Hits) -> None:
        """Samples `here`, all on shape `which`."""
        placed, own = self.scene.document.shapes[which], self.geometry[which]
        is_textured = self.scene.surfaces[placed.surface].textured
        number = hits.number - self.first[which]
        if isinstance(own, Primitive):
            for face_number, face in enumerate(own.faces):
                on_it = np.flatnonzero(number // 2 == face_number)
                unit_to_world = own.unit_to(placed.to_world)
                inverse = np.linalg.inv(unit_to_world[:, :3])
                ray = hits.ray[on_it] @ inverse.T
                unit = face.onto(inverse @ (eye - unit_to_world[:, 3]) + ray, ray, hits.is_back[on_it])
                found.position[here[on_it]] = apply_to_points(unit_to_world, unit)
                found.normal[here[on_it]] = _unit(face.gradient(unit) @ inverse)
                if is_textured:
                    self._fill_texels(found, placed, here[on_it], texture_transformed(face.texcoord(unit), placed.node))
            return
        weight = hits.weight[:, ::-1] if mirrors(placed.to_world) else hits.weight
        found.position[here] = apply_to_points(placed.to_world, _interpolated(weight, own.position, number))
        found.normal[here] = _unit(apply_to_normals(placed.to_world, _interpolated(weight, own.normal, number)))
        if found.color is not None and own.color is not None:
            found.color[here, : own.color.shape[2]] = _interpolated(weight, own.color, number)
        if is_textured:
            self._fill_texels(found, placed, here, _interpolated(weight, own.texcoord, number))

    def _fill_texels(self, found: Attributes, placed: PlacedShape, here: np.ndarray, texcoord: np.ndarray) -> None:
        node = self.scene.document.textures[self.scene.surfaces[placed.surface].texture]
        assert node.image is not None and found.texel_index is not None and found.texel_weight is not None
        found.texel_index[here], found.texel_weight[here] = bilinear_texels(
            texcoord, node.image.shape[1], node.image.shape[0], repeat_s=node.repeat_s, repeat_t=node.repeat_t
        )


def _to_camera(camera: Camera) -> np.ndarray:
    """[3, 4], the world to camera axes, relative to the eye."""
    turn = camera.rotation.T
    return np.hstack([turn, -(turn @ camera.position)[:, None]])


def _seen_corners(position: np.ndarray, placed: PlacedShape, camera: Camera) -> np.ndarray:
    """[3 corners, 3 axes, T], triangles in camera axes, relative to the eye, counterclockwise in front.

    Term by term: equal corners give bitwise equal results wherever they stand, which a blocked matrix product does not
    promise, and without which a hair's breadth could open between triangles.
    """
    world = [
        _row_times(row, position) + shift - eye
        for row, shift, eye in zip(placed.to_world[:, :3], placed.to_world[:, 3], camera.position, strict=True)
    ]
    seen = np.stack([sum(m * w for m, w in zip(axis, world, strict=True)) for axis in camera.rotation.T])
    corners = np.moveaxis(seen, 2, 0)
    return corners[::-1] if mirrors(placed.to_world) else corners


def _interpolated(weight: np.ndarray, values: np.ndarray, row: np.ndarray) -> np.ndarray:
    """[N, k], corner values [T, 3, k] of triangles `row` weighted by [N, 3]."""
    total = weight[:, :1] * values[row, 0]
    total += weight[:, 1:2] * values[row, 1]
    total += weight[:, 2:] * values[row, 2]
    return total


def _unit(normal: np.ndarray) -> np.ndarray:
    """[N, 3] of length 1, whatever power of a scale they came with; zero stays zero."""
    length = np.hypot.reduce(normal, axis=1)[:, None]
    return normal / np.where(length > 0, length, 1.0)


def _row_times(row: np.ndarray, points: np.ndarray) -> np.ndarray:
    return row[0] * points[..., 0] + row[1] * points[..., 1] + row[2] * points[..., 2]
