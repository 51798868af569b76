"""Helpers of the file-format tests: small X3D documents as text."""

from __future__ import annotations

import warnings
from pathlib import Path

from jaxlight.formats import ReadScene, SceneFileWarning, read_nodes
from jaxlight.scene.nodes import Node


def x3d(scene: str, version: str | None = "3.3", head: str = "") -> str:
    """A document that holds `scene`; the scene starts on line 3."""
    attribute = f" version='{version}'" if version else ""
    start = f"<?xml version='1.0' encoding='UTF-8'?>\n<X3D profile='Immersive'{attribute}>{head}<Scene>"
    return f"{start}\n{scene}\n</Scene></X3D>\n"


def read_text(folder: Path, scene: str, version: str | None = "3.3", head: str = "") -> ReadScene:
    """What `read_nodes` makes of `scene`; nothing may be skipped, clamped or missing."""
    path = folder / "scene.x3d"
    path.write_text(x3d(scene, version, head))
    with warnings.catch_warnings():
        warnings.simplefilter("error", SceneFileWarning)
        return read_nodes(path)


def only_node(folder: Path, scene: str, version: str | None = "3.3", head: str = "") -> Node:
    """The one root node of `scene`."""
    (node,) = read_text(folder, scene, version, head).children
    return node
