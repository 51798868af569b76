"""Numbers on lanes, put together in one array and taken apart again; derivatives by them."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight.lighting import lanes
from jaxlight.lighting.plan import make_plan
from jaxlight.lighting.prepared import Prepared, prepare
from jaxlight.raster import SampleBuffer
from jaxlight.scene import Scene, nodes
from leaves import same_leaves


def prepared_scene(materials: int) -> Prepared:
    """Every kind of light, a fog, and one light in a frame that measures distances otherwise."""
    shapes = [
        nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(shininess=0.1 + 0.2 * row)))
        for row in range(materials)
    ]
    lights = [
        nodes.DirectionalLight(ambient_intensity=0.3, global_=True),
        nodes.PointLight(location=(1, 2, 3), attenuation=(1, 0, 1), global_=True),
        nodes.Transform(
            scale=(1, 2, 1), children=[nodes.SpotLight(location=(0, 1, 2), attenuation=(1, 1, 0), global_=True)]
        ),
    ]
    scene = Scene.from_nodes([*shapes, *lights, nodes.Fog(visibility_range=30.0)], dtype=np.float32)
    random = np.random.default_rng(3)
    samples = SampleBuffer.create(
        position=random.uniform(-1, 1, (64, 3)),
        normal=np.tile([0.0, 0, 1], (64, 1)),
        eye=(0, 0, 5),
        surface=np.arange(64) * materials // 64,
        dtype=np.float32,
    )
    return prepare(scene, samples, make_plan(scene, samples, free=True))


@pytest.mark.parametrize("materials", [1, 3])
def test_planes_come_out_of_the_array_as_they_went_in(materials: int) -> None:
    prepared = prepared_scene(materials)
    packed = lanes.packed(prepared)
    assert packed.rows is not None and packed.rows.shape[1] == 1
    assert packed.others.lights[2] is not None and packed.others.lights[2].to_local is not None
    # Of several materials a tile spreads its own.
    assert (packed.others.materials.diffuse_color is None) == (materials == 1)
    assert same_leaves(lanes.unpacked(packed, prepared), prepared)
    wide = lanes.unpacked(lanes.spread(packed, prepared.lanes), prepared)
    assert prepared.lanes > 1 and wide.fog.color.shape == (3, 1, prepared.lanes)
    assert wide.materials.shininess.shape == ((1, prepared.lanes) if materials == 1 else (materials, 1, 1))
    assert same_leaves(wide, lanes.on_all_lanes(prepared))


@pytest.mark.parametrize("materials", [1, 3])
def test_derivatives_by_a_number_are_added_up_over_its_lanes(materials: int) -> None:
    prepared = prepared_scene(materials)
    moving = dataclasses.replace(eqx.filter(prepared, eqx.is_inexact_array), textures=())
    random = np.random.default_rng(4)
    weights = jax.tree.map(
        lambda plane: jnp.asarray(random.normal(size=plane.shape), plane.dtype), lanes.on_all_lanes(moving)
    )

    def weighted(moving: Prepared) -> jax.Array:
        wide = lanes.unpacked(lanes.spread(lanes.packed(moving), prepared.lanes), moving)
        return sum(jnp.vdot(*pair) for pair in zip(*map(jax.tree.leaves, (wide, weights)), strict=True))

    slope = jax.tree.leaves(jax.grad(weighted)(moving))
    fewer = lanes.packed(lanes.on_fewer_lanes(weights))
    sums = jax.tree.leaves(lanes.unpacked(lanes.summed(fewer), moving))
    for own, of_lanes, weight in zip(slope, sums, jax.tree.leaves(weights), strict=True):
        expected = np.asarray(weight, np.float64).reshape(*own.shape[:-1], -1).sum(axis=-1, keepdims=True)
        np.testing.assert_allclose(own, expected, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(of_lanes, expected, rtol=1e-4, atol=1e-5)


def test_what_does_not_move_is_in_no_array() -> None:
    prepared = prepared_scene(1)
    only_fog = dataclasses.replace(
        jax.tree.map(lambda _: None, prepared), fog=dataclasses.replace(prepared.fog, color=prepared.fog.color)
    )
    rows = lanes.packed(only_fog).rows
    assert rows is not None and rows.shape == (4, 1)
    nothing = jax.tree.map(lambda _: None, prepared)
    assert lanes.packed(nothing).rows is None
    assert not jax.tree.leaves(lanes.unpacked(lanes.summed(lanes.packed(nothing)), nothing))
