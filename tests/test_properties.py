"""What must hold for any scene: linearity, superposition, symmetry, monotony. Scenes are drawn by hypothesis."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fit_scenes import precision
from jaxlight import Scene, nodes, shade
from jaxlight.lighting import make_plan
from jaxlight.raster import SampleBuffer

KINDS = ("directional", "point", "spot")
SAMPLES = 6
EXAMPLES = settings(max_examples=20)
CLOSE = 1e-11

Numbers = dict[str, np.ndarray]


def numbers(low: float, high: float, *shape: int) -> st.SearchStrategy[np.ndarray]:
    """Arrays of numbers in a range, ends and simple numbers among them."""
    count = int(np.prod(shape))
    floats = st.floats(low, high, allow_subnormal=False)
    return st.lists(floats, min_size=count, max_size=count).map(lambda x: np.reshape(x, shape))


@st.composite
def drawn_scenes(draw: Callable) -> tuple[Scene, SampleBuffer]:
    """Two lights of each kind above a handful of samples; nothing degenerate, and no jumps nearby."""
    template, buffer = TEMPLATE
    changes = {}
    for kind in KINDS:
        lights = getattr(template, kind)
        fields: dict[str, Any] = {
            "ambient_intensity": draw(numbers(0, 1, 2)),
            "color": draw(numbers(0, 1, 2, 3)),
            "intensity": draw(numbers(0, 1, 2)),
        }
        if kind != "point":
            fields["direction"] = draw(numbers(-1, 1, 2, 3)) * np.array([1, 1, 0.4]) - np.array([0, 0, 0.7])
        if kind != "directional":
            fields["location"] = draw(numbers(-2, 2, 2, 3)) + np.array([0, 0, 4])
            fields["attenuation"] = draw(numbers(0, 1, 2, 3))
        if kind == "spot":
            beam = draw(numbers(0.05, 0.7, 2))
            fields |= {"beam_width": beam, "cut_off_angle": beam + draw(numbers(0.1, 0.8, 2))}
        changes[kind] = dataclasses.replace(lights, **{name: jnp.asarray(value) for name, value in fields.items()})
    body = {"ambient_intensity": numbers(0, 1, 1), "shininess": numbers(1 / 64, 1, 1)}
    body |= {name: numbers(0, 1, 1, 3) for name in ("diffuse_color", "emissive_color", "specular_color")}
    fields = {name: jnp.asarray(draw(strategy)) for name, strategy in body.items()}
    scene = dataclasses.replace(template, materials=dataclasses.replace(template.materials, **fields), **changes)
    position, normal = (
        draw(numbers(-1, 1, SAMPLES, 3)),
        draw(numbers(-1, 1, SAMPLES, 3)) * np.array([1, 1, 0.4]) + np.array([0, 0, 0.7]),
    )
    eye = draw(numbers(-1, 1, 3)) + np.array([0, 0, 5])
    return scene, with_geometry(buffer, position, normal, eye)


def make_template() -> tuple[Scene, SampleBuffer]:
    with precision("float64") as dtype:
        lights = [nodes.DirectionalLight(global_=True), nodes.PointLight(radius=1e9), nodes.SpotLight(radius=1e9)]
        body = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()))
        scene = Scene.from_nodes([body, *lights, *lights], dtype=dtype)
        return dataclasses.replace(scene, document=None), SampleBuffer.create(
            np.zeros((SAMPLES, 3)), np.ones((SAMPLES, 3)), (0, 0, 5), dtype=dtype
        )


TEMPLATE = make_template()


def with_geometry(buffer: SampleBuffer, position: np.ndarray, normal: np.ndarray, eye: np.ndarray) -> SampleBuffer:
    """The buffer with other numbers: its own layout, so that one compiled program serves all."""
    made = SampleBuffer.create(position, normal, eye, dtype=np.float64)
    return dataclasses.replace(made, slot=buffer.slot)


def colors(scene: Scene, samples: SampleBuffer) -> np.ndarray:
    """[N, 3]; nothing is skipped, so that all drawn scenes share a program."""
    plan = make_plan(*TEMPLATE, free=True)
    return np.asarray(shade(scene, samples, plan=plan))[:, :3]


def lights_of(scene: Scene, change: Callable[[str, Any], dict[str, Any]]) -> Scene:
    """The scene with fields of its lights replaced, kind by kind."""
    lights = {kind: getattr(scene, kind) for kind in KINDS}
    return dataclasses.replace(scene, **{k: dataclasses.replace(v, **change(k, v)) for k, v in lights.items()})


def emitted(scene: Scene) -> np.ndarray:
    return np.asarray(scene.materials.emissive_color)


@pytest.fixture(autouse=True, scope="module")
def double_precision():
    with precision("float64"):
        yield


@given(drawn_scenes(), st.floats(0, 3))
@EXAMPLES
def test_linear_in_the_lights_colours(drawn: tuple[Scene, SampleBuffer], factor: float) -> None:
    scene, samples = drawn
    scaled = lights_of(scene, lambda _, lights: {"color": factor * lights.color})
    wanted = emitted(scene) + factor * (colors(scene, samples) - emitted(scene))
    np.testing.assert_allclose(colors(scaled, samples), wanted, rtol=CLOSE, atol=CLOSE)


@given(drawn_scenes(), st.floats(0, 3))
@EXAMPLES
def test_linear_in_the_lights_intensities(drawn: tuple[Scene, SampleBuffer], factor: float) -> None:
    scene, samples = drawn
    dark, scaled = (lights_of(scene, lambda _, lights, k=k: {"intensity": k * lights.intensity}) for k in (0.0, factor))
    ambient = colors(dark, samples)
    wanted = ambient + factor * (colors(scene, samples) - ambient)
    np.testing.assert_allclose(colors(scaled, samples), wanted, rtol=CLOSE, atol=CLOSE)


@given(drawn_scenes())
@EXAMPLES
def test_lights_add_up(drawn: tuple[Scene, SampleBuffer]) -> None:
    scene, samples = drawn
    total = emitted(scene) + np.zeros((SAMPLES, 3))
    for kind in KINDS:
        for row in range(2):

            def only(other: str, lights: Any, kind: str = kind, row: int = row) -> dict[str, Any]:
                kept = (np.arange(2) == row)[:, None] & (other == kind)
                return {"color": jnp.where(kept, lights.color, 0.0)}

            total += colors(lights_of(scene, only), samples) - emitted(scene)
    np.testing.assert_allclose(colors(scene, samples), total, rtol=CLOSE, atol=CLOSE)


@given(drawn_scenes(), numbers(-1, 1, 4), numbers(-100, 100, 3))
@EXAMPLES
def test_rigid_motion_changes_nothing(
    drawn: tuple[Scene, SampleBuffer], quaternion: np.ndarray, translation: np.ndarray
) -> None:
    scene, samples = drawn
    w, x, y, z = (quaternion + np.array([2, 0, 0, 0])) / np.linalg.norm(quaternion + np.array([2, 0, 0, 0]))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )

    def moved(_: str, lights: Any) -> dict[str, Any]:
        fields = {}
        if hasattr(lights, "direction"):
            fields["direction"] = lights.direction @ rotation.T
        if hasattr(lights, "location"):
            fields["location"] = lights.location @ rotation.T + translation
        return fields

    position, normal = np.asarray(samples.position) @ rotation.T + translation, np.asarray(samples.normal) @ rotation.T
    eye = rotation @ np.asarray(samples.eye) + translation
    there = with_geometry(samples, position, normal, eye)
    np.testing.assert_allclose(colors(lights_of(scene, moved), there), colors(scene, samples), rtol=1e-9, atol=1e-9)


@given(drawn_scenes(), st.permutations(range(SAMPLES)))
@EXAMPLES
def test_the_order_of_lights_and_samples_does_not_matter(drawn: tuple[Scene, SampleBuffer], order: list[int]) -> None:
    scene, samples = drawn
    position, normal = np.asarray(samples.position)[order], np.asarray(samples.normal)[order]
    swapped = lights_of(scene, lambda _, lights: jax.tree.map(lambda leaf: leaf[::-1], arrays_of(lights)))
    permuted = with_geometry(samples, position, normal, np.asarray(samples.eye))
    np.testing.assert_allclose(colors(swapped, permuted), colors(scene, samples)[order], rtol=CLOSE, atol=CLOSE)


def arrays_of(lights: Any) -> dict[str, Any]:
    """The light's arrays by field."""
    return {
        f.name: getattr(lights, f.name) for f in dataclasses.fields(lights) if hasattr(getattr(lights, f.name), "at")
    }


@given(drawn_scenes(), st.floats(0, 1))
@EXAMPLES
def test_a_light_may_be_split_in_two(drawn: tuple[Scene, SampleBuffer], share: float) -> None:
    scene, samples = drawn

    def parted(_: str, lights: Any, shares: tuple[float, float]) -> dict[str, Any]:
        twice = {name: jnp.stack([value[0], value[0]]) for name, value in arrays_of(lights).items()}
        for name in ("intensity", "ambient_intensity"):
            twice[name] = twice[name] * jnp.asarray(shares)
        return twice

    whole = lights_of(scene, lambda kind, lights: parted(kind, lights, (1.0, 0.0)))
    split = lights_of(scene, lambda kind, lights: parted(kind, lights, (share, 1 - share)))
    np.testing.assert_allclose(colors(split, samples), colors(whole, samples), rtol=CLOSE, atol=CLOSE)


@given(drawn_scenes(), numbers(0, 2, 2, 3))
@EXAMPLES
def test_more_attenuation_is_never_brighter(drawn: tuple[Scene, SampleBuffer], more: np.ndarray) -> None:
    scene, samples = drawn
    damped = lights_of(
        scene, lambda kind, lights: {"attenuation": lights.attenuation + more} if kind != "directional" else {}
    )
    assert np.all(colors(damped, samples) <= colors(scene, samples) * (1 + CLOSE))


@pytest.mark.parametrize("kind", [nodes.DirectionalLight, nodes.PointLight, nodes.SpotLight])
def test_lights_that_are_off_send_nothing(kind: type) -> None:
    body = nodes.Material(emissive_color=(0.125, 0.25, 0.5), ambient_intensity=1.0)
    shape = nodes.Shape(appearance=nodes.Appearance(material=body))
    scene = Scene.from_nodes([shape, kind(on=False, ambient_intensity=1.0), nodes.NavigationInfo(headlight=False)])
    samples = SampleBuffer.create(np.zeros((3, 3)), np.ones((3, 3)), (0, 0, 5))
    np.testing.assert_array_equal(np.asarray(shade(scene, samples))[:, :3], [[0.125, 0.25, 0.5]] * 3)


def test_a_use_is_a_copy() -> None:
    """The same Shape and the same light in two groups, and their copies."""

    def shape() -> nodes.Shape:
        return nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(specular_color=(0.5, 0.5, 0.5))))

    def group(shape: nodes.Shape, light: nodes.PointLight, x: float) -> nodes.Transform:
        return nodes.Transform(translation=(x, 0, 0), scale=(2, 2, 2), children=[shape, light])

    def lamp() -> nodes.PointLight:
        return nodes.PointLight(location=(1, 2, 3), attenuation=(0.5, 0.1, 0.0), global_=False)

    body, light = shape(), lamp()
    used = Scene.from_nodes([group(body, light, 0.0), group(body, light, 1.0)])
    copied = Scene.from_nodes([group(shape(), lamp(), 0.0), group(shape(), lamp(), 1.0)])
    random = np.random.default_rng(0)
    samples = SampleBuffer.create(
        random.normal(size=(20, 3)), random.normal(size=(20, 3)), (0, 0, 9), surface=np.arange(20) % 2
    )
    np.testing.assert_array_equal(shade(used, samples), shade(copied, samples))
