"""The node hierarchy of a mesh file -> nested X3D Transforms."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from ..scene.nodes import Group, Node, Transform
from .limits import MAX_NESTING

_SAME = 1e-9
"""Relative difference up to which a matrix counts as the product of rotation and scale along the axes."""


def transform_from_matrix(matrix: np.ndarray, *, children: tuple[Node, ...] = (), name: str = "") -> Transform:
    """The Transform whose matrix is the given affine one [4, 4] (X3D Transform): T R, then a stretch along some axes.

    Any matrix that can be inverted is such a product: by its polar decomposition, R is a rotation and the rest
    stretches (or mirrors) along three directions at right angles, which scaleOrientation turns the axes to.
    """
    linear = np.asarray(matrix, dtype=np.float64)[:3, :3]
    translation = tuple(np.asarray(matrix, dtype=np.float64)[:3, 3].tolist())
    scale = np.linalg.norm(linear, axis=0)
    if np.linalg.det(linear) < 0:
        scale = -scale
    with np.errstate(divide="ignore", invalid="ignore"):
        rotation = linear / scale
    along_axes = bool(np.all(np.isfinite(rotation))) and np.allclose(rotation.T @ rotation, np.eye(3), atol=_SAME)
    orientation = np.eye(3)
    if not along_axes:
        left, stretch, right = np.linalg.svd(linear)
        sign = np.sign(np.linalg.det(left @ right)) or 1.0
        rotation, scale = sign * (left @ right), sign * stretch
        orientation = right.T * (np.sign(np.linalg.det(right)) or 1.0)
    return Transform(
        translation=translation,
        rotation=_axis_angle(rotation),
        scale=tuple(scale.tolist()),
        scale_orientation=_axis_angle(orientation),
        children=children,
        name=name,
    )


def _axis_angle(rotation: np.ndarray) -> tuple[float, float, float, float]:
    """Axis (a unit vector) and angle of a rotation matrix; well conditioned at every angle, also near 0 and pi."""
    m = rotation
    # Four times the products of the quaternion's components; the row of the largest square has all digits.
    products = np.array(
        [
            [1 + m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1 - m[0, 0] + m[1, 1] - m[2, 2], m[1, 2] + m[2, 1]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 - m[0, 0] - m[1, 1] + m[2, 2]],
        ]
    )
    w, *axis = products[int(np.argmax(np.diag(products)))].tolist()
    length = math.hypot(*axis)
    if length == 0.0:
        return 0.0, 0.0, 1.0, 0.0
    x, y, z = (component / length for component in axis)
    return x, y, z, 2.0 * math.atan2(length, w)


def nested_transforms(
    root: str, edges: Iterable[tuple[str, str, dict[str, Any]]], shape_of: Callable[[str], Node | None]
) -> tuple[Node, ...]:
    """The nodes below `root`: one Transform an edge (a plain Group, or its only child, where it moves nothing).

    Args:
        root: name of the world frame.
        edges: (parent, child, {"matrix": [4, 4], "geometry": its name or None}).
        shape_of: the Shape of a geometry; the same one each time it is asked for.

    Raises:
        ValueError: nesting deeper than MAX_NESTING.
    """
    below: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for parent, child, attributes in edges:
        below.setdefault(parent, []).append((child, attributes))

    def place(frame: str, depth: int) -> tuple[Node, ...]:
        if depth > MAX_NESTING:
            raise ValueError(f"nodes nested deeper than {MAX_NESTING}")
        placed: list[Node] = []
        for child, attributes in below.get(frame, ()):
            shape = shape_of(attributes["geometry"]) if attributes.get("geometry") else None
            children = (*(() if shape is None else (shape,)), *place(child, depth + 1))
            matrix = np.asarray(attributes.get("matrix", np.eye(4)), dtype=np.float64)
            if not children:
                continue
            if not np.array_equal(matrix, np.eye(4)):
                placed.append(transform_from_matrix(matrix, children=children, name=child))
            elif len(children) == 1:
                placed.append(children[0])
            else:
                placed.append(Group(children=children, name=child))
        return tuple(placed)

    return place(root, 0)
