"""X3D in its XML encoding (ISO/IEC 19776-1) -> nodes.

What jaxlight does not know is skipped and named. Elements are built from the inside out, in the order of the file and
without recursion, so a USE finds exactly the DEFs that stand before it.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from ..scene import nodes
from ..scene.fields import with_article
from ..scene.indices import check_indices
from .errors import SceneFileError
from .folder import ResourceFolder
from .limits import MAX_NESTING
from .notes import ReadNotes
from .x3d_fields import X3DField, fields_of, meant_attribute, python_name, version_defaults
from .x3d_groups import CHILD_HOLDERS, SIMPLIFIED, is_child_node, split_children
from .x3d_source import TextureFile, X3DSource
from .x3d_textures import TextureReader
from .x3d_unread import CHANGES_THE_PICTURE, ON_EVERY_ELEMENT, is_of_html, is_unread_field
from .x3d_values import SFBool, parse_floats
from .xml_elements import Element, parse_xml

_GROUPS = (nodes.Group, nodes.Transform, nodes.Switch)
_CHILD_KINDS = (
    *_GROUPS, nodes.Shape, nodes.DirectionalLight, nodes.PointLight, nodes.SpotLight, nodes.Fog, nodes.Background,
    nodes.Viewpoint, nodes.NavigationInfo,
)  # fmt: skip
_LONGEST_NAME = 60
"""Characters of an attribute's name; no field has as many."""
_MAX_DETOURS = 32
"""How many skipped subtrees may lead into one another through USE."""


def read_x3d(path: Path, data: bytes) -> tuple[tuple[nodes.Node, ...], ReadNotes, X3DSource]:
    """The nodes of an X3D file's Scene.

    Returns:
        The scene's root nodes, what could not be taken as it stands, and what writing back needs.

    Raises:
        SceneFileError: malformed XML, a value or child node that a field does not take, an index out of range, a USE
            without a DEF before it, nesting or size beyond the limits; with the line.
    """
    root = parse_xml(path, data)
    if root.tag != "X3D":
        raise SceneFileError(path, root.line, f"the root element is <{root.tag}>, expected <X3D>")
    scenes = [child for child in root.children if child.tag == "Scene"]
    if not scenes:
        raise SceneFileError(path, root.line, "<X3D> holds no <Scene>")
    if len(scenes) > 1:
        raise SceneFileError(path, scenes[1].line, "a second <Scene>, expected one")
    reader = _Reader(path, _version(root.attributes.get("version", "")), _unit(path, root, "angle"))
    if _unit(path, root, "length") != 1.0:
        reader.notes.unused["unit of length (numbers stay as they are)"] += 1
    reader.notes.skipped.update(child.tag for child in root.children if child.tag not in ("head", "Scene"))
    children = reader.read_all(scenes[0])
    place = path.parent.resolve() / path.name  # a link stays one: what the scene names lies beside the link
    source = X3DSource(place, data, reader.element_numbers, reader.texture_files, reader.angle_unit)
    return children, reader.notes, source


def _version(text: str) -> tuple[int, int]:
    """(3, 2) of "3.2"; a file that does not say counts as the oldest."""
    match = re.match(r"\s*(\d{1,4})\.(\d{1,4})", text)
    return (int(match[1]), int(match[2])) if match else (0, 0)


def _unit(path: Path, root: Element, category: str) -> float:
    """Radians or metres in one unit of the file: 1, unless X3D's `unit` statement says otherwise."""
    factor = 1.0
    for unit in (unit for head in root.children if head.tag == "head" for unit in head.children):
        if unit.tag == "unit" and unit.attributes.get("category") == category:
            text = unit.attributes.get("conversionFactor", "")
            try:
                (factor,) = parse_floats(text).tolist()
            except ValueError:
                factor = 0.0
            if not 0 < factor < float("inf"):
                message = f"unit.conversionFactor: expected a number > 0, got {text[:40]!r}"
                raise SceneFileError(path, unit.line, message)
    return factor


class _Reader:
    """Builds the nodes of one file."""

    def __init__(self, path: Path, version: tuple[int, int], angle_unit: float) -> None:
        self.path = path
        self.version = version
        self.angle_unit = angle_unit
        self.notes = ReadNotes()
        self.element_numbers: dict[nodes.Node, int] = {}
        self.texture_files: dict[nodes.Node, TextureFile] = {}
        self._textures = TextureReader(ResourceFolder(path))
        self._defined: dict[str, nodes.Node | None] = {}
        """By DEF name; None: a node that was skipped."""
        self._tags: dict[str, str] = {}
        """By DEF name: what the nodes are called in the file."""
        self._set_aside: dict[str, Element] = {}
        """Elements with a DEF inside skipped ones; read when a USE asks for them."""
        self._read_early: dict[Element, nodes.Node | None] = {}
        """What became of those; their parents may be read later."""
        self._depths: dict[nodes.Node, int] = {}
        self._detours = 0

    def read_all(self, scene: Element) -> tuple[nodes.Node, ...]:
        """The children of the Scene element."""
        made = [(child, self._read(child)) for child in scene.children]
        group = self._node_fields(nodes.Group, scene, made)
        return group.get("children", ())

    def _read(self, top: Element) -> nodes.Node | None:
        """The node of an element with all below it, or None if it was skipped."""
        results: dict[Element, nodes.Node | None] = {}
        stack = [(top, False)]
        while stack:
            element, children_are_made = stack.pop()
            if children_are_made:
                made = [(child, results.pop(child)) for child in split_children(element)[0]]
                results[element] = self._make(element, made)
            elif element in self._read_early:
                results[element] = self._read_early[element]
            elif not _is_known(element):
                self.notes.skipped[element.tag] += 1
                self._put_aside(element)
                results[element] = None
            elif "USE" in element.attributes:
                results[element] = self._use(element)
            else:
                chosen, left = split_children(element)
                for child in left:
                    self._put_aside(child)
                stack.append((element, True))
                stack.extend((child, False) for child in reversed(chosen))
        return results[top]

    def _put_aside(self, top: Element) -> None:
        """Remember the DEFs of a subtree that is not read; those of a prototype are its own."""
        stack = [top]
        while stack:
            element = stack.pop()
            if element.tag == "ProtoDeclare":
                continue
            if name := element.attributes.get("DEF"):
                self._set_aside[name] = element
                self._defined.pop(name, None)
            stack.extend(element.children)

    def _use(self, element: Element) -> nodes.Node | None:
        """The node that was DEFined with this name before."""
        name = element.attributes["USE"]
        shown = name[:60]
        if name in self._set_aside:
            if self._detours >= _MAX_DETOURS:
                raise self._error(element, f"USE='{shown}': too many skipped nodes use one another")
            self._detours += 1
            original = self._set_aside.pop(name)
            self._tags[name] = original.tag
            self._defined[name] = self._read(original) if _is_known(original) else None
            self._read_early[original] = self._defined[name]
            self._detours -= 1
        if name not in self._defined:
            raise self._error(element, f"USE='{shown}': no node before this one has DEF='{shown}'")
        node = self._defined[name]
        if node is None:
            self.notes.skipped[f"{element.tag} USE='{shown}'"] += 1
        else:
            self._note_beside_use(element, f"USE='{shown}'", self._tags[name])
        return node

    def _note_beside_use(self, element: Element, use: str, tag: str) -> None:
        """What an element says of a node that it only uses again."""
        line, beside = f"line {element.line}", self.notes.beside_use
        if element.tag != tag:
            beside[element.tag, "as", tag].append(f"the name {element.tag} ({use} is {with_article(tag)}, {line})")
        for attribute in element.attributes:
            if attribute not in ON_EVERY_ELEMENT and not is_of_html(attribute):
                beside[element.tag, attribute].append(f"{element.tag}.{attribute} ({use}, {line})")
        if element.children:
            beside[element.tag].append(f"what is in {element.tag} ({use}, {line})")

    def _make(self, element: Element, made: list[tuple[Element, nodes.Node | None]]) -> nodes.Node:
        """The node of an element whose children are made."""
        kind = nodes.NODE_TYPES.get(element.tag, nodes.Group)
        if element.tag in SIMPLIFIED:
            self.notes.simplified[SIMPLIFIED[element.tag]] += 1
        name = element.attributes.get("DEF", "")
        label = f"{kind.__name__}[{name}]" if name else kind.__name__
        values = {"name": name, **version_defaults(kind, self.version)}
        for field, value in self._values(kind, element, label):
            values[field.name] = value
        if kind is nodes.Background:
            _fit_sky(values, self.notes)
        texture_file = None
        if kind is nodes.ImageTexture and values.get("url"):
            values["image"], texture_file = self._image(element, values["url"])
        try:
            node = kind(**values, **self._node_fields(kind, element, made))
            check_indices(node)
        except SceneFileError:
            raise
        except ValueError as error:
            raise self._error(element, str(error)) from None
        if isinstance(node, nodes.Transform) and 0.0 in node.scale:
            self.notes.simplified["Transform with a scale of 0 (shows nothing)"] += 1
        self.element_numbers[node] = element.number
        if texture_file is not None:
            self.texture_files[node] = texture_file
        self._note_depth(element, node, [child for _, child in made])
        return self._define(element, node, name)

    def _define(self, element: Element, node: nodes.Node, name: str) -> nodes.Node:
        """Register the DEF; a node with visible='false' (X3D 4) becomes the choice that a Switch does not make."""
        if element.tag == "CADLayer" and len(element.attributes.get("visible", "").split()) > 1:
            self.notes.unused["CADLayer.visible (of its children one by one)"] += 1
        elif isinstance(node, (*_GROUPS, nodes.Shape)) and "visible" in element.attributes:
            try:
                visible = SFBool.parse(element.attributes["visible"])
            except ValueError as error:
                raise self._error(element, f"{node.label}.visible: {error}") from None
            if not visible:
                self.notes.simplified["visible='false' (as a Switch that shows nothing)"] += 1
                depth = self._depths[node]
                node = nodes.Switch(children=(node,))
                self._depths[node] = depth + 1
        if name:
            self._defined[name], self._tags[name] = node, element.tag
            self._set_aside.pop(name, None)
        return node

    def _values(self, kind: type[nodes.Node], element: Element, label: str) -> list[tuple[X3DField, Any]]:
        """The value fields that the element writes."""
        fields = fields_of(kind)
        found = []
        for attribute, text in element.attributes.items():
            field = fields.get(attribute) if element.tag == kind.__name__ else None
            if field is None:
                if attribute in CHANGES_THE_PICTURE.get(element.tag, ()):
                    self.notes.unused[f"{element.tag}.{attribute}"] += 1
                elif not is_unread_field(element.tag, attribute):
                    self._note_unknown(kind, element, attribute)
                continue
            try:
                value = field.in_radians(field.type.parse(text), self.angle_unit)
            except ValueError as error:
                raise self._error(element, f"{label}.{attribute}: {error}") from None
            value, was_clamped = field.clamped(value)
            if was_clamped:
                self.notes.clamped.append(f"{label}.{attribute} (line {element.line})")
            found.append((field, value))
        return found

    def _note_unknown(self, kind: type[nodes.Node], element: Element, attribute: str) -> None:
        """An attribute that X3D does not have, and the one that may be meant."""
        meant = meant_attribute(kind, attribute[:_LONGEST_NAME])
        where = f"line {element.line}; {meant} is meant?" if meant else f"line {element.line}"
        alike = self.notes.unknown[element.tag, attribute]
        alike.append(f"{_shown(element)}.{attribute} ({where})")

    def _node_fields(
        self, kind: type[nodes.Node], parent: Element, made: list[tuple[Element, nodes.Node | None]]
    ) -> dict[str, Any]:
        """The node-valued fields of `kind` from the children of its element."""
        fields: dict[str, Any] = {}
        for element, node in made:
            if node is None:
                if kind is nodes.Switch and is_child_node(element):
                    fields.setdefault("children", []).append(nodes.Group())  # keeps the count of which_choice
                if kind is nodes.Appearance and _is_material(element):
                    self.notes.simplified["Appearance without its material (unlit: white, or its own colours)"] += 1
                continue
            name = self._field_for(kind, parent, element, node)
            if name == "children":
                fields.setdefault(name, []).append(node)
            elif name in fields:
                raise self._error(element, f"<{parent.tag}> takes one node as {name}, this is the second")
            elif name is not None:
                fields[name] = node
        return {name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()}

    def _field_for(self, kind: type[nodes.Node], parent: Element, element: Element, node: nodes.Node) -> str | None:
        """The field of `kind` that a child node belongs to; None: one that jaxlight does not have."""
        takes = [name for name, kinds in kind.accepts.items() if _accepted(node, kinds)]
        holder = element.attributes.get("containerField", "").strip()
        if holder in CHILD_HOLDERS:
            holder = "children"
        if holder:
            name = python_name(kind, holder)
            if name is None:
                self.notes.skipped[f"{element.tag} as {parent.tag}.{holder}"] += 1
                return None
            takes = [name] if name in takes else []
        if not takes:
            raise self._error(element, f"{with_article(type(node).__name__)} cannot stand in <{parent.tag}>")
        return takes[0]

    def _image(self, element: Element, urls: tuple[str, ...]) -> tuple[Any, TextureFile | None]:
        try:
            found = self._textures.first(urls)
        except ValueError as error:
            self.notes.missing.append(f"{error} (line {element.line})")
            return None, None
        if found.was_clamped:
            self.notes.clamped.append(f"{element.tag}.image (line {element.line})")
        return found.pixels, found.file

    def _note_depth(self, element: Element, node: nodes.Node, children: list[nodes.Node | None]) -> None:
        depth = 1 + max((self._depths.get(child, 0) for child in children if child is not None), default=0)
        if depth > MAX_NESTING:
            raise self._error(element, f"nodes nested deeper than {MAX_NESTING} through USE")
        self._depths[node] = depth

    def _error(self, element: Element, message: str) -> SceneFileError:
        return SceneFileError(self.path, element.line, message)


def _fit_sky(values: dict[str, Any], notes: ReadNotes) -> None:
    """Bring the fields of a Background to one angle for each colour after the first, in which none decreases."""
    colors, angles = values.get("sky_color", nodes.Background().sky_color), values.get("sky_angle", ())
    stops = min(len(colors), len(angles) + 1)
    if stops < len(colors) or len(angles) > max(stops - 1, 0):
        notes.simplified["Background whose skyAngle is not one for each further skyColor (read as far as both go)"] += 1
    rising = tuple(np.maximum.accumulate(angles[: max(stops - 1, 0)]).tolist())
    if rising != angles[: len(rising)]:
        notes.simplified["Background whose skyAngle decreases (read as the largest before)"] += 1
    values |= {"sky_color": colors[:stops], "sky_angle": rising}


def _shown(element: Element) -> str:
    """As `Node.label`, by the element's own tag."""
    name = element.attributes.get("DEF", "")
    return f"{element.tag}[{name}]" if name else element.tag


def _is_known(element: Element) -> bool:
    return element.tag in nodes.NODE_TYPES or element.tag in SIMPLIFIED


def _is_material(element: Element) -> bool:
    """Whether an element stands for the material of an Appearance, as X3D 4 has several kinds of it."""
    default = "material" if element.tag.endswith("Material") else ""
    return (element.attributes.get("containerField", "").strip() or default) == "material"


def _accepted(node: nodes.Node, kinds: tuple[str, ...]) -> bool:
    return isinstance(node, _CHILD_KINDS) if "*" in kinds else type(node).__name__ in kinds
