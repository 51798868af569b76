"""Where rays meet the faces of primitives, for many faces and rays at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from .depth_buffer import BLOCK, SLACK, Boxes, DepthBuffer, bounds_of
from .quadrics import Face, root

_RIM = 64 * np.finfo(np.float64).eps
"""How much faces reach beyond their ends, of the distance to the eye: no ray slips through where two meet."""
_CUBE = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(8, 3)
"""The corners of what holds every unit primitive."""


@dataclasses.dataclass(frozen=True, eq=False)
class PreparedFaces:
    """Faces that may be seen, as functions of the pixel; two rows each where both sides are."""

    number: np.ndarray
    """[V]."""
    is_back: np.ndarray
    """[V], whether the face is seen from inside."""
    ray: np.ndarray
    """[3, 3, V], from (u, v, 1) to the direction of a ray, in the face's coordinates but for `size`."""
    size: np.ndarray
    """[V], what such a direction is too long by."""
    start: np.ndarray
    """[3, V], the eye, seen from the face's centre."""
    axes: np.ndarray
    """[3, V]."""
    tilt: np.ndarray
    level: np.ndarray
    """[V] each."""
    height: np.ndarray
    """[2, V], lowest and highest y, seen from the face's centre."""
    radius: np.ndarray
    """[V]."""
    bounds: np.ndarray
    """[4, V], least and largest u, least and largest v, in pixels."""
    nearest: np.ndarray
    """[V], no point of the face is nearer."""

    @classmethod
    def front_to_back(cls, parts: Sequence[PreparedFaces]) -> PreparedFaces | None:
        """All of them, nearest first; None if there are none."""
        if not parts:
            return None
        order = np.argsort(np.concatenate([part.nearest for part in parts]), kind="stable")
        columns = (
            np.concatenate([getattr(part, field.name) for part in parts], axis=-1) for field in dataclasses.fields(cls)
        )
        return cls(*(column[..., order] for column in columns))

    def depths(self, row: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which of the rays [N] through (u, v), in pixels, meet their face, and at which depths."""
        with np.errstate(over="ignore", invalid="ignore"):
            x, y, z = (
                self.ray[axis, 0][row] * u + self.ray[axis, 1][row] * v + self.ray[axis, 2][row] for axis in range(3)
            )
            p, q, r = (component[row] for component in self.start)
            i, j, k = (axis[row] for axis in self.axes)
            tilt, level = self.tilt[row] / 2, self.level[row]
            a = i * x * x + j * y * y + k * z * z
            b = i * p * x + j * q * y + k * r * z + tilt * y
            c = i * p * p + j * q * q + k * r * r + 2 * tilt * q - level
            # b^2 - a c without cancellation, however far away the face is (Lagrange's identity).
            away = i * j * (p * y - q * x) ** 2 + j * k * (q * z - r * y) ** 2 + k * i * (r * x - p * z) ** 2
            discriminant = level * a - away + (tilt * y) ** 2
            t = root(a, b, c, np.maximum(discriminant, 0.0), self.is_back[row])
            height = q + t * y
            hit = (discriminant >= 0) & (t > 0) & (self.height[0][row] <= height) & (height <= self.height[1][row])
            hit &= (p + t * x) ** 2 + (r + t * z) ** 2 <= self.radius[row] ** 2
            # At the apex of a cone both roots meet, and rounding may take one to the cone above: of the one below, rays
            # steeper than its side leave it there going up, and enter it going down.
            at_apex = (a < 0) & (height >= -self.height[1][row])
            hit &= ~at_apex | (self.is_back[row] == (y > 0))
        hit = np.flatnonzero(hit & np.isfinite(t))
        return hit, t[hit] / self.size[row[hit]]


def prepare_faces(
    faces: Sequence[Face],
    to_camera: np.ndarray,
    pixel_to_camera: np.ndarray,
    width: int,
    height: int,
    *,
    cull: bool,
    first_number: int = 0,
) -> PreparedFaces:
    """Set up the faces of one primitive for a picture; none if it cannot show them.

    Args:
        faces: of the unit primitive.
        to_camera: [3, 4], their coordinates to camera axes, relative to the eye; invertible.
        pixel_to_camera: [3, 3], (u, v, 1) to the direction of a ray.
        width, height: pixels.
        cull: True: not seen from inside.
        first_number: number of the first face from outside; from inside it is one more, and so on.
    """
    corners = (_CUBE @ to_camera[:, :3].T + to_camera[:, 3])[:, :, None]
    bounds = bounds_of(corners, pixel_to_camera)[:, 0]
    depth = -corners[:, 2, 0]
    is_on_picture = bounds[0] <= width and bounds[1] >= 0 and bounds[2] <= height and bounds[3] >= 0
    faces = faces if is_on_picture and np.any(depth > 0) else []
    inverse = np.linalg.inv(to_camera[:, :3])
    ray = inverse @ pixel_to_camera
    size = np.abs(ray).max()
    eye = -inverse @ to_camera[:, 3]
    sides = [
        (face, 2 * number + is_back, bool(is_back))
        for number, face in enumerate(faces)
        for is_back in range(1 if cull else 2)
    ]
    count = len(sides)
    own = [face for face, _, _ in sides]
    center = np.array([face.center for face in own]).reshape(count, 3).T
    start = eye[:, None] - center
    rim = _RIM * (1 + np.abs(eye).max())
    return PreparedFaces(
        number=np.array([number for _, number, _ in sides], dtype=np.int64) + first_number,
        is_back=np.array([is_back for _, _, is_back in sides], dtype=bool),
        ray=np.repeat((ray / size)[:, :, None], count, axis=2),
        size=np.full(count, size),
        start=start,
        axes=np.array([face.axes for face in own]).reshape(count, 3).T,
        tilt=np.array([face.tilt for face in own]),
        level=np.array([face.level for face in own]),
        height=np.array([[face.lowest - rim, face.highest + rim] for face in own]).reshape(count, 2).T - center[1],
        radius=np.array([face.radius + rim for face in own]),
        bounds=np.repeat(bounds[:, None], count, axis=1),
        nearest=np.full(count, max(depth.min(), 0.0) * (1 - SLACK)),
    )


def draw_faces(
    target: DepthBuffer, prepared: PreparedFaces, width: int, height: int, offset: tuple[float, float]
) -> None:
    """Test all faces where they may be seen; `offset`: where in its pixel a ray goes through."""
    for boxes in Boxes.within(prepared.bounds, width, height, offset).split(BLOCK):
        target.draw(prepared, boxes.select(prepared.nearest[boxes.row] <= target.farthest(boxes)), offset)
        target.note_depths()
