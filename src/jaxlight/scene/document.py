"""The host-side part of a Scene: nodes and where they stand. Compared by identity, so it can be static under jit."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from . import nodes


@dataclasses.dataclass(frozen=True, eq=False)
class PlacedShape:
    """A Shape and the matrix [3, 4] that maps its coordinates to the world; `surface`: its row in Scene.surfaces."""

    node: nodes.Shape
    to_world: np.ndarray
    surface: int


@dataclasses.dataclass(frozen=True, eq=False)
class PlacedViewpoint:
    """A Viewpoint and the matrix [3, 4] that maps its coordinates to the world."""

    node: nodes.Viewpoint
    to_world: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class PlacedBackground:
    """A Background and the matrix [3, 4] that maps its coordinates to the world."""

    node: nodes.Background
    to_world: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Document:
    """What a Scene was made from. Rows of the scene's arrays point back to their nodes here.

    One is equal to itself alone: scenes made of other nodes are other scenes to JAX, whatever numbers they hold.
    """

    children: tuple[nodes.Node, ...]
    shapes: tuple[PlacedShape, ...]
    viewpoints: tuple[PlacedViewpoint, ...]
    background: PlacedBackground | None
    materials: tuple[nodes.Material, ...]
    """The node behind each row of Scene.materials; likewise below."""
    directional: tuple[nodes.DirectionalLight, ...]
    point: tuple[nodes.PointLight, ...]
    spot: tuple[nodes.SpotLight, ...]
    textures: tuple[nodes.ImageTexture | nodes.PixelTexture, ...]
    fog: nodes.Fog | None
    source: Any = None
    """What the formats stage keeps of the file that the nodes were read from, to write the scene back into it."""

    def __repr__(self) -> str:
        # Short: JAX's messages about scenes that differ hold the documents of both.
        lights = len(self.directional) + len(self.point) + len(self.spot)
        return f"Document({len(self.shapes)} shapes, {lights} lights)"
