"""The float type of the samples decides: float64, float32 (with and without x64), half precision widened to float32."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cases_to_scenes import options_of, scene_and_sample
from fit_scenes import precision
from jaxlight import Scene, nodes, shade
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
