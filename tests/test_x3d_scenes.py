"""Real X3D scenes by others: every one renders, what can be told beforehand is there, a screenshot agrees."""

from __future__ import annotations

import csv
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from jaxlight import Camera, LightingOptions, Scene, load, nodes, rasterize, read_image, render

DATA = Path(__file__).parent / "data"
FOLDER = DATA / "x3d_scenes"
with (FOLDER / "manifest.csv").open() as manifest:
    XML = [row["file"] for row in csv.DictReader(manifest) if row["encoding"] == "xml"]

# Scenes whose shapes are all of kinds that are not supported yet: loading names them.
EMPTY = {
    "27cubes.x3d",
    "BackMaterial.x3d",
    "IndexedLineSet.x3d",
    "MaterialLights.x3d",
    "Mobius.x3d",
    "NestedProtos.x3d",
    "Teapot.x3dv",
    "TwoSidedMaterial.x3d",
    "newlines_in_string.x3d",
}

# (row, column of 240 x 320) -> colour, for reasons that are in the file.
EXPECTED: dict[str, dict[tuple[int, int], tuple[float, float, float]]] = {
    "Comment.x3d": {(120, 160): (1, 0, 0), (10, 10): (0, 0, 0)},  # a red face under the headlight
    "IndexedLineSet.x3d": {(120, 160): (0.2, 0.2, 0.2)},  # nothing but the Background
    "InlineGlobal.x3d": {(120, 160): (0.266667, 0.266667, 0.266667)},  # a floor that glows, without light
    "LightScale.x3d": {(235, 160): (0, 0, 0), (60, 160): (0, 0, 0)},  # beyond the light's radius
    "StaticGroup.x3d": {(205, 115): (1, 1, 1), (10, 10): (0.2, 0.2, 0.2)},  # an unlit sphere; the Background
}


@pytest.mark.parametrize("name", XML)
def test_every_scene_renders(name: str) -> None:
    path = FOLDER / name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = load(path)
        samples = rasterize(scene, None, 320, 240)
        picture = np.asarray(render(scene, samples))
    assert picture.shape == (240, 320, 3)
    assert np.all(np.isfinite(picture))
    assert picture.min() >= 0
    assert (samples.count == 0) == (path.name in EMPTY)
    for (row, column), color in EXPECTED.get(path.name, {}).items():
        np.testing.assert_allclose(picture[row, column], color, atol=1e-6)


def material_parameters() -> Scene:
    """The untextured spheres of michaliskambi/x3d-tests pbr/x3d_3_interesting_tests/material_parameters.x3dv."""
    black, yellow = (0.0, 0.0, 0.0), (1.0, 1.0, 0.0)
    materials = [
        None,
        nodes.Material(emissive_color=yellow, diffuse_color=black, ambient_intensity=0.0),
        nodes.Material(diffuse_color=yellow, ambient_intensity=1.0),
        nodes.Material(diffuse_color=yellow, ambient_intensity=0.0),
        nodes.Material(diffuse_color=black, ambient_intensity=0.0, specular_color=yellow),
    ]
    balls = [
        nodes.Transform(
            translation=(2.0 * column - 2.0, 0, 0),
            children=[nodes.Shape(appearance=nodes.Appearance(material=material), geometry=nodes.Sphere())],
        )
        for column, material in enumerate(materials)
    ]
    return Scene.from_nodes(
        [*balls, nodes.PointLight(location=(7, 0, 2), ambient_intensity=0.2), nodes.NavigationInfo(headlight=False)]
    )


def test_a_screenshot_of_another_program_agrees() -> None:
    """Castle Game Engine's picture of five spheres: no material, emissive, diffuse with ambient, diffuse, specular.

    Known departures of that program: it adds 0.2 x ambientIntensity x diffuseColor, has no highlight where N.L <= 0,
    and its spheres are polyhedra with normals interpolated over 12 degrees. Three pixels at each outline are left out.
    """
    reference = read_image(DATA / "castle_screenshot" / "material_parameters_top_row.png")
    scene = material_parameters()
    # The box of the whole scene is (-3, -3, -1) to (7.1, 1, 2.1); see SOURCE.txt.
    camera = Camera.look_at((2.05, -1, 2.1 + 2 * (10.1 + 4 + 3.1) / 3), (2.05, -1, 0))
    samples = rasterize(scene, camera, 1600, 900)
    picture = np.array(render(scene, samples, LightingOptions(specular_gate=True)))
    ball = np.full(900 * 1600, -1)
    ball[np.asarray(samples.pixel)] = np.round((np.asarray(samples.position)[:, 0] + 2) / 2).astype(int)
    window = (slice(280, 460), slice(380, 1300))
    ball, picture = ball.reshape(900, 1600)[window], picture[window]
    picture[ball == 2] += 0.2 * np.array([1.0, 1.0, 0.0])
    error = 255 * np.abs(np.clip(picture, 0, 1) - reference).max(axis=2)
    # Rounding makes 0.5; what the interpolated normals make grows with how fast the colour changes.
    for number, (worst, mean) in enumerate([(0.51, 0.01), (0.51, 0.01), (2.0, 0.3), (3.0, 0.6), (9.0, 0.6)]):
        inside = binary_erosion(ball == number, iterations=3)
        assert inside.sum() > 15_000
        assert error[inside].max() <= worst, number
        assert error[inside].mean() <= mean, number


def test_a_mesh_under_a_point_light_agrees_with_another_program() -> None:
    """view3dscene's picture of a cow, vertex normals and all (fitting/data/spot/HOW_IT_WAS_MADE.txt)."""
    folder = Path(__file__).parents[1] / "fitting" / "data" / "spot"
    scene = load(folder / "spot.x3d")
    picture = np.asarray(render(scene, rasterize(scene, None, 256, 256)))
    error = 255 * np.abs(np.clip(picture, 0, 1) - read_image(folder / "spot_256.png"))
    assert error.max() <= 0.52  # rounding to 8 bits makes 0.5
