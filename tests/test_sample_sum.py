"""Sums over samples, of which every tile is differentiated as it is evaluated: the same as of the whole image."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from colored_bodies import colored_bodies
from counted_work import programs_of
from fit_scenes import precision, sphere_scene
from jaxlight import SampleBuffer, Scene, compiler_options, nodes, shade, sum_over_samples
from jaxlight.lighting.totals import add_terms, added_up
from leaves import assert_leaves_close


def two_surfaces(dtype: Any, count: int = 700) -> tuple[Scene, SampleBuffer, np.ndarray]:
    """Samples of two surfaces in mixed order, so that both have padding; and a target for each."""
    random = np.random.default_rng(4)
    points = random.normal(size=(count, 3))
    shapes = [
        nodes.Shape(appearance=nodes.Appearance(material=material), geometry=nodes.Sphere())
        for material in (nodes.Material(transparency=0.3), nodes.Material(specular_color=(0.4, 0.5, 0.6)))
    ]
    lamps = [nodes.PointLight(location=(x, 1, 4), attenuation=(0.5, 0.1, 0.1), radius=20) for x in (-1.0, 2.0)]
    scene = Scene.from_nodes([*shapes, *lamps, nodes.Fog(visibility_range=30.0)], dtype=dtype)
    surface = random.integers(0, 2, count)
    samples = SampleBuffer.create(points, points, [0, 0, 6], surface=surface, dtype=dtype)
    return scene, samples, random.uniform(size=(count, 3))


def test_value_and_derivatives_are_those_of_the_colours_of_all_samples() -> None:
    """Of scene and of what the function closes over; padding counts nothing."""
    with precision("float64") as dtype:
        scene, samples, target = two_surfaces(dtype)
        assert samples.slots > samples.count
        stored = samples.in_storage_order(target, axis=0).T
        np.testing.assert_array_equal(samples.in_sample_order(stored), target.T)
        free, fixed = eqx.partition(scene, eqx.is_inexact_array)

        def robust(color: Any, target: Any, exposure: Any) -> Any:
            return jnp.log1p(jnp.sum((exposure * color[:3] - target) ** 2, axis=0)) + color[3]

        def ours(moving: Any) -> jax.Array:
            own = eqx.combine(moving[0], fixed)
            return 3 * sum_over_samples(lambda color, target: robust(color, target, moving[1]), own, samples, stored)

        def wanted(moving: Any) -> jax.Array:
            colors = shade(eqx.combine(moving[0], fixed), samples)
            return 3 * jnp.sum(robust(colors.T, target.T, moving[1]))

        moving = (free, jnp.asarray(1.2, dtype))
        expected = jax.jit(jax.value_and_grad(wanted))(moving)
        assert_leaves_close(jax.jit(jax.value_and_grad(ours))(moving), expected, 1e-12)
        assert float(ours(moving)) == pytest.approx(float(expected[0]), rel=1e-12)
        # Of the number alone, not of the scene.
        assert float(jax.grad(lambda e: ours((free, e)))(moving[1])) == pytest.approx(float(expected[1][1]), rel=1e-11)


def test_gradients_are_differentiated_again_in_either_mode() -> None:
    with precision("float64") as dtype:
        shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()), geometry=nodes.Sphere())
        scene = Scene.from_nodes([shape, nodes.DirectionalLight(direction=(0.3, 0.1, -1))], dtype=dtype)
        points = np.random.default_rng(6).normal(size=(60, 3))
        samples = SampleBuffer.create(points, points, [0, 0, 6], dtype=dtype)
        free, fixed = eqx.partition(scene, eqx.is_inexact_array)

        def ours(free: Scene) -> jax.Array:
            return sum_over_samples(lambda color: jnp.sum(color[:3] ** 3, axis=0), eqx.combine(free, fixed), samples)

        def wanted(free: Scene) -> jax.Array:
            return jnp.sum(shade(eqx.combine(free, fixed), samples)[:, :3] ** 3)

        direction = jax.tree.map(lambda leaf: leaf + 0.5, free)
        expected = jax.jit(lambda free: jax.jvp(jax.grad(wanted), (free,), (direction,))[1])(free)
        assert max(float(jnp.max(jnp.abs(leaf), initial=0.0)) for leaf in jax.tree.leaves(expected)) > 1
        forward = jax.jit(lambda free: jax.jvp(jax.grad(ours), (free,), (direction,))[1])(free)
        assert_leaves_close(forward, expected, 1e-11)
        reverse = jax.jit(lambda free: jax.vjp(jax.grad(ours), free)[1](direction)[0])(free)
        assert_leaves_close(reverse, expected, 1e-11)


@pytest.mark.parametrize("mixed", [False, True])
def test_padding_is_no_pair_that_the_function_never_sees(mixed: bool) -> None:
    """The colour distance is singular where the colour is the target, which of all pairs of them only the last colour
    and the first target are."""
    materials = (nodes.Material(), nodes.Material(shininess=0.5))
    balls = [nodes.Shape(appearance=nodes.Appearance(material=own), geometry=nodes.Sphere()) for own in materials]
    scene = Scene.from_nodes([*balls, nodes.DirectionalLight(direction=(0, 0, -1))])
    count = 70
    normal = np.tile([0.0, 0.0, 1.0], (count, 1))
    normal[-1] = 0, 0, -1
    surface = np.arange(count) % 2 if mixed else 0
    samples = SampleBuffer.create(np.zeros((count, 3)), normal, [0, 0, 5.0], surface=surface)
    assert samples.slots > count and (samples.slot is not None) == mixed
    target = np.full((3, count), 0.5, np.float32)
    target[:, :2] = 0
    stored = samples.in_storage_order(target)
    np.testing.assert_array_equal(samples.in_sample_order(stored), target)

    def distance(color: Any, target: Any) -> Any:
        return jnp.sqrt(jnp.sum((color[:3] - target) ** 2, axis=0))

    free, fixed = eqx.partition(scene, eqx.is_inexact_array)
    ours = jax.grad(lambda free: sum_over_samples(distance, eqx.combine(free, fixed), samples, stored))(free)
    wanted = jax.grad(lambda free: jnp.sum(distance(shade(eqx.combine(free, fixed), samples).T, target)))(free)
    assert float(wanted.directional.intensity[0]) > 50
    assert_leaves_close(ours, wanted, 1e-5)


def test_the_sum_alone_has_the_digits_of_that_with_a_gradient() -> None:
    """A line search compares the two; of equal samples the roundings of a running sum all go one way."""
    scene = sphere_scene()
    position, normal = (np.broadcast_to(row, (1 << 18, 3)) for row in ((0.1, 0.2, 0.9), (0.0, 0.6, 0.8)))
    samples = SampleBuffer.create(position, normal, [0, 0, 5])

    def red(scene: Scene) -> jax.Array:
        return sum_over_samples(lambda color: color[0], scene, samples)

    alone, (beside, _) = red(scene), jax.value_and_grad(red)(scene)
    exact = float(shade(scene, samples)[0, 0]) * (1 << 18)
    np.testing.assert_allclose([alone, beside], exact, rtol=1e-6)


def test_derivatives_by_samples_and_textures_are_those_of_the_whole_image() -> None:
    scene, samples = colored_bodies(2, 0)
    weights = samples.in_storage_order(np.random.default_rng(1).normal(size=(4, samples.count)).astype(np.float32))

    def moved(images: Any, positions: Any) -> tuple[Scene, SampleBuffer]:
        own = eqx.tree_at(lambda scene: [texture.image for texture in scene.textures], scene, images)
        return own, samples.with_rows(position=positions)

    def ours(images: Any, positions: Any) -> jax.Array:
        return sum_over_samples(lambda color, weight: weight * color**2, *moved(images, positions), weights)

    def wanted(images: Any, positions: Any) -> jax.Array:
        return jnp.sum(samples.in_sample_order(weights) * shade(*moved(images, positions)).T ** 2)

    moving = ([texture.image for texture in scene.textures], samples.position)
    found, expected = (jax.jit(jax.grad(function, argnums=(0, 1)))(*moving) for function in (ours, wanted))
    assert_leaves_close(found, expected, 1e-5)


def test_every_tile_is_evaluated_once() -> None:
    """In one loop over tiles, which a loss of the whole image takes two of; and nothing as large as that is stored."""
    scene, samples, target = two_surfaces(np.float32, count=2**17)
    stored = samples.in_storage_order(target.astype(np.float32).T)
    free, fixed = eqx.partition(scene, eqx.is_inexact_array)

    def loss(free: Scene, samples: SampleBuffer, stored: jax.Array) -> jax.Array:
        own = eqx.combine(free, fixed)
        return sum_over_samples(lambda color, target: (color[:3] - target) ** 2, own, samples, stored)

    program = jax.jit(jax.value_and_grad(loss), compiler_options=compiler_options()).lower(free, samples, stored)
    assert program.as_text().count("stablehlo.while") == 1
    memory = program.compile().memory_analysis()
    assert memory is not None
    assert memory.temp_size_in_bytes < stored.nbytes


def test_functions_may_close_over_whatever_is_traced() -> None:
    """A mask of integers too, of which there are no derivatives."""
    scene, samples, target = two_surfaces(np.float32, count=100)
    stored = samples.in_storage_order(target.astype(np.float32).T)
    free, fixed = eqx.partition(scene, eqx.is_inexact_array)

    @jax.jit
    def slope(free: Scene, chosen: jax.Array) -> Scene:
        def loss(free: Scene) -> jax.Array:
            own = eqx.combine(free, fixed)
            return sum_over_samples(
                lambda color, target: chosen[:, None] * (color[:3] - target) ** 2, own, samples, stored
            )

        return jax.grad(loss)(free)

    only_red, only_green, both = (slope(free, jnp.array(chosen)) for chosen in ([1, 0, 0], [0, 1, 0], [1, 1, 0]))
    assert any(np.any(leaf) for leaf in jax.tree.leaves(only_red))
    assert_leaves_close(jax.tree.map(jnp.add, only_red, only_green), both, 1e-5)


def test_numbers_of_half_precision_are_added_up_in_single() -> None:
    """Their sum lies beyond what half precision holds."""
    scene, samples, _ = two_surfaces("float32", 20_000)

    def summed(scene: Scene) -> jax.Array:
        return sum_over_samples(lambda color: (4 * color[:3]).astype(jnp.float16), scene, samples)

    terms = (4 * shade(scene, samples)[:, :3]).astype(jnp.float16)
    wanted = np.sum(np.asarray(terms, np.float64))
    assert wanted > 65536 and summed(scene).dtype == np.float32
    assert float(summed(scene)) == pytest.approx(wanted, rel=1e-6)
    assert float(jax.jit(jax.value_and_grad(summed))(scene)[0]) == pytest.approx(wanted, rel=1e-6)


def test_gradients_outside_of_jit_are_compiled_once() -> None:
    """Whatever numbers change, and though the function, with rules of derivatives in it, is made anew; another one is
    another program."""
    scene, samples, target = two_surfaces("float32", 60)
    stored = samples.in_storage_order(target, axis=0).T

    def slope(scene: Scene, target: Any, exposure: float = 1.0, power: int = 2) -> Any:
        factor = jnp.asarray(exposure)

        def loss(color: Any, target: Any) -> Any:
            return jax.nn.softplus(factor * color[:3] - target) ** power

        return jax.grad(lambda scene: sum_over_samples(loss, scene, samples, target))(scene)

    brighter = eqx.tree_at(lambda scene: scene.point.intensity, scene, replace_fn=lambda old: old / 2)
    one, other, double = slope(scene, stored), slope(brighter, stored / 2), slope(scene, stored, 2.0)
    assert [programs_of(lambda own=own: slope(*own)) for own in ((scene, stored), (brighter, stored))] == [0, 0]

    def value(scene: Scene) -> Any:
        return sum_over_samples(lambda color: jax.nn.softplus(color), scene, samples)

    assert float(value(scene)) == pytest.approx(float(np.logaddexp(0, shade(scene, samples)).sum()), rel=1e-6)
    assert programs_of(lambda: value(brighter)) == 0
    assert_leaves_close(slope(scene, stored), one, 0)
    for found in (other, double, slope(scene, stored, power=4)):
        assert not np.allclose(found.point.intensity, one.point.intensity, rtol=1e-3)


def test_what_does_not_fit_is_named() -> None:
    scene, samples, target = two_surfaces(np.float32)
    with pytest.raises(ValueError, match=r"in_storage_order: expected 700 along axis -1, one a sample, got \[700, 3\]"):
        samples.in_storage_order(target)
    with pytest.raises(ValueError, match=rf"planes\[0\]: expected shape \[..., {samples.slots}\].* got \[3, 700\]"):
        sum_over_samples(lambda color, target: color[:3] - target, scene, samples, target.T)
    with pytest.raises(ValueError, match=r"function: expected shape \[..., \d+\] for \d+ samples, got \(\)"):
        sum_over_samples(jnp.sum, scene, samples)
    with pytest.raises(ValueError, match="plan: expected a Plan, got int"):
        sum_over_samples(lambda color: color, scene, samples, plan=3)  # type: ignore[arg-type]  # what is tested


@pytest.mark.parametrize(
    ("terms", "total"),
    [([1e38] * 9, np.inf), ([np.inf, 1.0], np.inf), ([-np.inf, 1.0], -np.inf), ([1e38, -3e38, -3e38], -np.inf)],
)
def test_an_infinite_sum_stays_one_with_its_rounding_errors(terms: list[float], total: float) -> None:
    """What is lost of an infinite term is no number."""
    carry = ((jnp.zeros(()),), (jnp.zeros(()),))
    for term in terms:
        carry = add_terms(carry, (jnp.float32(term),))
    assert added_up(carry)[0] == total
