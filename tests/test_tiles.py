"""Tiles of any size: the same colours and derivatives, whoever evaluates them."""

from __future__ import annotations

import re
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from counted_work import at_most_calls
from fit_scenes import precision
from jaxlight import Scene, compiler_options, nodes, processor
from jaxlight.fit import View
from jaxlight.fit.normal import loss_and_gradient
from jaxlight.fit.problem import make_problem
from jaxlight.lighting import cores, make_plan, shade, shade_tiles
from jaxlight.raster import SampleBuffer
from leaves import assert_leaves_close

COUNT = 5000


def scene_with_lights(count: int, *, lamps: bool = True) -> Scene:
    """Two lit shapes and one that is not under `count` DirectionalLights and as many PointLights."""
    random = np.random.default_rng(3)
    shapes = [
        nodes.Shape(
            appearance=nodes.Appearance(material=nodes.Material(diffuse_color=color, specular_color=(0.3,) * 3))
        )
        for color in ((0.8, 0.2, 0.1), (0.1, 0.5, 0.9))
    ]
    suns = [nodes.DirectionalLight(direction=random.normal(size=3), intensity=0.1) for _ in range(count)]
    points = [
        nodes.PointLight(location=np.array([0, 0, 2]) + random.normal(size=3), intensity=0.1) for _ in range(count)
    ]
    unlit = nodes.Shape(geometry=nodes.IndexedFaceSet(color=nodes.Color(color=np.ones((1, 3)))))
    return Scene.from_nodes([*shapes, unlit, *suns, *(points if lamps else [])])


def samples_in_tiles(tile: int) -> SampleBuffer:
    """Random samples of all shapes, each with a colour of its own."""
    random = np.random.default_rng(4)
    return SampleBuffer.create(
        random.uniform(-1, 1, (COUNT, 3)),
        np.array([0, 0, 3]) + random.normal(size=(COUNT, 3)),
        [0, 0, 6],
        surface=random.integers(0, 3, COUNT),
        color=random.uniform(0, 1, (COUNT, 3)),
        tile=tile,
    )


def test_the_size_of_tiles_changes_no_colour_and_no_derivative() -> None:
    scene = scene_with_lights(3)
    large, small = samples_in_tiles(1024), samples_in_tiles(256)
    assert shade_tiles(scene, large).shape == (large.slots // 1024, 4, 1024)
    np.testing.assert_array_equal(shade(scene, large), shade(scene, small))

    free, fixed = eqx.partition(scene, eqx.is_inexact_array)
    target = jnp.asarray(np.random.default_rng(5).uniform(0, 1, (COUNT, 3)), jnp.float32)

    def loss(free: Scene, samples: SampleBuffer) -> jax.Array:
        colors = shade(eqx.combine(free, fixed), samples, plan=make_plan(scene, samples, free=True))
        return jnp.sum((colors[:, :3] - target) ** 2)

    of_large, of_small = (jax.jit(jax.grad(loss))(free, samples) for samples in (large, small))
    assert_leaves_close(of_large, of_small, 2e-5)


def test_lights_in_chunks_have_the_same_colours_and_derivatives(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, samples = scene_with_lights(20), samples_in_tiles(256)
    free, fixed = eqx.partition(scene, eqx.is_inexact_array)

    def loss(free: Scene) -> jax.Array:
        colors = shade(eqx.combine(free, fixed), samples, plan=make_plan(scene, samples, free=True))
        return jnp.sum(jnp.sin(3 * colors))

    at_once = jax.jit(jax.value_and_grad(loss))(free)
    monkeypatch.setattr(processor, "CPU", processor.CPU._replace(largest_plane=8 * 256, chunk=8 * 256))
    jax.clear_caches()
    in_chunks = jax.jit(jax.value_and_grad(loss))(free)
    jax.clear_caches()
    assert_leaves_close(in_chunks, at_once, 2e-5)


@pytest.mark.parametrize(("lights", "shares", "bits"), [(3, 5, "float64"), (20, 3, "float32")])
def test_several_cores_change_no_colour(
    monkeypatch: pytest.MonkeyPatch,
    several_cores: Callable[[str, int], list[int]],
    lights: int,
    shares: int,
    bits: str,
) -> None:
    """Shares of the tiles, side by side; runs of few tiles have fewer than there are shares.

    Samples that are not lit are one loop, the others are evaluated tile by tile.
    """
    threads = several_cores("jaxlight.lighting.shade", shares)
    with precision(bits) as dtype:
        scene, samples = scene_with_lights(lights), samples_in_tiles(256)
        side_by_side = shade_tiles(scene, samples)
        assert threads == [shares] and side_by_side.dtype == dtype
        monkeypatch.setattr(cores, "cores", lambda: 1)
        np.testing.assert_array_equal(side_by_side, shade_tiles(scene, samples))


def test_what_is_one_loop_is_shared_out_by_the_compiler(several_cores: Callable[[str, int], list[int]]) -> None:
    threads = several_cores("jaxlight.lighting.shade", 2)
    assert np.all(np.isfinite(shade_tiles(scene_with_lights(2), samples_in_tiles(1024))))
    assert threads == []


def test_few_samples_are_not_worth_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cores, "cores", lambda: 16)
    assert cores.shares_of(0) == cores.shares_of(2 * cores.LEAST_SAMPLES - 1) == 1
    assert cores.shares_of(3 * cores.LEAST_SAMPLES) == 3
    assert cores.shares_of(10**7) == 16


def test_a_call_asks_little_of_python_for_each_of_many_surfaces() -> None:
    count = 500
    materials = [nodes.Material(shininess=number / count) for number in range(count)]
    scene = Scene.from_nodes([nodes.Shape(appearance=nodes.Appearance(material=own)) for own in materials])
    position = np.arange(3.0 * count).reshape(count, 3) % 7
    samples = SampleBuffer.create(
        position, position + 1, [0, 0, 9], surface=np.arange(count), camera_to_world=np.eye(3)
    )
    shade(scene, samples)
    with at_most_calls(4 * count + 2000):
        shade(scene, samples)


def test_what_fails_in_a_thread_is_raised() -> None:
    def fail(share: int) -> None:
        raise ValueError(f"share {share}")

    with pytest.raises(ValueError, match="share 0"):
        cores.in_threads(fail, 2)


def test_a_fit_hears_every_sample_in_tiles_of_any_size() -> None:
    scene, target = scene_with_lights(20), np.random.default_rng(5).uniform(0, 1, (COUNT, 3))
    of = []
    for tile in (1024, 512):
        problem, _ = make_problem(scene, View(samples_in_tiles(tile), target), ["Material[0].diffuseColor"])
        assert problem.views[0].samples.tile == tile
        of.append(loss_and_gradient(problem, problem.parameters.start))
    np.testing.assert_allclose(of[0][0], of[1][0], rtol=1e-6)
    np.testing.assert_allclose(of[0][1], of[1][1], rtol=1e-5)


def test_gradients_of_a_loss_of_colors_alone_keep_no_image_with_alpha() -> None:
    samples = SampleBuffer.create(np.ones((COUNT, 3)), np.ones((COUNT, 3)), [0, 0, 6], tile=1024)
    free, fixed = eqx.partition(scene_with_lights(1), eqx.is_inexact_array)
    image = rf"f32\[(\d+,)*4,{samples.tile}\]"

    def colors(free: Scene, samples: SampleBuffer) -> jax.Array:
        return shade_tiles(eqx.combine(free, fixed), samples)

    def gradient(free: Scene, samples: SampleBuffer) -> Scene:
        return jax.grad(lambda free: jnp.sum(colors(free, samples)[:, :3] ** 2))(free)

    def program(function: Callable[[Scene, SampleBuffer], object]) -> str:
        return jax.jit(function).lower(free, samples).compile().as_text() or ""

    assert re.search(image, program(colors))
    assert not re.search(image, program(gradient))


@pytest.mark.parametrize("form", ["shade", "shade_tiles"])
def test_the_gradient_of_a_loss_of_an_image_takes_at_most_as_much_memory_as_its_inputs(form: str) -> None:
    count = 2**18
    points = np.random.default_rng(7).normal(size=(count, 3))
    samples = SampleBuffer.create(points, np.ones((count, 3)), [0, 0, 6])
    free, fixed = eqx.partition(scene_with_lights(4), eqx.is_inexact_array)
    target = jnp.zeros((count, 3) if form == "shade" else (count // samples.tile, 3, samples.tile))

    def loss(free: Scene, samples: SampleBuffer, target: jax.Array) -> jax.Array:
        scene = eqx.combine(free, fixed)
        colors = shade(scene, samples) if form == "shade" else shade_tiles(scene, samples)
        return jnp.sum((colors[:, :3] - target) ** 2)

    gradient = jax.jit(jax.value_and_grad(loss), compiler_options=compiler_options())
    memory = gradient.lower(free, samples, target).compile().memory_analysis()
    assert memory is not None
    assert target.nbytes < memory.temp_size_in_bytes < memory.argument_size_in_bytes
    assert memory.argument_size_in_bytes < 1.1 * (target.nbytes + 24 * count)
