"""Attributes of X3D files that jaxlight does not read: those that X3D has pass, all others are named."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import pytest

from jaxlight import SceneFileWarning
from jaxlight.formats import read_nodes
from jaxlight.formats.x3d_fields import fields_of
from jaxlight.formats.x3d_groups import SIMPLIFIED
from jaxlight.formats.x3d_unread import is_unread_field
from jaxlight.scene import nodes as n
from x3d_text import read_text, x3d


def said_of(folder: Path, scene: str, version: str = "3.3") -> str:
    """The one warning about a scene, without its file."""
    path = folder / "scene.x3d"
    path.write_text(x3d(scene, version))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_nodes(path)
    (warning,) = caught
    return str(warning.message).removeprefix(f"{path}: ")


MISSPELT = [
    ("<Shape><Appearance><Material DEF='m' difuseColor='1 0 0'/></Appearance></Shape>",
     r"Material\[m\].difuseColor \(line 3; diffuseColor is meant\?\)"),
    ("<Shape><Sphere Solid='false'/></Shape>", r"Sphere.Solid \(line 3; solid is meant\?\)"),
    ("<PointLight locaton='0 0 9' colour='1 0 0'/>", r"locaton .*, PointLight.colour \(line 3; color is meant\?\)"),
    ("<Group def='g'/>", r"Group.def \(line 3; DEF is meant\?\)"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "said"), MISSPELT)
def test_misspelt_attributes_are_named_with_the_field_that_is_meant(tmp_path: Path, text: str, said: str) -> None:
    assert re.search(f"skipped [12] attributes? that jaxlight does not know: .*{said}", said_of(tmp_path, text))


UNKNOWN = [
    ("<PointLight position='0 0 5'/>", "PointLight.position (line 3)"),
    ("<Viewpoint DEF='v' location='0 0 5' fov='1'/>", "Viewpoint[v].location (line 3), Viewpoint[v].fov (line 3)"),
    (
        "<Shape><Appearance><Material color='1 0 0' opacity='1' diffuse='1 0 0'/></Appearance></Shape>",
        "Material.color (line 3), Material.opacity (line 3), Material.diffuse (line 3)",
    ),
    ("<Shape><Appearance texture='wood.png'/></Shape>", "Appearance.texture (line 3)"),
    ("<Transform rotate='0 1 0 1'/>", "Transform.rotate (line 3)"),
    ("<Shape><IndexedTriangleSet coordIndex='0 1 2'/></Shape>", "IndexedTriangleSet.coordIndex (line 3)"),
    ("<Shape><IndexedFaceSet index='0 1 2'/></Shape>", "IndexedFaceSet.index (line 3)"),
    ("<Fog visibilityLimit='9'/>", "Fog.visibilityLimit (line 3)"),
    ("<Group axisOfRotation='0 1 0'/>", "Group.axisOfRotation (line 3)"),
]


@pytest.mark.parametrize(("text", "said"), UNKNOWN)
def test_attributes_that_are_no_fields_are_named(tmp_path: Path, text: str, said: str) -> None:
    count = said.count("line")
    noun = "attribute" if count == 1 else "attributes"
    assert said_of(tmp_path, text) == f"skipped {count} {noun} that jaxlight does not know: {said}"


def test_a_group_that_is_simplified_is_called_by_its_own_name(tmp_path: Path) -> None:
    said = said_of(tmp_path, "<Billboard DEF='b' axis='0 1 0' axisOfRotation='0 1 0'/>")
    assert said.endswith("; skipped 1 attribute that jaxlight does not know: Billboard[b].axis (line 3)")


def test_an_attribute_that_many_nodes_have_is_named_once(tmp_path: Path) -> None:
    many = "\n".join(f"<PointLight DEF='p{i}' position='0 0 {i}'/>" for i in range(50))
    assert said_of(tmp_path, f"{many}<Fog range='1'/>") == (
        "skipped 51 attributes that jaxlight does not know: PointLight[p0].position (line 3) and 49 alike, "
        "Fog.range (line 52)"
    )


NOT_READ = [
    "<Group id='a' class='b' style='c' bboxCenter='0 0 0' bboxSize='1 1 1' bboxDisplay='true' visible='true'/>",
    "<Transform bboxCenter='0 0 0' bboxSize='1 1 1' onclick='f()' data-part='7'/>",
    "<Shape castShadow='false' bboxSize='1 1 1'><Box class='a' id='b'/></Shape>",
    "<Shape><Appearance><Material normalScale='1' occlusionStrength='1' diffuseTextureMapping='a'"
    " emissiveTextureMapping='b' shininessTextureMapping='c' specularTextureMapping='d'/></Appearance></Shape>",
    "<DirectionalLight shadows='true' shadowIntensity='1'/>",
    "<PointLight shadows='true' shadowIntensity='1'/><SpotLight shadows='true' shadowIntensity='1'/>",
    "<Viewpoint centerOfRotation='0 0 0' jump='true' retainUserOffsets='true' viewAll='true' nearDistance='1'"
    " farDistance='9' set_bind='true'/>",
    "<NavigationInfo type='ANY' speed='1' avatarSize='1 1 1' transitionTime='1' transitionType='TELEPORT'"
    " visibilityLimit='0'/>",
    "<Fog f:depth='1' xmlns:f='urn:f' xmlns='urn:x3d'/>",
]


@pytest.mark.parametrize("text", NOT_READ)
def test_attributes_that_x3d_has_and_jaxlight_does_not_read_pass(tmp_path: Path, text: str) -> None:
    read_text(tmp_path, text)  # raises the warning if there is one


def test_fields_of_groups_that_are_simplified_pass(tmp_path: Path) -> None:
    said = said_of(
        tmp_path,
        "<Anchor url='a.x3d' description='a' parameter='target=b'/><Billboard axisOfRotation='0 1 0'/>"
        "<LOD center='0 0 0' range='5' forceTransitions='true'><Group/></LOD><Collision enabled='false'/>"
        "<LayerSet activeLayer='1' order='0 1'><Layer isPickable='true' pickable='true' objectType='ALL'/></LayerSet>",
    )
    assert said.startswith("simplified: ") and ";" not in said


def test_no_field_is_listed_both_as_read_and_as_not_read() -> None:
    assert all(
        is_unread_field(tag, "DEF") and not is_unread_field(tag, "size2") for tag in (*n.NODE_TYPES, *SIMPLIFIED)
    )
    read = {(tag, name) for tag, kind in n.NODE_TYPES.items() for name in fields_of(kind)}
    assert [pair for pair in sorted(read) if is_unread_field(*pair)] == [("Viewpoint", "description")]


BOX = "<Shape DEF='s'><Appearance/><Box DEF='b'/></Shape>"
BESIDE = [
    ("<Transform DEF='a'/><Transform USE='a' translation='1 0 0' visible='false'/>",
     "Transform.translation (USE='a', line 3), Transform.visible (USE='a', line 3)"),
    ("<Group DEF='a'/><Group USE='a'>\n<Shape/><Fog/></Group>", "what is in Group (USE='a', line 3)"),
    (f"{BOX}<Shape><Sphere USE='b'/></Shape>", "the name Sphere (USE='b' is a Box, line 3)"),
    (f"{BOX}<Group USE='s'/>", "the name Group (USE='s' is a Shape, line 3)"),
    (f"{BOX}<Shape><Sphere USE='b' radius='2'/></Shape>",
     "the name Sphere (USE='b' is a Box, line 3), Sphere.radius (USE='b', line 3)"),
    ("<Group DEF='a'/>" + "<Group USE='a' x='1'/>\n" * 40, "Group.x (USE='a', line 3) and 39 alike"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "said"), BESIDE)
def test_what_stands_beside_a_use_is_named(tmp_path: Path, text: str, said: str) -> None:
    assert said_of(tmp_path, text) == f"ignored beside a USE: {said}"


def test_a_node_that_is_used_under_another_name_stays_what_it_is(tmp_path: Path) -> None:
    with pytest.warns(SceneFileWarning, match="the name Sphere"):
        path = tmp_path / "scene.x3d"
        path.write_text(x3d(f"{BOX}<Shape><Sphere USE='b'/></Shape>"))
        defined, used = read_nodes(path).children
    assert isinstance(defined, n.Shape) and isinstance(used, n.Shape) and used.geometry is defined.geometry


def test_a_use_may_say_where_it_belongs(tmp_path: Path) -> None:
    again = "<Shape USE='s' containerField='children' class='a' id='b' style='c' onclick='f()'/>"
    hidden = "<Anchor><Shape DEF='h' visible='false'/></Anchor><Shape USE='h'/>"
    assert said_of(tmp_path, f"{BOX}{again}{hidden}", "4.0").startswith("simplified: Anchor")
    assert "USE" not in said_of(tmp_path, f"{BOX}{again}{hidden}<LOD DEF='l'/><LOD USE='l'/>", "4.0")


def test_a_use_of_a_use_inside_a_skipped_node_is_read(tmp_path: Path) -> None:
    said = said_of(tmp_path, "<Group DEF='a'/><Text><Group DEF='b' USE='a'/></Text><Group USE='b'/>")
    assert said == "skipped 1 node that jaxlight does not know: Text x1"


def test_a_skipped_node_that_is_used_is_named_once(tmp_path: Path) -> None:
    said = said_of(tmp_path, "<Text DEF='t'/><Group USE='t' translation='0 0 0'/>")
    assert said == "skipped 2 nodes that jaxlight does not know: Group USE='t' x1, Text x1"
