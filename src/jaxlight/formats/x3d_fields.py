"""How the fields of the node classes are called and written in an X3D file, derived from the classes themselves."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
import typing
from typing import Any

import numpy as np

from ..scene import nodes
from ..scene.ranges import SPOT_ANGLE, allowed_range
from . import x3d_values as values
from .x3d_values import FieldType

_BY_ANNOTATION: dict[Any, FieldType] = {
    bool: values.SFBool,
    int: values.SFInt32,
    float: values.SFFloat,
    str: values.SFString,
    nodes.Vec2: values.SFVec2f,
    nodes.Vec3: values.SFVec3f,
    nodes.Vec4: values.SFRotation,
    tuple[float, ...]: values.MFFloat,
    tuple[str, ...]: values.MFString,
}

_SMALLEST_CONE = 1e-6
"""Radians. Files write a beamWidth of 0; the range is (0, pi/2]."""

_ROUNDED = 1e-4
"""Radians by which an angle may be above its range, as files write 1.5708 for pi/2."""

_ANGLES = {
    "beam_width", "crease_angle", "cut_off_angle", "field_of_view", "orientation", "rotation", "scale_orientation",
    "sky_angle",
}  # fmt: skip

_SPOT_ANGLES_SINCE = (
    # Reading 14: (first version, beamWidth, cutOffAngle); before 3.3 the node class's own defaults.
    ((4, 0), 3 * math.pi / 16, math.pi / 2),
    ((3, 3), math.pi / 4, math.pi / 2),
)


@dataclasses.dataclass(frozen=True)
class X3DField:
    """A field of a node class as it stands in a file."""

    name: str
    """In the node class: `diffuse_color`."""
    attribute: str
    """In the file: `diffuseColor`."""
    type: FieldType
    low: float
    high: float
    """What is outside [low, high] is clamped when a file is read."""
    is_angle: bool

    def in_radians(self, value: Any, angle_unit: float) -> Any:
        """A value read in the file's angle unit (radians a unit)."""
        return self._scaled(value, angle_unit) if self.is_angle and angle_unit != 1.0 else value

    def in_file_units(self, value: Any, angle_unit: float) -> Any:
        """The inverse of `in_radians`."""
        return self._scaled(value, 1.0 / angle_unit) if self.is_angle and angle_unit != 1.0 else value

    def _scaled(self, value: Any, factor: float) -> Any:
        if not isinstance(value, tuple):
            return value * factor
        if self.type is values.MFFloat:
            return tuple(angle * factor for angle in value)
        return (*value[:3], value[3] * factor)

    def clamped(self, value: Any) -> tuple[Any, bool]:
        """The value within [low, high], and whether that changed it. A rotation about a zero axis is none."""
        if self.type is values.SFRotation and value[:3] == (0.0, 0.0, 0.0) and value[3] != 0.0:
            return (0.0, 0.0, 1.0, 0.0), True
        if self.low == -math.inf and self.high == math.inf:
            return value, False
        if isinstance(value, np.ndarray):
            inside: Any = np.clip(value, self.low, self.high)
            return inside, not np.array_equal(inside, value)
        numbers = value if isinstance(value, tuple) else (value,)
        inside = tuple([min(max(number, self.low), self.high) for number in numbers])
        return (inside if isinstance(value, tuple) else inside[0]), inside != numbers


@functools.cache
def fields_of(kind: type[nodes.Node]) -> dict[str, X3DField]:
    """The value fields of a node class by their name in the file (DEF and node-valued fields left out)."""
    hints = typing.get_type_hints(kind)
    default = kind()
    found = {}
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]  # every node class is a dataclass
        field_type = _type(kind, field.name, hints[field.name], getattr(default, field.name))
        if field_type is None or field.name in kind.accepts or field.name == "name":
            continue
        low, high = _range(kind, field.name)
        attribute = _camel_case(field.name)
        is_angle = field.name in _ANGLES
        found[attribute] = X3DField(field.name, attribute, field_type, low, high, is_angle)
    return found


@functools.lru_cache(maxsize=1024)
def meant_attribute(kind: type[nodes.Node], unknown: str) -> str | None:
    """The attribute of a class that an unknown one misspells, or None."""
    names = {name.lower(): name for name in (*fields_of(kind), "DEF", "USE", "containerField")}
    close = difflib.get_close_matches(unknown.lower(), names, n=1, cutoff=0.8)
    return names[close[0]] if close else None


def _type(kind: type[nodes.Node], name: str, hint: Any, default: Any) -> FieldType | None:
    if name == "image":
        return values.SFImage if kind is nodes.PixelTexture else None
    if isinstance(default, np.ndarray):
        return values.MFInt32 if default.ndim == 1 else values.ROWS[default.shape[1]]
    return _BY_ANNOTATION.get(hint)


def _range(kind: type[nodes.Node], name: str) -> tuple[float, float]:
    if name == "visibility_range":
        return 0.0, math.inf  # a node takes any number: none has a fog (reading 5)
    allowed = allowed_range(kind, name)
    if allowed == SPOT_ANGLE:
        return _SMALLEST_CONE, math.pi / 2 + _ROUNDED  # the node takes a rounded pi/2 for pi/2
    if name == "sky_angle":
        return 0.0, math.pi + _ROUNDED
    if name == "image" or allowed.open_below:
        return -math.inf, math.inf
    return allowed.lower, allowed.upper


def _camel_case(name: str) -> str:
    first, *others = name.rstrip("_").split("_")
    return first + "".join(word.capitalize() for word in others)


def python_name(kind: type[nodes.Node], holder: str) -> str | None:
    """The node-valued field of a class that a containerField names, or None."""
    return next((name for name in kind.accepts if _camel_case(name) == holder), None)


def version_defaults(kind: type[nodes.Node], version: tuple[int, int]) -> dict[str, Any]:
    """The defaults of a class in a version of X3D, where they differ from the class's own (reading 14)."""
    if kind is nodes.SpotLight:
        for since, beam_width, cut_off_angle in _SPOT_ANGLES_SINCE:
            if version >= since:
                return {"beam_width": beam_width, "cut_off_angle": cut_off_angle}
    return {}
