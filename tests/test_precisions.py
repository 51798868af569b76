"""The float type of the samples decides: float64, float32 (with and without x64), half precision widened to float32."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cases_to_scenes import options_of, scene_and_sample
from fit_scenes import precision
from jaxlight import LightingOptions, Scene, load, nodes, rasterize, shade
from jaxlight.fit.coverage import Coverage
from jaxlight.lighting import highlight
from jaxlight.raster import SampleBuffer
from oracle.cases import well_conditioned_cases
from oracle.fast_exact import values
from oracle.ulp import error_in_ulp
from test_modes import EYE, rows, spot_in_fog

HALVES = [jnp.bfloat16, jnp.float16]


@pytest.mark.parametrize(("bits", "digits"), [("float32", 32), ("float32 with x64", 32), ("float64", 64)])
def test_errors_are_some_last_bits_of_the_type(bits: str, digits: int) -> None:
    """The whole run is `jaxlight stress`; here two cases, by the same figures."""
    cases = well_conditioned_cases(5, 2, digits)
    exact = values(cases, digits)
    with precision(bits) as dtype:
        for i, case in enumerate(cases):
            scene, samples = scene_and_sample(case, dtype)
            got = shade(scene, samples, options_of(case))
            assert got.dtype == dtype
            ulp = error_in_ulp(np.asarray(got[0]), exact.rgba[i], digits)
            assert np.all(ulp <= 4 * exact.condition[i]), case


def test_float32_is_the_same_with_and_without_x64() -> None:
    found = []
    for bits in ("float32", "float32 with x64"):
        with precision(bits) as dtype:
            samples = SampleBuffer.create(*rows(30), EYE, dtype=dtype)
            found.append(np.asarray(shade(spot_in_fog(dtype), samples)))
    assert found[0].dtype == found[1].dtype == np.float32
    np.testing.assert_array_equal(found[0], found[1])


DOUBLE: dict[str, Callable[[Path], Any]] = {
    "dtype": lambda path: Scene.from_nodes(nodes.PointLight(), dtype="float64"),
    "load: dtype": lambda path: load(path, dtype=np.float64),
    "SampleBuffer: dtype": lambda path: SampleBuffer.create(*rows(3), EYE, dtype=jnp.float64),
    "rasterize: dtype": lambda path: rasterize(load(path), width=4, height=4, dtype=float),
}


@pytest.mark.parametrize("where", DOUBLE)
def test_float64_that_jax_would_make_float32_is_refused(where: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text("<X3D><Scene><Shape><Box/></Shape></Scene></X3D>")
    with precision("float32"), pytest.raises(ValueError, match=f"^{where}: .*float64.*jax_enable_x64"):
        DOUBLE[where](path)
    with precision("float64"):
        leaves = jax.tree.leaves(DOUBLE[where](path))
        assert {leaf.dtype.name for leaf in leaves if leaf.dtype.kind == "f"} == {"float64"}


def halved(tree: Any, half: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf.astype(half) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, tree)


@pytest.mark.parametrize("half", HALVES, ids=["bfloat16", "float16"])
def test_half_precision_is_widened_at_the_door(half: Any) -> None:
    """Half-precision buffers and scenes give, to the last bit, what their numbers give in float32."""
    texture = nodes.PixelTexture(image=np.random.default_rng(0).uniform(0.2, 1, (4, 4, 3)))
    body = nodes.Material(specular_color=(0.5, 0.5, 0.5))
    textured = nodes.Shape(appearance=nodes.Appearance(material=body, texture=texture))
    scene = halved(Scene.from_nodes([textured, nodes.PointLight(location=(1, 2, 3), attenuation=(0.5, 0.1, 0))]), half)
    position, normal = rows(30)
    index = np.random.default_rng(1).integers(0, 16, (30, 4))
    samples = halved(
        SampleBuffer.create(position, normal, EYE, texel_index=index, texel_weight=np.full((30, 4), 0.25)), half
    )
    got = shade(scene, samples)
    assert got.dtype == jnp.float32
    wide = jax.tree.map(
        lambda leaf: leaf.astype(jnp.float32) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, (scene, samples)
    )
    np.testing.assert_array_equal(got, shade(*wide))


@pytest.mark.parametrize("half", HALVES, ids=["bfloat16", "float16"])
def test_pixels_that_half_precision_samples_cover_wholly_are_fitted(half: Any) -> None:
    """Shares are not rounded to the samples' type; if they are, three of a third add up to 1 +- 2^-9 in bfloat16. A
    pixel that lacks a sample is left out all the same.
    """
    scene, view = Scene.from_nodes([nodes.Shape(geometry=nodes.Sphere())]), nodes.Viewpoint(position=(0, 0, 4))
    for count in (3, 5, 7, 48, 107, 144):
        samples = rasterize(scene, view, 12, samples=count, dtype=half)
        lying = np.bincount(np.asarray(samples.pixel), minlength=144)
        coverage = Coverage.of(samples)
        for own in (coverage, Coverage.of(halved(samples, half))):
            np.testing.assert_array_equal(own.is_whole, lying[coverage.pixel] == count)
        assert 0 < np.count_nonzero(coverage.is_whole) < len(coverage.pixel)
        np.testing.assert_allclose(coverage.covered[coverage.is_whole], 1, atol=1e-6)
    lacking = SampleBuffer.create(*rows(4), EYE, pixel=[0, 0, 1, 1], coverage=[0.5, 0.49, 0.5, 0.5], width=2, height=1)
    assert Coverage.of(halved(lacking, half)).is_whole.tolist() == [False, True]


def test_derivatives_of_half_precision() -> None:
    """They come back in the type of the field, rounded once."""
    body = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(specular_color=(0.5, 0.5, 0.5))))
    lamp = nodes.PointLight(location=(1, 2, 3), attenuation=(0.5, 0.25, 0.125))
    scene = dataclasses.replace(halved(Scene.from_nodes([body, lamp]), jnp.bfloat16), document=None)
    samples = halved(SampleBuffer.create(*rows(30), EYE), jnp.bfloat16)

    def total(scene: Scene) -> jax.Array:
        return jnp.mean(shade(scene, samples)[:, :3])

    slopes = jax.grad(total)(scene)
    wide = jax.grad(total)(jax.tree.map(lambda leaf: leaf.astype(jnp.float32), scene))
    for got, wanted in zip(jax.tree.leaves(slopes), jax.tree.leaves(wide), strict=True):
        assert got.dtype == jnp.bfloat16 and wanted.dtype == jnp.float32
        np.testing.assert_allclose(got.astype(jnp.float32), wanted, rtol=2.0**-8, atol=1e-7)


def test_the_fast_accuracy_keeps_its_bound() -> None:
    """Highlights to 1e-4 of themselves: here 64 ulp x condition of the whole colour."""
    cases = well_conditioned_cases(11, 8, 32)
    exact = values(cases, 32)
    worst = 0.0
    for i, case in enumerate(cases):
        scene, samples = scene_and_sample(case, np.float32)
        got = shade(scene, samples, dataclasses.replace(options_of(case), accuracy="fast"))
        ulp = error_in_ulp(np.asarray(got[0]), exact.rgba[i], 32)
        assert np.all(ulp <= 64 * exact.condition[i]), case
        worst = max(worst, float(np.max(ulp)))
    assert worst > 0


FAST = LightingOptions(accuracy="fast")


@pytest.mark.parametrize("bits", ["float32", "float64"])
def test_fast_highlights_at_all_exponents(bits: str) -> None:
    """From the peak to where they vanish; the exact power of the same N . H in float64."""
    with precision(bits) as dtype:
        angle = np.linspace(0, 1.5, 200)
        normal = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
        samples = SampleBuffer.create(np.zeros_like(normal), normal, (0, 0, 1), dtype=dtype)
        cosine = np.asarray(samples.normal, np.float64)[:, 2] / np.linalg.norm(
            np.asarray(samples.normal, float), axis=1
        )
        for shininess in (0.0, 0.01, 0.2, 1.0):
            body = nodes.Material(diffuse_color=(0, 0, 0), specular_color=(1, 1, 1), shininess=shininess)
            shape = nodes.Shape(appearance=nodes.Appearance(material=body))
            scene = Scene.from_nodes([shape, nodes.DirectionalLight(direction=(0, 0, -1))], dtype=dtype)
            got = np.asarray(shade(scene, samples, FAST))[:, 0]
            exponent = 128 * float(np.asarray(scene.materials.shininess)[0])
            np.testing.assert_allclose(got, cosine**exponent, rtol=1e-4, atol=1e-37)


def test_fast_changes_highlights_only() -> None:
    samples = SampleBuffer.create(*rows(30), EYE, dtype=np.float32)
    scene = spot_in_fog(np.float32)
    dull = dataclasses.replace(
        scene,
        materials=dataclasses.replace(scene.materials, specular_color=jnp.zeros_like(scene.materials.specular_color)),
    )
    np.testing.assert_array_equal(shade(dull, samples, FAST), shade(dull, samples))


def test_derivatives_of_fast_highlights() -> None:
    samples = SampleBuffer.create(*rows(30), EYE, dtype=np.float32)
    scene = dataclasses.replace(spot_in_fog(np.float32), document=None)

    def mean(scene: Scene, options: LightingOptions | None) -> jax.Array:
        return jnp.mean(shade(scene, samples, options)[:, :3])

    def slopes(options: LightingOptions | None) -> Any:
        free, fixed = eqx.partition(scene, eqx.is_inexact_array)
        return jax.jit(jax.grad(lambda free: mean(eqx.combine(free, fixed), options)))(free)

    for got, wanted in zip(jax.tree.leaves(slopes(FAST)), jax.tree.leaves(slopes(None)), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-4, atol=1e-6)


def test_derivatives_of_fast_highlights_at_their_ends() -> None:
    """0 where N . H <= 0, and finite at the peak and with exponent 0."""
    for squared, exponent in itertools.product((0.0, 1e-38, 1e-10, 1.0), (0.0, 1e-30, 1.0, 128.0)):
        slopes = jax.grad(highlight.FAST.power, argnums=(0, 1))(jnp.float32(squared), jnp.float32(exponent))
        assert np.all(np.isfinite(slopes)), (squared, exponent)
        if squared == 0:
            assert [*map(float, slopes)] == [0, 0]
