"""Field paths: every number of a scene has one, and what a path means is what it says."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight import Scene, nodes
from jaxlight.fit.free import free_parameters
from jaxlight.fit.parameters import World
from jaxlight.scene import paths


@pytest.fixture(scope="module")
def scene() -> Scene:
    body = nodes.Material(name="body", diffuse_color=(0.1, 0.2, 0.3))
    texture = nodes.PixelTexture(image=np.ones((2, 3, 3)), name="wood")
    return Scene.from_nodes(
        [
            nodes.Shape(appearance=nodes.Appearance(material=body)),
            nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(), texture=texture)),
            nodes.PointLight(name="key one"),
            nodes.PointLight(name="key two"),
            nodes.PointLight(name="fill"),
            nodes.PointLight(name="fill"),
            nodes.SpotLight(name="7"),
            nodes.DirectionalLight(),
            nodes.Fog(name="mist", visibility_range=3.0),
        ]
    )


def chosen(scene: Scene, path: paths.Path | list[paths.Path]) -> dict[str, list[tuple[int, ...]]]:
    return {
        f"{selection.leaf.kind}.{selection.leaf.field}": [tuple(i) for i in np.argwhere(selection.mask).tolist()]
        for selection in paths.select(scene, path)
    }


def test_every_listed_field_is_found_by_its_path_and_holds_its_value(scene: Scene) -> None:
    listed = paths.fields(scene)
    assert len({field.path for field in listed}) == len(listed) == 2 * 6 + 4 * 6 + 9 + 4 + 2 + 1
    for field in listed:
        (selection,) = paths.select(scene, field.path)
        assert selection.leaf == field.leaf
        np.testing.assert_array_equal(np.asarray(field.leaf.get(scene))[selection.mask], field.value(scene).ravel())
        assert len(field.labels(scene)) == field.value(scene).size
        for label, number in zip(field.labels(scene), field.value(scene).ravel(), strict=True):
            (part,) = paths.select(scene, label)
            np.testing.assert_array_equal(np.asarray(part.leaf.get(scene))[part.mask], [number])


CASES = {
    "Material[body].diffuse_color": {"Material.diffuse_color": [(0, 0), (0, 1), (0, 2)]},
    "Material[1].shininess": {"Material.shininess": [(1,)]},
    "Material[body].diffuseColor.g": {"Material.diffuse_color": [(0, 1)]},
    "PointLight[key*].intensity": {"PointLight.intensity": [(0,), (1,)]},
    "PointLight[*].attenuation[2]": {"PointLight.attenuation": [(0, 2), (1, 2), (2, 2), (3, 2)]},
    "PointLight[3].intensity": {"PointLight.intensity": [(3,)]},
    "SpotLight[0].cutOffAngle": {"SpotLight.cut_off_angle": [(0,)]},
    "SpotLight[0].location.z": {"SpotLight.location": [(0, 2)]},
    "DirectionalLight.direction.x": {"DirectionalLight.direction": [(0, 0)]},
    "Fog.visibilityRange": {"Fog.visibility_range": [()]},
    "Fog.*": {"Fog.color": [(0,), (1,), (2,)], "Fog.visibility_range": [()]},
    "Fog[0].color.b": {"Fog.color": [(2,)]},
    "Fog[m*].visibility_range": {"Fog.visibility_range": [()]},
    "Material[body].diffuse*": {"Material.diffuse_color": [(0, 0), (0, 1), (0, 2)]},
    "Material[1].s*": {"Material.shininess": [(1,)], "Material.specular_color": [(1, 0), (1, 1), (1, 2)]},
    "Material[1].*_color.g": {
        "Material.diffuse_color": [(1, 1)],
        "Material.emissive_color": [(1, 1)],
        "Material.specular_color": [(1, 1)],
    },
    "PointLight[?ill*].?ntensity": {"PointLight.intensity": [(2,), (3,)]},
    "PixelTexture[wood].image[1][2][0]": {"Texture.image": [(1, 2, 0)]},
}


@pytest.mark.parametrize("path", CASES)
def test_what_a_path_means(scene: Scene, path: str) -> None:
    assert chosen(scene, path) == CASES[path]


def test_functions_of_the_scene_mean_leaves_and_parts_of_leaves(scene: Scene) -> None:
    assert chosen(scene, lambda s: s.materials.shininess) == {"Material.shininess": [(0,), (1,)]}
    assert chosen(scene, lambda s: (s.materials.diffuse_color[1, 2], s.fog.color[:2])) == {
        "Material.diffuse_color": [(1, 2)],
        "Fog.color": [(0,), (1,)],
    }


def test_several_paths_are_joined_by_leaf(scene: Scene) -> None:
    both = chosen(scene, ["Material[0].shininess", "Material[1].shininess", "Fog.color.r"])
    assert both == {"Material.shininess": [(0,), (1,)], "Fog.color": [(0,)]}


WRONG = {
    "Material[bdoy].diffuse_color": r"closest: Material\[body\].diffuse_color",
    "Materail[body].shininess": r"closest: Material\[body\].shininess",
    "PointLight[fill].intensity": r"2 nodes have this name; write the row number: PointLight\[2\], PointLight\[3\]",
    "Material.shininess": r"the scene has 2 Material nodes; write Material\[\*\]",
    "Material[9].shininess": r"no field 'Material\[9\].shininess'",
    "Material[body].diffuse_color.x": r"no component 'x'; components: r, g, b",
    "Material[body].shininess.r": r"none: it is one number",
    "PointLight[0].attenuation[3]": r"the field has shape \[3\]",
    "PointLight[0].attenuation.x": "no component 'x'; components: a number in brackets",
    "Material[body].diffuse": r"closest: Material\[body\].diffuse_color",
    "Fog[1].color": r"no field 'Fog\[1\].color'; the closest: Fog.color",
    "Fog[fog*].color": r"no field 'Fog\[fog\*\].color'; the closest: Fog.color",
    "shininess": r"expected the form 'Material\[name or row\].diffuse_color'",
    "PointLight[0].on": r"no field 'PointLight\[0\].on'",
}


@pytest.mark.parametrize("path", WRONG)
def test_a_path_that_means_nothing_is_refused_with_what_there_is(scene: Scene, path: str) -> None:
    with pytest.raises(ValueError, match=WRONG[path]):
        paths.select(scene, path)


def test_a_function_that_returns_no_leaf_is_refused(scene: Scene) -> None:
    with pytest.raises(ValueError, match="must return leaves of the scene"):
        paths.select(scene, lambda s: 3.0)


def test_ranges_are_the_specifications(scene: Scene) -> None:
    ranges = {(field.leaf.kind, field.leaf.field): field.leaf.range for field in paths.fields(scene)}
    assert ranges["Material", "shininess"] == (0, 1, False)
    assert ranges["PointLight", "intensity"] == (0, math.inf, False)
    assert ranges["PointLight", "attenuation"] == (0, math.inf, False)
    assert ranges["SpotLight", "cut_off_angle"] == (0, math.pi / 2, True)
    assert ranges["DirectionalLight", "direction"] == (-math.inf, math.inf, False)
    assert ranges["Fog", "visibility_range"] == (0, math.inf, True)
    assert str(ranges["SpotLight", "beam_width"]) == "(0, pi/2]"
    assert str(ranges["PointLight", "radius"]) == "[0, inf)"


def test_light_rows(scene: Scene) -> None:
    one, several = (paths.light_rows(scene, lights) for lights in ("PointLight[key*]", ["PointLight[key*]"]))
    assert all(one[kind].tolist() == several[kind].tolist() for kind in paths.LIGHT_KINDS)
    rows = paths.light_rows(scene, ["PointLight[key*]", "SpotLight[0]"])
    assert {kind: found.tolist() for kind, found in rows.items()} == {
        "DirectionalLight": [],
        "PointLight": [0, 1],
        "SpotLight": [0],
    }
    with pytest.raises(ValueError, match=r"no 'PointLight.sun.'; it has DirectionalLight"):
        paths.light_rows(scene, ["PointLight[sun]"])
    with pytest.raises(ValueError, match="expected a light such as"):
        paths.light_rows(scene, ["Material[body]"])


@pytest.mark.parametrize(
    ("path", "rows"),
    [
        ("PointLight[Lamp.001]", [1]),
        ("PointLight[Lamp.*]", [1, 2]),
        ("PointLight[Lamp.001].*", [1]),
        ("PointLight[*]", [0, 1, 2]),
        ("SpotLight", []),
    ],
)
def test_light_names_may_have_dots(path: str, rows: list[int]) -> None:
    """Blender calls the second light of a name Lamp.001."""
    points = [nodes.PointLight(name=name) for name in ("Lamp", "Lamp.001", "Lamp.002")]
    scene = Scene.from_nodes([*points, nodes.SpotLight(name="spot.001")])
    assert paths.light_rows(scene, [path])["PointLight"].tolist() == rows
    for wrong in ("PointLight[Lamp.001].intensity", "PointLight.color"):
        with pytest.raises(ValueError, match="expected a light such as"):
            paths.light_rows(scene, [wrong])


def test_digits_are_a_row_even_where_a_node_is_called_so() -> None:
    """Lists and labels tell such nodes by their rows, and mean the same by them as a path does."""
    named = [nodes.Material(name=name, shininess=0.1 * row) for row, name in enumerate(("1", "0", "", "7"), 1)]
    scene = Scene.from_nodes([nodes.Shape(appearance=nodes.Appearance(material=material)) for material in named])
    listed = [field.path for field in paths.fields(scene) if field.path.endswith("shininess")]
    assert listed == [f"Material[{row}].shininess" for row in range(4)]
    assert [chosen(scene, path) for path in listed] == [{"Material.shininess": [(row,)]} for row in range(4)]
    with pytest.raises(ValueError, match=r"no field 'Material\[7\].shininess'; the closest: Material\[3\]"):
        paths.select(scene, "Material[7].shininess")


def test_hundreds_of_paths_are_free_at_the_cost_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A list of all fields of all lights means what the wildcard means, and the scene is gone through no more often."""
    lights = [nodes.PointLight(location=(i, 0, 1), intensity=0.5) for i in range(40)]
    world = World(Scene.from_nodes([nodes.Shape(), *lights]), jnp.ones(1))
    every = [field.path for field in paths.fields(world.scene) if field.path.startswith("PointLight")]
    looked_up, fields = [], paths.fields

    def counted(scene: Scene) -> list[paths.Field]:
        looked_up.append(scene)
        return fields(scene)

    monkeypatch.setattr(paths, "fields", counted)
    one, of_one = free_parameters(world, "PointLight[*].*", ["view"], np.float32)
    once = len(looked_up)
    many, of_many = free_parameters(world, every, ["view"], np.float32)
    assert once >= 1 and len(looked_up) == 2 * once
    assert [field.path for field in of_many] == [field.path for field in of_one] == every
    np.testing.assert_array_equal(many.start, one.start)
