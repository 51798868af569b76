"""What is static of scenes and plans, and numbers that are none: refused by name before anything is compiled."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight import SampleBuffer, Scene, Surface, nodes, shade, sum_over_samples
from jaxlight.lighting import make_plan
from jaxlight.scene.flags import Flags

BALL = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(shininess=0.1)), geometry=nodes.Sphere())
LAMP = nodes.PointLight(location=(0, 0, 3), name="key")
SUN = nodes.DirectionalLight()
SAMPLE = SampleBuffer.create([[0, 0, 1.0]], [[0, 0, 1.0]], [0, 0, 5.0])


def scene_of(*others: nodes.Node) -> Scene:
    return Scene.from_nodes([BALL, *others])


SCENE = scene_of(LAMP, nodes.Fog(visibility_range=9))
FREE: dict[str, Any] = {
    "all": True,
    "a path": "Material[*].specular_color",
    "paths": ["PointLight[key].color", "Material[0].specular_color.r"],
    "a function": lambda scene: scene.materials.specular_color,
    "a leaf": SCENE.materials.specular_color,  # pyright: ignore[reportOptionalMemberAccess]
    "leaves": [SCENE.materials.specular_color],  # pyright: ignore[reportOptionalMemberAccess]
    "all of a kind": SCENE.materials,
}


@pytest.mark.parametrize("name", FREE)
def test_what_is_free_is_told_in_every_way_that_means_it(name: str) -> None:
    plan = make_plan(SCENE, SAMPLE, free=FREE[name])
    assert plan.specular and not make_plan(SCENE, SAMPLE).specular
    bright = eqx.tree_at(lambda scene: scene.materials.specular_color, SCENE, jnp.ones((1, 3)))
    np.testing.assert_allclose(shade(bright, SAMPLE, plan=plan), shade(bright, SAMPLE), rtol=1e-6)


@pytest.mark.parametrize(
    ("free", "said"),
    [
        ([jnp.zeros((1, 3))], "an array of shape .1, 3. that is none of them"),
        ([np.zeros((1, 3))], "an array of shape .1, 3. that is none of them"),
        (False, "got False that is none of them"),
        ("Material[*].shine", "the closest: Material"),
        (3, "got 3 that is none of them"),
    ],
)
def test_what_the_scene_does_not_hold_cannot_be_free(free: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make_plan(SCENE, SAMPLE, free=free)


def test_plans_are_made_for_scenes() -> None:
    with pytest.raises(ValueError, match="scene: expected a Scene, got NoneType"):
        make_plan(None)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="samples: expected a SampleBuffer or None, got str"):
        make_plan(SCENE, "x")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("others", "differs"),
    [
        ([LAMP, LAMP, nodes.Fog(visibility_range=9)], "point"),
        ([nodes.PointLight(on=False), nodes.Fog(visibility_range=9)], "point"),
        ([nodes.NavigationInfo(headlight=False), nodes.Fog(visibility_range=9)], "point"),
        ([LAMP, nodes.Fog(visibility_range=9, fog_type="EXPONENTIAL")], "fog"),
        ([nodes.Transform(scale=(2, 1, 1), children=[LAMP]), SUN], "directional and point and fog"),
        ([nodes.Shape(appearance=nodes.Appearance(material=nodes.Material())), LAMP], "materials and point and fog"),
    ],
)  # fmt: skip
def test_a_plan_of_another_scene_is_refused(others: list[nodes.Node], differs: str) -> None:
    plan = make_plan(scene_of(*others), SAMPLE, free=True)
    for shaded in (
        lambda: shade(SCENE, SAMPLE, plan=plan),
        lambda: jax.jit(lambda scene: shade(scene, SAMPLE, plan=plan))(dataclasses.replace(SCENE, document=None)),
        lambda: sum_over_samples(lambda color: color[0], SCENE, SAMPLE, plan=plan),
    ):
        with pytest.raises(ValueError, match=f"plan: made for a scene with other .*{differs} .numbers may differ"):
            shaded()


def test_a_plan_serves_other_numbers() -> None:
    plan = make_plan(SCENE, SAMPLE, free=True)
    moved = scene_of(nodes.PointLight(location=(1, 0, 2), color=(1, 0, 0)), nodes.Fog(visibility_range=20))
    np.testing.assert_allclose(shade(moved, SAMPLE, plan=plan), shade(moved, SAMPLE), rtol=1e-6)


@pytest.mark.parametrize("far", [False, True])
def test_a_plan_by_where_samples_lie_is_refused_elsewhere(far: bool) -> None:
    """A light of radius 6 reaches all samples near it, and none far away: its radius, or the light, is left out."""
    scene = scene_of(nodes.PointLight(location=(0, 0, 5), radius=6))
    near, away = (SampleBuffer.create([[0, 0, z]], [[0, 0, 1.0]], [0, 0, 9.0]) for z in (0.0, -20.0))
    own, other = (away, near) if far else (near, away)
    plan = make_plan(scene, own)
    np.testing.assert_array_equal(shade(scene, own, plan=plan), shade(scene, own))
    moved = own.with_rows(position=other.position)
    for shaded in (
        lambda: shade(scene, other, plan=plan),
        lambda: shade(scene, moved, plan=plan),
        lambda: jax.jit(lambda scene: shade(scene, other, plan=plan))(dataclasses.replace(scene, document=None)),
        lambda: sum_over_samples(lambda color: color[0], scene, other, plan=plan),
    ):
        with pytest.raises(ValueError, match=r"plan: made for samples from \[0.0, .* make a plan for these"):
            shaded()
    free = make_plan(scene, own, free="PointLight[*].radius")
    np.testing.assert_array_equal(shade(scene, other, plan=free), shade(scene, other))


def test_a_plan_without_radii_serves_all_places() -> None:
    away = SAMPLE.with_rows(position=np.full((1, 3), 30.0))
    endless = scene_of(nodes.PointLight(radius=float("inf")), SUN)
    np.testing.assert_array_equal(shade(endless, away, plan=make_plan(endless, SAMPLE)), shade(endless, away))


@pytest.mark.parametrize("ambient_intensity", [0.0, 0.5])
def test_a_light_of_no_intensity_is_kept_for_its_ambient_light(ambient_intensity: float) -> None:
    lamp = nodes.PointLight(intensity=0, ambient_intensity=ambient_intensity)
    assert (make_plan(scene_of(lamp)).point is not None) == (ambient_intensity > 0)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["location", "radius", "attenuation", "intensity", "color"])
def test_numbers_of_lights_that_are_none_are_refused(field: str, number: float) -> None:
    leaf = getattr(SCENE.point, field)
    broken = eqx.tree_at(lambda scene: getattr(scene.point, field), SCENE, jnp.full_like(leaf, number))
    if np.isinf(number) and field in ("radius", "attenuation"):
        assert np.all(np.isfinite(shade(broken, SAMPLE)))
        return
    with pytest.raises(ValueError, match=rf"PointLight\[key\].{field}: every number must be finite, got {number}"):
        shade(broken, SAMPLE)
    for unread in ({"on": Flags([False])}, {"in_scope": Flags([[False]])}):
        unlit = dataclasses.replace(broken, point=dataclasses.replace(broken.point, **unread))
        assert np.all(np.isfinite(shade(unlit, SAMPLE)))


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_texels_that_are_none_are_refused(number: float) -> None:
    texture = nodes.ImageTexture(image=np.full((2, 2, 3), 0.5))
    ball = nodes.Shape(appearance=nodes.Appearance(texture=texture), geometry=nodes.Sphere())
    scene = Scene.from_nodes([ball, LAMP])
    broken = eqx.tree_at(
        lambda scene: scene.textures[0].image, scene, replace_fn=lambda image: image.at[0, 1].set(number)
    )
    with pytest.raises(ValueError, match=rf"Texture\[0\].image: every number must be finite, got {number}"):
        shade(broken, SAMPLE)


@pytest.mark.parametrize("name", ["position", "normal"])
@pytest.mark.parametrize("number", [np.nan, np.inf, 1e39])
@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
def test_rows_are_finite_as_those_of_a_new_buffer(name: str, number: float) -> None:
    with pytest.raises(ValueError, match=rf"SampleBuffer: {name}: every number must be finite; {name}\[0, 0\] is"):
        SAMPLE.with_rows(**{name: np.full((1, 3), number)})


STATIC: dict[str, tuple[dict[str, Any], str]] = {
    "row": ({"surfaces": (Surface("lit", 7),)}, r"surfaces\[0\].material: expected a row in \[0, 1\), got 7"),
    "kind": ({"surfaces": (Surface("Lit", 0),)}, r"surfaces\[0\].lighting: expected 'lit', .* got 'Lit'"),
    "unlit": ({"surfaces": (Surface("unlit", 0),)}, r"surfaces\[0\].material: expected -1, got 0"),
    "texture": ({"surfaces": (Surface("lit", 0, 0),)}, r"surfaces\[0\].texture: expected a row in \[-1, 0\), got 0"),
    "scope": ({"surfaces": SCENE.surfaces * 2}, r"in_scope: expected Flags of shape \[2, 1\], got shape \[1, 1\]"),
    "fog": ({"fog": dataclasses.replace(SCENE.fog, fog_type="linear")}, "fog_type: expected 'LINEAR' or 'EXP"),
    "lights": ({"point": SCENE.materials}, "scene: point: expected PointLights or None, got Materials"),
    "material": ({"materials": "x"}, "scene: materials: expected Materials or None, got str"),
    "textures": ({"textures": []}, "scene: textures: expected a tuple of Texture, got"),
    "on": ({"point": dataclasses.replace(SCENE.point, on=[True])}, "PointLight.on: expected Flags of shape .*a list"),
}  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("case", STATIC)
def test_static_parts_that_do_not_fit_are_refused(case: str) -> None:
    changes, said = STATIC[case]
    with pytest.raises(ValueError, match=said):
        shade(dataclasses.replace(SCENE, **changes), SAMPLE)


def test_scenes_made_anew_are_one_program_without_their_nodes() -> None:
    traced = []

    @jax.jit
    def brightness(scene: Scene) -> jax.Array:
        traced.append(scene)
        return jnp.sum(shade(scene, SAMPLE))

    made = [scene_of(nodes.PointLight(location=(aside, 0, 3))) for aside in (1, 2)]
    assert len(repr(made[0].document)) < 100
    bare = [dataclasses.replace(scene, document=None) for scene in made]
    found = [float(brightness(scene)) for scene in bare]
    assert len(traced) == 1
    assert found == [float(brightness(scene)) for scene in made] and found[0] != found[1]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *bare)
    np.testing.assert_allclose(jax.vmap(brightness)(stacked), found, rtol=1e-6)


def test_lines_of_a_shape_with_a_texture_need_no_texels() -> None:
    """They are unlit, in the material's emissive colour (reading 24); the shape itself is refused without."""
    shown = nodes.Appearance(
        material=nodes.Material(emissive_color=(0.2, 0.4, 0.6)),
        texture=nodes.PixelTexture(image=np.full((1, 1, 4), 0.5)),
    )
    scene = Scene.from_nodes(nodes.Shape(appearance=shown, geometry=nodes.Sphere()))
    with pytest.raises(ValueError, match="surface 0 has a texture, but the buffer has no texel_index and texel_weight"):
        shade(scene, SAMPLE)
    (surface,) = scene.surfaces
    lines = dataclasses.replace(scene, surfaces=(surface._replace(lighting="emissive"),))
    np.testing.assert_allclose(shade(lines, SAMPLE), [[0.2, 0.4, 0.6, 1.0]], rtol=1e-6)
