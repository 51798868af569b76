"""The browser's headlight: white light along the view for scenes that have no light of their own (X3D 23.4.4)."""

from __future__ import annotations

import numpy as np
import pytest

from jaxlight import Camera, SampleBuffer, Scene, nodes, rasterize, shade

BALL = nodes.Shape(
    appearance=nodes.Appearance(material=nodes.Material(diffuse_color=(0.5, 0.25, 1.0), ambient_intensity=1.0)),
    geometry=nodes.Sphere(),
)


@pytest.mark.parametrize("eye", [(0.0, 0.0, 5.0), (4.0, 3.0, 0.0), (-2.0, -3.0, -4.0)])
def test_a_scene_without_lights_is_lit_along_the_view(eye: tuple[float, float, float]) -> None:
    scene = Scene.from_nodes([BALL])
    samples = rasterize(scene, Camera.look_at(eye, (0, 0, 0)), 32, 32)
    towards = np.array(eye) / np.linalg.norm(eye)
    facing = np.maximum(np.asarray(samples.normal, np.float64) @ towards, 0)
    expected = facing[:, None] * [0.5, 0.25, 1.0]
    np.testing.assert_allclose(np.asarray(shade(scene, samples))[:, :3], expected, atol=1e-6)


@pytest.mark.parametrize("dtype", ["float32", "bfloat16", "float16"])
def test_its_direction_has_length_one_whatever_the_rotation_is_rounded_to(dtype: str) -> None:
    """Exact for the samples as they are stored, whose numbers are widened before anything is computed."""
    scene = Scene.from_nodes([BALL])
    samples = rasterize(scene, Camera.look_at((1.0, 2.0, 4.0), (0, 0, 0), up=(0.3, 1, 0)), 24, 24, dtype=dtype)
    towards = np.asarray(samples.camera_to_world, np.float64) @ [0, 0, 1]
    normal = np.asarray(samples.normal, np.float64)
    cosine = normal @ towards / np.linalg.norm(towards) / np.linalg.norm(normal, axis=1)
    got = np.asarray(shade(scene, samples))[:, 2]
    np.testing.assert_allclose(got, np.maximum(cosine, 0), atol=3e-7)


def flat(*children: nodes.Node) -> nodes.Transform:
    return nodes.Transform(scale=(1, 0, 1), children=children)


@pytest.mark.parametrize(
    "other",
    [
        nodes.NavigationInfo(headlight=False),
        nodes.PointLight(on=False),
        nodes.DirectionalLight(color=(0, 0, 0)),
        flat(nodes.PointLight()),
        flat(nodes.Group(children=(nodes.Shape(), flat(nodes.SpotLight())))),
        flat(nodes.Switch(which_choice=1, children=(nodes.Group(), nodes.DirectionalLight()))),
    ],
)
def test_there_is_none_with_lights_or_where_navigation_info_says_so(other: nodes.Node) -> None:
    scene = Scene.from_nodes([BALL, other])
    samples = rasterize(scene, Camera.look_at((0, 0, 5), (0, 0, 0)), 16, 16)
    np.testing.assert_array_equal(np.asarray(shade(scene, samples))[:, :3], 0)


@pytest.mark.parametrize(
    "other",
    [
        flat(nodes.Group(children=(nodes.Shape(),))),
        nodes.Switch(children=(nodes.PointLight(),)),
        flat(nodes.Switch(which_choice=0, children=(nodes.Group(), nodes.PointLight()))),
    ],
)
def test_lights_that_no_group_shows_count_for_nothing(other: nodes.Node) -> None:
    directional = Scene.from_nodes([BALL, other]).directional
    assert directional is not None and directional.headlight


def test_lights_below_a_scale_of_0_are_looked_for_once() -> None:
    """2^30 paths lead through the groups, and a thousand scales of 0 to them."""
    group = nodes.Group(children=(nodes.Shape(),))
    for _ in range(30):
        group = nodes.Group(children=(group, group))
    scene = Scene.from_nodes([BALL, *(flat(group) for _ in range(1000))])
    assert scene.directional is not None and scene.directional.headlight


def test_without_a_camera_it_is_said_where_it_shines() -> None:
    scene, point = Scene.from_nodes([BALL]), [[1.0, 0.0, 0.0]]
    samples = SampleBuffer.create(position=point, normal=point, eye=(4, 0, 0))
    with pytest.warns(UserWarning, match="no camera_to_world: the headlight .* along the world's -z"):
        shade(scene, samples)
    turned = SampleBuffer.create(
        position=point, normal=point, eye=(4, 0, 0), camera_to_world=[[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    )
    np.testing.assert_allclose(np.asarray(shade(scene, turned))[0, :3], [0.5, 0.25, 1.0], rtol=1e-6)


def test_the_first_navigation_info_counts() -> None:
    infos = [nodes.NavigationInfo(headlight=True), nodes.NavigationInfo(headlight=False)]
    assert Scene.from_nodes([BALL, *infos]).directional is not None
    assert Scene.from_nodes([BALL, *reversed(infos)]).directional is None
