"""Nodes -> Scene: which nodes share a row."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from fit_scenes import precision
from jaxlight import Scene, nodes
from jaxlight.scene.transforms import rotation_matrix


def shape(material: nodes.Material | None, texture: nodes.PixelTexture | None = None) -> nodes.Shape:
    return nodes.Shape(appearance=nodes.Appearance(material=material, texture=texture))


def test_a_node_has_one_row_however_often_it_is_used_and_nodes_that_are_alike_stay_apart() -> None:
    red, also_red = nodes.Material(diffuse_color=(1, 0, 0)), nodes.Material(diffuse_color=(1, 0, 0))
    wood, also_wood = (nodes.PixelTexture(image=np.ones((1, 1, 3))) for _ in range(2))
    pairs = [(red, None), (also_red, wood), (red, also_wood), (None, wood), (red, None)]
    scene = Scene.from_nodes([*(shape(*pair) for pair in pairs), nodes.Shape()])
    rows = [scene.surfaces[placed.surface] for placed in scene.document.shapes]
    assert [(row.material, row.texture) for row in rows] == [(0, -1), (1, 0), (0, 1), (-1, 0), (0, -1), (-1, -1)]
    assert scene.document.materials == (red, also_red)
    assert scene.document.textures == (wood, also_wood)


def test_tens_of_thousands_of_materials_have_a_row_each() -> None:
    shapes = [shape(nodes.Material()) for _ in range(40_000)]
    scene = Scene.from_nodes(shapes)
    assert len(scene.surfaces) == len(scene.document.materials) == 40_000
    assert [row.material for row in scene.surfaces] == list(range(40_000))


def test_turns_and_even_scales_are_a_similarity_but_for_rounding() -> None:
    random = np.random.default_rng(0)
    for _ in range(50):
        inner = nodes.Transform(rotation=random.normal(size=4), scale=(0.1, 0.1, 0.1), children=[nodes.PointLight()])
        outer = nodes.Transform(rotation=random.normal(size=4), scale=(3, 3, 3), children=[inner])
        assert Scene.from_nodes([outer]).point.frame == "similarity"


@pytest.mark.parametrize("length", [1e-320, 1e-170, 1e-150, 1e150, 1e155, 1e308])
def test_an_axis_of_any_length_turns_alike(length: float) -> None:
    expected = rotation_matrix((0.0, 1.0, 1.0, 0.5))
    np.testing.assert_allclose(rotation_matrix((0.0, length, length, 0.5)), expected, atol=1e-15)


@pytest.mark.parametrize("kind", [nodes.PointLight, nodes.SpotLight])
@pytest.mark.parametrize(
    ("scale", "location", "dtype", "reach"),
    [
        ((1, 100, 1), (1, 3.4e38, 1), "float32", "3.4e+40"),
        ((1e10, 1e10, 1e10), (0, -1e29, 0), "float32", "1e+39"),
        ((1e10, 1e10, 1e10), (0, 1e300, 0), "float64", "inf"),
    ],
)
def test_a_light_that_transforms_move_beyond_the_type_is_refused(
    kind: type[nodes.PointLight], scale: Any, location: Any, dtype: str, reach: str
) -> None:
    light = nodes.Transform(scale=scale, children=[kind(location=location, name="far")])
    said = rf"{kind.__name__}\[far\].location: with the transforms above it {re.escape(reach)} is larger than"
    with precision(dtype), pytest.raises(ValueError, match=said):
        Scene.from_nodes([light], dtype=dtype)


def test_the_farthest_light_of_a_type_is_held_where_no_transform_moves_it() -> None:
    light = nodes.PointLight(location=(3e38, -3e38, 3e38))
    assert np.all(np.isfinite(Scene.from_nodes([light], dtype="float32").point.location))
