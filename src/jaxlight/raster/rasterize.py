"""A scene seen by a camera -> the samples of its visible surface points."""

from __future__ import annotations

import math
import warnings
from typing import Any, NamedTuple

import numpy as np

from ..scene import Scene, nodes
from ..scene.document import PlacedShape
from ..scene.transforms import apply_to_normals, mirrors
from .camera import Camera
from .pattern import sample_pattern
from .quadrics import onto_quadric
from .samples import SampleBuffer
from .tessellate import SEGMENTS, segments_for, tessellate
from .texels import bilinear_texels
from .triangles import Triangles
from .visibility import barycentric, first_hits, prepare

MAX_SIDE = 1 << 15
MAX_PICTURE_SAMPLES = 1 << 26
"""Samples of one picture (8192 x 8192, one sample a pixel)."""


def rasterize(
    scene: Scene,
    camera: Camera | nodes.Viewpoint | None = None,
    width: int = 512,
    height: int = 512,
    samples: int = 1,
    *,
    dtype: Any = None,
) -> SampleBuffer:
    """The visible surface points of a scene, one a ray: first hit, exact in float64; background left out.

    Back faces are not seen where `solid` is TRUE; elsewhere their normals are turned round. Transparent shapes hide
    what is behind them (one layer). Spheres, cylinders and cones have their exact surface and normals, within an
    outline that is true to 1/16 pixel.

    Args:
        scene: the scene.
        camera: a Camera, a Viewpoint (of the scene: with the transforms above it), or None: `Camera.default`.
        width, height: size of the picture in pixels.
        samples: rays a pixel: 1 through its centre, or k on a rotated grid, each of which covers 1/k of the pixel.
        dtype: float type of the buffer (default: JAX's).

    Returns:
        Samples ordered by surface, and within a surface along a Morton curve over the pixels, so that neighbours in the
        buffer are neighbours in the picture. `pixel` counts row by row from the top left.

    Raises:
        ValueError: a size that is not a whole number in range, a scene without geometry, a geometry with a bad index.
    """
    _check_size(width, height, samples)
    offsets = sample_pattern(samples)
    camera = _camera(scene, camera)
    placed = _placed_triangles(scene, camera, min(width, height))
    relative = placed.position - camera.position
    corners = _rotated(relative, camera.rotation.T)
    prepared = prepare(corners, camera.pixel_to_camera(width, height), placed.cull, width, height)
    hits = [_Hits.of(*first_hits(prepared, width, height, offset), width, offset) for offset in offsets.tolist()]
    seen = _Hits(*(np.concatenate(parts) for parts in zip(*hits, strict=True)))
    number = prepared.number[seen.row]
    surface = placed.surface[number]
    order = np.lexsort((_morton(seen.x, seen.y), surface))
    seen, number, surface = _Hits(*(part[order] for part in seen)), number[order], surface[order]
    if len(number) == 0:
        warnings.warn("rasterize: the camera sees no surface; the picture is all background", stacklevel=2)

    weight = barycentric(prepared, seen.row, seen.u, seen.v)
    position = _interpolated(weight, placed.position, number)
    normal = _interpolated(weight, placed.normal, number)
    placed.exact(camera.position, position, normal, number)
    normal[prepared.is_back[seen.row]] *= -1.0
    texels = _texels(scene, placed, weight, number, surface)
    return SampleBuffer.create(
        position,
        normal,
        camera.position,
        surface=surface,
        color=None if placed.color is None else _interpolated(weight, placed.color, number),
        texel_index=None if texels is None else texels[0],
        texel_weight=None if texels is None else texels[1],
        pixel=seen.y * width + seen.x,
        coverage=None if samples == 1 else np.full(len(number), 1.0 / samples),
        width=width,
        height=height,
        camera_to_world=camera.rotation,
        pixel_to_world=camera.pixel_to_world(width, height),
        dtype=dtype,
    )


class _Hits(NamedTuple):
    """Rays that meet a surface: pixel column and row, place in the picture, row of the triangle."""

    x: np.ndarray
    y: np.ndarray
    u: np.ndarray
    v: np.ndarray
    row: np.ndarray

    @classmethod
    def of(cls, pixel: np.ndarray, row: np.ndarray, width: int, offset: list[float]) -> _Hits:
        y, x = np.divmod(pixel, width)
        return cls(x, y, x + offset[0], y + offset[1], row)


class _Placed(NamedTuple):
    """The triangles of all shapes, world space, counterclockwise in front."""

    position: np.ndarray
    normal: np.ndarray
    texcoord: np.ndarray
    color: np.ndarray | None
    shape: np.ndarray
    """[T], which placed shape."""
    surface: np.ndarray
    """[T], row in Scene.surfaces."""
    cull: np.ndarray
    """[T], back faces are not seen."""
    curved: list[tuple[int, int, PlacedShape, Triangles]]
    """(first triangle, triangle after the last, ...) of the shapes that have a quadric."""

    def exact(self, eye: np.ndarray, position: np.ndarray, normal: np.ndarray, number: np.ndarray) -> None:
        """Move the samples of curved primitives along their rays onto the true surface, in place."""
        for start, stop, placed, triangles in self.curved:
            assert triangles.quadric is not None and triangles.curved is not None
            here = np.flatnonzero((number >= start) & (number < stop))
            here = here[triangles.curved[number[here] - start]]
            if len(here):
                position[here], normal[here] = onto_quadric(triangles.quadric, placed.to_world, eye, position[here])


def _placed_triangles(scene: Scene, camera: Camera, side: int) -> _Placed:
    """Every shape cut into triangles, fine enough for a picture `side` pixels across, in world space."""
    shapes = scene.document.shapes
    known: dict[tuple[int, int], Triangles] = {}
    parts: list[tuple[np.ndarray, ...]] = []
    components = max((surface.color_components for surface in scene.surfaces), default=0)
    curved, first = [], 0
    for placed in shapes:
        segments = _segments(placed, camera, side)
        key = (id(placed.node), segments)
        if key not in known:
            known[key] = tessellate(placed.node, segments)
        triangles = known[key]
        linear, offset = placed.to_world[:, :3], placed.to_world[:, 3]
        position = _rotated(triangles.position, linear) + offset
        normal = apply_to_normals(placed.to_world, triangles.normal.reshape(-1, 3)).reshape(-1, 3, 3)
        arrays = (position, normal, triangles.texcoord, _color(triangles, components))
        if mirrors(placed.to_world):
            arrays = tuple(array[:, ::-1] for array in arrays)
        parts.append(arrays)
        if triangles.quadric is not None:
            curved.append((first, first + len(triangles), placed, triangles))
        first += len(triangles)
    if first == 0:
        raise ValueError("rasterize: the scene has no shape with geometry; there is nothing to see")
    position, normal, texcoord, color = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    shape = np.repeat(np.arange(len(shapes)), [len(part[0]) for part in parts])
    return _Placed(
        position,
        normal,
        texcoord,
        color if components else None,
        shape,
        np.array([placed.surface for placed in shapes])[shape],
        np.array([placed.node.geometry is not None and placed.node.geometry.solid for placed in shapes])[shape],
        curved,
    )


def _color(triangles: Triangles, components: int) -> np.ndarray:
    """Colours of a shape's corners with the buffer's number of components: 1 where the shape has fewer."""
    color = np.ones((len(triangles), 3, components))
    if triangles.color is not None:
        color[..., : triangles.color.shape[2]] = triangles.color
    return color


def _segments(placed: PlacedShape, camera: Camera, side: int) -> int:
    """How finely a curved primitive must be cut, from its size in the picture."""
    match placed.node.geometry:
        case nodes.Sphere(radius=radius):
            extent = radius
        case nodes.Cylinder(radius=radius, height=height) | nodes.Cone(bottom_radius=radius, height=height):
            extent = math.hypot(radius, height / 2)
        case _:
            return SEGMENTS
    largest = float(np.linalg.norm(placed.to_world[:, :3], 2))
    distance = float(np.linalg.norm(placed.to_world[:, 3] - camera.position)) - extent * largest
    scale = 1 / np.abs(np.diag(camera.pixel_to_camera(side, side))[:2]).min()
    return segments_for(scale * radius * largest / max(distance, 1e-3 * radius * largest))


def _texels(
    scene: Scene, placed: _Placed, weight: np.ndarray, number: np.ndarray, surface: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Texels and weights [N, 4] of the samples whose surface has a texture; None without textures."""
    if all(row.texture < 0 for row in scene.surfaces):
        return None
    texels = np.zeros((len(number), 4), dtype=np.int64)
    weights = np.zeros((len(number), 4))
    texture_of = np.array([row.texture for row in scene.surfaces])[surface]
    for texture, node in enumerate(scene.document.textures):
        here = np.flatnonzero(texture_of == texture)
        assert node.image is not None
        height, width = node.image.shape[:2]
        texcoord = _interpolated(weight[here], placed.texcoord, number[here])
        texels[here], weights[here] = bilinear_texels(
            texcoord, width, height, repeat_s=node.repeat_s, repeat_t=node.repeat_t
        )
    return texels, weights


def _interpolated(weight: np.ndarray, values: np.ndarray, number: np.ndarray) -> np.ndarray:
    """[N, k], corner values [T, 3, k] of triangles `number` weighted by [N, 3]."""
    return sum(weight[:, corner, None] * values[number, corner] for corner in range(3))  # type: ignore[return-value]


def _rotated(vectors: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """matrix @ vector for [..., 3], term by term: equal vectors give bitwise equal results wherever they stand, which
    a blocked matrix product does not promise, and without which a hair's breadth could open between triangles."""
    x, y, z = (vectors[..., axis] for axis in range(3))
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in matrix], axis=-1)


def _morton(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Place of a pixel on the Morton (Z-order) curve: the bits of x and y in turn."""
    code = np.zeros(len(x), dtype=np.int64)
    for bit in range(max(int(x.max(initial=0)).bit_length(), int(y.max(initial=0)).bit_length())):
        code |= ((x >> bit) & 1) << (2 * bit) | ((y >> bit) & 1) << (2 * bit + 1)
    return code


def _camera(scene: Scene, camera: Camera | nodes.Viewpoint | None) -> Camera:
    match camera:
        case Camera():
            return camera
        case nodes.Viewpoint():
            placed = [v for v in scene.document.viewpoints if v.node is camera]
            return Camera.from_viewpoint(placed[0] if placed else camera)
        case None:
            return Camera.default(scene)
        case _:
            raise ValueError(f"rasterize: camera: expected a Camera, a Viewpoint or None, got {camera!r:.60}")


def _check_size(width: int, height: int, samples: int) -> None:
    for what, value in (("width", width), ("height", height)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 1 <= value <= MAX_SIDE:
            raise ValueError(f"rasterize: {what}: expected a whole number of pixels in [1, {MAX_SIDE}], got {value!r}")
    if width * height * (samples if isinstance(samples, (int, np.integer)) else 1) > MAX_PICTURE_SAMPLES:
        raise ValueError(
            f"rasterize: {width} x {height} pixels with {samples} samples each exceed {MAX_PICTURE_SAMPLES} samples"
        )
