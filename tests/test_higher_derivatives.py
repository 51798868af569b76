"""Curvature of functions of derivatives, such as J^T J: right in every order of modes, also where JAX divides loops."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import precision
from jaxlight import SampleBuffer, Scene, nodes, shade
from leaves import assert_leaves_close

LAMPS = [
    nodes.PointLight(location=(1, 1, 3), attenuation=(0.9, 0.1, 0.02), radius=50, ambient_intensity=0.2),
    nodes.SpotLight(location=(-1, 1, 3), direction=(0.3, -0.2, -1), beam_width=0.1, cut_off_angle=0.9, radius=50),
    nodes.DirectionalLight(direction=(0.2, -0.4, -1), intensity=0.3),
]


def ball(lights: list[nodes.Node]) -> Scene:
    body = nodes.Material(name="body", shininess=0.1, specular_color=(0.3, 0.4, 0.2), ambient_intensity=0.3)
    shape = nodes.Shape(appearance=nodes.Appearance(material=body), geometry=nodes.Sphere())
    scene = Scene.from_nodes([shape, *lights], dtype=np.float64)
    return dataclasses.replace(scene, document=None)


def half_sphere(count: int) -> SampleBuffer:
    """Seen from the front: many of the half vectors are far from the normals."""
    normal = np.random.default_rng(0).normal(size=(count, 3))
    normal *= np.sign(normal[:, 2:]) / np.linalg.norm(normal, axis=1)[:, None]
    return SampleBuffer.create(normal, normal, [0, 0, 5], dtype=np.float64, by_place=True)


def random_direction(numbers: Any, seed: int) -> Any:
    random = np.random.default_rng(seed)
    return jax.tree.map(lambda leaf: jnp.asarray(random.normal(size=leaf.shape)), numbers)


def once(function: Callable[[Any], jax.Array]) -> Callable[[Any], jax.Array]:
    return function


def in_a_loop(function: Callable[[Any], jax.Array]) -> Callable[[Any], jax.Array]:
    """Twice, in a loop of the user's."""

    def looped(numbers: Any) -> jax.Array:
        def step(total: jax.Array, factor: jax.Array) -> tuple[jax.Array, None]:
            return total + function(jax.tree.map(lambda leaf: factor * leaf, numbers)), None

        return jax.lax.scan(step, jnp.zeros(()), jnp.asarray([1.0, 1.01]))[0]

    return looped


def shown(scene: Scene) -> Any:
    """What highlights follow from."""
    return [scene.materials.shininess, *(lights.location for lights in (scene.point, scene.spot) if lights is not None)]


def squared_change(scene: Scene, samples: SampleBuffer, inner: Any) -> Callable[[Any], jax.Array]:
    """Of colours along a direction, as a function of what is shown."""

    def colors(numbers: Any) -> jax.Array:
        return shade(eqx.tree_at(shown, scene, numbers), samples)[:, :3]

    return lambda numbers: jnp.sum(jax.jvp(colors, (numbers,), (inner,))[1] ** 2)


@pytest.mark.parametrize(
    ("lights", "count", "around"),
    [
        pytest.param(LAMPS[:1], 250, once, id="one step"),
        pytest.param(LAMPS[:1], 250, in_a_loop, id="in a loop"),
        pytest.param(LAMPS[:1], 3000, once, id="many tiles", marks=pytest.mark.thorough),
        pytest.param(LAMPS, 250, once, id="lights of all kinds", marks=pytest.mark.thorough),
    ],
)
def test_curvature_is_that_of_differences(lights: list[nodes.Node], count: int, around: Any) -> None:
    with precision("float64"):
        scene = ball(lights)
        numbers = shown(scene)
        inner, outer = random_direction(numbers, 1), random_direction(numbers, 2)
        slope = jax.jit(jax.grad(around(squared_change(scene, half_sphere(count), inner))))

        def at(step: float) -> Any:
            return slope([number + step * change for number, change in zip(numbers, outer, strict=True)])

        curvature = jax.jit(lambda numbers: jax.jvp(slope, (numbers,), (outer,))[1])(numbers)
        differences = [(after - before) / 2e-6 for after, before in zip(at(1e-6), at(-1e-6), strict=True)]
        assert_leaves_close(curvature, differences, 1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("around", [once, in_a_loop])
def test_curvature_is_the_same_in_every_order_of_modes(around: Any) -> None:
    with precision("float64"):
        scene = ball(LAMPS[:1])
        numbers = shown(scene)
        function = around(squared_change(scene, half_sphere(250), random_direction(numbers, 1)))
        forward, reverse = jax.jacfwd, jax.jacrev
        wanted = jax.jit(forward(forward(function)))(numbers)
        for outer, inner in ((forward, reverse), (reverse, forward), (reverse, reverse)):
            assert_leaves_close(jax.jit(outer(inner(function)))(numbers), wanted, 1e-10)
