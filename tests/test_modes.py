"""One answer, however it is asked for: eager or compiled, forward or reverse, in any batch, beside anything."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import precision
from jaxlight import Scene, nodes, shade
from jaxlight.lighting import make_plan
from jaxlight.raster import SampleBuffer
from leaves import assert_leaves_close

EYE = (0.5, 1.0, 6.0)
EPSILON = {"float32": 2.0**-23, "float64": 2.0**-52}


def spot_in_fog(dtype: Any = None) -> Scene:
    """A spot, which has all that a light can have, and fog."""
    body = nodes.Material(
        ambient_intensity=0.25, diffuse_color=(0.75, 0.5, 0.25), shininess=0.3, specular_color=(0.5, 0.6, 0.4)
    )
    spot = nodes.SpotLight(
        location=(-1.0, 2.0, 3.0),
        ambient_intensity=0.5,
        direction=(1.0, -2.0, -3.5),
        beam_width=0.1,
        cut_off_angle=1.0,
        attenuation=(0.7, 0.1, 0.1),
    )
    fog = nodes.Fog(visibility_range=20.0, fog_type="EXPONENTIAL", color=(0.5, 0.6, 0.7))
    shape = nodes.Shape(appearance=nodes.Appearance(material=body))
    scene = Scene.from_nodes([shape, spot, fog], dtype=dtype)
    return dataclasses.replace(scene, document=None)


def rows(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return random.uniform(-2, 2, (count, 3)), random.normal(size=(count, 3)) + np.array([0, 0, 1])


def colors(scene: Scene, position: np.ndarray, normal: np.ndarray, dtype: Any = None) -> np.ndarray:
    samples = SampleBuffer.create(position, normal, EYE, dtype=dtype)
    return np.asarray(shade(scene, samples))


# --- batches ----------------------------------------------------------------------------------------------------------


def test_rows_do_not_depend_on_the_batch() -> None:
    """From one row to more than 8000, where XLA's CPU backend changes how it reduces."""
    scene, (position, normal) = spot_in_fog(), rows(9000)
    whole = colors(scene, position, normal)
    for count in (1, 7, 1000):
        np.testing.assert_allclose(colors(scene, position[:count], normal[:count]), whole[:count], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("count", [5, 9000])
def test_rows_do_not_depend_on_their_neighbours(count: int) -> None:
    """Zero normals, samples at a light and at the viewer, and far away, change no other row.

    But for rounding, if the compiler joins products and sums differently where a tile needs care.
    """
    scene, (position, normal) = spot_in_fog(), rows(count)
    alone = colors(scene, position, normal)
    odd = np.arange(count) % 4 == 1
    position, normal = position.copy(), normal.copy()
    which = np.arange(count) % 16
    position[odd & (which == 1)] = (-1.0, 2.0, 3.0)
    position[odd & (which == 5)] = EYE
    normal[odd & (which == 9)] = 0
    position[odd & (which == 13)] = 1e37
    beside = colors(scene, position, normal)
    assert np.isfinite(beside).all()
    np.testing.assert_array_max_ulp(beside[~odd], alone[~odd], 4)


def test_rows_beside_no_numbers() -> None:
    """A row that is NaN stays alone with it, in small and large batches, in colours and in derivatives by position."""
    scene = spot_in_fog()
    for count in (5, 9000):
        position, normal = rows(count)
        good = SampleBuffer.create(position, normal, EYE)
        bad = dataclasses.replace(good, position_planes=good.position_planes.at[0, :, 1].set(jnp.nan))
        plan = make_plan(scene, good, free=True)

        def total(planes: jax.Array, good: SampleBuffer = good, plan: Any = plan) -> tuple[jax.Array, jax.Array]:
            found = shade(scene, dataclasses.replace(good, position_planes=planes), plan=plan)
            return jnp.sum(found[:, :3]), found

        slope_and_colors = jax.jit(jax.grad(total, has_aux=True))

        def both(samples: SampleBuffer, of: Any = slope_and_colors, count: int = count) -> tuple[Any, Any]:
            slope, found = of(samples.position_planes)
            return np.asarray(found), np.asarray(slope).swapaxes(1, 2).reshape(-1, 3)[:count]

        (alone, slopes), (beside, slopes_beside) = both(good), both(bad)
        others = np.arange(count) != 1
        np.testing.assert_array_equal(beside[others], alone[others])
        np.testing.assert_array_equal(slopes_beside[others], slopes[others])


# --- eager and compiled -----------------------------------------------------------------------------------------------


def test_compiled_is_eager() -> None:
    """To some last bits: compiled, multiplications and additions may be joined."""
    with precision("float32") as dtype:
        scene, (position, normal) = spot_in_fog(dtype), rows(50)
        samples = SampleBuffer.create(position, normal, EYE, dtype=dtype)
        compiled = np.asarray(shade(scene, samples))
        within = np.asarray(jax.jit(lambda scene, samples: shade(scene, samples))(scene, samples))
        with jax.disable_jit():
            eager = np.asarray(shade(scene, samples))
    tolerance = 40 * EPSILON["float32"]
    np.testing.assert_allclose(compiled, eager, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(within, eager, rtol=tolerance, atol=tolerance)


def test_what_is_shaded_may_be_closed_over() -> None:
    """Scene and samples that a function is not given, but knows, are shaded in it as they are outside."""
    scene, (position, normal) = spot_in_fog(), rows(50)
    samples = SampleBuffer.create(position, normal, EYE)
    alone = shade(scene, samples)
    factors = jnp.array([1.0, 0.5])
    tolerance = 40 * EPSILON["float32"]

    def scaled(factor: jax.Array) -> jax.Array:
        return factor * shade(scene, samples)

    for mapped in (jax.jit(jax.vmap(scaled)), jax.vmap(scaled), lambda factors: jax.lax.map(scaled, factors)):
        np.testing.assert_allclose(mapped(factors), factors[:, None, None] * alone, rtol=tolerance, atol=tolerance)
    for changed in (jax.jit(jax.jacfwd(scaled)), jax.jit(jax.jacrev(scaled)), jax.jacfwd(scaled), jax.jacrev(scaled)):
        np.testing.assert_allclose(changed(0.5), alone, rtol=tolerance, atol=tolerance)
    assert jax.eval_shape(lambda: shade(scene, samples)).shape == alone.shape


def test_samples_may_be_numpy_arrays() -> None:
    """As `jax.device_get` gives them, or a file."""
    scene, (position, normal) = spot_in_fog(), rows(50)
    samples = SampleBuffer.create(position, normal, EYE)
    np.testing.assert_array_equal(shade(scene, jax.device_get(samples)), shade(scene, samples))
    np.testing.assert_array_equal(shade(jax.device_get(scene), samples), shade(scene, samples))


# --- derivatives ------------------------------------------------------------------------------------------------------


def total_color(scene: Scene, samples: SampleBuffer, plan: Any, weights: jax.Array) -> jax.Array:
    return jnp.sum(weights * shade(scene, samples, plan=plan)[:, :3])


def close(found: Any, wanted: Any, tolerance: float) -> None:
    assert_leaves_close(found, wanted, tolerance, least=1e-3)


def test_derivatives_agree_in_every_mode() -> None:
    """Along one direction: J v forward, v . grad in reverse; H v forward over reverse, reverse over forward
    and forward over forward."""
    tolerance = 2000 * EPSILON["float64"]
    with precision("float64") as dtype:
        scene, (position, normal) = spot_in_fog(dtype), rows(40)
        samples = SampleBuffer.create(position, normal, EYE, dtype=dtype)
        plan = make_plan(scene, samples, free=True)
        random = np.random.default_rng(2)
        weights = jnp.asarray(random.normal(size=(40, 3)), dtype)
        steps = jax.tree.map(lambda leaf: jnp.asarray(random.normal(size=leaf.shape), dtype) * leaf, scene)

        def value(scene: Scene) -> jax.Array:
            return total_color(scene, samples, plan, weights)

        def along(function: Callable) -> Callable:
            """The function and its change."""
            return lambda scene: jax.jvp(function, (scene,), (steps,))

        def dotted(slope: Scene) -> jax.Array:
            return sum((jnp.sum(a * b) for a, b in zip(*map(jax.tree.leaves, (slope, steps)), strict=True)), start=0.0)

        slope, forward_over_reverse = jax.jit(along(jax.grad(value)))(scene)
        reverse_over_forward = jax.jit(jax.grad(lambda scene: along(value)(scene)[1]))(scene)
        close(reverse_over_forward, forward_over_reverse, tolerance)
        (_, forward), (_, twice_forward) = jax.jit(along(along(value)))(scene)
        np.testing.assert_allclose(forward, dotted(slope), rtol=tolerance)
        np.testing.assert_allclose(twice_forward, dotted(forward_over_reverse), rtol=tolerance)


@pytest.mark.parametrize(("lights", "radius"), [pytest.param(2, 100.0, marks=pytest.mark.thorough), (40, 0.5)])
def test_derivatives_of_mapped_samples_are_those_of_each(lights: int, radius: float) -> None:
    """Few lights, in one loop, and lists of many."""
    random = np.random.default_rng(3)
    places = random.uniform([-1, -1, 0.5], [1, 1, 1.5], (lights, 3))
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(specular_color=(0.4, 0.5, 0.6))))
    scene = Scene.from_nodes([shape, *(nodes.PointLight(location=place, radius=radius) for place in places)])
    buffers = [
        SampleBuffer.create(random.uniform([-1, -1, 0], [1, 1, 0.2], (300, 3)), [(0, 0, 1)] * 300, EYE, tile=64)
        for _ in range(3)
    ]
    plan = make_plan(scene, buffers[0], free=True)
    assert scene.materials is not None and plan.point is not None and plan.point.culled == (lights == 40)
    together = jax.tree.map(lambda *leaves: jnp.stack(leaves), *buffers)

    def color_of(color: jax.Array, samples: SampleBuffer) -> jax.Array:
        moved = jax.tree.map(lambda leaf: color if leaf is scene.materials.specular_color else leaf, scene)
        return shade(moved, samples, plan=plan)

    def mapped(color: jax.Array) -> jax.Array:
        return jax.vmap(jax.jit(color_of), in_axes=(None, 0))(color, together)

    def one_by_one(color: jax.Array) -> jax.Array:
        return jnp.stack([color_of(color, samples) for samples in buffers])

    color, step = scene.materials.specular_color, jnp.asarray([[0.3, -0.2, 0.5]])
    found, wanted = (jax.jvp(function, (color,), (step,)) for function in (mapped, one_by_one))
    assert np.max(np.abs(wanted[1])) > 0.01
    close(found, wanted, 1e-5)
    slopes = [jax.grad(lambda color, of=of: jnp.sum(of(color) ** 2))(color) for of in (mapped, one_by_one)]
    close(slopes[0], slopes[1], 1e-5)
