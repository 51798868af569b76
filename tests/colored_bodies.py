"""A scene with a little of everything that tiles are made of."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from jaxlight import SampleBuffer, Scene, nodes
from jaxlight.raster import rasterize


def colored_bodies(points: int = 70, spots: int = 40, *, textures: bool = True) -> tuple[Scene, SampleBuffer]:
    """Two sheets, one textured and one with vertex colours, both with an alpha that differs from sample to sample;
    without textures only the second.

    They are under many point lights and spots, most of them on one side, and one directional light.
    """
    random = np.random.default_rng(9)
    appearance = nodes.Appearance(material=nodes.Material(specular_color=(0.4, 0.5, 0.6), shininess=0.1))
    image = nodes.ImageTexture(image=random.uniform(0, 1, (8, 8, 4)))
    corners = np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], float)
    uv = nodes.TextureCoordinate(point=[(0, 0), (1, 0), (1, 1), (0, 1)])
    colors = nodes.ColorRGBA(color=random.uniform(0.2, 1, (4, 4)))

    def sheet(**fields: Any) -> nodes.IndexedFaceSet:
        return nodes.IndexedFaceSet(coord=nodes.Coordinate(point=corners), coord_index=[0, 1, 2, 3, -1], **fields)

    textured = dataclasses.replace(appearance, texture=image)
    bodies = [
        nodes.Transform(
            translation=(-2.1, 0, 0), children=[nodes.Shape(appearance=textured, geometry=sheet(tex_coord=uv))]
        ),
        nodes.Transform(
            translation=(2.1, 0, 0), children=[nodes.Shape(appearance=appearance, geometry=sheet(color=colors))]
        ),
    ]

    def place() -> tuple[float, float, float]:
        return (float(8 * random.uniform() ** 2 - 4), float(random.uniform(-2, 2)), 0.3)

    lamps: list[nodes.Node] = [
        nodes.PointLight(location=place(), radius=0.7, color=random.uniform(size=3)) for _ in range(points)
    ]
    lamps += [
        nodes.SpotLight(location=place(), direction=(0.2, 0, -1), radius=1, cut_off_angle=0.9, beam_width=0.5)
        for _ in range(spots)
    ]
    sun = nodes.DirectionalLight(direction=(0.3, 0.1, -1), intensity=0.2)
    view = nodes.Viewpoint(position=(0, 0, 9))
    scene = Scene.from_nodes([view, *bodies[0 if textures else 1 :], sun, *lamps], dtype=np.float32)
    return dataclasses.replace(scene, document=None), rasterize(scene, width=80, height=48)
