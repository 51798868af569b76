"""Samples to pixels, the sky, transfer functions, comparison."""

from __future__ import annotations

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight import Camera, LightingOptions, SampleBuffer, Scene, compare, nodes, rasterize, render, shade
from jaxlight.image import (
    decode,
    encode,
    linear_to_srgb,
    resolve,
    sky,
    srgb_to_linear,
)

CAMERA = Camera.look_at((0.5, 1.0, 6.0), (0, 0, 0), field_of_view=0.7)


def sphere_scene(*more: nodes.Node, transparency: float = 0.0) -> Scene:
    material = nodes.Material(name="ball", diffuse_color=(0.7, 0.4, 0.2), transparency=transparency)
    shape = nodes.Shape(appearance=nodes.Appearance(material=material), geometry=nodes.Sphere())
    box = nodes.Shape(geometry=nodes.Box(size=(0.4, 3, 0.4)))
    return Scene.from_nodes([shape, box, nodes.PointLight(location=(3, 4, 5)), *more])


def by_hand(scene: Scene, samples: SampleBuffer, behind: np.ndarray) -> np.ndarray:
    """The picture, pixel by pixel, in plain NumPy."""
    color = np.asarray(shade(scene, samples), dtype=np.float64)
    share = np.ones(samples.count) if samples.coverage is None else np.asarray(samples.coverage)
    assert samples.width is not None and samples.height is not None
    picture = np.broadcast_to(behind, (samples.height, samples.width, 3)).copy().reshape(-1, 3)
    seen = np.zeros_like(picture)
    left = np.ones(len(picture))
    for sample, pixel in enumerate(np.asarray(samples.pixel)):
        seen[pixel] += share[sample] * color[sample, 3] * color[sample, :3]
        left[pixel] -= share[sample] * color[sample, 3]
    return (seen + left[:, None] * picture).reshape(samples.height, samples.width, 3)


@pytest.mark.parametrize("samples_per_pixel", [1, 5])
@pytest.mark.parametrize("transparency", [0.0, 0.3])
def test_render_is_the_weighted_sum_over_the_background(samples_per_pixel: int, transparency: float) -> None:
    scene = sphere_scene(nodes.Background(sky_color=[(0.1, 0.3, 0.5)]), transparency=transparency)
    samples = rasterize(scene, CAMERA, 33, 21, samples=samples_per_pixel)
    picture = np.asarray(render(scene, samples))
    assert picture.shape == (21, 33, 3)
    np.testing.assert_allclose(picture, by_hand(scene, samples, np.array([0.1, 0.3, 0.5])), atol=2e-6)
    np.testing.assert_allclose(picture[0, 0], (0.1, 0.3, 0.5), atol=1e-7)


def test_render_is_the_same_under_jit_and_differentiable() -> None:
    scene = sphere_scene(nodes.Background(sky_color=[(0.1, 0.3, 0.5)]), transparency=0.25)
    samples = rasterize(scene, CAMERA, 17, 19, samples=2)
    options = LightingOptions()
    eager = render(scene, samples, options)
    np.testing.assert_allclose(np.asarray(jax.jit(render, static_argnums=2)(scene, samples, options)), eager, atol=2e-6)

    def brightness(color: jax.Array) -> jax.Array:
        changed = eqx.tree_at(lambda s: s.materials.diffuse_color, scene, color)
        return jnp.sum(render(changed, samples, options) ** 2)

    color = scene.materials.diffuse_color
    gradient = jax.grad(brightness)(color)
    step = 1e-2
    expected = [
        (brightness(color.at[0, i].add(step)) - brightness(color.at[0, i].add(-step))) / (2 * step) for i in range(3)
    ]
    np.testing.assert_allclose(gradient[0], expected, rtol=1e-3)
    assert np.all(np.asarray(gradient) > 0)


def test_nothing_in_the_picture_leaves_the_background() -> None:
    scene = Scene.from_nodes([nodes.Background(sky_color=[(0.2, 0.4, 0.6)])])
    with pytest.warns(UserWarning, match="all background"):
        samples = rasterize(scene, CAMERA, 5, 4)
    np.testing.assert_allclose(render(scene, samples), np.broadcast_to((0.2, 0.4, 0.6), (4, 5, 3)), atol=1e-7)


def test_the_sky_changes_with_the_angle_from_the_zenith() -> None:
    """X3D 24.4.1: colours at 0, 1.0 and 1.6 radians from +y, the last one down to the nadir."""
    colors = np.array([(0, 0, 1), (1, 0, 0), (0, 1, 0)])
    background = nodes.Background(sky_color=colors, sky_angle=(1.0, 1.6))
    camera = Camera.look_at((-4, -1.6, -0.8), (-3, -1.2, -0.6), field_of_view=2.0)
    scene = sphere_scene(background)
    samples = rasterize(scene, camera, 31, 23)
    ray = camera.rays(31, 23).direction
    angle = np.arccos(ray[:, 1] / np.linalg.norm(ray, axis=1))
    expected = np.stack([np.interp(angle, [0, 1.0, 1.6], colors[:, i]) for i in range(3)], axis=1)
    np.testing.assert_allclose(np.asarray(sky(scene, samples)).reshape(-1, 3), expected, atol=1e-5)
    assert angle.min() < 1.0 < 1.6 < angle.max()
    unknown = eqx.tree_at(lambda s: s.pixel_to_world, samples, None)
    np.testing.assert_array_equal(sky(scene, unknown), colors[0])
    np.testing.assert_array_equal(sky(sphere_scene(), samples), (0, 0, 0))


def test_derivatives_of_the_sky_are_finite_at_the_zenith() -> None:
    """The middle pixel looks straight up, where the angle from the zenith has a tip."""
    background = nodes.Background(sky_color=np.eye(3), sky_angle=(1.0, 2.0))
    samples = rasterize(sphere_scene(background), Camera.look_at((0, -3, 0), (0, 0, 0), (0, 0, 1), 1.0), 5, 5)
    assert samples.pixel_to_world is not None

    def brightness(pixel_to_world: jax.Array) -> jax.Array:
        turned = eqx.tree_at(lambda s: s.pixel_to_world, samples, pixel_to_world)
        return jnp.sum(sky(sphere_scene(background), turned)[..., 0])

    gradient = jax.grad(brightness)(samples.pixel_to_world)
    step = jnp.zeros((3, 3)).at[0, 2].set(1e-3)  # off the tip by as much to either side: all others change smoothly
    change = brightness(samples.pixel_to_world + step) - brightness(samples.pixel_to_world - step)
    np.testing.assert_allclose(gradient[0, 2], change / 2e-3, atol=1e-3)
    assert np.all(np.isfinite(gradient))


@pytest.mark.parametrize("colors", [1, 3])
@pytest.mark.parametrize("dtype", ["float16", "bfloat16"])
def test_the_sky_behind_half_precision_is_that_of_float32(dtype: str, colors: int) -> None:
    """Only what the buffer stores is rounded: the picture's rays, by 2^-8."""
    background = nodes.Background(
        sky_color=[(0.1, 0.2, 0.3), (0.9, 0.8, 0.7), (0, 0, 0)][:colors], sky_angle=[1, 2][: colors - 1]
    )
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()), geometry=nodes.Sphere(radius=0.2))
    scene, camera = Scene.from_nodes([background, shape]), Camera.look_at((0, 0, 5), (0, 0, 0))
    half, single = (render(scene, rasterize(scene, camera, 200, 50, dtype=t)) for t in (dtype, "float32"))
    assert half.dtype == single.dtype == np.float32
    corner = (slice(None, 10), slice(None, 50))
    np.testing.assert_allclose(half[corner], single[corner], atol=1e-7 if colors == 1 else 5e-3)
    assert len(np.unique(half[0, :, 0])) == (1 if colors == 1 else 200)


def test_resolve_sums_what_lies_in_a_pixel() -> None:
    count = 7
    samples = SampleBuffer.create(
        position=np.zeros((count, 3)),
        normal=np.ones((count, 3)),
        eye=np.zeros(3),
        surface=np.array([1, 0, 1, 0, 0, 1, 2]),
        pixel=np.array([0, 5, 5, 2, 0, 0, 3]),
        coverage=np.array([0.25, 0.5, 0.5, 1, 0.25, 0.5, 1]),
        width=3,
        height=2,
    )
    values = np.arange(14.0).reshape(7, 2)
    expected = np.zeros((2, 3, 2))
    expected[0, 0] = 0.25 * values[0] + 0.25 * values[4] + 0.5 * values[5]
    expected[1, 2] = 0.5 * values[1] + 0.5 * values[2]
    expected[0, 2], expected[1, 0] = values[3], values[6]
    np.testing.assert_allclose(resolve(values, samples), expected, atol=1e-6)
    np.testing.assert_allclose(resolve(values[:, 0], samples), expected[..., 0], atol=1e-6)
    np.testing.assert_allclose(resolve(values.astype(int), samples), expected, atol=1e-6)
    with pytest.raises(ValueError, match=r"expected values of shape \[7, channels\], got \[6, 2\]"):
        resolve(values[:6], samples)


def test_samples_without_pixels_cannot_be_a_picture() -> None:
    samples = SampleBuffer.create(np.zeros((2, 3)), np.ones((2, 3)), np.zeros(3))
    for act in (lambda: render(sphere_scene(), samples), lambda: resolve(np.zeros(2), samples)):
        with pytest.raises(ValueError, match="no picture to put them in"):
            act()


def test_srgb_is_the_standard_curve_and_its_inverse() -> None:
    """Values of IEC 61966-2-1, evaluated apart from the code."""
    known = {0.0: 0.0, 0.001: 0.01292, 0.18: 0.46135612950044164, 0.5: 0.7353569830524495, 1.0: 1.0}
    for linear, srgb in known.items():
        assert math.isclose(float(linear_to_srgb(linear)), srgb, rel_tol=2e-6, abs_tol=1e-7)
        assert math.isclose(float(srgb_to_linear(srgb)), linear, rel_tol=2e-6, abs_tol=1e-7)
    x = jnp.linspace(-0.1, 1.5, 1001)
    np.testing.assert_allclose(srgb_to_linear(linear_to_srgb(x)), x, atol=2e-6)
    np.testing.assert_array_equal(encode(x, "none"), x)
    np.testing.assert_array_equal(decode(x, "none"), x)
    np.testing.assert_array_equal(decode(x), srgb_to_linear(x))
    slopes = jax.vmap(jax.grad(linear_to_srgb))(jnp.array([-1.0, 0.0, 1e-30, 0.0031308, 1.0]))
    np.testing.assert_allclose(slopes, [12.92] * 4 + [1.055 / 2.4], rtol=1e-5)


def test_comparison_figures() -> None:
    reference = np.zeros((2, 3, 3))
    reference[0, 0] = (1, 0, 0)
    image = reference.copy()
    image[1, 2, 1] = -0.5
    found = compare(image, reference)
    assert (found.largest, found.worst_pixel, found.pixels) == (0.5, (1, 2), 6)
    assert math.isclose(found.mean, 0.5 / 18)
    assert math.isclose(found.rmse, math.sqrt(0.25 / 18))
    assert math.isclose(found.psnr, 10 * math.log10(18 / 0.25))
    assert math.isclose(found.relative_l2, 0.5)
    assert "max 0.5 (row 1, column 2)" in str(found)
    mask = np.ones((2, 3), bool)
    mask[1, 2] = False
    same = compare(image, reference, mask)
    assert (same.largest, same.psnr, same.relative_l2, same.pixels) == (0, math.inf, 0, 5)
    assert compare(image, reference, np.where(mask, 0.5, 0.49)).pixels == 5
    image[0, 1] = 0.4  # more in all channels together, less in each
    assert compare(image, reference).worst_pixel == (1, 2)
    black = compare(np.zeros((2, 3)), np.zeros((2, 3)))
    assert (black.relative_l2, compare(np.ones((2, 3)), np.zeros((2, 3))).relative_l2) == (0, math.inf)
    assert compare(np.full((2, 2), 255, np.uint8), np.full((2, 2), 65535, np.uint16)).largest == 0


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: compare(np.zeros((2, 3)), np.zeros((3, 2))), r"image has shape \[2, 3\], reference \[3, 2\]"),
        (lambda: compare(np.zeros(3), np.zeros(3)), r"expected \[height, width, channels\]"),
        (lambda: compare(np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3))), "no pixel to compare"),
        (lambda: compare(np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((3, 3))), r"mask: expected shape \[2, 3\]"),
        (lambda: compare(np.full((2, 3), np.nan), np.zeros((2, 3))), "image is not finite at row 0, column 0"),
        (
            lambda: compare(np.zeros((2, 3)), np.zeros((2, 3)), np.full((2, 3), np.nan)),
            "mask: 6 of its 6 numbers are NaN",
        ),
        (
            lambda: compare([[0, 1], [1]], np.zeros((2, 2))),
            r"compare: image: expected \[height, .*, got \[\[0, 1\], \[1\]\]",
        ),
        (lambda: encode(np.zeros(3, np.uint8)), "image: got uint8; divide by 255"),
        (lambda: decode(np.zeros(3, np.uint16)), "image: got uint16; divide by 65535"),
        (lambda: encode(np.full(3, 200)), "image: got int64 above 1; divide by the largest level"),
        (lambda: encode(np.zeros(3), "gamma"), "expected 'none' or 'srgb', got 'gamma'"),
        (lambda: encode(np.zeros(3), np.ones(3)), "expected 'none' or 'srgb', got array"),
        (lambda: encode("x"), "image: expected real numbers, got 'x'"),
        (lambda: decode(None), "image: expected real numbers, got None"),
        (lambda: decode(np.ones(3) * 1j), "image: expected real numbers, got complex"),
        (lambda: compare(np.zeros((2, 3)), np.zeros((2, 3)), peak="a"), "peak: expected a finite number > 0, got 'a'"),
        (
            lambda: compare(np.zeros((2, 3)), np.ones((2, 3)), peak=np.inf),
            "peak: expected a finite number > 0, got inf",
        ),
    ],
)
def test_errors_say_what_is_wrong(act: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        act()
