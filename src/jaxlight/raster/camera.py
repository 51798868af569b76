"""Cameras: a Viewpoint of the scene, or the intrinsics and pose of a photograph. Host side, float64."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from ..arrays import known_numbers
from ..formats.limits import MAX_PIXELS
from ..scene import Scene, nodes
from ..scene.checks import check_has_nodes
from ..scene.document import PlacedViewpoint
from ..scene.fields import number, positive, whole
from ..scene.transforms import IDENTITY, apply_to_points, rotation_matrix, unit
from .pattern import sample_pattern
from .shapes import geometries_of, world_bounds

DEFAULT_VIEWPOINT = nodes.Viewpoint()
"""What X3D binds (Navigation) when a file has no Viewpoint: at (0, 0, 10), looking along -z."""
MAX_SIDE = 1 << 15
MAX_PICTURE_SAMPLES = 1 << 26
"""Samples of one picture (8192 x 8192, one sample a pixel)."""


class Rays(NamedTuple):
    """Rays through an image: `origin` [3] and `direction` [N, 3] in world space, one unit of depth long."""

    origin: np.ndarray
    direction: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera. Camera axes: x right, y up, looking along -z, as in X3D.

    Either `field_of_view` is given and the picture may have any size, or `intrinsics` belong to pictures of one size.
    """

    position: np.ndarray
    """[3], the eye, world space."""
    rotation: np.ndarray
    """[3, 3], camera axes to world axes."""
    field_of_view: float | None = None
    """Radians across the smaller dimension of the picture (X3D Viewpoint)."""
    intrinsics: np.ndarray | None = None
    """[3, 3], camera to picture as OpenCV writes it, but with (0, 0) at the outer corner of the top left pixel."""

    def __post_init__(self) -> None:
        _set(self, "position", _finite("Camera.position", self.position, (3,)))
        _set(self, "rotation", checked_rotation("Camera.rotation", self.rotation))
        if (self.field_of_view is None) == (self.intrinsics is None):
            raise ValueError("Camera: expected either field_of_view or intrinsics")
        if self.field_of_view is not None:
            _set(self, "field_of_view", _angle("Camera.field_of_view", self.field_of_view))
        if self.intrinsics is not None:
            matrix = _finite("Camera.intrinsics", self.intrinsics, (3, 3))
            if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or np.any(matrix[[1, 2, 2], [0, 0, 1]]) or matrix[2, 2] != 1:
                raise ValueError(
                    "Camera.intrinsics: expected [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0, "
                    f"got {matrix.tolist()}"
                )
            _set(self, "intrinsics", matrix)

    @classmethod
    def from_viewpoint(cls, viewpoint: nodes.Viewpoint | PlacedViewpoint) -> Camera:
        """The camera of a Viewpoint: a node in world space, or as placed by the transforms above it.

        Of those transforms the camera takes place and attitude; scaling does not distort its picture.
        """
        if not isinstance(viewpoint, (nodes.Viewpoint, PlacedViewpoint)):
            raise ValueError(f"Camera.from_viewpoint: expected a Viewpoint, got {type(viewpoint).__name__}")
        placed = isinstance(viewpoint, PlacedViewpoint)
        node = viewpoint.node if placed else viewpoint
        to_world = viewpoint.to_world if placed else IDENTITY
        axes = to_world[:, :3] @ rotation_matrix(node.orientation)
        position = apply_to_points(to_world, np.array([node.position]))[0]
        return cls(position, _upright(-axes[:, 2], axes[:, 1]), node.field_of_view)

    @classmethod
    def look_at(cls, eye: Any, target: Any, up: Any = (0.0, 1.0, 0.0), field_of_view: float = math.pi / 4) -> Camera:
        """A camera at `eye` that looks at `target`, with `up` upwards in the picture.

        Args:
            eye, target: [3], places in world space.
            up: [3], a direction in world space, of any length.
            field_of_view: radians across the smaller dimension of the picture, in (0, pi).

        Raises:
            ValueError: eye and target coincide, `up` points along the view, or an angle out of range.
        """
        eye, target, up = (
            _finite(f"Camera.look_at: {what}", value, (3,))
            for what, value in (("eye", eye), ("target", target), ("up", up))
        )
        if np.array_equal(eye, target):
            raise ValueError(f"Camera.look_at: eye and target are the same point {eye.tolist()}")
        return cls(eye, _upright(target - eye, up), field_of_view)

    @classmethod
    def from_intrinsics(
        cls,
        intrinsics: Any = None,
        *,
        fx: float | None = None,
        fy: float | None = None,
        cx: float | None = None,
        cy: float | None = None,
        R: Any = None,
        t: Any = None,
        pixel_center: float = 0.0,
    ) -> Camera:
        """A calibrated camera in OpenCV's convention: x right, y down, z forward; x_camera = R x_world + t.

        Args:
            intrinsics: the matrix K, [3, 3], in pixels; or give fx, fy, cx, cy.
            R, t: world to camera, [3, 3] and [3]; default: the camera is the world.
            pixel_center: coordinate of the centre of the first pixel: 0 (OpenCV) or 0.5.

        Raises:
            ValueError: a shape or value that does not fit; says which.
        """
        given = [value is not None for value in (fx, fy, cx, cy)]
        if (intrinsics is not None) == any(given) or (any(given) and not all(given)):
            raise ValueError("Camera.from_intrinsics: expected a matrix K, or all of fx, fy, cx, cy")
        if intrinsics is None:
            fx, fy = (positive(f"Camera.from_intrinsics: {name}", value) for name, value in (("fx", fx), ("fy", fy)))
            cx, cy = (number(f"Camera.from_intrinsics: {name}", value) for name, value in (("cx", cx), ("cy", cy)))
            intrinsics = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
        matrix = _finite("Camera.from_intrinsics: K", intrinsics, (3, 3)).copy()
        matrix[:2, 2] += 0.5 - number("Camera.from_intrinsics: pixel_center", pixel_center)
        turn = np.eye(3) if R is None else _finite("Camera.from_intrinsics: R", R, (3, 3))
        shift = np.zeros(3) if t is None else _finite("Camera.from_intrinsics: t", t, (3,), flat=True)
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-4) or np.linalg.det(turn) < 0:
            raise ValueError(f"Camera.from_intrinsics: R: expected a rotation matrix, got {turn.tolist()}")
        u, _, v = np.linalg.svd(turn)
        turn = u @ v
        return cls(-turn.T @ shift, turn.T @ np.diag([1.0, -1.0, -1.0]), None, matrix)

    @classmethod
    def view_all(cls, scene: Scene, direction: Any = (0.0, 0.0, -1.0), field_of_view: float = math.pi / 4) -> Camera:
        """A camera that looks along `direction` from where all shapes of the scene just fit into the picture.

        Args:
            scene: the scene.
            direction: [3], world space, of any length.
            field_of_view: radians across the smaller dimension of the picture, in (0, pi).

        Raises:
            ValueError: the scene has no shape with geometry, a direction of length 0, or an angle out of range.
        """
        check_has_nodes("Camera.view_all", scene)
        field_of_view = _angle("Camera.view_all: field_of_view", field_of_view)
        sphere = bounding_sphere(scene)
        if sphere is None:
            raise ValueError("Camera.view_all: the scene has no shape with geometry to look at")
        center, radius = sphere
        toward = _finite("Camera.view_all: direction", direction, (3,))
        if not np.any(toward):
            raise ValueError("Camera.view_all: direction is zero")
        toward = unit(toward)
        up = np.array([0.0, 0.0, -1.0]) if abs(toward[1]) > 0.99 else np.array([0.0, 1.0, 0.0])
        distance = (radius or 1.0) / math.sin(field_of_view / 2)
        return cls(center - distance * toward, _upright(toward, up), field_of_view)

    @classmethod
    def default(cls, scene: Scene) -> Camera:
        """The camera that a scene is first seen with.

        The first Viewpoint (X3D Navigation). Without one: X3D's default Viewpoint if all shapes lie in its view and
        fill at least a tenth of it (or there are none), otherwise `view_all`. Browsers do either; meshes have sizes of
        their own.
        """
        check_has_nodes("Camera.default", scene)
        if scene.document.viewpoints:
            return cls.from_viewpoint(scene.document.viewpoints[0])
        default = cls.from_viewpoint(DEFAULT_VIEWPOINT)
        sphere = bounding_sphere(scene)
        if sphere is None:
            return default
        center, radius = sphere
        half = DEFAULT_VIEWPOINT.field_of_view / 2
        distance = float(np.linalg.norm(center - default.position))
        if distance > radius:
            off_axis = math.acos(max(min((default.position[2] - center[2]) / distance, 1.0), -1.0))
            seen = math.asin(radius / distance)
            if off_axis + seen <= half and seen >= half / 10:
                return default
        return cls.view_all(scene)

    def pixel_to_camera(self, width: int, height: int) -> np.ndarray:
        """From places in the picture to directions in camera axes.

        Args:
            width, height: size of the picture in pixels; `intrinsics` do not depend on it.

        Returns:
            [3, 3]: (u, v, 1) in pixels, (0, 0) the outer corner of the top left one, to a direction whose z is -1.
        """
        if self.intrinsics is not None:
            # Division by hand keeps zeros zero; camera axes are OpenCV's with y and z turned round.
            (fx, skew, cx), (_, fy, cy), _ = self.intrinsics
            return np.array(
                [[1 / fx, -skew / (fx * fy), (skew * cy / fy - cx) / fx], [0, -1 / fy, cy / fy], [0, 0, -1.0]]
            )
        assert self.field_of_view is not None
        width, height = (
            whole(f"pixel_to_camera: {name}", size, at_least=1, at_most=MAX_PIXELS)
            for name, size in (("width", width), ("height", height))
        )
        scale = 2 * math.tan(self.field_of_view / 2) / min(width, height)
        return np.array([[scale, 0, -scale * width / 2], [0, -scale, scale * height / 2], [0, 0, -1.0]])

    def pixel_to_world(self, width: int, height: int) -> np.ndarray:
        """From places in the picture to directions in world axes.

        Args:
            width, height: size of the picture in pixels; `intrinsics` do not depend on it.

        Returns:
            [3, 3]: (u, v, 1) in pixels, as for `pixel_to_camera`, to the direction of its ray, one unit of depth long.
        """
        return self.rotation @ self.pixel_to_camera(width, height)

    def rays(self, width: int, height: int, samples: int = 1) -> Rays:
        """The rays of a picture in row order.

        Args:
            width, height: size of the picture in pixels.
            samples: rays a pixel, one after the other: 1 through its centre, or more on a rotated grid.

        Returns:
            width * height * samples rays in world space.

        Raises:
            ValueError: `width` or `height` is no whole number >= 1, `samples` none in [1, 256].
        """
        offsets = sample_pattern(samples)
        width, height = picture_size("rays", width, height, len(offsets))
        u = np.arange(width)[None, :, None] + offsets[:, 0]
        v = np.arange(height)[:, None, None] + offsets[:, 1]
        points = np.stack(np.broadcast_arrays(u, v, 1.0), axis=-1).reshape(-1, 3)
        return Rays(self.position, points @ self.pixel_to_world(width, height).T)


def bounding_sphere(scene: Scene) -> tuple[np.ndarray, float] | None:
    """Centre and radius of a sphere around the bounding box of all shapes, world space; None without geometry."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    shapes = scene.document.shapes
    for placed, geometry in zip(shapes, geometries_of(shapes), strict=True):
        if (bounds := world_bounds(placed, geometry)) is not None:
            low, high = np.minimum(low, bounds[0]), np.maximum(high, bounds[1])
    if np.any(low > high):
        return None
    return (low + high) / 2, float(np.linalg.norm(high - low) / 2)


def picture_size(where: str, width: Any, height: Any, samples: int) -> tuple[int, int]:
    """Width and height of a picture of so many samples a pixel; raises ValueError if it is none, or too large."""
    width, height = (
        whole(f"{where}: {name}", size, at_least=1, at_most=MAX_SIDE, what="a whole number of pixels")
        for name, size in (("width", width), ("height", height))
    )
    if width * height * samples > MAX_PICTURE_SAMPLES:
        about = "samples" if samples > 1 else where
        raise ValueError(
            f"{about}: {width} x {height} pixels with {samples} samples each exceed {MAX_PICTURE_SAMPLES} samples"
        )
    return width, height


def checked_rotation(what: str, value: Any) -> np.ndarray:
    """The matrix [3, 3] of a rotation; raises ValueError for another."""
    rotation = _finite(what, value, (3, 3))
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
        raise ValueError(f"{what}: expected a rotation matrix, got {rotation.tolist()}")
    return rotation


def _upright(toward: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Camera axes to world: looking along `toward`, `up` upwards."""
    back = -unit(toward)
    right = np.cross(unit(up), back)
    length = np.linalg.norm(right)
    if not length > 1e-12:
        raise ValueError(f"Camera: up {up.tolist()} points along the view {toward.tolist()}")
    right = right / length
    return np.stack([right, np.cross(back, right), back], axis=1)


def _angle(what: str, radians: Any) -> float:
    allowed = "radians in (0, pi)"
    array = known_numbers(what, radians, allowed)
    if array.shape or array.dtype == bool or not 0 < array < math.pi:
        raise ValueError(f"{what}: expected {allowed}, got {radians!r:.60}")
    return float(array)


def _finite(what: str, value: Any, shape: tuple[int, ...], *, flat: bool = False) -> np.ndarray:
    """The numbers as an array; `flat`: whatever rows and columns they come in."""
    array = np.array(known_numbers(what, value, f"{list(shape)} numbers"), dtype=np.float64)
    array = array.ravel() if flat else array
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise ValueError(f"{what}: expected {list(shape)} finite numbers, got {array!r:.80}")
    array.setflags(write=False)
    return array


def _set(camera: Camera, name: str, value: Any) -> None:
    object.__setattr__(camera, name, value)
