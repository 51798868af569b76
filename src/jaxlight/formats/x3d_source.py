"""What is kept of an X3D file beside its nodes, so that the scene can be written back into the same text."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ..scene import nodes


@dataclasses.dataclass(frozen=True, eq=False)
class X3DSource:
    """The bytes of an X3D file in its XML encoding and where each node stands in them."""

    path: Path
    data: bytes = dataclasses.field(repr=False)
    element_numbers: dict[nodes.Node, int] = dataclasses.field(repr=False)
    """How many start tags stand before the node's own in the file."""
    texture_files: dict[nodes.Node, Path] = dataclasses.field(repr=False)
    """The file behind each ImageTexture that was read."""
    angle_unit: float
    """Radians in one angle unit of the file."""
