"""A scene seen by a camera -> the samples of its visible surface points."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np

from ..scene import Scene, nodes
from ..scene.checks import check_has_nodes
from ..scene.fields import float_type, type_or_own
from .camera import Camera, picture_size
from .depth_buffer import rows_of
from .face_depth import PreparedFaces
from .pattern import morton, sample_pattern
from .placed import Hits, PlacedShapes
from .sample_rows import SampleRows
from .samples import MANY_LIGHTS, SampleBuffer
from .visibility import Prepared, barycentric, first_hits

TOO_FAR = 1e4
"""How many times its own size what is seen may lie from the origin: 3 of the 7 digits of float32 are left there."""


def rasterize(
    scene: Scene,
    camera: Camera | nodes.Viewpoint | None = None,
    width: int = 512,
    height: int | None = None,
    samples: int = 1,
    *,
    dtype: Any = None,
) -> SampleBuffer:
    """The visible surface points of a scene, one a ray: first hit, exact in float64; background left out.

    Back faces are not seen where `solid` is TRUE; elsewhere their normals are turned round. Transparent shapes hide
    what is behind them (one layer). Spheres, cylinders and cones are exact: outline, surface, normals and texture
    coordinates.

    Args:
        scene: the scene.
        camera: a Camera, a Viewpoint (of the scene: with the transforms above it), or None: `Camera.default`.
        width, height: size of the picture in pixels; a height of None is the width.
        samples: rays a pixel: 1 through its centre, or k on a rotated grid, each of which covers 1/k of the pixel.
        dtype: float type of the buffer, as in `SampleBuffer.create`.

    Returns:
        Samples surface by surface, those that the same code colours after each other, and within a surface along a
        Morton curve over the pixels, so that neighbours in the buffer are neighbours in the picture (under many lights:
        in space). `pixel` counts row by row from the top left.

    Raises:
        ValueError: a size that is not a whole number in range, another type, a geometry with a bad index, one that
            lies farther from the origin than 1e100, too many triangles (more than 2^25 of all placed shapes together).

    Warns:
        UserWarning: nothing is seen, or the scene has no geometry; the buffer then has no samples. Or what is seen
            lies so far from the origin that its places keep few digits in `dtype` (float32 and smaller).
    """
    check_has_nodes("rasterize: scene", scene)
    dtype = float_type("rasterize: dtype", dtype)
    offsets = sample_pattern(samples)
    width, height = picture_size("rasterize", width, width if height is None else height, len(offsets))
    camera = _camera(scene, camera)
    placed = PlacedShapes.of(scene)
    triangles, faces = placed.prepared(camera, width, height)
    seen = _Seen.joined([_seen(triangles, faces, width, height, offset) for offset in offsets.tolist()])
    surface = placed.surface_of(seen.number)
    rank = _rank_of_surfaces(scene)
    order = np.lexsort((morton(seen.x, seen.y), rank[surface]))
    seen = _Seen(*(part[order] for part in seen))
    if len(order) == 0:
        reason = "the camera sees no surface" if placed.first[-1] else "no shape of the scene has geometry"
        warnings.warn(f"rasterize: {reason}; the picture is all background", stacklevel=2)
    pixel_to_world = camera.pixel_to_world(width, height)
    attributes = placed.attributes(camera.position, _hits(triangles, faces, seen, pixel_to_world))
    _warn_if_far(attributes.position, camera.position, type_or_own(dtype))
    given = SampleRows(
        **attributes._asdict(),
        eye=camera.position,
        surface=surface[order],
        pixel=seen.y * width + seen.x,
        coverage=None if len(offsets) == 1 else np.full(len(order), 1.0 / len(offsets)),
        width=width,
        height=height,
        camera_to_world=camera.rotation,
        pixel_to_world=pixel_to_world,
    )
    by_place = any(lights is not None and len(lights.names) >= MANY_LIGHTS for lights in (scene.point, scene.spot))
    return SampleBuffer.from_rows(given, by_place=by_place, dtype=dtype, rank=rank)


def _rank_of_surfaces(scene: Scene) -> np.ndarray:
    """In which order surfaces are stored: each change of code is compiled."""
    codes = [(surface.code(scene.textures), surface.texture) for surface in scene.surfaces]
    rank = np.empty(len(codes), dtype=np.int64)
    rank[sorted(range(len(codes)), key=codes.__getitem__)] = np.arange(len(codes))
    return rank


def _warn_if_far(position: np.ndarray, eye: np.ndarray, dtype: np.dtype) -> None:
    if dtype == np.float64:
        return
    places = np.concatenate([position, eye[None]])
    size, distance = np.ptp(places, axis=0).max(), np.abs(places).max()
    if distance > TOO_FAR * size > 0:
        warnings.warn(
            f"rasterize: the scene lies {distance:.3g} from the origin, and what is seen of it is {size:.3g} in size: "
            f"few digits of its places are left in {dtype}; move it to the origin, or use float64",
            stacklevel=3,
        )


class _Seen(NamedTuple):
    """Rays that meet something: pixel column and row, place in the picture, number and depth of what is met."""

    x: np.ndarray
    y: np.ndarray
    u: np.ndarray
    v: np.ndarray
    number: np.ndarray
    depth: np.ndarray

    @classmethod
    def joined(cls, parts: list[_Seen]) -> _Seen:
        return cls(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _seen(triangles: Prepared, faces: PreparedFaces | None, width: int, height: int, offset: list[float]) -> _Seen:
    pixel, number, depth = first_hits(triangles, faces, width, height, (offset[0], offset[1]))
    y, x = np.divmod(pixel, width)
    return _Seen(x, y, x + offset[0], y + offset[1], number, depth)


def _hits(triangles: Prepared, faces: PreparedFaces | None, seen: _Seen, pixel_to_world: np.ndarray) -> Hits:
    row = rows_of(triangles.number, seen.number)
    on_triangle = row >= 0
    weight, is_back = np.zeros((len(row), 3)), np.zeros(len(row), dtype=bool)
    weight[on_triangle] = barycentric(triangles, row[on_triangle], seen.u[on_triangle], seen.v[on_triangle])
    is_back[on_triangle] = triangles.is_back[row[on_triangle]]
    if faces is not None:
        is_back[~on_triangle] = faces.is_back[rows_of(faces.number, seen.number[~on_triangle])]
    direction = np.stack([seen.u, seen.v, np.ones_like(seen.u)], axis=1) @ pixel_to_world.T
    return Hits(seen.number, seen.depth[:, None] * direction, weight, is_back)


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
