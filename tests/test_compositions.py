"""Shading inside of what JAX has for several devices: values and derivatives are those of one device."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, NamedSharding, PartitionSpec

from counted_work import programs_of
from jaxlight import SampleBuffer, Scene, nodes, shade, sum_over_samples
from jaxlight.lighting import Plan, make_plan
from jaxlight.raster.samples import MANY_LIGHTS
from leaves import assert_leaves_close

SHARED, OWN = PartitionSpec(), PartitionSpec("i")
FACTOR = np.float32(1.5)

Loss = Callable[[Scene, SampleBuffer, Any], jax.Array]


def scene_under_lights(count: int, fog_type: str = "LINEAR") -> Scene:
    """A sphere with highlights in fog; many lights are small."""
    body = nodes.Material(specular_color=(0.3, 0.4, 0.5))
    own: dict[str, Any] = {"radius": 0.7} if count >= MANY_LIGHTS else {"radius": 100}
    height = 0.5 if count >= MANY_LIGHTS else 3
    lamps = [nodes.PointLight(location=(0.1 * k - count / 20, 0, height), **own) for k in range(count)]
    shape = nodes.Shape(appearance=nodes.Appearance(material=body), geometry=nodes.Sphere())
    scene = Scene.from_nodes([shape, *lamps, nodes.Fog(visibility_range=20, fog_type=fog_type)])
    return dataclasses.replace(scene, document=None)


def buffer(seed: int) -> SampleBuffer:
    position, normal = np.random.default_rng(seed).normal(size=(2, 50, 3))
    return SampleBuffer.create(position, normal, [0, 0, 5], tile=8, by_place=True)


def own(samples: SampleBuffer) -> SampleBuffer:
    """That of one device."""
    return jax.tree.map(lambda leaf: leaf[0], samples)


def of_colors(plan: Plan) -> Loss:
    def loss(scene: Scene, samples: SampleBuffer, factor: jax.Array) -> jax.Array:
        return jnp.sum((factor * shade(scene, samples, plan=plan)[:, :3]) ** 2)

    return loss


def tile_by_tile(plan: Plan) -> Loss:
    def loss(scene: Scene, samples: SampleBuffer, factor: jax.Array) -> jax.Array:
        return sum_over_samples(lambda color: (factor * color[:3]) ** 2, scene, samples, plan=plan)

    return loss


def assert_close(got: Any, wanted: Any) -> None:
    assert_leaves_close(got, wanted, 2e-5, least=1e-2)


def on_two_devices(lights: int, *, whole: bool) -> None:
    """`whole`: with every way to ask for derivatives."""
    mesh = jax.make_mesh((2,), ("i",), axis_types=(AxisType.Auto,))
    scene, buffers = scene_under_lights(lights), [buffer(1), buffer(2)]
    plan = make_plan(scene, buffers[0], free=True)
    assert plan.culled is (lights >= MANY_LIGHTS)
    samples = jax.tree.map(lambda *leaves: jnp.stack(leaves), *buffers)

    def mapped(function: Callable[..., Any], given: Any, out: Any = OWN) -> Callable[..., Any]:
        return jax.shard_map(function, mesh=mesh, in_specs=given, out_specs=out)

    def colors(samples: SampleBuffer) -> jax.Array:
        return shade(scene, own(samples), plan=plan)[None]

    wanted = jnp.stack([shade(scene, one, plan=plan) for one in buffers])
    assert_close(jax.jit(mapped(colors, OWN))(samples), wanted)

    tiles = tile_by_tile(plan)
    for loss in (of_colors(plan), tiles) if whole else (tiles,):

        def on_each(scene: Scene, samples: SampleBuffer, factor: jax.Array, loss: Loss = loss) -> jax.Array:
            return jax.lax.psum(loss(scene, own(samples), factor), "i")

        def slope_on_each(scene: Scene, samples: SampleBuffer, factor: jax.Array, loss: Loss = loss) -> Any:
            return jax.grad(lambda scene: loss(scene, own(samples), factor))(scene)

        def on_one(scene: Scene, factors: jax.Array, loss: Loss = loss) -> jax.Array:
            return sum(
                (loss(scene, one, factor) for one, factor in zip(buffers, factors, strict=True)), start=jnp.zeros(())
            )

        alone = jax.jit(jax.value_and_grad(on_one, (0, 1)))
        value, (slope, by_factors) = alone(scene, jnp.full(2, FACTOR))
        total = mapped(on_each, (SHARED, OWN, SHARED), SHARED)
        found = jax.jit(jax.value_and_grad(total, (0, 2)))(scene, samples, FACTOR)
        assert_close(found, (value, (slope, jnp.sum(by_factors))))
        if whole and loss is tiles:
            assert_close(jax.jit(mapped(slope_on_each, (SHARED, OWN, SHARED), SHARED))(scene, samples, FACTOR), slope)
            assert_close(jax.grad(total)(scene, samples, FACTOR), slope)  # outside of jit
            # A factor for each device, of different losses.
            factors = jnp.array([1.5, 0.5])
            total = mapped(lambda *all: on_each(*all[:2], all[2][0]), (SHARED, OWN, OWN), SHARED)
            found = jax.jit(jax.value_and_grad(total, (0, 2)))(scene, samples, factors)
            assert_close(found, alone(scene, factors))

    def of_all(scene: Scene, samples: SampleBuffer) -> jax.Array:
        return jnp.sum(jax.vmap(lambda one: of_colors(plan)(scene, one, FACTOR))(samples))

    # What each device does is left to XLA.
    divided = jax.device_put(samples, NamedSharding(mesh, OWN))
    assert_close(jax.jit(jax.grad(of_all))(scene, divided), slope)


@pytest.mark.parametrize(("lights", "whole"), [(1, True), pytest.param(40, False, marks=pytest.mark.thorough)])
def test_devices_of_a_mesh_that_keeps_account_of_what_varies(lights: int, whole: bool) -> None:
    """In one loop, and with lists of lights."""
    call = f"from test_compositions import on_two_devices; on_two_devices({lights}, whole={whole})"
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, sys.argv[1]); {call}", str(Path(__file__).parent)]
    two = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    done = subprocess.run(command, env=two, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("lights", "fog_type"), [(1, "LINEAR"), pytest.param(12, "EXPONENTIAL", marks=pytest.mark.thorough)]
)
def test_a_mesh_of_explicit_axes(lights: int, fog_type: str) -> None:
    """Of arrays that are divided along no axis, along one that is mapped over, and along that of samples."""
    scene, samples = scene_under_lights(lights, fog_type), buffer(1)
    wanted, mesh = shade(scene, samples), jax.make_mesh((1,), ("i",))
    stack = jax.device_put(jax.tree.map(lambda leaf: leaf[None], samples), NamedSharding(mesh, OWN))
    planes = jax.device_put(samples.position_planes, NamedSharding(mesh, PartitionSpec(None, None, "i")))
    divided = dataclasses.replace(samples, position_planes=planes)
    with jax.set_mesh(mesh):
        np.testing.assert_array_equal(shade(scene, samples), wanted)
        np.testing.assert_array_equal(shade(scene, divided), wanted)
    np.testing.assert_array_equal(jax.vmap(lambda one: shade(scene, one))(stack)[0], wanted)


def test_derivatives_on_a_mesh_of_explicit_axes() -> None:
    scene, samples = scene_under_lights(1), buffer(1)
    mesh, plan = jax.make_mesh((1,), ("i",)), make_plan(scene, samples, free=True)
    stack = jax.device_put(jax.tree.map(lambda leaf: leaf[None], samples), NamedSharding(mesh, OWN))
    wanted = jax.jit(jax.grad(of_colors(plan)))(scene, samples, FACTOR)

    def of_all(scene: Scene, stack: SampleBuffer) -> jax.Array:
        return jnp.sum(jax.vmap(lambda one: tile_by_tile(plan)(scene, one, FACTOR))(stack))

    with jax.set_mesh(mesh):
        assert_close(jax.jit(jax.grad(of_all))(scene, stack), wanted)


def test_pmap() -> None:
    scene, samples = scene_under_lights(1), buffer(1)
    stack = jax.tree.map(lambda leaf: leaf[None], samples)
    np.testing.assert_allclose(jax.pmap(lambda own: shade(scene, own))(stack)[0], shade(scene, samples), rtol=1e-5)


def test_numbers_recompile_only_where_they_change_what_is_skipped() -> None:
    """And never inside jit, or with one plan."""
    scene, samples = scene_under_lights(2), buffer(1)
    assert scene.point is not None and scene.materials is not None

    def with_place(*place: float) -> Scene:
        assert scene.point is not None
        return dataclasses.replace(
            scene, point=dataclasses.replace(scene.point, location=scene.point.location.at[1].set(jnp.array(place)))
        )

    black = jnp.zeros_like(scene.materials.specular_color)
    dull = dataclasses.replace(scene, materials=dataclasses.replace(scene.materials, specular_color=black))
    near, far = with_place(1.0, 0.0, 3.0), with_place(500.0, 0.0, 0.0)
    renamed = dataclasses.replace(near, materials=dataclasses.replace(near.materials, names=("other",)))
    plan, compiled = make_plan(scene, samples, free=True), jax.jit(lambda scene: shade(scene, samples))
    ways: list[Callable[[Scene], jax.Array]] = [lambda scene: shade(scene, samples, plan=plan), compiled]
    shade(scene, samples)
    assert [programs_of(lambda own=own: shade(own, samples)) for own in (near, renamed, far, dull)] == [0, 0, 1, 1]
    for way in ways:
        way(scene)
        assert [programs_of(lambda own=own, way=way: way(own)) for own in (near, far, dull)] == [0, 0, 0]
