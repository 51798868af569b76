"""X3D nodes as a person writes them: frozen host-side data with the specification's fields, defaults and ranges.

A scene built from these in Python and the same scene read from a file are the same thing. A node that appears twice
in the tree (X3D's USE) is the same Python object twice. Nodes compare by identity; `nodes_equal` compares content.

Clause numbers of X3D, here and in other files, are those of ISO/IEC 19775-1:2008 (X3D 3.2). Where there is none, the
component or the node is named: (X3D Rendering).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, ClassVar

import numpy as np

from ..given import several
from .fields import (
    axis_angle,
    boolean,
    choice,
    color,
    direction,
    factors,
    index_list,
    integer,
    lengths,
    non_negative,
    number,
    positive,
    reach,
    rgb_rows,
    rgba_rows,
    rising_angles,
    spot_angle,
    string,
    strings,
    texture_image,
    unit_interval,
    vector2,
    vector2_rows,
    vector3,
    vector3_rows,
)

Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]


def _field(default: Any, check: Any) -> Any:
    """A field with its default and the check (and canonical form) of its value."""
    return dataclasses.field(default=default, metadata={"check": check})


def _nodes() -> Any:
    return dataclasses.field(default=(), metadata={"check": None})


def _node() -> Any:
    return dataclasses.field(default=None, metadata={"check": None})


class Node:
    """What all nodes share: the DEF name, and a check of every field when the node is made.

    Raises ValueError that names the node, the field, what came and what is allowed.
    """

    # The kinds of node that each node-valued field takes, by field name.
    accepts: ClassVar[dict[str, tuple[str, ...]]] = {}
    name: str

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]  # every subclass is a dataclass
            value = getattr(self, field.name)
            check = field.metadata.get("check")
            if check is not None:
                object.__setattr__(self, field.name, check(f"{self.label}.{field.name}", value))
            elif field.name in self.accepts:
                object.__setattr__(self, field.name, self._checked_nodes(field.name, field.default, value))

    @property
    def label(self) -> str:
        """How messages name this node: `Material[body]`, or `Material` without a DEF name."""
        name = getattr(self, "name", "")
        return f"{type(self).__name__}[{name}]" if isinstance(name, str) and name else type(self).__name__

    def _checked_nodes(self, field: str, default: Any, value: Any) -> Any:
        allowed = self.accepts[field]

        def check(node: Any) -> None:
            if not isinstance(node, Node) or ("*" not in allowed and type(node).__name__ not in allowed):
                kinds = "any node" if "*" in allowed else " or ".join(allowed)
                raise ValueError(f"{self.label}.{field}: expected {kinds}, got {node!r:.80}")

        if isinstance(default, tuple):
            for child in (children := tuple(several(value))):
                check(child)
            return children
        if value is not None:
            check(value)
        return value


# --- grouping (X3D clause 10) ---------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Group(Node):
    """Children in the parent's coordinate system (X3D Grouping)."""

    accepts = {"children": ("*",)}
    children: tuple[Node, ...] = _nodes()
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Transform(Node):
    """Children in their own coordinate system (X3D Grouping).

    Translate, centre, rotate, scale along `scale_orientation`.
    `rotation` and `scale_orientation` are (x, y, z, angle in radians). Where a number of `scale` is 0 nothing below is
    shown, and no light there shines.
    """

    accepts = {"children": ("*",)}
    center: Vec3 = _field((0.0, 0.0, 0.0), vector3)
    children: tuple[Node, ...] = _nodes()
    rotation: Vec4 = _field((0.0, 0.0, 1.0, 0.0), axis_angle)
    scale: Vec3 = _field((1.0, 1.0, 1.0), vector3)
    scale_orientation: Vec4 = _field((0.0, 0.0, 1.0, 0.0), axis_angle)
    translation: Vec3 = _field((0.0, 0.0, 0.0), vector3)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Switch(Node):
    """The child number `which_choice`, or none of them when it is -1 or too large (X3D Grouping)."""

    accepts = {"children": ("*",)}
    children: tuple[Node, ...] = _nodes()
    which_choice: int = _field(-1, integer)
    name: str = _field("", string)


# --- shape and appearance (X3D clauses 12 and 18) ---------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Material(Node):
    """The Phong material of the lighting equation (X3D 12.4.4, 17.2.2.4). Colours are RGB, all fields in [0, 1]."""

    ambient_intensity: float = _field(0.2, unit_interval)
    diffuse_color: Vec3 = _field((0.8, 0.8, 0.8), color)
    emissive_color: Vec3 = _field((0.0, 0.0, 0.0), color)
    shininess: float = _field(0.2, unit_interval)
    specular_color: Vec3 = _field((0.0, 0.0, 0.0), color)
    transparency: float = _field(0.0, unit_interval)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ImageTexture(Node):
    """A texture read from a file (X3D Texturing).

    `image` holds the decoded values, [height, width, components] in [0, 1], row 0 at the bottom (t = 0), one to four
    components; None when the file could not be had: the texture then counts as absent.
    """

    image: np.ndarray | None = _field(None, texture_image)
    repeat_s: bool = _field(True, boolean)
    repeat_t: bool = _field(True, boolean)
    url: tuple[str, ...] = _field((), strings)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PixelTexture(Node):
    """A texture written out in the file (X3D Texturing); `image` as in ImageTexture."""

    image: np.ndarray | None = _field(None, texture_image)
    repeat_s: bool = _field(True, boolean)
    repeat_t: bool = _field(True, boolean)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class TextureTransform(Node):
    """A 2-D transform of texture coordinates (X3D 18.4.8); `rotation` in radians."""

    center: Vec2 = _field((0.0, 0.0), vector2)
    rotation: float = _field(0.0, number)
    scale: Vec2 = _field((1.0, 1.0), vector2)
    translation: Vec2 = _field((0.0, 0.0), vector2)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Appearance(Node):
    """What a shape looks like (X3D 12.4.1). No material: the shape is unlit (X3D 17.2.2.2)."""

    accepts = {
        "material": ("Material",),
        "texture": ("ImageTexture", "PixelTexture"),
        "texture_transform": ("TextureTransform",),
    }
    material: Material | None = _node()
    texture: ImageTexture | PixelTexture | None = _node()
    texture_transform: TextureTransform | None = _node()
    name: str = _field("", string)


_GEOMETRY = ("Box", "Cone", "Cylinder", "Sphere", "IndexedFaceSet", "IndexedTriangleSet", "TriangleSet")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Shape(Node):
    """A geometry with its appearance (X3D Shape). `geometry` may be None: a material whose pixels come from maps."""

    accepts = {"appearance": ("Appearance",), "geometry": _GEOMETRY}
    appearance: Appearance | None = _node()
    geometry: Node | None = _node()
    name: str = _field("", string)


# --- geometry (X3D clauses 11 and 13) ---------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Box(Node):
    """A box centred at the origin (X3D 13.3.1); `size` along x, y, z."""

    size: Vec3 = _field((2.0, 2.0, 2.0), lengths)
    solid: bool = _field(True, boolean)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Cone(Node):
    """A cone around the y axis, centred at the origin (X3D 13.3.2)."""

    bottom: bool = _field(True, boolean)
    bottom_radius: float = _field(1.0, positive)
    height: float = _field(2.0, positive)
    side: bool = _field(True, boolean)
    solid: bool = _field(True, boolean)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Cylinder(Node):
    """A cylinder around the y axis, centred at the origin (X3D 13.3.3)."""

    bottom: bool = _field(True, boolean)
    height: float = _field(2.0, positive)
    radius: float = _field(1.0, positive)
    side: bool = _field(True, boolean)
    solid: bool = _field(True, boolean)
    top: bool = _field(True, boolean)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Sphere(Node):
    """A sphere centred at the origin (X3D 13.3.7)."""

    radius: float = _field(1.0, positive)
    solid: bool = _field(True, boolean)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Coordinate(Node):
    """Vertex positions [n, 3] (X3D Rendering)."""

    point: np.ndarray = _field((), vector3_rows)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Normal(Node):
    """Normal vectors [n, 3] (X3D Rendering)."""

    vector: np.ndarray = _field((), vector3_rows)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Color(Node):
    """RGB colours [n, 3] in [0, 1] (X3D Rendering)."""

    color: np.ndarray = _field((), rgb_rows)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ColorRGBA(Node):
    """RGBA colours [n, 4] in [0, 1] (X3D Rendering)."""

    color: np.ndarray = _field((), rgba_rows)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class TextureCoordinate(Node):
    """Texture coordinates [n, 2] (X3D Texturing)."""

    point: np.ndarray = _field((), vector2_rows)
    name: str = _field("", string)


_VERTEX_DATA = {
    "color": ("Color", "ColorRGBA"),
    "coord": ("Coordinate",),
    "normal": ("Normal",),
    "tex_coord": ("TextureCoordinate",),
}


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class IndexedFaceSet(Node):
    """Polygons given by indices, each ended by -1 (X3D 13.3.6). `crease_angle` in radians."""

    accepts = _VERTEX_DATA
    ccw: bool = _field(True, boolean)
    color: Color | ColorRGBA | None = _node()
    color_index: np.ndarray = _field((), index_list)
    color_per_vertex: bool = _field(True, boolean)
    convex: bool = _field(True, boolean)
    coord: Coordinate | None = _node()
    coord_index: np.ndarray = _field((), index_list)
    crease_angle: float = _field(0.0, non_negative)
    normal: Normal | None = _node()
    normal_index: np.ndarray = _field((), index_list)
    normal_per_vertex: bool = _field(True, boolean)
    solid: bool = _field(True, boolean)
    tex_coord: TextureCoordinate | None = _node()
    tex_coord_index: np.ndarray = _field((), index_list)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class IndexedTriangleSet(Node):
    """Triangles given by index triples (X3D Rendering)."""

    accepts = _VERTEX_DATA
    ccw: bool = _field(True, boolean)
    color: Color | ColorRGBA | None = _node()
    color_per_vertex: bool = _field(True, boolean)
    coord: Coordinate | None = _node()
    index: np.ndarray = _field((), index_list)
    normal: Normal | None = _node()
    normal_per_vertex: bool = _field(True, boolean)
    solid: bool = _field(True, boolean)
    tex_coord: TextureCoordinate | None = _node()
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class TriangleSet(Node):
    """Triangles given by consecutive vertex triples (X3D Rendering)."""

    accepts = _VERTEX_DATA
    ccw: bool = _field(True, boolean)
    color: Color | ColorRGBA | None = _node()
    color_per_vertex: bool = _field(True, boolean)
    coord: Coordinate | None = _node()
    normal: Normal | None = _node()
    normal_per_vertex: bool = _field(True, boolean)
    solid: bool = _field(True, boolean)
    tex_coord: TextureCoordinate | None = _node()
    name: str = _field("", string)


# --- lights (X3D clause 17) -------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class DirectionalLight(Node):
    """Parallel light (X3D 17.4.1). `global_` is X3D's `global`; FALSE: lights only its parent group's descendants."""

    ambient_intensity: float = _field(0.0, unit_interval)
    color: Vec3 = _field((1.0, 1.0, 1.0), color)
    direction: Vec3 = _field((0.0, 0.0, -1.0), direction)
    global_: bool = _field(False, boolean)
    intensity: float = _field(1.0, non_negative)
    on: bool = _field(True, boolean)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PointLight(Node):
    """Light from a point in all directions (X3D 17.4.2). `radius` and `location` in the light's coordinate system."""

    ambient_intensity: float = _field(0.0, unit_interval)
    attenuation: Vec3 = _field((1.0, 0.0, 0.0), factors)
    color: Vec3 = _field((1.0, 1.0, 1.0), color)
    global_: bool = _field(True, boolean)
    intensity: float = _field(1.0, non_negative)
    location: Vec3 = _field((0.0, 0.0, 0.0), vector3)
    on: bool = _field(True, boolean)
    radius: float = _field(100.0, reach)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SpotLight(Node):
    """Light from a point into a cone (X3D 17.4.3). Angles in radians, in (0, pi/2]."""

    ambient_intensity: float = _field(0.0, unit_interval)
    attenuation: Vec3 = _field((1.0, 0.0, 0.0), factors)
    beam_width: float = _field(math.pi / 2, spot_angle)
    color: Vec3 = _field((1.0, 1.0, 1.0), color)
    cut_off_angle: float = _field(math.pi / 4, spot_angle)
    direction: Vec3 = _field((0.0, 0.0, -1.0), direction)
    global_: bool = _field(True, boolean)
    intensity: float = _field(1.0, non_negative)
    location: Vec3 = _field((0.0, 0.0, 0.0), vector3)
    on: bool = _field(True, boolean)
    radius: float = _field(100.0, reach)
    name: str = _field("", string)


# --- environment and navigation (X3D clauses 23 and 24) ---------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Fog(Node):
    """Fog towards `color` with distance (X3D table 17.5); `visibility_range` in the fog's coordinate system."""

    color: Vec3 = _field((1.0, 1.0, 1.0), color)
    fog_type: str = _field("LINEAR", choice("LINEAR", "EXPONENTIAL"))
    visibility_range: float = _field(0.0, number)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Background(Node):
    """What is seen behind the geometry (X3D 24.4.1): the sky colours, of which the first is the zenith's.

    `sky_angle` holds one angle (radians from the zenith, none smaller than the last) for every colour after the first.
    """

    sky_angle: tuple[float, ...] = _field((), rising_angles)
    sky_color: np.ndarray = _field(((0.0, 0.0, 0.0),), rgb_rows)
    name: str = _field("", string)

    def __post_init__(self) -> None:
        super().__post_init__()
        wanted, came = max(len(self.sky_color) - 1, 0), len(self.sky_angle)
        if came != wanted:
            allowed = f"{wanted} angle{'s' * (wanted != 1)}, one for each colour after the first"
            raise ValueError(f"{self.label}.sky_angle: expected {allowed}, got {came}")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Viewpoint(Node):
    """A camera (X3D Navigation): looks along -z, y up; `field_of_view` (radians) spans the smaller image dimension."""

    description: str = _field("", string)
    field_of_view: float = _field(math.pi / 4, lambda where, value: number(where, value, above=0.0, below=math.pi))
    orientation: Vec4 = _field((0.0, 0.0, 1.0, 0.0), axis_angle)
    position: Vec3 = _field((0.0, 0.0, 10.0), vector3)
    name: str = _field("", string)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class NavigationInfo(Node):
    """How a browser moves and lights (X3D 23.4.4); only `headlight` matters to a picture."""

    headlight: bool = _field(True, boolean)
    name: str = _field("", string)


NODE_TYPES: dict[str, type[Node]] = {
    kind.__name__: kind for kind in list(globals().values()) if isinstance(kind, type) and issubclass(kind, Node)
}
del NODE_TYPES["Node"]


def nodes_equal(a: Any, b: Any) -> bool:
    """True if two nodes (or tuples of nodes, or field values) have the same kinds and the same content."""
    waiting: list[tuple[Any, Any]] = [(a, b)]
    compared: set[tuple[int, int]] = set()
    while waiting:
        a, b = waiting.pop()
        if isinstance(a, Node) and type(a) is type(b):
            if (id(a), id(b)) not in compared:  # nodes used again are compared once
                compared.add((id(a), id(b)))
                waiting += [(getattr(a, field.name), getattr(b, field.name)) for field in dataclasses.fields(a)]  # type: ignore[arg-type]  # nodes are dataclasses
        elif isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
            waiting += zip(a, b, strict=True)
        elif isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
            if not np.array_equal(a, b):  # type: ignore[arg-type]  # arrays by now
                return False
        elif a != b:
            return False
    return True
