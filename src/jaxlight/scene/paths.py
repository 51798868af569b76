"""Field paths: how people and files name the numbers of a scene, and which elements of which leaf they mean.

Material[body].diffuse_color     the row with the DEF name `body`
PointLight[0].location           the row number 0: digits always are one
PointLight[*].intensity          every row; any shell pattern works on names
Material[body].diffuse*          every field that matches: * and ?
Material[body].diffuse_color.r   one component (r g b, x y z or a number)
Fog.color, Texture[0].image      X3D's spelling (diffuseColor) is understood too
lambda s: s.materials.shininess  a leaf or part of a leaf of the Scene
"""

from __future__ import annotations

import difflib
import fnmatch
import math
import re
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from ..given import several
from . import nodes
from .ranges import POSITIVE, Range, allowed_range
from .scene import Scene

Path = str | Callable[[Scene], Any]


class _Kind(NamedTuple):
    attribute: str
    """Where a Scene keeps its nodes."""
    node: type[nodes.Node]
    fields: tuple[str, ...]
    """Those that are numbers of a Scene."""


_LIGHT = ("ambient_intensity", "color", "intensity")
_PLACED = ("attenuation", "location", "radius")
_KINDS: dict[str, _Kind] = {
    "Material": _Kind(
        "materials",
        nodes.Material,
        ("ambient_intensity", "diffuse_color", "emissive_color", "shininess", "specular_color", "transparency"),
    ),
    "DirectionalLight": _Kind("directional", nodes.DirectionalLight, (*_LIGHT, "direction")),
    "PointLight": _Kind("point", nodes.PointLight, (*_LIGHT, *_PLACED)),
    "SpotLight": _Kind("spot", nodes.SpotLight, (*_LIGHT, *_PLACED, "beam_width", "cut_off_angle", "direction")),
    "Fog": _Kind("fog", nodes.Fog, ("color", "visibility_range")),
    "Texture": _Kind("textures", nodes.ImageTexture, ("image",)),
}
_ALIASES = {"ImageTexture": "Texture", "PixelTexture": "Texture"}
ATTRIBUTES = {name: kind.attribute for name, kind in _KINDS.items()}
"""Where a Scene keeps the nodes of each kind."""
LIGHT_KINDS = ("DirectionalLight", "PointLight", "SpotLight")
LIGHT_ATTRIBUTES = tuple(ATTRIBUTES[kind] for kind in LIGHT_KINDS)
"""Where a Scene keeps the lights of each kind."""


class Leaf(NamedTuple):
    """Which array of a Scene: `materials.diffuse_color`, or `textures[row].image`. Hashable, so it can be static."""

    kind: str
    field: str
    row: int = -1
    """Row in `Scene.textures`; -1 for leaves that hold all rows of their kind."""

    def get(self, scene: Scene) -> Any:
        """The array."""
        owner = getattr(scene, self.attribute)
        return getattr(owner[self.row] if self.row >= 0 else owner, self.field)

    def set(self, scene: Scene, value: Any) -> Scene:
        """The scene with this array replaced."""
        return eqx.tree_at(self.get, scene, value)

    @property
    def attribute(self) -> str:
        """Where a Scene keeps nodes of this kind."""
        return ATTRIBUTES[self.kind]

    @property
    def range(self) -> Range:
        """The values that the specification allows; of a fog the ranges at which there is one (reading 5)."""
        if self.field == "visibility_range":
            return POSITIVE
        return allowed_range(_KINDS[self.kind].node, self.field)


class Field(NamedTuple):
    """One field of one node: its canonical path, where its numbers lie, and what the specification allows."""

    path: str
    leaf: Leaf
    index: tuple[int, ...]
    """Index of the node's row in the leaf; () when the leaf is the field."""

    def value(self, scene: Scene) -> np.ndarray:
        """The present value on the host."""
        return np.asarray(self.leaf.get(scene))[self.index]

    def labels(self, scene: Scene) -> list[str]:
        """The canonical path of each number, in order: `Material[body].diffuse_color.r` and so on."""
        shape = self.value(scene).shape
        if not shape:
            return [self.path]
        names = _component_names(self.leaf.field, shape)
        if names:
            return [f"{self.path}.{name}" for name in names]
        return [self.path + "".join(f"[{i}]" for i in index) for index in np.ndindex(shape)]


class Selection(NamedTuple):
    """Elements of one leaf that a path means."""

    leaf: Leaf
    mask: np.ndarray
    """True where an element is meant; the shape of the leaf."""


def fields(scene: Scene) -> list[Field]:
    """Every field of the scene that can be fitted, one entry a node and field, in the order of the specification."""
    found = []
    for kind, (attribute, _, names) in _KINDS.items():
        owner = getattr(scene, attribute)
        if owner is None:
            continue
        for row, label in enumerate(_row_labels(kind, owner)):
            for name in names:
                leaf = Leaf(kind, name, row if kind == "Texture" else -1)
                index = () if kind in ("Fog", "Texture") else (row,)
                found.append(Field(f"{label}.{name}", leaf, index))
    return found


def select(scene: Scene, path: Path | Iterable[Path]) -> list[Selection]:
    """The elements that a path, a function of the scene, or several of them mean; one entry a leaf.

    Raises:
        ValueError: nothing in the scene has this path; lists the closest that exist.
    """
    masks: dict[Leaf, np.ndarray] = {}
    for one in several(path):
        if not (isinstance(one, str) or callable(one)):
            raise ValueError(f"fields: expected paths such as 'Material[0].diffuse_color', got {one!r:.60}")
        found = _by_function(scene, one) if callable(one) else _by_name(scene, one)
        for leaf, mask in found:
            masks[leaf] = masks[leaf] | mask if leaf in masks else mask
    return [Selection(leaf, mask) for leaf, mask in masks.items()]


def first_rows(scene: Scene, kind: str) -> list[int]:
    """Of every row of a kind of node the first one of the same node: an earlier one where it is placed again (USE).

    Of a scene without its document, or with other rows than that has nodes, every row itself.
    """
    rows = _names(kind, getattr(scene, ATTRIBUTES[kind]))
    behind = getattr(scene.document, ATTRIBUTES[kind], None)
    if not isinstance(behind, tuple) or len(behind) != len(rows):
        return list(range(len(rows)))
    first: dict[Any, int] = {}
    return [first.setdefault(node, row) for row, node in enumerate(behind)]


def light_rows(scene: Scene, paths: str | Iterable[str]) -> dict[str, np.ndarray]:
    """The rows of each kind of light that a path such as `PointLight[key]`, or several, mean.

    Raises:
        ValueError: no such light; lists those that exist.
    """
    rows: dict[str, set[int]] = {kind: set() for kind in LIGHT_KINDS}
    for path in several(paths):
        if not isinstance(path, str):
            raise ValueError(f"lights: expected a light such as 'PointLight[0]', got {path!r:.60}")
        kind, row, field, _ = _parse(path if "." in path.rpartition("]")[2] else f"{path}.*")
        if kind not in LIGHT_KINDS or field != "*":
            raise ValueError(f"lights: expected a light such as 'PointLight[0]', got {path!r}{_lights_there(scene)}")
        owner = getattr(scene, ATTRIBUTES[kind])
        matching = [] if owner is None else _matching_rows(scene, path, kind, row)
        if not matching:
            raise ValueError(f"lights: the scene has no {path!r}{_lights_there(scene)}")
        rows[kind].update(matching)
    return {kind: np.array(sorted(found), dtype=np.int32) for kind, found in rows.items()}


def _lights_there(scene: Scene) -> str:
    there = [
        label
        for kind in LIGHT_KINDS
        if getattr(scene, ATTRIBUTES[kind]) is not None
        for label in _row_labels(kind, getattr(scene, ATTRIBUTES[kind]))
    ]
    return f"; it has {', '.join(there[:8]) or 'no lights'}"


_PLAIN_NAME = re.compile(r"[^\[\]*?!]*[^\[\]*?!\d][^\[\]*?!]*")
_SYNTAX = re.compile(r"(?P<kind>\w+)(?:\[(?P<row>.*?)\])?\.(?P<field>[\w*?]+)(?P<part>(?:\[\d+\])+|\.\w+)?")


def _row_labels(kind: str, owner: Any) -> list[str]:
    """`Material[body]`: the DEF name where it is there, unique and not to be mistaken for something else."""
    if kind == "Fog":
        return ["Fog"]
    names = _names(kind, owner)
    return [
        f"{kind}[{name if _PLAIN_NAME.fullmatch(name) and names.count(name) == 1 else row}]"
        for row, name in enumerate(names)
    ]


def _names(kind: str, owner: Any) -> tuple[str, ...]:
    """The DEF name of every row."""
    if kind == "Fog":
        return (owner.name,)
    return tuple(texture.name for texture in owner) if kind == "Texture" else owner.names


def _component_names(field: str, shape: tuple[int, ...]) -> str:
    if shape != (3,) or field == "attenuation":
        return ""
    return "rgb" if field.endswith("color") else "xyz"


def _snake(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])([A-Z])", lambda match: "_" + match[1].lower(), name)


def _parse(path: str) -> tuple[str, str | None, str, str]:
    match = _SYNTAX.fullmatch(path.strip())
    if match is None:
        raise ValueError(f"{path!r} is no field path; expected the form 'Material[name or row].diffuse_color'")
    kind = match["kind"]
    return _ALIASES.get(kind, kind), match["row"], _snake(match["field"]), match["part"] or ""


def _matching_rows(scene: Scene, path: str, kind: str, row: str | None) -> list[int]:
    owner = getattr(scene, ATTRIBUTES[kind])
    names = _names(kind, owner)
    if row is None:
        if len(names) > 1:
            raise ValueError(
                f"{path!r}: the scene has {len(names)} {kind} nodes; write {kind}[*] for all of them, "
                f"or one of {', '.join(_row_labels(kind, owner)[:8])}"
            )
        return list(range(len(names)))
    if row.isdecimal():  # also where a node is called so: labels have the row of it
        return [int(row)] if int(row) < len(names) else []
    if row in names:
        matching = [i for i, name in enumerate(names) if name == row]
        first = first_rows(scene, kind)
        different = [i for i in matching if first[i] == i]
        if len(different) > 1:
            rows = ", ".join(f"{kind}[{i}]" for i in matching)
            raise ValueError(f"{path!r}: {len(different)} nodes have this name; write the row number: {rows}")
        return matching
    return [i for i, name in enumerate(names) if fnmatch.fnmatchcase(name, row)] if row != "*" else [*range(len(names))]


def _by_name(scene: Scene, path: str) -> list[tuple[Leaf, np.ndarray]]:
    kind, row, field, part = _parse(path)
    known = _KINDS.get(kind)
    owner = None if known is None else getattr(scene, known.attribute)
    rows = [] if owner is None else _matching_rows(scene, path, kind, row)
    names = [name for name in known.fields if fnmatch.fnmatchcase(name, field)] if known else []
    if not rows or not names:
        raise _unknown(scene, path)
    found = []
    for name in names:
        for leaf in [Leaf(kind, name, i) for i in rows] if kind == "Texture" else [Leaf(kind, name)]:
            shape = leaf.get(scene).shape
            mask = np.zeros(shape, dtype=bool)
            for i in rows:
                index = () if kind in ("Fog", "Texture") else (i,)
                mask[index + _part(path, part, name, shape[len(index) :])] = True
            found.append((leaf, mask))
    return found


def _part(path: str, part: str, field: str, shape: tuple[int, ...]) -> tuple[int, ...]:
    """The index that `.r` or `[2]` at the end of a path means within a field of this shape."""
    if not part:
        return ()
    names = _component_names(field, shape)
    if part.startswith("."):
        if part[1:] not in tuple(names):
            allowed = ", ".join(names) or ("a number in brackets" if shape else "none: it is one number")
            raise ValueError(f"{path!r}: no component {part[1:]!r}; components: {allowed}")
        return (names.index(part[1:]),)
    index = tuple(int(i) for i in re.findall(r"\d+", part))
    if len(index) > len(shape) or any(i >= size for i, size in zip(index, shape, strict=False)):
        raise ValueError(f"{path!r}: no component {part}; the field has shape {list(shape)}")
    return index


def _unknown(scene: Scene, path: str) -> ValueError:
    known = [field.path for field in fields(scene)]
    kind, _, rest = path.partition("[")
    spelled = _ALIASES.get(kind, kind) + ("[" + rest if rest else "")
    close = difflib.get_close_matches(spelled, known, n=4, cutoff=0.4) or known[:4]
    return ValueError(f"the scene has no field {path!r}; the closest: {', '.join(close) or 'none, it has no fields'}")


class _Marker:
    """Stands in for a leaf while a user's function of the scene runs: remembers which part of it was taken."""

    def __init__(self, leaf: Leaf, numbers: np.ndarray) -> None:
        self.leaf, self.numbers = leaf, numbers

    def __getitem__(self, index: Any) -> _Marker:
        return _Marker(self.leaf, self.numbers[index])


def _by_function(scene: Scene, function: Callable[[Scene], Any]) -> list[tuple[Leaf, np.ndarray]]:
    leaves = list(dict.fromkeys(field.leaf for field in fields(scene)))
    shapes = {leaf: leaf.get(scene).shape for leaf in leaves}
    marked = scene
    for leaf, shape in shapes.items():
        marked = leaf.set(marked, _Marker(leaf, np.arange(math.prod(shape)).reshape(shape)))
    try:
        chosen = function(marked)
    except (AttributeError, IndexError, KeyError, TypeError) as error:
        raise ValueError(f"a function that chooses fields fails on this scene: {error}") from error
    found = []
    for marker in chosen if isinstance(chosen, (list, tuple)) else (chosen,):
        if not isinstance(marker, _Marker):
            raise ValueError(
                f"a function that chooses fields must return leaves of the scene or parts of them "
                f"(`lambda s: s.materials.diffuse_color[0]`), got a {type(marker).__name__}"
            )
        mask = np.zeros(shapes[marker.leaf], dtype=bool)
        mask.reshape(-1)[marker.numbers] = True
        found.append((marker.leaf, mask))
    return found
