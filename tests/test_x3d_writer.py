"""Scenes -> X3D files: only what changed changes, every number comes back, and nothing is ever half written."""

from __future__ import annotations

import codecs
import dataclasses
import os
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from jaxlight import Scene, SceneFileError, load, save
from jaxlight.scene import nodes as n
from jaxlight.scene.nodes import nodes_equal
from x3d_text import x3d

SCENE = """<!-- a "comment" with <Material diffuseColor='9 9 9'/> -->
<Transform translation='0 1 0'>
  <Shape DEF='ball'>
    <Appearance>
      <Material   DEF='body'
          diffuseColor="0.1 0.2 0.3"	shininess = '0.5' transparency='0.25'/>
    </Appearance>
    <Sphere/>
  </Shape>
</Transform>
<![CDATA[ <Material/> ]]>
<PointLight DEF='key' location='1 2 3'/><SpotLight DEF='lamp' beamWidth='0.3' cutOffAngle='0.6'></SpotLight>
<Fog color='0.5 0.5 0.5' visibilityRange='10'/>
<Script><![CDATA[ if (a < b && c > "d") return '<PointLight/>'; ]]></Script>
"""


def quietly(path: Path) -> Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load(path)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "source.x3d"
    path.write_text(x3d(SCENE))
    return path


def with_values(scene: Scene, **changes: object) -> Scene:
    """The scene with leaves replaced: `materials__diffuse_color=...`."""
    for name, value in changes.items():
        group, field = name.split("__")

        def leaf(s: Scene, group: str = group, field: str = field) -> object:
            return getattr(getattr(s, group), field)

        old = leaf(scene)
        scene = eqx.tree_at(leaf, scene, jnp.asarray(value, dtype=old.dtype))
    return scene


def test_only_the_changed_attributes_change(source: Path, tmp_path: Path) -> None:
    scene = with_values(
        quietly(source),
        materials__diffuse_color=[[0.1, 0.7, 0.3]],
        materials__specular_color=[[0.25, 0.5, 1]],
        point__intensity=[0.125],
        spot__cut_off_angle=[0.75],
        fog__visibility_range=20.0,
    )
    save(scene, tmp_path / "out.x3d")
    expected = (
        x3d(SCENE)
        .replace('"0.1 0.2 0.3"', '"0.1 0.7 0.3"')
        .replace("transparency='0.25'/>", "transparency='0.25' specularColor='0.25 0.5 1'/>")
        .replace("location='1 2 3'/>", "location='1 2 3' intensity='0.125'/>")
        .replace("cutOffAngle='0.6'", "cutOffAngle='0.75'")
        .replace("visibilityRange='10'", "visibilityRange='20'")
    )
    assert (tmp_path / "out.x3d").read_text() == expected


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "iso-8859-1", "cp1252"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_encoding_and_line_ends_stay(tmp_path: Path, encoding: str, newline: str) -> None:
    declared = encoding.removesuffix("-sig")
    text = x3d("<!-- ä ö ü -->" + SCENE).replace("UTF-8", declared).replace("\n", newline)
    path = tmp_path / "source.x3d"
    path.write_bytes(text.encode(encoding))
    save(with_values(quietly(path), materials__shininess=[0.75]), path)
    assert path.read_bytes() == text.replace("shininess = '0.5'", "shininess = '0.75'").encode(encoding)


@pytest.mark.parametrize(("encoding", "name"), [("iso-8859-1", "ä"), ("us-ascii", "a"), ("cp1252", "ä")])
def test_what_a_file_declares_goes_before_a_mark_of_utf8(tmp_path: Path, encoding: str, name: str) -> None:
    text = x3d(SCENE.replace("DEF='key'", f"DEF='{name}'")).replace("UTF-8", encoding)
    path = tmp_path / "source.x3d"
    path.write_bytes(codecs.BOM_UTF8 + text.encode(encoding))
    scene = quietly(path)
    assert scene.point.names == (name,)
    save(with_values(scene, materials__shininess=[0.75]), path)
    changed = text.replace("shininess = '0.5'", "shininess = '0.75'")
    assert path.read_bytes() == codecs.BOM_UTF8 + changed.encode(encoding)


def test_what_the_encoding_of_a_file_lacks_is_written_as_a_reference(tmp_path: Path) -> None:
    """A url that its file writes so is shortened: in the new folder there is a strange picture of its first name."""
    source, out = tmp_path / "source", tmp_path / "out"
    source.mkdir()
    out.mkdir()
    Image.new("RGB", (1, 1)).save(out / "a.png")
    url = "url='&quot;a.png&quot; &quot;&#x4E2D;.png&quot;'"
    text = x3d(f"<Shape><Appearance><ImageTexture {url}/></Appearance><Box/></Shape>").replace("UTF-8", "iso-8859-1")
    (source / "a.x3d").write_text(text)
    save(quietly(source / "a.x3d"), out / "a.x3d")
    assert "a.png" not in (out / "a.x3d").read_text()
    assert quietly(out / "a.x3d").document.shapes[0].node.appearance.texture.url == ("\u4e2d.png",)


def test_a_document_type_with_an_internal_subset_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "source.x3d"
    head = """<!DOCTYPE X3D PUBLIC "a-b" 'c>d' [ <!-- ' ]> <Material> --> <!ATTLIST Shape x CDATA "]> Sphere>"> ]>"""
    path.write_text(f"{head}\n<X3D><Scene><Fog visibilityRange='1'/></Scene></X3D>")
    save(with_values(load(path), fog__visibility_range=2.0), path)
    assert path.read_text() == f"{head}\n<X3D><Scene><Fog visibilityRange='2'/></Scene></X3D>"


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_every_number_comes_back_to_the_last_bit(source: Path, dtype: type) -> None:
    rng = np.random.default_rng(3)
    with jax.enable_x64(True):
        scene = load_as(source, dtype)
        colors = rng.random((1, 3)).astype(dtype)
        changed = with_values(scene, materials__diffuse_color=colors, point__location=rng.normal(size=(1, 3)) * 1e-5)
        save(changed, source)
        again = load_as(source, dtype)
        for a, b in zip(jax.tree.leaves(changed), jax.tree.leaves(again), strict=True):
            assert a.dtype == dtype
            assert np.array_equal(a, b)


def load_as(path: Path, dtype: type) -> Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load(path, dtype=dtype)


def test_numbers_that_a_leaf_only_rounds_keep_their_digits(tmp_path: Path) -> None:
    text = x3d("<PointLight location='0.123456789012 1 2' color='0.3333333333333333 0 0'/>")
    path = tmp_path / "source.x3d"
    path.write_text(text)
    scene = load_as(path, np.float32)
    save(with_values(scene, point__location=[[0.123456789012, 1, 3]]), path)
    assert path.read_text() == text.replace("0.123456789012 1 2", "0.123456789012 1 3")


def test_angles_are_written_in_the_files_unit(tmp_path: Path) -> None:
    path = tmp_path / "source.x3d"
    head = f"<head><unit category='angle' name='degree' conversionFactor='{np.pi / 180!r}'/></head>".replace(
        "np.float64", ""
    )
    path.write_text(x3d("<SpotLight beamWidth='30' cutOffAngle='60'/>", head=head))
    save(with_values(load(path), spot__cut_off_angle=[np.pi / 4]), path)
    (written,) = re.findall("cutOffAngle='(.*?)'", path.read_text())
    assert float(written) == pytest.approx(45, rel=1e-6)
    assert "beamWidth='30'" in path.read_text()


def test_clamped_values_are_not_written_back(tmp_path: Path) -> None:
    path = tmp_path / "source.x3d"
    path.write_text(x3d("<PointLight color='1.5 0 0' intensity='1'/>"))
    save(with_values(quietly(path), point__intensity=[2.0]), path)
    assert path.read_text() == x3d("<PointLight color='1.5 0 0' intensity='2'/>")


SHARED = """<Group><PointLight DEF='lamp' intensity='0.5'/></Group>
<Transform translation='5 0 0'><PointLight USE='lamp'/></Transform>
"""


def test_rows_of_one_node_must_agree(tmp_path: Path) -> None:
    path = tmp_path / "source.x3d"
    path.write_text(x3d(SHARED))
    scene = load(path)
    with pytest.raises(ValueError, match=r"PointLight\[lamp\].intensity: the node is used 2 times \(USE\)"):
        save(with_values(scene, point__intensity=[0.5, 0.75]), tmp_path / "out.x3d")
    save(with_values(scene, point__intensity=[0.75, 0.75]), tmp_path / "out.x3d")
    assert (tmp_path / "out.x3d").read_text() == x3d(SHARED).replace("0.5", "0.75")


REFUSED = [
    ({"materials__diffuse_color": [[1.5, 0, 0]]}, r"Material\[body\].diffuse_color: expected 3 numbers in \[0, 1\]"),
    ({"materials__shininess": [np.nan]}, r"Material\[body\].shininess: expected a finite number"),
    ({"spot__cut_off_angle": [2.0]}, r"SpotLight\[lamp\].cut_off_angle: expected"),
    ({"point__to_world": np.ones((1, 3, 4))}, r"point.to_world changed"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_what_no_field_can_hold_is_refused_and_the_file_stays(source: Path, changes: dict, message: str) -> None:
    before = source.read_bytes()
    with pytest.raises(ValueError, match=message):
        save(with_values(quietly(source), **changes), source)
    assert source.read_bytes() == before
    assert os.listdir(source.parent) == ["source.x3d"]


def with_surface(scene: Scene, **changes: object) -> Scene:
    return dataclasses.replace(scene, surfaces=(scene.surfaces[0]._replace(**changes), *scene.surfaces[1:]))


def with_part(scene: Scene, kind: str, **changes: object) -> Scene:
    return dataclasses.replace(scene, **{kind: dataclasses.replace(getattr(scene, kind), **changes)})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: with_surface(s, texture=0), r"surfaces\[0\].texture changed from -1 to 0, "),
        (lambda s: with_surface(s, lighting="unlit"), r"surfaces\[0\].lighting changed from 'lit' to 'unlit', "),
        (lambda s: dataclasses.replace(s, surfaces=s.surfaces * 2), "surfaces were added to or removed from the scene"),
        (
            lambda s: with_part(s, "materials", names=("soul",)),
            r"materials.names changed from \('body',\) to \('soul',\)",
        ),
        (lambda s: with_part(s, "fog", name="mist"), "fog.name changed from '' to 'mist', "),
    ],
)
def test_what_only_nodes_can_say_is_refused(source: Path, change: Callable[[Scene], Scene], message: str) -> None:
    before = source.read_bytes()
    with pytest.raises(ValueError, match=f"^save: {message}"):
        save(change(quietly(source)), source)
    assert source.read_bytes() == before


def test_names_of_textures_and_the_headlight_are_the_nodes(tmp_path: Path) -> None:
    picture = n.PixelTexture(name="wall", image=np.ones((1, 1, 3)))
    scene = Scene.from_nodes(n.Shape(appearance=n.Appearance(texture=picture), geometry=n.Box()))
    renamed = dataclasses.replace(scene, textures=(dataclasses.replace(scene.textures[0], name="floor"),))
    with pytest.raises(ValueError, match=r"^save: textures\[0\].name changed from 'wall' to 'floor', "):
        save(renamed, tmp_path / "out.x3d")
    with pytest.raises(ValueError, match=r"^save: directional\.headlight changed from True to False, "):
        save(with_part(scene, "directional", headlight=False), tmp_path / "out.x3d")
    assert os.listdir(tmp_path) == []


def test_the_headlight_is_not_the_files(tmp_path: Path) -> None:
    path = tmp_path / "source.x3d"
    path.write_text(x3d("<Shape><Sphere/></Shape>"))
    scene = load(path)
    save(scene, tmp_path / "same.x3d")
    with pytest.raises(ValueError, match="headlight is the browser's"):
        save(with_values(scene, directional__intensity=[0.5]), tmp_path / "out.x3d")


@pytest.mark.parametrize("name", ["out.glb", "out.wrl", "out", "out.x3dv"])
def test_other_formats_are_refused(source: Path, name: str) -> None:
    with pytest.raises(ValueError, match=r"expected a name that ends in \.x3d"):
        save(quietly(source), source.parent / name)


@pytest.mark.parametrize("texture", [None, n.ImageTexture(image=np.ones((1, 1, 3)))])
def test_a_folder_that_is_not_there_is_named_and_not_made(tmp_path: Path, texture: n.Node | None) -> None:
    scene = Scene.from_nodes([n.Shape(appearance=n.Appearance(texture=texture))])
    with pytest.raises(FileNotFoundError, match=rf"scene\.x3d: there is no folder {re.escape(str(tmp_path))}/none$"):
        save(scene, tmp_path / "none" / "scene.x3d")
    assert os.listdir(tmp_path) == []


def test_something_else_than_a_scene_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"save: scene: expected a Scene, got .*Path"):
        save(tmp_path / "scene.x3d", Scene.from_nodes([n.Group()]))


def test_an_interrupted_write_leaves_the_old_file(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = source.read_bytes()

    def fails(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_bytes", fails)
    with pytest.raises(OSError, match="disk full"):
        save(with_values(quietly(source), materials__shininess=[0.75]), source)
    assert source.read_bytes() == before
    assert os.listdir(source.parent) == ["source.x3d"]


def test_permissions_stay(source: Path) -> None:
    source.chmod(0o640)
    save(quietly(source), source)
    assert source.stat().st_mode & 0o777 == 0o640


# --- scenes without a file ------------------------------------------------------------------------------------------


def a_scene_of_everything() -> list[n.Node]:
    rng = np.random.default_rng(5)
    body = n.Material(name="body", diffuse_color=(0.1, 1 / 3, 0.7), shininess=0.123456789)
    shared = n.Coordinate(name="points", point=rng.normal(size=(4, 3)))
    pixels = rng.integers(0, 256, (2, 3, 4)) / 255
    lamp = n.SpotLight(name='a "quoted" & <odd> name', radius=np.inf, attenuation=(0.1, 0.2, 1e-30))
    return [
        n.Transform(
            translation=(1e-7, 2e20, -0.1),
            rotation=(0.6, 0.8, 0, 1.1),
            children=(
                n.Shape(
                    appearance=n.Appearance(
                        material=body,
                        texture=n.PixelTexture(image=pixels),
                        texture_transform=n.TextureTransform(rotation=1),
                    ),
                    geometry=n.IndexedFaceSet(
                        coord=shared,
                        coord_index=[0, 1, 2, -1, 0, 2, 3, -1],
                        color=n.ColorRGBA(color=rng.random((2, 4))),
                        color_per_vertex=False,
                        tex_coord=n.TextureCoordinate(point=rng.random((4, 2))),
                    ),
                ),
                n.Shape(
                    appearance=n.Appearance(material=body),
                    geometry=n.IndexedTriangleSet(
                        coord=shared, index=[0, 1, 2], normal=n.Normal(vector=rng.normal(size=(4, 3)))
                    ),
                ),
                n.Group(children=(lamp, lamp)),
            ),
        ),
        n.Switch(which_choice=1, children=(n.Shape(geometry=n.Cone()), n.Shape(geometry=n.Cylinder(top=False)))),
        n.Shape(
            geometry=n.TriangleSet(coord=n.Coordinate(point=rng.normal(size=(3, 3))), color=n.Color(color=np.eye(3)))
        ),
        n.Shape(geometry=n.Box(size=(1, 2, 3))),
        n.DirectionalLight(on=False, global_=True),
        n.PointLight(name="key", intensity=2.5),
        n.Fog(fog_type="EXPONENTIAL", visibility_range=12.5),
        n.Background(sky_angle=(1.0,), sky_color=[[0, 0, 1], [1, 1, 1]]),
        n.Viewpoint(description='it\'s "here"\nor there', position=(1, 2, 3)),
        n.NavigationInfo(headlight=False),
    ]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_scene_built_in_python_comes_back(tmp_path: Path, dtype: type) -> None:
    with jax.enable_x64(True):
        scene = Scene.from_nodes(a_scene_of_everything(), dtype=dtype)
        save(scene, tmp_path / "scene.x3d")
        again = load(tmp_path / "scene.x3d", dtype=dtype)
        assert nodes_equal(again.document.children, scene.document.children)
        for a, b in zip(jax.tree.leaves(scene), jax.tree.leaves(again), strict=True):
            assert np.array_equal(a, b)
    shapes = again.document.shapes
    assert shapes[0].node.appearance.material is shapes[1].node.appearance.material


def test_changed_numbers_of_a_scene_built_in_python_are_written(tmp_path: Path) -> None:
    scene = with_values(Scene.from_nodes(a_scene_of_everything()), materials__diffuse_color=[[0.5, 0.25, 0.125]])
    save(scene, tmp_path / "scene.x3d")
    assert load(tmp_path / "scene.x3d").document.materials[0].diffuse_color == (0.5, 0.25, 0.125)


def test_nodes_without_a_name_that_are_used_twice_get_one(tmp_path: Path) -> None:
    ball = n.Shape(geometry=n.Sphere())
    save(Scene.from_nodes([ball, n.Group(children=(ball,)), n.Group(name="Shape_1")]), tmp_path / "scene.x3d")
    first, group, _ = load(tmp_path / "scene.x3d").document.children
    assert first.name == "Shape_2"
    assert group.children[0] is first


def test_two_nodes_of_one_name_stay_two(tmp_path: Path) -> None:
    a, b = n.Shape(name="s", geometry=n.Box()), n.Shape(name="s", geometry=n.Sphere())
    save(Scene.from_nodes([a, b, a, b]), tmp_path / "scene.x3d")
    kinds = [type(shape.geometry).__name__ for shape in load(tmp_path / "scene.x3d").document.children]
    assert kinds == ["Box", "Sphere", "Box", "Sphere"]


def test_characters_of_names_that_xml_cannot_hold_are_replaced(tmp_path: Path) -> None:
    groups = [n.Group(name=name) for name in ("a\033x", "a_x", "\0", "\ud800", "\ufffe\U0001f600")]
    save(Scene.from_nodes(groups), tmp_path / "scene.x3d")
    names = [group.name for group in load(tmp_path / "scene.x3d").document.children]
    assert names == ["a_x", "a_x_2", "_", "__2", "_\U0001f600"]


def test_characters_that_xml_cannot_hold_are_refused_in_other_fields(tmp_path: Path) -> None:
    view = n.Viewpoint(name="front\033", description="seen from\0the front")
    with pytest.raises(
        ValueError, match=r"^save: Viewpoint\[front_\]\.description: XML cannot hold .*'seen from.x00the"
    ):
        save(Scene.from_nodes([view]), tmp_path / "scene.x3d")
    assert os.listdir(tmp_path) == []


def test_a_file_that_somebody_changed_meanwhile_is_not_replaced(source: Path, tmp_path: Path) -> None:
    scene = with_values(quietly(source), point__intensity=[0.25])
    edited = source.read_text() + "<!-- mine -->"
    source.write_text(edited)
    linked = tmp_path / "linked"
    linked.symlink_to(tmp_path)
    before = sorted(tmp_path.iterdir())
    for path in (source, linked / source.name):
        with pytest.raises(SceneFileError, match=r"source\.x3d: was changed since it was read.* save under another"):
            save(scene, path)
    assert source.read_text() == edited and sorted(tmp_path.iterdir()) == before
    save(scene, tmp_path / "other.x3d")
    assert quietly(tmp_path / "other.x3d").point.intensity == 0.25


def test_a_file_is_replaced_again_where_only_save_changed_it_or_it_is_gone(source: Path) -> None:
    scene = quietly(source)
    for intensity in (0.25, 0.5):
        save(with_values(scene, point__intensity=[intensity]), source)
        assert quietly(source).point.intensity == intensity
    source.unlink()
    save(scene, source)
    assert source.read_text() == x3d(SCENE)
