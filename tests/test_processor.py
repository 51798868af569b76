"""Programs that are written for a GPU, run here by the CPU: they give what those for the CPU give."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from colored_bodies import colored_bodies
from fit_scenes import material, sphere_picture, sphere_samples, sphere_scene
from jaxlight import SampleBuffer, Scene, compiler_options, nodes, processor
from jaxlight.fit import View
from jaxlight.fit.normal import normal_equations
from jaxlight.fit.problem import make_problem
from jaxlight.lighting import make_plan, shade
from leaves import assert_leaves_close


@pytest.fixture
def turn_to_gpu(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], None]]:
    """From its call on, what is traced or stored is for a GPU."""

    def turn() -> None:
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
        jax.clear_caches()

    yield turn
    jax.clear_caches()


@pytest.mark.parametrize(
    ("points", "spots", "culled"), [(40, 0, True), pytest.param(17, 0, False, marks=pytest.mark.thorough)]
)
def test_colours_and_derivatives_are_the_same(
    turn_to_gpu: Callable[[], None], monkeypatch: pytest.MonkeyPatch, points: int, spots: int, culled: bool
) -> None:
    """Under lights that are culled, and under more than are evaluated at once (these with textures and by samples)."""
    few = {"clusters": 16, "derived_clusters": 16}  # side by side: the others wait
    monkeypatch.setattr(processor, "GPU", processor.GPU._replace(**few))

    def results() -> Any:
        scene, samples = colored_bodies(points, spots, textures=not culled)
        plan = make_plan(scene, samples, free=True)
        assert plan.culled == culled
        weights = jnp.asarray(np.random.default_rng(1).normal(size=(samples.count, 4)), np.float32)

        def total(scene: Scene, position: jax.Array, color: jax.Array) -> tuple[jax.Array, jax.Array]:
            colors = shade(scene, samples.with_rows(position=position, color=color), plan=plan)
            return jnp.sum(weights * colors), colors

        assert samples.color is not None
        slope = jax.jit(jax.grad(total, (0,) if culled else (0, 1, 2), has_aux=True))
        gradient, colors = slope(scene, samples.position, samples.color)
        return gradient, colors, shade(scene, samples, plan=plan)

    wanted = results()
    turn_to_gpu()
    assert_leaves_close(results(), wanted, 3e-5)


def sheet_under_lights(count: int) -> tuple[Scene, SampleBuffer]:
    points = np.random.default_rng(2).uniform(-1, 1, (4096, 3))
    lamps = [
        nodes.PointLight(location=(x, 0, 3), attenuation=(0.5, 0.1, 0.2), radius=9, ambient_intensity=0.2)
        for x in np.linspace(-2, 2, count)
    ]
    body = nodes.Appearance(material=nodes.Material(specular_color=(0.5, 0.5, 0.5)))
    fog = nodes.Fog(visibility_range=30, fog_type="EXPONENTIAL")
    scene = Scene.from_nodes([nodes.Shape(appearance=body, geometry=nodes.Sphere()), *lamps, fog], dtype=np.float32)
    samples = SampleBuffer.create(points, points, [0, 0, 6], dtype=np.float32)
    return dataclasses.replace(scene, document=None), samples


@pytest.mark.parametrize("lights", [1, 20])
def test_a_gpu_has_nothing_to_decide(turn_to_gpu: Callable[[], None], lights: int) -> None:
    """Its program holds no branch: to take one, a GPU waits for the processor beside it."""

    def program(platform: str) -> str:
        scene, samples = sheet_under_lights(lights)

        def total(scene: Scene) -> jax.Array:
            return jnp.sum(shade(scene, samples, plan=make_plan(scene, samples, free=True)) ** 2)

        traced = jax.jit(jax.value_and_grad(total)).trace(scene)
        return traced.lower(lowering_platforms=(platform,)).as_text()

    assert "stablehlo.case" in program("cpu")
    turn_to_gpu()
    assert "stablehlo.case" not in program("cuda")


def test_normal_equations_are_the_same(turn_to_gpu: Callable[[], None]) -> None:
    picture = sphere_picture(24, body=material(diffuse_color=(0.2, 0.5, 0.4)))

    def equations() -> Any:
        view = View(sphere_samples(24, dtype=np.float32), picture)
        free = ["Material[body].diffuse_color", "Material[body].shininess", "PointLight[key].location"]
        problem, _ = make_problem(sphere_scene(dtype=np.float32), view, free)
        return jax.jit(normal_equations)(problem, problem.parameters.start)

    wanted = equations()
    turn_to_gpu()
    assert_leaves_close(equations(), wanted, 2e-6, least=0.0)


def test_images_are_few_large_tiles_for_a_gpu(turn_to_gpu: Callable[[], None]) -> None:
    points = np.random.default_rng(2).normal(size=(2**17, 3))
    assert SampleBuffer.create(points, points, [0, 0, 6]).tile == processor.CPU.tile
    turn_to_gpu()
    samples = SampleBuffer.create(points, points, [0, 0, 6])
    assert samples.tile * samples.group == samples.slots == 2**17


def test_the_default_device_decides(turn_to_gpu: Callable[[], None]) -> None:
    assert processor.for_cpu()
    assert compiler_options()
    turn_to_gpu()
    assert not processor.for_cpu()
    assert not compiler_options()
    for device in (jax.devices("cpu")[0], "cpu"):
        with jax.default_device(device):
            assert processor.for_cpu()
