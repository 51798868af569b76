"""Sample buffers with other rows: positions, normals and colours that are estimated themselves."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight import Scene, nodes
from jaxlight.lighting import make_plan, shade
from jaxlight.processor import sizes
from jaxlight.raster import SampleBuffer
from jaxlight.raster.tile_layout import layout_of

COUNT = 5000


def rows(seed: int) -> dict[str, np.ndarray]:
    """Positions, normals and colours."""
    random = np.random.default_rng(seed)
    return {
        "position": np.float32([1, 1, 0.1]) * random.uniform(-1, 1, (COUNT, 3)).astype(np.float32),
        "normal": np.float32([0, 0, 3]) + random.normal(size=(COUNT, 3)).astype(np.float32),
        "color": random.uniform(0.1, 1, (COUNT, 3)).astype(np.float32),
    }


def buffer(own: dict[str, np.ndarray], by_place: bool = False) -> SampleBuffer:
    """Of three surfaces, so that tiles are padded."""
    surface = np.random.default_rng(1).integers(0, 3, COUNT)
    return SampleBuffer.create(**own, eye=(0.3, 0.2, 6), surface=surface, by_place=by_place, dtype=np.float32)


def small_lights(count: int) -> Scene:
    """Three shapes with colours of their own under lights that reach few samples."""
    random = np.random.default_rng(2)
    color = nodes.Color(color=np.ones((1, 3)))
    shapes = [
        nodes.Shape(
            appearance=nodes.Appearance(material=nodes.Material(shininess=shininess)),
            geometry=nodes.IndexedFaceSet(color=color),
        )
        for shininess in (0.1, 0.2, 0.3)
    ]
    places = (0.9, 0.9, 0.4) * random.uniform(0, 1, (count, 3))
    return Scene.from_nodes([*shapes, *(nodes.PointLight(location=place, radius=0.3) for place in places)])


def test_a_buffer_with_other_rows_is_one_made_of_them() -> None:
    """Lists of lights are drawn up for where the samples are now."""
    scene, own = small_lights(60), rows(1)
    other = rows(2) | {"position": own["position"][:, [1, 0, 2]]}
    got, made = buffer(own, by_place=True).with_rows(**other), buffer(other, by_place=True)
    assert make_plan(scene, got).culled
    for name, wanted in other.items():
        np.testing.assert_array_equal(getattr(got, name), wanted)
    np.testing.assert_array_equal(got.surface, made.surface)
    before, wanted = (np.asarray(shade(scene, samples)) for samples in (buffer(own, by_place=True), made))
    assert np.max(np.abs(before - wanted)) > 0.1
    np.testing.assert_allclose(shade(scene, got), wanted, rtol=1e-5, atol=1e-6)


def test_an_empty_buffer_has_no_other_rows() -> None:
    empty = SampleBuffer.create(np.zeros((0, 3)), np.zeros((0, 3)), (0, 0, 5))
    assert empty.with_rows(position=empty.position, normal=empty.normal).position.shape == (0, 3)


@pytest.mark.parametrize("by_place", [False, True])
def test_derivatives_by_rows_are_those_by_planes(by_place: bool) -> None:
    scene, samples = small_lights(3), buffer(rows(1), by_place)
    weight = np.random.default_rng(3).normal(size=(COUNT, 3))

    def loss(samples: SampleBuffer) -> jax.Array:
        return jnp.sum(weight * shade(scene, samples)[:, :3])

    by_planes = jax.grad(loss, allow_int=True)(samples)
    by_rows = jax.jit(jax.grad(lambda own: loss(samples.with_rows(**own))))(rows(1))
    for name in ("position", "normal", "color"):
        wanted = np.asarray(samples.rows_in_sample_order(getattr(by_planes, f"{name}_planes")))
        assert np.max(np.abs(wanted)) > 1e-2
        np.testing.assert_allclose(by_rows[name], wanted, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ({"normal": np.zeros((3, COUNT))}, r"normal: expected shape \[5000, 3\], got \[3, 5000\]"),
        ({"position": np.zeros((COUNT + 1, 3))}, r"position: expected shape \[5000, 3\], got \[5001, 3\]"),
        ({"color": np.zeros((COUNT, 4))}, r"color: expected shape \[5000, 3\], got \[5000, 4\]"),
        ({"normal": [[1, 2, 3], [1, 2]]}, r"normal: expected real numbers, got \[\[1, 2, 3\], \[1, 2\]\]"),
        ({"color": np.full((COUNT, 3), 2)}, "color: got int64 above 1; divide by the largest level"),
        ({"normal": np.full((COUNT, 3), 1j)}, "normal: expected real numbers, got complex64"),
    ],
)
def test_rows_of_another_shape_are_refused(own: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        buffer(rows(1)).with_rows(**own)


TEXELS = np.zeros((1, 4), int)
ONE: dict[str, Any] = {"position": np.zeros((1, 3)), "normal": np.ones((1, 3)), "eye": (0, 0, 5)}
FOUR: dict[str, Any] = {"position": np.zeros((4, 3)), "normal": np.ones((4, 3)), "width": 3, "height": 1}


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ({"dtype": int}, "dtype: expected a floating-point type such as 'float32' .*, got <class 'int'>"),
        ({"dtype": "float31"}, "dtype: expected a floating-point type such as 'float32' .*, got 'float31'"),
        (
            {"dtype": "float8_e4m3fn"},
            "dtype: expected .*one of float64, float32, float16, bfloat16.*, got 'float8_e4m3fn'",
        ),
        ({"tile": 2.0}, "tile: expected a whole number >= 1, got 2.0"),
        ({"tile": 3}, "tile: expected a power of two, got 3"),
        ({"tile": 2**40}, "tile: expected at most 16777216 samples, got 1099511627776"),
        ({"by_place": "no"}, "by_place: expected True or False, got 'no'"),
        ({"position": [[1e39, 0, 0]], "dtype": "float32"}, "position: 1e\\+39 is larger than its type holds"),
        ({"position": None}, "position: expected real numbers, got None"),
        ({"position": [[1j, 0, 0]]}, r"position: expected real numbers, got \[\[1j, 0, 0\]\]"),
        ({"color": [[1e39, 0, 0]], "dtype": "float32"}, "color: 1e\\+39 is larger than its type holds, 3.40282e\\+38"),
        ({"texel_index": TEXELS, "texel_weight": 1e39 + TEXELS}, "texel_weight: 1e\\+39 is larger than its type holds"),
        ({"color": np.full((1, 3), 128, np.uint8)}, "color: got uint8; divide by 255"),
        ({"color": np.full((1, 3), 200)}, "color: got int64 above 1; divide by the largest level"),
        ({"camera_to_world": 1e39 * np.eye(3)}, "camera_to_world: 1e\\+39 is larger than its type holds"),
        ({"pixel_to_world": 1e39 * np.eye(3)}, "pixel_to_world: 1e\\+39 is larger than its type holds"),
        (
            {"texel_index": TEXELS + 2**32 + 1, "texel_weight": TEXELS},
            "texel_index: every index must be >= 0 and below 2147483648; got 4294967297 to 4294967297",
        ),
        ({"surface": 2**31}, "surface: every index must be >= 0 and below 2147483648"),
        ({"surface": [[1], [1, 2]]}, r"surface: expected integers of shape \[1\] or one, got \[\[1\], \[1, 2\]\]"),
        (
            {"pixel": [0], "width": 2**16, "height": 2**15},
            "pixel: expected fewer than 2147483648 pixels, got 65536 x 32768",
        ),
        ({"coverage": [-0.5]}, r"coverage: expected shares in \[0, 1\], got -0.5 to -0.5"),
        ({"coverage": [5.0]}, r"coverage: expected shares in \[0, 1\], got 5.0 to 5.0"),
        (
            FOUR | {"pixel": [1, 0, 1, 2]},
            "coverage: expected shares of a pixel that add up to at most 1, got 2 in pixel 1; "
            "without coverage each sample stands for a whole pixel",
        ),
        (
            FOUR | {"pixel": [2, 0, 0, 0], "coverage": [1.0, 0.5, 0.25, 0.5]},
            "coverage: expected shares of a pixel that add up to at most 1, got 1.25 in pixel 0$",
        ),
    ],
)
def test_what_makes_no_buffer_is_refused(own: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"SampleBuffer: {message}"):
        SampleBuffer.create(**ONE | own)


def test_whole_numbers_up_to_1_are_colors() -> None:
    for kind in (bool, np.int32):
        color = SampleBuffer.create(**ONE, color=np.eye(3, dtype=kind)[:1]).color
        assert color is not None and color.tolist() == [[1, 0, 0]]


@pytest.mark.parametrize("dtype", [int, "float31", "float8_e5m2"])
def test_a_scene_of_no_floats_is_refused(dtype: Any) -> None:
    with pytest.raises(ValueError, match="dtype: expected a floating-point type such as 'float32'"):
        Scene.from_nodes(nodes.PointLight(), dtype=dtype)


def test_texels_that_the_texture_lacks_are_refused() -> None:
    """Of the surfaces that have one: what others say of texels is not read."""
    images = [nodes.PixelTexture(image=np.full((2, size, 1), 0.5)) for size in (3, 4)]
    textured = [
        nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(), texture=image), geometry=nodes.Sphere())
        for image in (*images, None)
    ]
    scene, weight = Scene.from_nodes(textured), np.tile([1.0, 0, 0, 0], (3, 1))
    rows: dict[str, Any] = {"position": np.zeros((3, 3)), "normal": np.ones((3, 3)), "eye": (0, 0, 5)}

    def shaded(*texels: int) -> jax.Array:
        index = np.repeat(np.array(texels)[:, None], 4, axis=1)
        samples = SampleBuffer.create(**rows, surface=np.arange(3), texel_index=index, texel_weight=weight)
        return shade(scene, samples)

    assert shaded(5, 7, 99).shape == (3, 4)
    with pytest.raises(ValueError, match="texel 6 of surface 0 asked for, but its texture has 2 x 3 texels"):
        shaded(6, 7, 0)
    with pytest.raises(ValueError, match="texel 8 of surface 1 asked for, but its texture has 2 x 4 texels"):
        shaded(5, 8, 0)


def test_colors_for_a_buffer_without_are_refused() -> None:
    own = rows(1)
    samples = SampleBuffer.create(own["position"], own["normal"], (0, 0, 5))
    with pytest.raises(ValueError, match="color: the buffer has none"):
        samples.with_rows(color=own["color"])


def test_few_tiles_are_nothing_but_padding() -> None:
    random = np.random.default_rng(0)
    for _ in range(50):
        surface = np.repeat(np.arange(5), random.integers(1, 5000, 5))
        stored, needed = len(layout_of(surface, 64).tile_surface), np.sum(-(-np.bincount(surface) // 64))
        assert stored <= needed * (1 + sizes().padding)
