"""What is asked of XLA's CPU backend."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight import SampleBuffer, Scene, compiler_options, nodes
from jaxlight.lighting import compiling, shade_tiles


@pytest.fixture
def asked_anew() -> Iterator[None]:
    compiling.cpu_options.cache_clear()
    yield
    compiling.cpu_options.cache_clear()


def test_options_that_xla_does_not_know_are_not_asked_for(asked_anew: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "WANTED", {"xla_cpu_no_such_option": 1, "xla_cpu_prefer_vector_width": 512})
    assert compiler_options() == {"xla_cpu_prefer_vector_width": 512}


def scene_and_samples(lights: int, count: int = 2**13) -> tuple[Scene, SampleBuffer]:
    lamps = [nodes.PointLight(location=(x, 0, 4), ambient_intensity=0.1) for x in np.linspace(-1, 1, lights)]
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()), geometry=nodes.Sphere())
    points = np.random.default_rng(3).normal(size=(count, 3))
    return Scene.from_nodes([shape, *lamps]), SampleBuffer.create(points, points, [0, 0, 6])


def test_sums_of_a_gradient_are_loops_of_xla() -> None:
    scene, samples = scene_and_samples(2)
    free, fixed = eqx.partition(scene, eqx.is_inexact_array)

    def loss(free: Scene) -> jax.Array:
        return jnp.sum(shade_tiles(eqx.combine(free, fixed), samples) ** 2)

    program = jax.jit(jax.grad(loss), compiler_options=compiler_options()).lower(free).compile().as_text() or ""
    assert "reduce" in program
    assert "ynn" not in program


@pytest.mark.parametrize("lights", [8, 12])
def test_loops_over_samples_are_not_part_of_a_larger_function(lights: int) -> None:
    """In one function with the loop over tiles, or over chunks of lights, they would be slower."""
    scene, samples = scene_and_samples(lights, 2**15)
    text = jax.jit(partial(shade_tiles, scene)).lower(samples).compile().as_text() or ""
    assert "while" in text
    assert "small_call" not in text


@pytest.mark.parametrize("scale", [(2, 2, 2), (1, 2, 0.5)])
def test_xla_finds_an_end_in_simplifying_lights_of_a_scaled_frame(
    scale: tuple[float, float, float], capfd: pytest.CaptureFixture[str]
) -> None:
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(specular_color=(0.5,) * 3)))
    lamp = nodes.SpotLight(location=(0, 0, 1), ambient_intensity=0.1, attenuation=(1, 0.1, 0.2))
    scene = Scene.from_nodes([shape, nodes.Transform(scale=scale, translation=(0, 0.1, 0), children=[lamp])])
    points = np.random.default_rng(3).normal(size=(3000, 3))
    jax.jit(partial(shade_tiles, scene)).lower(SampleBuffer.create(points, points, [0, 0, 6])).compile()
    assert "circular simplification" not in capfd.readouterr().err
