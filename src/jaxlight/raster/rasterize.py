"""A scene seen by a camera -> the samples of its visible surface points."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np

from ..scene import Scene, nodes
from .camera import Camera
from .pattern import morton, sample_pattern
from .placed import PlacedTriangles
from .samples import MANY_LIGHTS, SampleBuffer
from .visibility import barycentric, first_hits

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
        buffer are neighbours in the picture (under many lights: in space). `pixel` counts row by row from the top left.

    Raises:
        ValueError: a size that is not a whole number in range, a geometry with a bad index, too many triangles (more
            than 2^25 of all placed shapes together).

    Warns:
        UserWarning: nothing is seen, or the scene has no geometry; the buffer then has no samples.
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"rasterize: scene: expected a Scene, got {type(scene).__name__}")
    width, height = _size(width, height, samples)
    offsets = sample_pattern(samples)
    camera = _camera(scene, camera)
    placed = PlacedTriangles.of(scene, camera, width, height)
    prepared = placed.prepared(camera, width, height)
    hits = [_Hits.of(*first_hits(prepared, width, height, offset), width, offset) for offset in offsets.tolist()]
    seen = _Hits(*(np.concatenate(parts) for parts in zip(*hits, strict=True)))
    surface = placed.surface_of(prepared.number[seen.row])
    order = np.lexsort((morton(seen.x, seen.y), surface))
    seen = _Hits(*(part[order] for part in seen))
    if len(order) == 0:
        reason = "the camera sees no surface" if placed.first[-1] else "no shape of the scene has geometry"
        warnings.warn(f"rasterize: {reason}; the picture is all background", stacklevel=2)
    attributes = placed.attributes(
        camera.position,
        prepared.number[seen.row],
        barycentric(prepared, seen.row, seen.u, seen.v),
        prepared.is_back[seen.row],
    )
    return SampleBuffer.create(
        **attributes._asdict(),
        eye=camera.position,
        surface=surface[order],
        pixel=seen.y * width + seen.x,
        coverage=None if samples == 1 else np.full(len(order), 1.0 / samples),
        width=width,
        height=height,
        camera_to_world=camera.rotation,
        pixel_to_world=camera.pixel_to_world(width, height),
        by_place=any(lights is not None and len(lights.names) >= MANY_LIGHTS for lights in (scene.point, scene.spot)),
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


def _size(width: int, height: int, samples: int) -> tuple[int, int]:
    """Width and height as Python's integers, which neither overflow nor pass for arrays."""
    for what, value in (("width", width), ("height", height)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 1 <= value <= MAX_SIDE:
            raise ValueError(f"rasterize: {what}: expected a whole number of pixels in [1, {MAX_SIDE}], got {value!r}")
    width, height = int(width), int(height)
    if width * height * (int(samples) if isinstance(samples, (int, np.integer)) else 1) > MAX_PICTURE_SAMPLES:
        raise ValueError(
            f"rasterize: {width} x {height} pixels with {samples} samples each exceed {MAX_PICTURE_SAMPLES} samples"
        )
    return width, height
