"""Nodes -> Scene: walk the tree once, place what it holds in world space, resolve scopes and repeated nodes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from ..arrays import array_of
from ..given import several
from . import nodes
from .document import Document, PlacedBackground, PlacedShape, PlacedViewpoint
from .fields import float_type, largest_of, with_article
from .flags import Flags
from .scene import DirectionalLights, Fog, Materials, PointLights, Scene, SpotLights, Surface, Texture
from .transforms import IDENTITY, compose, frame_kind, is_invertible, transform_matrix

MAX_DEPTH = 400
MAX_PLACED = 1_000_000
TOO_MANY_PLACED = f"scene: more than {MAX_PLACED} placed nodes (a node used again counts every time)"
MAX_SCOPED = 10_000_000

_Light = nodes.DirectionalLight | nodes.PointLight | nodes.SpotLight
_HEADLIGHT = nodes.DirectionalLight(name="headlight", global_=True)


@dataclasses.dataclass
class _Walk:
    """What the walk has met: each with its frame and the chain of group instances above it."""

    shapes: list[tuple[nodes.Shape, np.ndarray, tuple[int, ...]]] = dataclasses.field(default_factory=list)
    lights: list[tuple[_Light, np.ndarray, int]] = dataclasses.field(default_factory=list)
    viewpoints: list[PlacedViewpoint] = dataclasses.field(default_factory=list)
    fogs: list[tuple[nodes.Fog, np.ndarray]] = dataclasses.field(default_factory=list)
    backgrounds: list[PlacedBackground] = dataclasses.field(default_factory=list)
    navigation: list[nodes.NavigationInfo] = dataclasses.field(default_factory=list)
    has_dark_light: bool = False
    """Whether there is a light below a scale of 0."""
    without_light: set[int] = dataclasses.field(default_factory=set)
    """What was searched for such a light, by identity."""
    groups: int = 0
    visited: int = 0
    waiting: list[tuple[nodes.Node, np.ndarray, tuple[int, ...]]] = dataclasses.field(default_factory=list)
    """What is to be visited, the next one last."""

    @classmethod
    def through(cls, roots: Sequence[nodes.Node]) -> _Walk:
        """All that stands below the roots of a scene, in the order in which it is written."""
        walk = cls()
        walk.enter(roots, IDENTITY, ())
        while walk.waiting:
            walk.visit(*walk.waiting.pop())
        return walk

    def enter(self, children: Sequence[nodes.Node], to_world: np.ndarray, above: tuple[int, ...]) -> None:
        """The children of a new group instance are the next to be visited."""
        if len(above) >= MAX_DEPTH:
            raise ValueError(f"scene: groups nested deeper than {MAX_DEPTH}")
        inside = (*above, self.groups)
        self.groups += 1
        self.waiting.extend((child, to_world, inside) for child in reversed(children))

    def visit(self, node: nodes.Node, to_world: np.ndarray, above: tuple[int, ...]) -> None:
        self.visited += 1
        if self.visited > MAX_PLACED:
            raise ValueError(TOO_MANY_PLACED)
        match node:
            case nodes.Transform() if 0.0 in node.scale:
                self.has_dark_light = self.has_dark_light or self.holds_light(node)
            case nodes.Transform():
                own = transform_matrix(node)
                if not is_invertible(own):
                    raise ValueError(f"{node.label}: its matrix cannot be inverted (scale {node.scale})")
                with np.errstate(over="ignore", invalid="ignore"):
                    placed = compose(to_world, own)
                if not np.all(np.isfinite(placed)):
                    raise ValueError(f"{node.label}: with the transforms above it the numbers become too large")
                self.enter(node.children, placed, above)
            case nodes.Group() | nodes.Switch():
                self.enter(shown_below(node), to_world, above)
            case nodes.Shape():
                self.shapes.append((node, to_world, above))
            case nodes.DirectionalLight() | nodes.PointLight() | nodes.SpotLight():
                self.lights.append((node, to_world, above[-1]))
            case nodes.Viewpoint():
                self.viewpoints.append(PlacedViewpoint(node, to_world))
            case nodes.Fog():
                self.fogs.append((node, to_world))
            case nodes.Background():
                self.backgrounds.append(PlacedBackground(node, to_world))
            case nodes.NavigationInfo():
                self.navigation.append(node)
            case _:
                raise ValueError(
                    f"scene: {with_article(type(node).__name__)} cannot stand among the children of a group"
                )

    def holds_light(self, top: nodes.Node) -> bool:
        """Whether a light stands below, were no scale 0. A node without one is never searched again."""
        waiting = [top]
        while waiting:
            node = waiting.pop()
            if isinstance(node, _Light):
                return True
            if id(node) not in self.without_light:
                self.without_light.add(id(node))
                waiting.extend(node.children if isinstance(node, nodes.Transform) else shown_below(node))
        return False


def shown_below(node: nodes.Node) -> tuple[nodes.Node, ...]:
    """The children that a grouping node shows; other nodes have none."""
    match node:
        case nodes.Transform():
            return () if 0.0 in node.scale else node.children
        case nodes.Group():
            return node.children
        case nodes.Switch():
            return node.children[node.which_choice :][:1] if node.which_choice >= 0 else ()
        case _:
            return ()


def scene_from_nodes(children: nodes.Node | Sequence[nodes.Node], *, dtype: Any = None) -> Scene:
    """See `Scene.from_nodes`."""
    roots = tuple(several(children))
    for root in roots:
        if not isinstance(root, nodes.Node):
            raise ValueError(f"Scene.from_nodes: expected a node or a list of nodes, got {root!r:.60}")
    walk = _Walk.through(roots)
    materials = _distinct(shape.appearance.material for shape, _, _ in walk.shapes if shape.appearance)
    textures = _distinct(_texture(shape) for shape, _, _ in walk.shapes)
    lights = list(walk.lights)
    no_light = not lights and not walk.has_dark_light
    headlight = no_light and all(info.headlight for info in walk.navigation[:1])
    if headlight:
        lights.append((_HEADLIGHT, IDENTITY, 0))

    # A surface is a row of the colour tables together with the scoped lights above the shape.
    scoped = {group for light, _, group in lights if not light.global_}
    surfaces: dict[tuple[Surface, frozenset[int]], int] = {}
    placed = []
    row_of = {id(node): row for rows in (materials, textures) for row, node in enumerate(rows)}
    for shape, to_world, above in walk.shapes:
        key = (_surface(shape, row_of), frozenset(above) & scoped)
        row = surfaces.setdefault(key, len(surfaces))
        placed.append(PlacedShape(shape, to_world, row))

    if len(surfaces) * len(lights) > MAX_SCOPED:
        raise ValueError(
            f"scene: {len(lights)} lights over {len(surfaces)} surfaces; their product may be at most {MAX_SCOPED}"
        )

    def of_kind(kind: type[_Light]) -> list[tuple[Any, np.ndarray, np.ndarray]]:
        """(node, to_world, in_scope over surfaces) of the lights of one kind."""
        return [
            (light, to_world, np.array([light.global_ or group in scopes for _, scopes in surfaces], dtype=bool))
            for light, to_world, group in lights
            if isinstance(light, kind)
        ]

    directional, point, spot = of_kind(nodes.DirectionalLight), of_kind(nodes.PointLight), of_kind(nodes.SpotLight)
    stack = _Stack(float_type("dtype", dtype))
    document = Document(
        children=roots,
        shapes=tuple(placed),
        viewpoints=tuple(walk.viewpoints),
        background=walk.backgrounds[0] if walk.backgrounds else None,
        materials=tuple(materials),
        directional=tuple(light for light, _, _ in directional),
        point=tuple(light for light, _, _ in point),
        spot=tuple(light for light, _, _ in spot),
        textures=tuple(textures),
        fog=walk.fogs[0][0] if walk.fogs else None,
    )
    return Scene(
        materials=stack.materials(materials),
        directional=stack.directional(directional, headlight=headlight),
        point=stack.point(point),
        spot=stack.spot(spot),
        fog=stack.fog(*walk.fogs[0]) if walk.fogs else None,
        textures=stack.textures(textures),
        surfaces=tuple(surface for surface, _ in surfaces),
        document=document,
    )


def _distinct(found: Iterable[Any]) -> list[Any]:
    """The distinct objects in order of appearance, None left out."""
    return list({id(node): node for node in found if node is not None}.values())


def _texture(shape: nodes.Shape) -> nodes.ImageTexture | nodes.PixelTexture | None:
    texture = shape.appearance.texture if shape.appearance else None
    return texture if texture is not None and texture.image is not None else None


def _surface(shape: nodes.Shape, row_of: dict[int, int]) -> Surface:
    """The shape's row of tables 17.2 and 17.3, given the rows of materials and textures by identity."""
    material = row_of.get(id(shape.appearance.material), -1) if shape.appearance else -1
    color = getattr(shape.geometry, "color", None)
    components = 0 if color is None or len(color.color) == 0 else color.color.shape[1]
    texture = row_of.get(id(_texture(shape)), -1)
    return Surface("lit" if material >= 0 else "unlit", material, texture, components)


@dataclasses.dataclass(frozen=True)
class _Stack:
    """Stacks the fields of nodes into struct-of-arrays of one float type."""

    dtype: Any

    def floats(self, values: Any, where: str | Callable[[int], str] = "") -> Any:
        """`where` names the values, or those of a row, in the error that one is too large for the type."""
        wide = np.asarray(values, dtype=np.float64)
        largest = largest_of(self.dtype)
        too_large = ((wide > largest) | (wide < -largest)) & np.isfinite(wide)
        if np.any(too_large):
            place = tuple(np.argwhere(too_large)[0].tolist())
            name = where if isinstance(where, str) else where(place[0])
            raise ValueError(f"{name}: {wide[place]:g} is larger than {largest:.3g}, the most that the type holds")
        return array_of(wide, self.dtype)

    def _fields(self, rows: list[Any], *names: str) -> dict[str, Any]:
        def field(name: str) -> Any:
            return self.floats([getattr(node, name) for node in rows], lambda row: f"{rows[row].label}.{name}")

        return {name: field(name) for name in names}

    def _light(self, lights: list[tuple[Any, np.ndarray, np.ndarray]], *names: str) -> dict[str, Any]:
        rows, frames = [light for light, _, _ in lights], [to_world for _, to_world, _ in lights]
        return {
            **self._fields(rows, "ambient_intensity", "color", "intensity", *names),
            "on": Flags([light.on for light in rows]),
            "in_scope": Flags(np.stack([scope for _, _, scope in lights], axis=1)),
            "to_world": self.floats(frames, lambda row: f"{rows[row].label}: its frame"),
            "names": tuple(light.name for light in rows),
            "frame": frame_kind(frames),
        }

    def _check_places(self, lights: list[tuple[Any, np.ndarray, np.ndarray]]) -> None:
        """The products and sums that place a light in the world, and so their derivatives, stay within the type."""
        frames = np.abs([to_world for _, to_world, _ in lights])
        locations = np.abs([light.location for light, _, _ in lights])
        with np.errstate(over="ignore"):
            reach = np.max(np.einsum("lij,lj->li", frames[..., :3], locations) + frames[..., 3], axis=1)
        largest, row = largest_of(self.dtype), int(np.argmax(reach))
        if reach[row] > largest:
            said = f"with the transforms above it {reach[row]:g} is larger than {largest:.3g}, the most that the type"
            raise ValueError(f"{lights[row][0].label}.location: {said} holds")

    def _to_local(self, lights: list[tuple[Any, np.ndarray, np.ndarray]]) -> Any:
        inverses = [np.linalg.inv(to_world[:, :3]) for _, to_world, _ in lights]
        return self.floats(inverses, lambda row: f"{lights[row][0].label}: the inverse of its frame")

    def textures(self, found: list[nodes.ImageTexture | nodes.PixelTexture]) -> tuple[Texture, ...]:
        """One a node; those of one picture share its array."""
        arrays: dict[int, Any] = {}
        for node in found:
            if id(node.image) not in arrays:
                arrays[id(node.image)] = self.floats(node.image, f"{node.label}.image")
        images: list[Any] = [node.image for node in found]  # nodes without one are no textures of a scene
        return tuple(
            Texture(arrays[id(image)], node.name, image.shape[:2]) for node, image in zip(found, images, strict=True)
        )

    def materials(self, rows: list[nodes.Material]) -> Materials | None:
        if not rows:
            return None
        colors = self._fields(rows, "diffuse_color", "emissive_color", "specular_color")
        scalars = self._fields(rows, "ambient_intensity", "shininess", "transparency")
        return Materials(**colors, **scalars, names=tuple(node.name for node in rows))

    def directional(self, lights: list[Any], *, headlight: bool) -> DirectionalLights | None:
        return DirectionalLights(**self._light(lights, "direction"), headlight=headlight) if lights else None

    def point(self, lights: list[Any]) -> PointLights | None:
        if not lights:
            return None
        fields = self._light(lights, "attenuation", "location", "radius")
        self._check_places(lights)
        return PointLights(**fields, to_local=self._to_local(lights))

    def spot(self, lights: list[Any]) -> SpotLights | None:
        if not lights:
            return None
        fields = self._light(lights, "attenuation", "beam_width", "cut_off_angle", "direction", "location", "radius")
        self._check_places(lights)
        return SpotLights(**fields, to_local=self._to_local(lights))

    def fog(self, node: nodes.Fog, to_world: np.ndarray) -> Fog:
        return Fog(
            color=self.floats(node.color, f"{node.label}.color"),
            visibility_range=self.floats(node.visibility_range, f"{node.label}.visibility_range"),
            to_local=self.floats(np.linalg.inv(to_world[:, :3]), f"{node.label}: the inverse of its frame"),
            fog_type=node.fog_type,  # type: ignore[arg-type]  # checked when the node was made
            name=node.name,
            frame=frame_kind([to_world]),  # type: ignore[arg-type]  # one of the kinds
        )
