"""X3D files that are refused: what each error says, and the limits on size and nesting."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from jaxlight import SceneFileError, SceneFileWarning, load
from jaxlight.formats import read_nodes
from jaxlight.formats import x3d_values as values
from jaxlight.formats.folder import ResourceFolder
from jaxlight.formats.xml_elements import parse_xml
from x3d_text import x3d

POINTS = "<Coordinate point='0 0 0, 1 0 0, 0 1 0'/>"

ERRORS = [
    ("<Material", "malformed XML"),
    ("<Group>\n</Transform>", "malformed XML"),
    ("<Transform translation='1 2'/>", "Transform.translation: expected 3 numbers, got 2"),
    ("<Transform DEF='a' translation='1 2 x'/>", r"Transform\[a\].translation: 'x' is not a number"),
    ("<PointLight intensity='nan'/>", "'nan' is not a number"),
    ("<PointLight location='0 0 1e999'/>", "PointLight.location: expected 3 finite numbers"),
    ("<Shape><Sphere radius='-1'/></Shape>", "Sphere.radius: expected a finite number > 0"),
    ("<Fog fogType='CUBIC'/>", "Fog.fog_type: expected 'LINEAR' or 'EXPONENTIAL'"),
    ("<Shape><Appearance><Box/></Appearance></Shape>", "a Box cannot stand in <Appearance>"),
    ("<Group><Material/></Group>", "a Material cannot stand in <Group>"),
    ("<Group><Appearance/></Group>", "an Appearance cannot stand in <Group>"),
    ("<Box/>", "a Box cannot stand in <Scene>"),
    ("<Shape><Box/><Sphere/></Shape>", "takes one node as geometry, this is the second"),
    ("<Shape><Box containerField='appearance'/></Shape>", "a Box cannot stand in <Shape>"),
    ("<Group USE='nobody'/>", "no node before this one has DEF='nobody'"),
    ("<Group USE='later'/><Group DEF='later'/>", "no node before this one has DEF='later'"),
    ("<Group DEF='a'><Group USE='a'/></Group>", "no node before this one has DEF='a'"),
    (f"<Shape><IndexedFaceSet coordIndex='0 1 3 -1'>{POINTS}</IndexedFaceSet></Shape>", "index 3, but coord has 3"),
    (f"<Shape><IndexedFaceSet coordIndex='0 1 -2'>{POINTS}</IndexedFaceSet></Shape>", "integers >= -1"),
    (
        f"<Shape><IndexedFaceSet coordIndex='0 1 2 -1' normalIndex='0 1'>{POINTS}<Normal vector='0 0 1 0 0 1'/>"
        "</IndexedFaceSet></Shape>",
        "normal_index: expected -1 in the same places",
    ),
    (
        f"<Shape><IndexedFaceSet coordIndex='0 1 2 -1 2 1 0' colorPerVertex='false'>{POINTS}<Color color='1 0 0'/>"
        "</IndexedFaceSet></Shape>",
        "color: 1 entries for 2 faces",
    ),
    (f"<Shape><IndexedTriangleSet index='0 -1 1'>{POINTS}</IndexedTriangleSet></Shape>", "indices >= 0, got -1"),
    (f"<Shape><IndexedTriangleSet index='0 1 5'>{POINTS}</IndexedTriangleSet></Shape>", "index 5, but coord has 3"),
    (f"<Shape><TriangleSet>{POINTS}<Color color='1 0 0'/></TriangleSet></Shape>", "but color has 1 entries"),
    (
        f"<Shape><IndexedTriangleSet index='0 1 2 2 1 0' colorPerVertex='false'>{POINTS}<Color color='1 0 0 0 1 0'/>"
        "</IndexedTriangleSet></Shape>",
        "index 2, but color has 2 entries",
    ),
    (
        "<Shape><IndexedFaceSet coordIndex='0 1 2 -1'><Coordinate/></IndexedFaceSet></Shape>",
        "index 2, but coord has 0 entries",
    ),
    ("<Shape><Appearance><PixelTexture image='1 1 3'/></Appearance></Shape>", "1 x 1 pixels announced, 0 given"),
    ("<Group visible='maybe'/>", "Group.visible: expected true or false"),
]


@pytest.mark.parametrize(("text", "message"), ERRORS)
def test_errors_name_file_line_and_cause(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(x3d("\n\n" + text))
    with pytest.raises(SceneFileError, match=message) as caught:
        load(path)
    assert caught.value.line is not None and caught.value.line >= 5
    assert str(caught.value).startswith(f"{path}:{caught.value.line}: ")
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize("factor", ["", "conversionFactor='0'", "conversionFactor='x'", "conversionFactor='1e999'"])
def test_a_unit_without_its_factor_is_an_error(tmp_path: Path, factor: str) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(x3d("", head=f"<head>\n<unit category='angle' name='deg' {factor}/></head>"))
    with pytest.raises(SceneFileError, match=r":3: unit\.conversionFactor: expected a number > 0, got '"):
        load(path)


def test_a_singular_transform_is_an_error_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(x3d("<Transform DEF='flat' scale='1 1e-40 1'/>"))
    with pytest.raises(SceneFileError, match=r"Transform\[flat\]: its matrix cannot be inverted"):
        load(path)


def test_transforms_that_overflow_together_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    inner = "<Transform DEF='b' scale='1e99 1e99 1e99'><Shape/></Transform>"
    path.write_text(x3d("<Transform scale='1e99 1e99 1e99'>" * 3 + inner + "</Transform>" * 3))
    with pytest.raises(SceneFileError, match=r"Transform\[b\]: with the transforms above it"):
        load(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<PointLight DEF='a' intensity='1e39'/>", r"PointLight\[a\].intensity: 1e\+39 is larger than 3.4e\+38"),
        ("<PointLight DEF='a' location='0 -1e39 0'/>", r"PointLight\[a\].location: -1e\+39 is larger than 3.4e\+38"),
        ("<PointLight/><SpotLight DEF='b' location='0 -1e39 0'/>", r"SpotLight\[b\].location: -1e\+39 is larger"),
        ("<Transform translation='1e39 0 0'><PointLight DEF='c'/></Transform>", r"PointLight\[c\]: its frame: 1e\+39"),
    ],
)
def test_numbers_that_are_too_large_for_the_type_are_errors(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(x3d(text))
    with pytest.raises(SceneFileError, match=message):
        load(path)


def test_more_scopes_than_are_kept_are_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(x3d("<Group><PointLight global='false'/><Shape><Sphere/></Shape></Group>" * 3))
    monkeypatch.setattr("jaxlight.scene.flatten.MAX_SCOPED", 9)
    assert load(path).point is not None
    monkeypatch.setattr("jaxlight.scene.flatten.MAX_SCOPED", 8)
    with pytest.raises(SceneFileError, match="3 lights over 3 surfaces; their product may be at most 8"):
        load(path)


def test_attributes_of_other_namespaces_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    own = "<Material DEF='m' f:diffuseColor='hello' diffuseColor='0 1 0' f:shininess='1' xmlns:f='urn:f'/>"
    path.write_text(x3d(f"<Shape><Appearance>{own}</Appearance><Sphere/></Shape>"))
    scene = load(path)
    assert scene.materials is not None
    assert scene.materials.diffuse_color.tolist() == [[0, 1, 0]] and scene.materials.shininess[0] < 0.5


@pytest.mark.parametrize("codec", ["utf-16-le", "utf-16-be"])
def test_utf_16_without_a_mark_is_refused(tmp_path: Path, codec: str) -> None:
    path = tmp_path / "scene.x3d"
    path.write_bytes(f"<?xml version='1.0' encoding='{codec}'?><X3D><Scene/></X3D>".encode(codec))
    with pytest.raises(SceneFileError, match=":1: UTF-16 without a byte order mark"):
        load(path)


ENTITY_BOMB = "<!DOCTYPE X3D [<!ENTITY a 'aaaaaaaaaa'><!ENTITY b '&a;&a;&a;&a;&a;&a;'>]>\n<X3D><Scene DEF='&b;'/></X3D>"
EXTERNAL_ENTITY = "<!DOCTYPE X3D [<!ENTITY a SYSTEM 'file:///etc/passwd'>]>\n<X3D><Scene DEF='&a;'/></X3D>"


@pytest.mark.parametrize("text", [ENTITY_BOMB, EXTERNAL_ENTITY])
def test_entities_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(text)
    with pytest.raises(SceneFileError, match=":1: entities are not read"):
        load(path)


def test_a_document_type_is_not_fetched(tmp_path: Path) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(
        '<!DOCTYPE X3D PUBLIC "ISO//Web3D//DTD X3D 3.3//EN" "http://127.0.0.1:9/x.dtd">\n<X3D><Scene/></X3D>'
    )
    assert load(path).document.shapes == ()


@pytest.mark.parametrize(
    ("declared", "element"),
    [
        ("<!ATTLIST Group description CDATA '{}'>", "<Group/>"),
        ("<!ATTLIST Group " + " ".join(f"a{i} CDATA '0'" for i in range(1000)) + ">", "<Group/>"),
    ],
)
def test_attributes_of_a_document_type_are_limited(tmp_path: Path, declared: str, element: str) -> None:
    """A few kilobytes would hold hundreds of megabytes."""
    path = tmp_path / "scene.x3d"
    head = f"<!DOCTYPE X3D [{declared.format('x' * 20_000)}]>"
    path.write_text(head + "<X3D><Scene>" + element * 10_000 + "</Scene></X3D>")
    with pytest.raises(SceneFileError, match=":1: DOCTYPE declares attributes that are longer than the file"):
        load(path)
    path.write_text("<!DOCTYPE X3D [<!ATTLIST Group DEF CDATA 'g'>]><X3D><Scene><Group/></Scene></X3D>")
    assert load(path).document.children[0].name == "g"


def test_prefixes_are_dropped_whatever_they_stand_for(tmp_path: Path) -> None:
    prefixed = x3d("<x3d:Shape x3d:DEF='other' DEF='own'/>").replace("<X3D ", f"<X3D xmlns:x3d='{'u' * 50_000}' ", 1)
    path = tmp_path / "scene.x3d"
    path.write_text(prefixed)
    assert load(path).document.children[0].name == "own"
    names = [element.tag for element in parse_xml(path, b"<a:X3D xmlns:a='u'><a:b/></a:X3D>").children]
    assert names == ["b"]


@pytest.mark.parametrize("word", ["1" * 400_000 + "x", "." + "1" * 400_000 + "x", "1e" + "1" * 400_000 + "x"])
def test_a_long_word_is_looked_at_once(word: str) -> None:
    """A pattern that tries every way to divide its digits would take an hour, and CI would not end."""
    with pytest.raises(ValueError, match="is not a number"):
        values.parse_floats(word)


def test_a_url_that_no_file_can_have_is_not_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "resolve", lambda self: self)
    folder = ResourceFolder(tmp_path / "scene.x3d")
    assert folder.place("a/../" * 100_000 + "x.png") is None and folder.place("x.png") == tmp_path / "x.png"


@pytest.mark.parametrize("text", ["<html/>", "<X3D/>", "<X3D><Group/></X3D>", "<X3D><Scene/>\n<Scene/></X3D>"])
def test_other_documents_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(text)
    with pytest.raises(SceneFileError, match=r"root element|no <Scene>|HTML page|:2: a second <Scene>, expected one"):
        load(path)


def test_what_stands_beside_the_scene_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.x3d").write_text("<X3D><head/><Scene><Group/></Scene><Shape/></X3D>")
    with pytest.warns(SceneFileWarning, match=r"skipped 1 .*: Shape"):
        load(tmp_path / "a.x3d")


def nested(depth: int) -> str:
    """A document whose elements are nested `depth` deep."""
    groups = depth - 3
    return x3d("<Group>" * groups + "<Shape/>" + "</Group>" * groups)


def test_nesting_up_to_400_is_read_and_deeper_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "deep.x3d"
    path.write_text(nested(400))
    assert len(load(path).document.shapes) == 1
    path.write_text(nested(401))
    with pytest.raises(SceneFileError, match="nested deeper than 400"):
        load(path)
    path.write_text(x3d("<Group>" * 100_000 + "</Group>" * 100_000))
    with pytest.raises(SceneFileError, match="nested deeper than 400"):
        load(path)


def test_nesting_through_use_is_limited(tmp_path: Path) -> None:
    path = tmp_path / "chain.x3d"
    chain = "".join(f"<Switch DEF='g{i}'><Group USE='g{i - 1}'/></Switch>" for i in range(1, 1000))
    path.write_text(x3d("<Switch DEF='g0'/>" + chain))
    with pytest.raises(SceneFileError, match="nested deeper than 400 through USE"):
        load(path)
    skipped = "".join(f"<Text><Group DEF='g{i}'><Group USE='g{i + 1}'/></Group></Text>" for i in range(1000))
    path.write_text(x3d(skipped + "<Group USE='g0'/>"))
    with pytest.raises(SceneFileError, match="too many skipped nodes use one another"):
        load(path)


def test_doubling_through_use_is_limited(tmp_path: Path) -> None:
    path = tmp_path / "bomb.x3d"
    doubling = "".join(
        f"<Group DEF='g{i}'><Group USE='g{i - 1}'/><Group USE='g{i - 1}'/></Group>" for i in range(1, 60)
    )
    path.write_text(x3d("<Group DEF='g0'><Shape/></Group>" + doubling))
    with pytest.raises(SceneFileError, match="more than 1000000 placed nodes"):
        load(path)


def test_a_file_beyond_the_size_limit_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scene.x3d"
    path.write_text(x3d("<Group/>" * 1000))
    monkeypatch.setattr("jaxlight.formats.limits.MAX_FILE_BYTES", 1000)
    with pytest.raises(SceneFileError, match="larger than"):
        load(path)
    monkeypatch.undo()
    monkeypatch.setattr("jaxlight.formats.xml_elements.MAX_ELEMENTS", 500)
    with pytest.raises(SceneFileError, match="more than 500 elements"):
        load(path)


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(SceneFileError, match="no such file"):
        load(tmp_path / "none.x3d")
    with pytest.raises(SceneFileError, match="is a folder"):
        load(tmp_path)


def test_a_pipe_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.x3d")
    with pytest.raises(SceneFileError, match=r"pipe\.x3d: is a pipe or a device; only files are read"):
        read_nodes(tmp_path / "pipe.x3d")


def test_placed_nodes_are_counted_before_they_are_placed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each group uses the one before twice: 2^300 spheres."""
    groups = ["<Group DEF='g0'><Shape><Sphere/></Shape></Group>"]
    groups += [f"<Group DEF='g{i}'><Group USE='g{i - 1}'/><Group USE='g{i - 1}'/></Group>" for i in range(1, 301)]
    path = tmp_path / "many.x3d"
    path.write_text(x3d("".join(groups)))
    with monkeypatch.context() as patch:
        patch.setattr("jaxlight.Scene.from_nodes", None)
        with pytest.raises(SceneFileError, match=r"many\.x3d: scene: more than 1000000 placed nodes"):
            load(path)
    path.write_text(x3d(f"<Switch whichChoice='4'>{''.join(groups)}</Switch>"))
    assert len(load(path).document.shapes) == 16
