"""Scenes whose leaves are not what they should be, and arguments of other types, are refused by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight import (
    Camera,
    LightingOptions,
    SampleBuffer,
    Scene,
    Surface,
    View,
    check_gradients,
    fit,
    nodes,
    rasterize,
    render,
    shade,
)
from jaxlight.lighting import make_plan

DIFFUSE = "Material[red].diffuse_color"


@pytest.fixture(scope="module")
def seen() -> tuple[Scene, SampleBuffer]:
    """Two spheres of two materials under a light of each kind, in fog, one of them with a texture."""
    picture = nodes.PixelTexture(image=np.full((2, 2, 3), 0.5))
    bodies = [
        nodes.Shape(
            appearance=nodes.Appearance(material=nodes.Material(name=name), texture=texture), geometry=nodes.Sphere()
        )
        for name, texture in (("red", None), ("blue", picture))
    ]
    placed = [nodes.Transform(translation=(x, 0, 0), children=(body,)) for x, body in zip((-1, 1), bodies, strict=True)]
    lights = [nodes.DirectionalLight(), nodes.PointLight(), nodes.SpotLight()]
    scene = Scene.from_nodes([*placed, *lights, nodes.Fog(visibility_range=30.0)])
    return scene, rasterize(scene, Camera.look_at((0, 0, 8), (0, 0, 0)), 16, 16)


LEAVES: list[tuple[Callable[[Scene], Any], Any, str]] = [
    (
        lambda s: s.materials.diffuse_color,
        jnp.ones(3),
        r"Material\.diffuse_color: .* \[2, 3\], got float32 of shape \[3\]",
    ),
    (lambda s: s.materials.diffuse_color, jnp.ones((1, 3)), r"\[2, 3\], got float32 of shape \[1, 3\]"),
    (lambda s: s.materials.diffuse_color, jnp.ones((2, 4)), r"\[2, 3\], got float32 of shape \[2, 4\]"),
    (
        lambda s: s.materials.diffuse_color,
        np.ones((2, 3), int),
        r"floating-point numbers .*got int64 of shape \[2, 3\]",
    ),
    (lambda s: s.materials.shininess, np.ones(2, ">f4"), r"floating-point numbers .*got >f4 of shape \[2\]"),
    (lambda s: s.materials.shininess, 0.5, r"Material\.shininess: .* \[2\], got a float"),
    (lambda s: s.materials.shininess, 1, r"Material\.shininess: .* \[2\], got an int"),
    (
        lambda s: s.directional.intensity,
        jnp.ones(()),
        r"DirectionalLight\.intensity: .* \[1\], got float32 of shape \[\]",
    ),
    (lambda s: s.point.location, jnp.ones(3), r"PointLight\.location: .* \[1, 3\], got float32 of shape \[3\]"),
    (lambda s: s.spot.to_world, jnp.ones((1, 4, 4)), r"SpotLight\.to_world: .* \[1, 3, 4\]"),
    (lambda s: s.fog.color, jnp.ones((1, 3)), r"Fog\.color: .* \[3\], got float32 of shape \[1, 3\]"),
    (lambda s: s.textures[0].image, jnp.ones((2, 2)), r"Texture\[0\]\.image: .* \[2, 2, components\]"),
    (lambda s: s.textures[0].image, jnp.ones((3, 2, 3)), r"\[2, 2, components\], got float32 of shape \[3, 2, 3\]"),
]


@pytest.mark.parametrize(("leaf", "value", "message"), LEAVES)
def test_leaves_of_another_shape_or_type_are_refused(
    seen: tuple[Scene, SampleBuffer], leaf: Callable[[Scene], Any], value: Any, message: str
) -> None:
    scene, samples = seen
    target = np.zeros((16, 16, 3))
    changed = eqx.tree_at(leaf, scene, value)
    for act in (
        lambda: shade(changed, samples),
        lambda: render(changed, samples),
        lambda: jax.jit(lambda samples: shade(changed, samples))(samples),
        lambda: fit(changed, View(samples, target), [DIFFUSE]),
        lambda: check_gradients(changed, samples, [DIFFUSE]),
    ):
        with pytest.raises(ValueError, match=message):
            act()


@pytest.mark.filterwarnings("ignore:A JAX array is being set as static")
@pytest.mark.parametrize("surfaces", [None, [Surface("lit", 0)], (("lit", 0, -1, 0),), (Surface("lit", np.array(0)),)])
def test_surfaces_of_another_type_are_refused(seen: tuple[Scene, SampleBuffer], surfaces: Any) -> None:
    scene, samples = seen
    with pytest.raises(ValueError, match="scene: surfaces: expected a tuple of Surface, got "):
        shade(dataclasses.replace(scene, surfaces=surfaces), samples)


@pytest.mark.parametrize("kind", ["directional", "point", "spot", "fog"])
def test_a_frame_is_of_the_kind_that_is_stated(kind: str) -> None:
    """Where all are the world's own, matrices are not read: other ones alone would change nothing."""
    haze = nodes.Fog(visibility_range=30.0)
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()), geometry=nodes.Sphere())
    placed: dict[str, Any] = {"location": (0.5, 1.0, 4.0), "attenuation": (1.0, 0.5, 0.0)}
    lights = [nodes.DirectionalLight(), nodes.PointLight(**placed), nodes.SpotLight(**placed)]
    everything = (shape, *lights, haze)
    plain = Scene.from_nodes(everything)
    even = Scene.from_nodes(nodes.Transform(rotation=(0, 0, 1, 0.5), scale=(2, 2, 2), children=everything))
    samples = rasterize(plain, Camera.look_at((0, 0, 8), (0, 0, 0)), 8, 8)
    sheared = jnp.array([[1, 0.5, 1, 0], [0, 2, 0, 0], [0.2, 0.3, 3, 0]])
    field, matrices = ("to_local", sheared[:, :3]) if kind == "fog" else ("to_world", sheared[None])
    for scene in (plain, even):
        owner, before = getattr(scene, kind), shade(scene, samples)

        def changed(own: Any, scene: Scene = scene) -> Scene:
            return eqx.tree_at(lambda s: getattr(s, kind), scene, own)

        with pytest.raises(ValueError, match=f"{field}: `frame` states that it is of the kind '{owner.frame}'"):
            shade(changed(dataclasses.replace(owner, **{field: matrices})), samples)
        stated = changed(dataclasses.replace(owner, frame="general", **{field: matrices}))
        assert np.max(np.abs(shade(stated, samples) - before)) > 1e-3


def test_leaves_of_numpy_and_of_every_float_type_are_shaded(seen: tuple[Scene, SampleBuffer]) -> None:
    scene, samples = seen
    plain = render(scene, samples)
    for dtype, rounding in ((np.float16, 1e-2), (np.float32, 1e-6), (np.float64, 1e-6)):
        changed = jax.tree.map(lambda leaf, dtype=dtype: np.asarray(leaf, dtype), scene)
        np.testing.assert_allclose(render(changed, samples), plain, rtol=0, atol=rounding)


def test_arguments_of_another_type_are_refused(seen: tuple[Scene, SampleBuffer]) -> None:
    scene, samples = seen
    wrong: Any = samples
    other: Any = scene
    nothing: Any = None
    options: Any = "modulate"
    for function in (shade, render, check_gradients):
        with pytest.raises(ValueError, match="scene: expected a Scene, got SampleBuffer"):
            function(wrong, other)
        with pytest.raises(ValueError, match="scene: expected a Scene, got NoneType"):
            function(nothing, samples)
        with pytest.raises(ValueError, match="samples: expected a SampleBuffer, got Scene"):
            function(scene, other)
        with pytest.raises(ValueError, match="options: expected LightingOptions, got str"):
            function(scene, samples, options=options)


def test_a_plan_stands_alone(seen: tuple[Scene, SampleBuffer]) -> None:
    """It holds the options that it was made with; other ones beside it would be ignored."""
    scene, samples = seen
    plan: Any = LightingOptions()
    for function in (shade, render):
        with pytest.raises(ValueError, match="options: a plan has options of its own"):
            function(scene, samples, LightingOptions(support_level=1), plan=make_plan(scene, samples))
        with pytest.raises(ValueError, match="plan: expected a Plan, got LightingOptions"):
            function(scene, samples, plan=plan)
