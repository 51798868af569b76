"""Nodes -> an X3D file in its XML encoding."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from ..scene import nodes
from .x3d_fields import fields_of
from .xml_elements import xml_text

_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<!DOCTYPE X3D PUBLIC "ISO//Web3D//DTD X3D 3.3//EN" "http://www.web3d.org/specifications/x3d-3.3.dtd">
<X3D profile="Immersive" version="3.3">
  <head>
    <meta name="generator" content="jaxlight"/>
  </head>
  <Scene>
"""
_TAIL = """  </Scene>
</X3D>
"""
_ALWAYS = {"SpotLight": {"beamWidth", "cutOffAngle"}}
"""Fields whose default depends on the version of X3D, so that readers may not agree on it."""
_ADDRESSED = {
    "DirectionalLight", "Fog", "ImageTexture", "Material", "PixelTexture", "PointLight", "SpotLight",
}  # fmt: skip
"""Nodes whose fields are addressed by their name (`Material[body].diffuse_color`)."""


def write_x3d(children: Iterable[nodes.Node]) -> bytes:
    """The X3D file (version 3.3) that holds these nodes; fields at their default are left out.

    A node that appears more than once is written once and used again (USE), for which it gets a DEF name if it has
    none; DEF names are made unique, with `_` for characters that XML cannot hold.

    Raises:
        ValueError: such a character in another field; says in which node's.
    """
    roots = tuple(children)
    writer = _Writer(_def_names(roots))
    writer.lines.append(_HEAD)
    for node in roots:
        writer.write(node, 2)
    writer.lines.append(_TAIL)
    return "".join(writer.lines).encode()


class _Writer:
    def __init__(self, names: dict[nodes.Node, str]) -> None:
        self.lines: list[str] = []
        self._names = names
        self._written: set[nodes.Node] = set()

    def write(self, node: nodes.Node, depth: int) -> None:
        """One element with all that is in it."""
        tag, indent = type(node).__name__, "  " * depth
        if node in self._written:
            self.lines.append(f"{indent}<{tag} USE={quoteattr(self._names[node])}/>\n")
            return
        self._written.add(node)
        attributes = {"DEF": self._names[node]} if node in self._names else {}
        attributes |= _attributes(node)
        start = indent + " ".join([f"<{tag}", *(f"{name}={quoteattr(text)}" for name, text in attributes.items())])
        children = child_nodes(node)
        if not children:
            self.lines.append(f"{start}/>\n")
            return
        self.lines.append(f"{start}>\n")
        for child in children:
            self.write(child, depth + 1)
        self.lines.append(f"{indent}</{tag}>\n")


def child_nodes(node: nodes.Node) -> list[nodes.Node]:
    """The nodes in the node-valued fields, in the order of the fields."""
    found: list[nodes.Node] = []
    for name in node.accepts:
        value = getattr(node, name)
        found.extend(value if isinstance(value, tuple) else [] if value is None else [value])
    return found


def all_nodes(children: tuple[nodes.Node, ...]) -> list[nodes.Node]:
    """Every node once, in no particular order."""
    seen: dict[nodes.Node, None] = {}
    stack = list(children)
    while stack:
        node = stack.pop()
        if node not in seen:
            seen[node] = None
            stack.extend(child_nodes(node))
    return list(seen)


def _attributes(node: nodes.Node) -> dict[str, str]:
    """The value fields that are not at their default, as text."""
    kind = type(node)
    default = kind()
    found = {}
    for attribute, field in fields_of(kind).items():
        value = getattr(node, field.name)
        if attribute in _ALWAYS.get(kind.__name__, ()) or not _equal(value, getattr(default, field.name)):
            text = found[attribute] = field.type.format(value)
            if xml_text(text) != text:
                where = xml_text(f"{node.label}.{field.name}")
                raise ValueError(f"save: {where}: XML cannot hold a character of {value!r:.60}")
    return found


def _equal(a: Any, b: Any) -> bool:
    return np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b


def _def_names(roots: tuple[nodes.Node, ...]) -> dict[nodes.Node, str]:
    """DEF names: the nodes' own, made unique, and new ones for nameless nodes that appear more than once.

    Of two nodes with one name, the one whose fields can be fitted keeps it.
    """
    order: dict[nodes.Node, int] = {}
    stack = list(reversed(roots))
    while stack:
        node = stack.pop()
        order[node] = order.get(node, 0) + 1
        if order[node] == 1:
            stack.extend(reversed(child_nodes(node)))
    taken = {xml_text(node.name) for node in order}
    names: dict[nodes.Node, str] = {}
    given: set[str] = set()
    for node in sorted(order, key=lambda node: type(node).__name__ not in _ADDRESSED):
        name, count = xml_text(node.name), order[node]
        if name in given or (not name and count > 1):
            stem, number = name or type(node).__name__, 2 if name else 1
            while f"{stem}_{number}" in taken:
                number += 1
            name = f"{stem}_{number}"
            taken.add(name)
        if name:
            given.add(name)
            names[node] = name
    return names
