"""The gradient check passes what is right, names what is wrong, and knows a kink from an error."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import PRECISIONS, key_light, material, precision, sphere_points, sphere_samples, sphere_scene
from jaxlight import SampleBuffer, Scene, check_gradients, nodes
from jaxlight.fit import gradients

SPOT = nodes.SpotLight(name="spot", location=(-1.0, 1.0, 3.0), direction=(0.3, -0.3, -1.0), beam_width=0.1,
                       cut_off_angle=0.5, attenuation=(0.5, 0.2, 0.1))  # fmt: skip
SUN = nodes.DirectionalLight(name="sun", direction=(1.0, -2.0, -3.0), ambient_intensity=0.2, global_=True)


def everything(dtype: Any) -> tuple[Scene, SampleBuffer]:
    """Every kind of light, fog and a texture that scales the diffuse colour."""
    random = np.random.default_rng(0)
    texture = nodes.PixelTexture(image=random.uniform(0.2, 1.0, (4, 4, 1)))
    appearance = nodes.Appearance(material=material(emissive_color=(0.1, 0.0, 0.0)), texture=texture)
    fog = nodes.Fog(visibility_range=8.0, fog_type="EXPONENTIAL", color=(0.5, 0.6, 0.7))
    lamp = key_light(attenuation=(0.9, 0.1, 0.02), ambient_intensity=0.1)
    shape = nodes.Shape(appearance=appearance, geometry=nodes.Sphere())
    count = len(sphere_points(16)[0])
    samples = sphere_samples(
        16, dtype=dtype, texel_index=random.integers(0, 16, (count, 4)), texel_weight=np.full((count, 4), 0.25)
    )
    return Scene.from_nodes([shape, lamp, SPOT, SUN, fog], dtype=dtype), samples


def test_every_field_of_every_node_passes() -> None:
    with precision("float64") as dtype:
        check = check_gradients(*everything(dtype))
    assert check.passed, str(check)
    assert len(check.rows) == 6 + 6 + 9 + 4 + 2 + 1
    assert check.dtype == "float64"
    assert sum(row.largest > 0.01 for row in check.rows) >= 20
    assert check.skipped == ()


def test_a_kink_is_no_error() -> None:
    """The attenuation sum is exactly 1 everywhere: any derivative between the one-sided ones is right."""
    with precision("float64") as dtype:
        check = check_gradients(
            sphere_scene(dtype=dtype), sphere_samples(16, dtype=dtype), "PointLight[key].attenuation"
        )
    (row,) = check.rows
    assert check.passed and row.kinks > 150


def test_a_field_that_changes_nothing_has_no_derivative() -> None:
    """A radius that reaches everything, and the ambient part of a light that has none: differences are rounding."""
    with precision("float64") as dtype:
        scene = sphere_scene(key_light(attenuation=(0.9, 0.1, 0.02), radius=50.0), dtype=dtype)
        fields = ["PointLight[key].radius", "Material[body].ambient_intensity"]
        check = check_gradients(scene, sphere_samples(16, dtype=dtype), fields)
    assert check.passed and [row.largest for row in check.rows] == [0.0, 0.0]


def test_fields_that_are_switched_off_are_named() -> None:
    body = nodes.Shape(appearance=nodes.Appearance(material=material()), geometry=nodes.Sphere())
    with precision("float32") as dtype:
        scene = Scene.from_nodes([body, key_light(radius=np.inf), nodes.Fog()], dtype=dtype)
        check = check_gradients(scene, sphere_samples(16, dtype=dtype))
    assert check.skipped == ("PointLight[key].radius", "Fog.visibility_range")
    assert "PointLight[key].radius" in str(check) and "not checked" in str(check)


@pytest.mark.parametrize("bits", PRECISIONS)
def test_where_all_fields_are_switched_off_nothing_is_checked(bits: str) -> None:
    with precision(bits) as dtype:
        body = nodes.Shape(appearance=nodes.Appearance(material=material()), geometry=nodes.Sphere())
        scene = Scene.from_nodes([body, nodes.Fog()], dtype=dtype)
        check = check_gradients(scene, sphere_samples(8, dtype=dtype), ["Fog.visibility_range"])
    assert check.rows == () and check.skipped == ("Fog.visibility_range",) and check.passed
    assert check.dtype == ("float64" if bits == "float64" else "float32")
    assert str(check).splitlines() == [
        "Fog.visibility_range  not checked: it is switched off",
        "nothing was checked: no field has a derivative here",
    ]


@pytest.mark.parametrize(
    ("of_scene", "of_samples"), [("float32", "float64"), ("float64", "float32"), ("float16", "bfloat16")]
)
def test_the_float_type_of_samples_decides(of_scene: str, of_samples: str) -> None:
    with precision("float64"):
        check = check_gradients(
            sphere_scene(dtype=of_scene), sphere_samples(8, dtype=of_samples), "Material[body].diffuse_color"
        )
    assert check.passed and check.rows[0].largest > 0.1
    assert check.dtype == ("float64" if of_samples == "float64" else "float32")


@pytest.mark.parametrize("factor", [1.01, jnp.nan])
def test_a_derivative_that_is_wrong_by_a_hundredth_is_flagged(monkeypatch: pytest.MonkeyPatch, factor: float) -> None:
    original = gradients.shade_planes

    @jax.custom_jvp
    def crooked(shininess: Any) -> Any:
        return shininess

    crooked.defjvp(lambda primals, tangents: (primals[0], factor * tangents[0]))

    def shade(scene: Scene, samples: SampleBuffer, options: Any = None) -> Any:
        bent = crooked(scene.materials.shininess)
        return original(jax.tree.unflatten(*_replaced(scene, scene.materials.shininess, bent)), samples, options)

    def _replaced(scene: Scene, old: Any, new: Any) -> Any:
        leaves, structure = jax.tree.flatten(scene)
        return structure, [new if leaf is old else leaf for leaf in leaves]

    monkeypatch.setattr(gradients, "shade_planes", shade)
    jax.clear_caches()
    with precision("float32") as dtype:
        check = check_gradients(
            sphere_scene(dtype=dtype),
            sphere_samples(16, dtype=dtype),
            ["Material[body].shininess", "PointLight[key].color"],
        )
    jax.clear_caches()
    assert not check.passed and "WRONG" in str(check)
    shininess, color = check.rows
    assert not shininess.forward_error < 1e-3 and not shininess.reverse_error < 1e-3
    # A number that is none reaches the forward derivatives of all fields.
    assert color.reverse_error < 1e-3 and (color.forward_error < 1e-3 or np.isnan(factor))


def test_a_buffer_without_samples_is_refused() -> None:
    empty = SampleBuffer.create(np.zeros((0, 3)), np.zeros((0, 3)), (0, 0, 4))
    with pytest.raises(ValueError, match="samples: there is nothing to check: the buffer holds no sample"):
        check_gradients(sphere_scene(), empty, "Material[body].shininess")


@pytest.mark.parametrize("tolerance", [-1.0, 0.0, np.nan, np.inf])
def test_a_tolerance_that_none_or_all_would_pass_is_refused(tolerance: float) -> None:
    with pytest.raises(ValueError, match=f"tolerance: expected a finite number > 0, got {tolerance}"):
        check_gradients(sphere_scene(), sphere_samples(8), "Material[body].shininess", tolerance=tolerance)


def test_an_unknown_field_is_refused() -> None:
    with pytest.raises(ValueError, match="the closest: Material"):
        check_gradients(sphere_scene(), sphere_samples(8), "Material[body].shine")
