"""Grouping nodes that are read as a plain Group of their children, and the elements that are no nodes at all."""

from __future__ import annotations

from .xml_elements import Element

SIMPLIFIED = {
    "Anchor": "Anchor (as Group)",
    "Billboard": "Billboard (as Group, not turned)",
    "CADAssembly": "CADAssembly (as Group)",
    "CADLayer": "CADLayer (as Group)",
    "Collision": "Collision (as Group)",
    "LOD": "LOD (its first level)",
    "Layer": "Layer (as Group)",
    "LayerSet": "LayerSet (its active layer)",
    "PickableGroup": "PickableGroup (as Group)",
    "StaticGroup": "StaticGroup (as Group)",
    "ViewpointGroup": "ViewpointGroup (as Group)",
}
"""What the warning says of each."""

_STATEMENTS = {
    "EXPORT", "ExternProtoDeclare", "IMPORT", "IS", "ProtoDeclare", "ROUTE", "connect", "field", "fieldValue",
}  # fmt: skip
CHILD_HOLDERS = {"children", "layers", "level"}
"""The containerFields of what stands in a group."""


def is_child_node(element: Element) -> bool:
    """True for a node among the children of a group: no statement, no metadata, nothing in another field."""
    holder = element.attributes.get("containerField", "children")
    is_node = element.tag not in _STATEMENTS and not element.tag.startswith("Metadata")
    return is_node and holder in CHILD_HOLDERS


def split_children(element: Element) -> tuple[list[Element], list[Element]]:
    """The child elements to read, and those to leave: of a LOD all but the first level, of a LayerSet the layers that
    are not active (they lie on top of the picture, with cameras of their own; layer 0 is the scene beside it).
    """
    if element.tag not in ("LOD", "LayerSet"):
        return element.children, []
    levels = [child for child in element.children if is_child_node(child)]
    wanted = 0
    if element.tag == "LayerSet":
        active = element.attributes.get("activeLayer", "0").strip()
        wanted = int(active) - 1 if active.isdecimal() and len(active) < 9 else -1
    chosen = levels[wanted : wanted + 1] if wanted >= 0 else []
    return chosen, [child for child in element.children if child not in chosen]
