"""Samples from maps: photographs whose geometry comes from elsewhere (photometric stereo, scanners, networks)."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np

from ..formats.levels import is_chosen
from ..scene.fields import boolean, float_type, positive, type_or_own, vector3
from .camera import Camera, checked_rotation
from .map_values import check_shape, fitted, is_path, map_values, surface_numbers
from .pattern import morton
from .samples import SampleBuffer

FAR = 1e6
"""How far off the eye of an orthographic view stands, in units of the seen area's size."""
OVERSHOOT = 0.25
"""By which colours that hold normals may leave [0, 1]: filters that make pictures smaller do so at edges."""
GREY = 0.6 / 255
"""How near to one half all of a colour's channels are where it holds no normal: 8 bits have 127 and 128 there."""
_ENCODINGS, _FRAMES, _DEPTHS = ("vector", "color"), ("camera", "world"), ("z", "distance")


@dataclasses.dataclass(frozen=True, eq=False)
class Orthographic:
    """A view along parallel rays, as photometric stereo assumes; axes as a Camera's (x right, y up, z to the viewer).

    The lighting equation has an eye point. It is put FAR (1e6) sizes of the seen area away, so that every direction to
    the viewer is true to 1e-6 radians; only fog, which asks for that distance, has no meaning then. A float16 buffer
    holds no number above 65504: the eye then stands as far away as that allows, at least 1024 sizes, and the directions
    are true to one size by its distance, 1e-3 radians at most. Half precision also rounds the eye, which turns all of
    them alike, by up to 2^-11 (float16) or 2^-8 (bfloat16) radians.
    """

    pixel_size: float = 1.0
    """Side of a pixel in units of the scene."""
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """World position that the middle of the picture shows at depth 0."""
    rotation: np.ndarray = dataclasses.field(default_factory=lambda: np.eye(3))
    """[3, 3], camera axes to world axes."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixel_size", positive("Orthographic.pixel_size", self.pixel_size))
        object.__setattr__(self, "center", vector3("Orthographic.center", self.center))
        object.__setattr__(self, "rotation", checked_rotation("Orthographic.rotation", self.rotation))

    def pixel_to_world(self, width: int, height: int) -> np.ndarray:
        """As of a Camera, of whose pixels each has a ray of its own; here all are one."""
        return np.outer(-self.rotation[:, 2], (0.0, 0.0, 1.0))


def samples_from_maps(
    normal: Any,
    view: Camera | Orthographic,
    *,
    position: Any = None,
    depth: Any = None,
    mask: Any = None,
    color: Any = None,
    surface: Any = 0,
    normal_encoding: Literal["vector", "color"] | None = None,
    normal_frame: Literal["camera", "world"] = "camera",
    normal_y_down: bool = False,
    position_frame: Literal["camera", "world"] = "world",
    depth_kind: Literal["z", "distance"] = "z",
    texel_per_pixel: bool = False,
    dtype: Any = None,
) -> SampleBuffer:
    """One sample for every pixel of maps that show a surface. Row 0 of every map is the top of the picture.

    Each map is an array, or the path of an .npy, .npz (the array named as the argument, or the only one) or image file.

    Args:
        normal: [height, width, 3], any length.
        view: where the picture was taken from; a Camera with intrinsics belongs to pictures of this size.
        position: [height, width, 3]. Give this or `depth`.
        depth: [height, width], or one number for all, which will do where only directional lights shine. Whole numbers
            of an array, .npy or .npz stand as they are; those of an image file are, as in `read_image`, divided by the
            largest of their size (for the millimetres of a 16-bit PNG give 65535 * read_image(path)).
        mask: [height, width], True (or from one half on) where there is a surface. Default: where normal and depth are
            finite and the normal is not zero. Of normals held as colours zero is mid grey (127 or 128 of 255 in all
            channels), and neither black pixels (0 in all channels) nor clear ones (alpha 0) hold a normal.
        color: [height, width, 3 or 4], colours in the place of vertex colours, shown by shapes that have some.
        surface: row in `Scene.surfaces`, one for all or [height, width]; of a PNG or TIFF its grey levels of 8 or 16
            bits, or its palette indices, are the rows.
        normal_encoding: "vector": the numbers are components; "color": n = 2 c - 1, as colour images hold normals.
            Default: "color" for image files other than EXR, "vector" for everything else.
        normal_frame: axes of the normals: "camera" (x right, y up, z to the viewer) or "world".
        normal_y_down: the map's y points down (its green channel is turned round).
        position_frame: axes and origin of the positions; "camera" for an Orthographic view: its centre.
        depth_kind: "z": distance from the plane of the eye (from the plane of `center` for an Orthographic view), as
            depth cameras and renderers give it; "distance": from the eye along the ray.
        texel_per_pixel: give each pixel the texel of its own in a texture [height, width], whose row 0 is at the
            bottom: per-pixel unknowns (albedo) are then a texture of the scene.
        dtype: float type of the buffer, as in `SampleBuffer.create`.

    Returns:
        Samples in Morton order over the pixels; `pixel` counts row by row from the top left.

    Raises:
        ValueError: a shape, an option or a value (inside the mask) that does not fit; says which map and where. The
            area that an Orthographic view shows is too large for an eye in `dtype`.
    """
    _check_options(view, normal_encoding, normal_frame, position_frame, depth_kind, position, depth)
    dtype = float_type("samples_from_maps: dtype", dtype)
    normal_y_down = boolean("samples_from_maps: normal_y_down", normal_y_down)
    texel_per_pixel = boolean("samples_from_maps: texel_per_pixel", texel_per_pixel)
    vectors, encoding = map_values("normal", normal, _check_normal)
    height, width = vectors.shape[:2]
    empty = outside = np.zeros((height, width), bool)
    vectors, given = vectors[..., :3], vectors
    if (normal_encoding or encoding) == "color":
        empty = _is_empty(given)
        outside = np.any((vectors < -OVERSHOOT) | (vectors > 1 + OVERSHOOT), axis=2)
        vectors = 2 * vectors - 1
    if normal_y_down:
        vectors = vectors * [1.0, -1.0, 1.0]
    if normal_frame == "camera":
        vectors = _turned(vectors, view)
    points = _points(view, position, depth, position_frame, depth_kind, height, width)

    finite = np.all(np.isfinite(vectors), axis=2) & np.all(np.isfinite(points), axis=2)
    if mask is None:
        seen = finite & np.any(vectors != 0, axis=2) & ~empty
    else:
        seen = is_chosen(_map("mask", mask, height, width, None))
        _refuse_pixels(seen & ~finite, "pixels inside the mask have a normal or a position that is not finite")
    _refuse_pixels(seen & outside, "pixels have a normal that is no colour in [0, 1] (divide levels by the largest)")
    if not np.any(seen):
        raise ValueError("samples_from_maps: no pixel shows a surface: mask, normal and depth leave none")
    rows, columns = np.nonzero(seen)
    order = np.argsort(morton(columns, rows), kind="stable")
    rows, columns = rows[order], columns[order]
    eye = view.position if isinstance(view, Camera) else _far_eye(view, points[rows, columns], dtype)
    texel = (height - 1 - rows) * width + columns
    return SampleBuffer.create(
        points[rows, columns],
        vectors[rows, columns],
        eye,
        surface=_surface(surface, height, width, rows, columns),
        color=None if color is None else _color(color, height, width)[rows, columns],
        texel_index=np.repeat(texel[:, None], 4, axis=1) if texel_per_pixel else None,
        texel_weight=np.tile([1.0, 0.0, 0.0, 0.0], (len(texel), 1)) if texel_per_pixel else None,
        pixel=rows * width + columns,
        width=width,
        height=height,
        camera_to_world=view.rotation,
        pixel_to_world=view.pixel_to_world(width, height),
        dtype=dtype,
    )


def _turned(vectors: np.ndarray, view: Camera | Orthographic) -> np.ndarray:
    """Vectors of camera axes in world axes."""
    with np.errstate(invalid="ignore"):  # of infinite components, where there is no surface
        return vectors @ view.rotation.T


def _is_empty(colors: np.ndarray) -> np.ndarray:
    """Which colours [height, width, 3 or 4] hold no normal: clear, black or mid grey ones."""
    clear = np.zeros(colors.shape[:2], bool) if colors.shape[2] == 3 else colors[..., 3] == 0
    black = np.all(colors[..., :3] == 0, axis=2)
    return clear | black | np.all(np.abs(colors[..., :3] - 0.5) < GREY, axis=2)


def _refuse_pixels(bad: np.ndarray, what: str) -> None:
    """Raise ValueError for pixels [height, width] if there are any."""
    if np.any(bad):
        row, column = np.argwhere(bad)[0]
        raise ValueError(f"samples_from_maps: {np.count_nonzero(bad)} {what}, the first at row {row}, column {column}")


def _points(
    view: Camera | Orthographic,
    position: Any,
    depth: Any,
    position_frame: str,
    depth_kind: str,
    height: int,
    width: int,
) -> np.ndarray:
    """World positions [height, width, 3]."""
    origin = np.asarray(view.position if isinstance(view, Camera) else view.center)
    if position is not None:
        points = _map("position", position, height, width, 3)
        return _turned(points, view) + origin if position_frame == "camera" else points
    away = _map("depth", depth, height, width, None, or_one=True)
    away = np.full((height, width), float(away)) if away.ndim == 0 else away
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    if isinstance(view, Orthographic):
        x, y = (u - width / 2) * view.pixel_size, (height / 2 - v) * view.pixel_size
        return _turned(np.stack([x, y, -away], axis=-1), view) + origin
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ view.pixel_to_world(width, height).T
    if depth_kind == "distance":
        rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        return np.where(away[..., None] > 0, away[..., None], np.nan) * rays + origin


def _far_eye(view: Orthographic, points: np.ndarray, dtype: Any) -> np.ndarray:
    """FAR sizes away; in a type that does not hold that, as far as it holds, if its digits do not tell."""
    size = max(float(np.linalg.norm(np.ptp(points, axis=0))), view.pixel_size)
    middle, about = points.mean(axis=0), jnp.finfo(type_or_own(dtype))
    largest = float(about.max)
    distance, least = min(FAR * size, largest - np.abs(middle).max()), min(FAR, 1 / float(about.eps))
    if distance < least * size:
        raise ValueError(
            f"samples_from_maps: view: the eye of an Orthographic view stands at least {least:g} sizes of what is seen "
            f"({size:g}) away, farther than {about.dtype} holds ({largest:g}); give a smaller pixel_size (positions "
            "in a larger unit, nearer to the origin), or a dtype that holds more"
        )
    return np.clip(middle + view.rotation[:, 2] * distance, -largest, largest)


def _surface(surface: Any, height: int, width: int, rows: np.ndarray, columns: np.ndarray) -> Any:
    if np.ndim(surface) == 0 and not is_path(surface):
        return surface
    numbers = surface_numbers(surface, functools.partial(_check_surface, height=height, width=width))
    if numbers.ndim == 0:
        return numbers
    if numbers.shape != (height, width) or numbers.dtype.kind not in "iu":
        raise ValueError(
            f"samples_from_maps: surface: expected a row of Scene.surfaces or integers of shape {[height, width]}, "
            f"got {numbers.dtype} {list(numbers.shape)}"
        )
    return numbers[rows, columns]


def _color(color: Any, height: int, width: int) -> np.ndarray:
    return map_values("color", color, functools.partial(check_shape, height=height, width=width, channels=3))[0]


def _map(what: str, value: Any, height: int, width: int, channels: int | None, *, or_one: bool = False) -> np.ndarray:
    """A map of this size, [height, width] without `channels`; or one number, if that will do."""

    def fits(shape: tuple[int, ...]) -> None:
        if shape or not or_one:
            check_shape(shape, height, width, channels)

    numbers = map_values(what, value, fits)[0]
    return numbers if or_one and numbers.ndim == 0 else fitted(what, numbers, channels)


def _check_normal(shape: tuple[int, ...]) -> None:
    if len(shape) != 3 or shape[2] not in (3, 4) or 0 in shape:
        raise ValueError(f"expected [height, width, 3], got {list(shape)}")


def _check_surface(shape: tuple[int, ...], height: int, width: int) -> None:
    if shape not in ((), (height, width)):
        raise ValueError(
            f"expected a row of Scene.surfaces or integers of shape {[height, width]}, got shape {list(shape)}"
        )


def _check_options(
    view: Any, encoding: Any, normal_frame: Any, position_frame: Any, depth_kind: Any, position: Any, depth: Any
) -> None:
    if not isinstance(view, (Camera, Orthographic)):
        raise ValueError(f"samples_from_maps: view: expected a Camera or an Orthographic view, got {view!r:.60}")
    if (position is None) == (depth is None):
        raise ValueError("samples_from_maps: expected either position or depth (one number will do as depth)")
    for what, value, allowed in (
        ("normal_encoding", encoding, (None, *_ENCODINGS)),
        ("normal_frame", normal_frame, _FRAMES),
        ("position_frame", position_frame, _FRAMES),
        ("depth_kind", depth_kind, _DEPTHS),
    ):
        if not isinstance(value, str | None) or value not in allowed:
            expected = " or ".join(repr(word) for word in allowed if word is not None)
            raise ValueError(f"samples_from_maps: {what}: expected {expected}, got {value!r:.60}")
