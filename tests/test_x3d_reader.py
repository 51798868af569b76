"""X3D files -> nodes: every node and field, DEF and USE, defaults of versions, what is skipped and how that is said."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import pytest

from jaxlight import Scene, SceneFileWarning, load
from jaxlight.formats import read_nodes
from jaxlight.scene import nodes as n
from jaxlight.scene.nodes import nodes_equal
from x3d_text import only_node, read_text, x3d

TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
POINTS = "<Coordinate point='0 0 0, 1 0 0, 0 1 0'/>"

NODES = [
    ("<Group/>", n.Group()),
    (
        "<Transform DEF='t' translation='1 2 3' rotation='0 1 0 0.5' scale='1 2 -1' center='1 0 0'"
        " scaleOrientation='1 0 0 0.25'><Group/></Transform>",
        n.Transform(
            name="t",
            translation=(1, 2, 3),
            rotation=(0, 1, 0, 0.5),
            scale=(1, 2, -1),
            center=(1, 0, 0),
            scale_orientation=(1, 0, 0, 0.25),
            children=(n.Group(),),
        ),
    ),
    ("<Switch whichChoice='1'><Group/><Group/></Switch>", n.Switch(which_choice=1, children=(n.Group(), n.Group()))),
    ("<Shape><Box size='1 2 3' solid='false'/></Shape>", n.Shape(geometry=n.Box(size=(1, 2, 3), solid=False))),
    (
        "<Shape><Cone bottomRadius='2' height='3' side='false' bottom='false'/></Shape>",
        n.Shape(geometry=n.Cone(bottom_radius=2, height=3, side=False, bottom=False)),
    ),
    (
        "<Shape><Cylinder radius='2' height='3' side='false' bottom='false' top='false'/></Shape>",
        n.Shape(geometry=n.Cylinder(radius=2, height=3, side=False, bottom=False, top=False)),
    ),
    ("<Shape><Sphere radius='.5'/></Shape>", n.Shape(geometry=n.Sphere(radius=0.5))),
    (
        "<Shape><Appearance><Material ambientIntensity='.1' diffuseColor='.1 .2 .3' emissiveColor='.4 .5 .6'"
        " shininess='.7' specularColor='.8 .9 1' transparency='.25'/></Appearance></Shape>",
        n.Shape(
            appearance=n.Appearance(
                material=n.Material(
                    ambient_intensity=0.1,
                    diffuse_color=(0.1, 0.2, 0.3),
                    emissive_color=(0.4, 0.5, 0.6),
                    shininess=0.7,
                    specular_color=(0.8, 0.9, 1),
                    transparency=0.25,
                )
            )
        ),
    ),
    (
        "<Shape><Appearance><PixelTexture image='1 2 1 0 255' repeatS='false' repeatT='FALSE'/>"
        "<TextureTransform center='1 2' rotation='3' scale='4 5' translation='6 7'/></Appearance></Shape>",
        n.Shape(
            appearance=n.Appearance(
                texture=n.PixelTexture(image=np.array([[[0.0]], [[1.0]]]), repeat_s=False, repeat_t=False),
                texture_transform=n.TextureTransform(center=(1, 2), rotation=3, scale=(4, 5), translation=(6, 7)),
            )
        ),
    ),
    (
        "<Shape><IndexedFaceSet ccw='false' solid='false' convex='false' creaseAngle='0.5' coordIndex='0 1 2 -1'"
        " colorPerVertex='false' colorIndex='1' normalPerVertex='true' normalIndex='0 0 0 -1' texCoordIndex='2 1 0'>"
        f"{POINTS}<Color color='1 0 0, 0 1 0'/><Normal vector='0 0 1'/><TextureCoordinate point='0 0 1 0 0 1'/>"
        "</IndexedFaceSet></Shape>",
        n.Shape(
            geometry=n.IndexedFaceSet(
                ccw=False,
                solid=False,
                convex=False,
                crease_angle=0.5,
                coord_index=[0, 1, 2, -1],
                color_per_vertex=False,
                color_index=[1],
                normal_index=[0, 0, 0, -1],
                tex_coord_index=[2, 1, 0],
                coord=n.Coordinate(point=TRIANGLE),
                color=n.Color(color=[[1, 0, 0], [0, 1, 0]]),
                normal=n.Normal(vector=[[0, 0, 1]]),
                tex_coord=n.TextureCoordinate(point=[[0, 0], [1, 0], [0, 1]]),
            )
        ),
    ),
    (
        f"<Shape><IndexedTriangleSet index='2 1 0' solid='false' ccw='false' normalPerVertex='false'>{POINTS}"
        "<ColorRGBA color='1 0 0 1, 0 1 0 .5, 0 0 1 0'/><Normal vector='0 0 1'/></IndexedTriangleSet></Shape>",
        n.Shape(
            geometry=n.IndexedTriangleSet(
                index=[2, 1, 0],
                solid=False,
                ccw=False,
                normal_per_vertex=False,
                coord=n.Coordinate(point=TRIANGLE),
                color=n.ColorRGBA(color=[[1, 0, 0, 1], [0, 1, 0, 0.5], [0, 0, 1, 0]]),
                normal=n.Normal(vector=[[0, 0, 1]]),
            )
        ),
    ),
    (
        f"<Shape><TriangleSet colorPerVertex='false'>{POINTS}<Color color='1 1 0 1 1 0 0 0 1'/></TriangleSet></Shape>",
        n.Shape(
            geometry=n.TriangleSet(
                color_per_vertex=False,
                coord=n.Coordinate(point=TRIANGLE),
                color=n.Color(color=[[1, 1, 0], [1, 1, 0], [0, 0, 1]]),
            )
        ),
    ),
    (
        "<DirectionalLight ambientIntensity='.1' color='1 .5 0' direction='1 2 3' global='true' intensity='2'"
        " on='false'/>",
        n.DirectionalLight(
            ambient_intensity=0.1, color=(1, 0.5, 0), direction=(1, 2, 3), global_=True, intensity=2, on=False
        ),
    ),
    (
        "<PointLight DEF='key' attenuation='1 2 3' global='false' location='1 2 3' radius='7'/>",
        n.PointLight(name="key", attenuation=(1, 2, 3), global_=False, location=(1, 2, 3), radius=7),
    ),
    (
        "<SpotLight attenuation='0 0 1' beamWidth='.3' cutOffAngle='.6' direction='0 1 0'"
        " location='1 2 3' radius='9'/>",
        n.SpotLight(
            attenuation=(0, 0, 1), beam_width=0.3, cut_off_angle=0.6, direction=(0, 1, 0), location=(1, 2, 3), radius=9
        ),
    ),
    (
        "<Fog color='.5 .6 .7' fogType='EXPONENTIAL' visibilityRange='12'/>",
        n.Fog(color=(0.5, 0.6, 0.7), fog_type="EXPONENTIAL", visibility_range=12),
    ),
    (
        "<Background skyAngle='0.5 1' skyColor='0 0 0, 1 1 1, .5 .5 .5'/>",
        n.Background(sky_angle=(0.5, 1), sky_color=[[0, 0, 0], [1, 1, 1], [0.5, 0.5, 0.5]]),
    ),
    (
        "<Viewpoint description='front' fieldOfView='1' orientation='0 1 0 2' position='1 2 3'/>",
        n.Viewpoint(description="front", field_of_view=1, orientation=(0, 1, 0, 2), position=(1, 2, 3)),
    ),
    ("<NavigationInfo headlight='false' type='\"EXAMINE\"'/>", n.NavigationInfo(headlight=False)),
]


@pytest.mark.parametrize(("text", "expected"), NODES, ids=[type(node).__name__ for _, node in NODES])
def test_a_file_written_by_hand_gives_the_nodes_built_in_python(tmp_path: Path, text: str, expected: n.Node) -> None:
    assert nodes_equal(only_node(tmp_path, text), expected)


def test_every_node_class_stands_in_a_file_above() -> None:
    text = " ".join(text for text, _ in NODES)
    assert {kind for kind in n.NODE_TYPES if f"<{kind}" not in text} == {"ImageTexture"}  # it has tests of its own


def test_use_is_the_same_object(tmp_path: Path) -> None:
    a, b = read_text(
        tmp_path,
        "<Shape DEF='s'><Appearance DEF='a'><Material DEF='m'/></Appearance></Shape>"
        "<Group><Shape USE='s'/><Shape><Appearance USE='a'/></Shape><Shape><Appearance><Material USE='m'/></Appearance>"
        "</Shape></Group>",
    ).children
    assert isinstance(a, n.Shape) and isinstance(b, n.Group)
    again, same_appearance, same_material = b.children
    assert again is a
    assert same_appearance.appearance is a.appearance
    assert same_material.appearance.material is a.appearance.material


def test_the_latest_def_of_a_name_counts(tmp_path: Path) -> None:
    *_, last = read_text(tmp_path, "<Fog DEF='f'/><Group DEF='f'/><Group USE='f'/>").children
    assert isinstance(last, n.Group)


SPOT_ANGLES = [
    (None, math.pi / 2, math.pi / 4),
    ("3.0", math.pi / 2, math.pi / 4),
    ("3.2", math.pi / 2, math.pi / 4),
    ("3.3", math.pi / 4, math.pi / 2),
    ("4.0", 3 * math.pi / 16, math.pi / 2),
    ("4.1", 3 * math.pi / 16, math.pi / 2),
]


@pytest.mark.parametrize(("version", "beam_width", "cut_off_angle"), SPOT_ANGLES)
def test_spot_light_defaults_follow_the_version(
    tmp_path: Path, version: str | None, beam_width: float, cut_off_angle: float
) -> None:
    light = only_node(tmp_path, "<SpotLight/>", version)
    assert isinstance(light, n.SpotLight)
    assert (light.beam_width, light.cut_off_angle) == (beam_width, cut_off_angle)
    written = only_node(tmp_path, "<SpotLight beamWidth='0.25' cutOffAngle='0.5'/>", version)
    assert (written.beam_width, written.cut_off_angle) == (0.25, 0.5)


def test_angles_are_read_in_the_files_unit(tmp_path: Path) -> None:
    head = f"<head><unit category='angle' name='degree' conversionFactor='{math.pi / 180!r}'/></head>"
    light = only_node(tmp_path, "<SpotLight beamWidth='30' cutOffAngle='60'/>", head=head)
    assert (light.beam_width, light.cut_off_angle) == pytest.approx((math.pi / 6, math.pi / 3))
    turned = only_node(tmp_path, "<Transform rotation='0 0 1 90' scaleOrientation='1 0 0 180'/>", head=head)
    assert turned.rotation == pytest.approx((0, 0, 1, math.pi / 2))
    assert turned.scale_orientation == pytest.approx((1, 0, 0, math.pi))
    sky = only_node(tmp_path, "<Background skyAngle='45 90' skyColor='0 0 0 0 0 0 0 0 0'/>", head=head)
    assert sky.sky_angle == pytest.approx((math.pi / 4, math.pi / 2))
    moved = only_node(tmp_path, "<Transform translation='1 2 3' scale='4 5 6'/>", head=head)
    assert (moved.translation, moved.scale) == ((1, 2, 3), (4, 5, 6))


SKIES = [
    ("skyColor='1 0 0 0 1 0'", [[1, 0, 0]], (), "skyAngle is not one for each further skyColor"),
    ("skyColor='1 0 0 0 1 0' skyAngle='1 2'", [[1, 0, 0], [0, 1, 0]], (1,), "skyAngle is not one for each"),
    ("skyAngle='1 2 3'", [[0, 0, 0]], (), "skyAngle is not one for each further"),
    ("skyColor='' skyAngle='1'", [], (), "skyAngle is not one for each further"),
    ("skyColor='1 0 0 0 1 0 0 0 1' skyAngle='2 1'", [[1, 0, 0], [0, 1, 0], [0, 0, 1]], (2, 2), "skyAngle decreases"),
]


@pytest.mark.parametrize(("sky", "colors", "angles", "noted"), SKIES)
def test_a_sky_is_read_as_far_as_its_colours_and_angles_go(
    tmp_path: Path, sky: str, colors: list, angles: tuple[float, ...], noted: str
) -> None:
    (tmp_path / "a.x3d").write_text(x3d(f"<Background {sky}/>"))
    with pytest.warns(SceneFileWarning, match=rf"simplified: Background whose {noted} .*\) x1$"):
        (node,) = read_nodes(tmp_path / "a.x3d").children
    assert (node.sky_color.tolist(), node.sky_angle) == (colors, angles)


def test_container_fields_say_where_a_child_belongs(tmp_path: Path) -> None:
    appearance = "<Appearance containerField='appearance'><Material containerField='material'/></Appearance>"
    node = only_node(tmp_path, f"<Shape containerField='children'>{appearance}</Shape>")
    assert nodes_equal(node, n.Shape(appearance=n.Appearance(material=n.Material())))


def test_namespaces_do_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text("<x:X3D xmlns:x='http://x'><x:Scene><x:Fog visibilityRange='5'/></x:Scene></x:X3D>")
    assert nodes_equal(read_nodes(path).children, (n.Fog(visibility_range=5),))


def one_warning(path: Path) -> str:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load(path)
    assert [warning.category for warning in caught] == [SceneFileWarning]
    assert caught[0].filename == __file__
    return str(caught[0].message)


def test_one_warning_counts_and_names_what_is_skipped(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(
        x3d(
            "<ProtoDeclare name='P'><ProtoBody><Group><TimeSensor/></Group></ProtoBody></ProtoDeclare>"
            "<TimeSensor/><TimeSensor/><Script><field name='x'/></Script><Inline url='x.x3d'/>"
            "<Shape><Text/><MetadataString/></Shape><ROUTE fromNode='a'/>"
            "<Shape><Appearance><Material><ImageTexture containerField='diffuseTexture'/></Material></Appearance>"
            "</Shape>"
        )
    )
    text = one_warning(path)
    assert "skipped 9 nodes that jaxlight does not know: TimeSensor x2," in text
    for name in ("ProtoDeclare", "Script", "Inline", "Text", "MetadataString", "ROUTE"):
        assert f"{name} x1" in text
    assert "ImageTexture as Material.diffuseTexture x1" in text
    assert str(path) in text


NO_MATERIAL = [
    ("<PhysicalMaterial/>", 1),
    ("<ProtoInstance name='P' containerField='material'/>", 1),
    ("<UnlitMaterial containerField='backMaterial'/><Material/>", 0),
    ("<FillProperties/><Material/>", 0),
]


@pytest.mark.parametrize(("inside", "count"), NO_MATERIAL)
def test_what_becomes_of_a_shape_whose_material_is_skipped_is_said(tmp_path: Path, inside: str, count: int) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(x3d(f"<Shape><Appearance>{inside}</Appearance><Box/></Shape>"))
    text = one_warning(path)
    assert f"{inside[1:].split()[0].split('/')[0]} x1" in text
    assert ("Appearance without its material (unlit: white, or its own colours) x1" in text) == bool(count)


def test_groups_that_are_simplified_are_named(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(
        x3d(
            "<Anchor><Fog visibilityRange='1'/></Anchor><Billboard/>"
            "<Collision><Shape containerField='proxy'/><Group/></Collision>"
            "<LOD><MetadataSet/><Group DEF='near'/><Group DEF='far'/></LOD><Group USE='far'/><StaticGroup/>"
            "<LayerSet activeLayer='2'><Layer><Fog/></Layer><Layer><Viewpoint/></Layer></LayerSet>"
        )
    )
    text = one_warning(path)
    for words in ("Anchor (as Group) x1", "LOD (its first level) x1", "LayerSet (its active layer) x1"):
        assert words in text
    assert "Shape as Collision.proxy x1" in text
    near, far, fog = n.Group(name="near"), n.Group(name="far"), n.Fog(visibility_range=1)
    layers = n.Group(children=(n.Group(children=(n.Viewpoint(),)),))
    expected = (
        *(n.Group(children=(fog,)), n.Group(), n.Group(children=(n.Group(),)), n.Group(children=(near,))),
        *(far, n.Group(), layers),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert nodes_equal(read_nodes(path).children, expected)


def test_a_switch_keeps_its_count_over_children_that_are_skipped(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(x3d("<Switch whichChoice='1'><MetadataSet/><Text/><Shape DEF='right'/><Shape/></Switch>"))
    with pytest.warns(SceneFileWarning):
        scene = load(path)
    assert [placed.node.name for placed in scene.document.shapes] == ["right"]


def test_invisible_nodes_are_not_placed_but_can_be_used(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(
        x3d(
            "<Shape DEF='a' visible='false'/><Group visible='FALSE'><Shape/><PointLight/></Group>"
            "<Transform visible='true'><Shape DEF='b'><Appearance DEF='look'/></Shape></Transform>",
            "4.0",
        )
    )
    with pytest.warns(SceneFileWarning, match="visible='false'.* x2"):
        scene = load(path)
    assert [placed.node.name for placed in scene.document.shapes] == ["b"]
    assert scene.point is None


def test_use_of_a_node_inside_a_skipped_one(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(
        x3d(
            "<Shape><IndexedLineSet DEF='lines'><Coordinate DEF='points' point='0 0 0 1 0 0 0 1 0'/>"
            "</IndexedLineSet></Shape><Shape><IndexedLineSet USE='lines'/></Shape><Group USE='lines'/>"
            "<Shape><TriangleSet><Coordinate USE='points'/></TriangleSet></Shape>"
        )
    )
    with pytest.warns(SceneFileWarning, match="Group USE='lines' x1"):
        *_, last = read_nodes(path).children
    assert nodes_equal(last, n.Shape(geometry=n.TriangleSet(coord=n.Coordinate(point=TRIANGLE, name="points"))))


CLAMPED = [
    ("<Fog color='1.0000001 -0.5 0.5'/>", n.Fog(color=(1, 0, 0.5)), r"Fog.color \(line 3\)"),
    ("<PointLight DEF='p' ambientIntensity='2'/>", n.PointLight(name="p", ambient_intensity=1), r"PointLight\[p\]"),
    ("<Fog visibilityRange='-5'/>", n.Fog(), r"Fog.visibilityRange \(line 3\)"),
    ("<PointLight intensity='-1' radius='-1'/>", n.PointLight(intensity=0, radius=0), "2 values"),
    (
        "<SpotLight beamWidth='0' cutOffAngle='3'/>",
        n.SpotLight(beam_width=1e-6, cut_off_angle=math.pi / 2),
        "SpotLight.beamWidth",
    ),
    ("<Transform rotation='0 0 0 1'/>", n.Transform(), "Transform.rotation"),
    (
        f"<Shape><TriangleSet>{POINTS}<Color color='2 0 0 0 1 0 0 0 1'/></TriangleSet></Shape>",
        n.Shape(
            geometry=n.TriangleSet(
                coord=n.Coordinate(point=TRIANGLE), color=n.Color(color=[[1, 0, 0], [0, 1, 0], [0, 0, 1]])
            )
        ),
        "Color.color",
    ),
]


@pytest.mark.parametrize(("text", "expected", "said"), CLAMPED)
def test_values_out_of_range_are_clamped_and_said(tmp_path: Path, text: str, expected: n.Node, said: str) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(x3d(text))
    with pytest.warns(SceneFileWarning, match=f"clamped .*{said}"):
        assert nodes_equal(read_nodes(path).children, (expected,))


def test_a_rounded_right_angle_and_an_intensity_above_one_are_in_range(tmp_path: Path) -> None:
    light = only_node(tmp_path, "<SpotLight intensity='3' cutOffAngle='1.5708' beamWidth='1.570796'/>")
    assert nodes_equal(light, n.SpotLight(intensity=3, cut_off_angle=math.pi / 2, beam_width=1.570796))


def test_a_sky_ends_at_half_a_turn(tmp_path: Path) -> None:
    (tmp_path / "a.x3d").write_text(x3d("<Background skyAngle='-1 4' skyColor='0 0 0 1 1 1 0 0 0'/>"))
    with pytest.warns(SceneFileWarning, match=r"clamped 1 value to the allowed range: Background.skyAngle \(line 3\)$"):
        (clamped,) = read_nodes(tmp_path / "a.x3d").children
    assert isinstance(clamped, n.Background) and clamped.sky_angle == pytest.approx((0, math.pi), abs=2e-4)
    sky = only_node(tmp_path, "<Background skyAngle='1.57 3.1416' skyColor='0 0 0 1 1 1 0 0 0'/>")
    assert isinstance(sky, n.Background) and sky.sky_angle == (1.57, 3.1416)


def test_loading_a_file_equals_building_the_scene_in_python(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(x3d("\n".join(text for text, _ in NODES)))
    built = Scene.from_nodes([node for _, node in NODES])
    loaded = load(path)
    assert nodes_equal(loaded.document.children, built.document.children)
    for name in ("materials", "directional", "point", "spot", "fog"):
        a, b = getattr(loaded, name), getattr(built, name)
        for field in vars(a):
            x, y = getattr(a, field), getattr(b, field)
            assert x == y if not hasattr(x, "shape") else np.array_equal(x, y), f"{name}.{field}"
    assert loaded.surfaces == built.surfaces
    assert loaded.document.source is not None and built.document.source is None


def test_what_was_read_is_described_in_few_words(tmp_path: Path) -> None:
    """Not by the bytes of the file, nor by where each of its nodes stands."""
    path = tmp_path / "scene.x3d"
    path.write_text(x3d("".join(f"<Transform translation='{i} 0 0'><Group/></Transform>" for i in range(2000))))
    scene = load(path)
    assert len(repr(scene)) < 2000
    assert len(repr(scene.document.source)) < 500
