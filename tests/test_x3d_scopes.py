"""What of an X3D file is read, and what is not, where nodes are skipped, hidden, or used before they are read."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from jaxlight import Scene, SceneFileWarning, load, nodes, rasterize, render, save
from jaxlight.formats.images import write_image

RED = "<Appearance><Material DEF='M' diffuseColor='1 0 0'/></Appearance>"
GREEN = "<Appearance><Material DEF='M' diffuseColor='0 1 0'/></Appearance>"
USED = "<Appearance><Material USE='M'/></Appearance>"


def scene_of(tmp_path: Path, body: str, *, head: str = "", version: str = "3.3", warns: str | None = None) -> Scene:
    file = tmp_path / "scene.x3d"
    file.write_text(f'<X3D version="{version}"><head>{head}</head><Scene>{body}</Scene></X3D>')
    if warns is None:
        return load(file)
    with pytest.warns(SceneFileWarning, match=warns):
        return load(file)


def test_names_in_a_prototype_are_its_own(tmp_path: Path) -> None:
    prototype = f"<ProtoDeclare name='P'><ProtoBody><Shape DEF='Q'>{GREEN}<Box/></Shape></ProtoBody></ProtoDeclare>"
    body = f"<Shape>{RED}</Shape>{prototype}<Shape>{USED}<Box/></Shape>"
    scene = scene_of(tmp_path, body, warns="skipped 1 node .*ProtoDeclare x1")
    np.testing.assert_array_equal(scene.materials.diffuse_color, [[1, 0, 0]])
    with pytest.raises(ValueError, match="no node before this one has DEF='Q'"):
        scene_of(tmp_path, f"{prototype}<Shape USE='Q'/>")


@pytest.mark.parametrize(
    ("geometry", "warns"),
    [
        ("<IndexedFaceSet coordIndex='0 1 2 -1'/>", None),
        ("<IndexedFaceSet coordIndex='0 1 2 -1'><Color color='1 0 0'/></IndexedFaceSet>", None),
        ("<IndexedTriangleSet index='0 1 2'><CoordinateDouble point='0 0 0 1 0 0 0 1 0'/></IndexedTriangleSet>",
         "CoordinateDouble x1"),
        ("<TriangleSet><Normal vector='0 0 1'/></TriangleSet>", None),
    ],
)  # fmt: skip
def test_a_geometry_without_coordinates_draws_nothing(tmp_path: Path, geometry: str, warns: str | None) -> None:
    others = "<Viewpoint/><Shape><Appearance><Material/></Appearance><Box/></Shape>"
    alone, beside = (scene_of(tmp_path, body, warns=said) for body, said in
                     ((others, None), (f"{others}<Shape>{geometry}</Shape>", warns)))  # fmt: skip
    wanted, found = (rasterize(scene, width=8, height=8) for scene in (alone, beside))
    np.testing.assert_array_equal(found.position, wanted.position)


@pytest.mark.parametrize("scale", ["0 0 0", "1 0 1"])
def test_a_scale_of_0_shows_nothing(tmp_path: Path, scale: str) -> None:
    hidden = f"<Transform scale='{scale}'><Shape><Box size='9 9 9'/></Shape><PointLight/></Transform>"
    said = "simplified: Transform with a scale of 0 .shows nothing. x1"
    scene = scene_of(tmp_path, f"<Viewpoint/>{hidden}<Shape>{RED}<Sphere/></Shape>", warns=said)
    assert len(scene.document.shapes) == 1 and scene.point is None
    assert rasterize(scene, width=16, height=16).count > 10


def test_the_sky_turns_with_the_transforms_above_it(tmp_path: Path) -> None:
    def picture(rotation: str) -> np.ndarray:
        sky = "<Background skyColor='1 0 0 0 1 0 0 0 1' skyAngle='0.8 2'/>"
        scene = scene_of(
            tmp_path,
            f"<Viewpoint/><Transform translation='3 4 5' scale='2 2 2' rotation='{rotation}'>{sky}</Transform>",
        )
        with pytest.warns(UserWarning, match="no shape of the scene has geometry"):
            return np.asarray(render(scene, rasterize(scene, width=6, height=6)))

    plain = picture("0 0 1 0")
    assert np.ptp(plain[:, 0, 1]) > 0.1
    np.testing.assert_allclose(picture("0 0 1 3.141592653589793"), plain[::-1, ::-1], atol=1e-6)
    np.testing.assert_allclose(picture("0 0 1 1.5707963267948966"), np.rot90(plain), atol=1e-6)


def test_what_is_used_before_the_group_that_holds_it_is_one_node(tmp_path: Path) -> None:
    level = f"<Group DEF='A'><Shape>{RED}<Box/></Shape></Group>"
    apart = f"<Transform translation='3 0 0'><Shape>{USED}<Sphere/></Shape></Transform>"
    scene = scene_of(tmp_path, f"<LOD><Group/>{level}</LOD>{apart}<Group USE='A'/>", warns="LOD")
    assert scene.materials is not None and scene.materials.names == ("M",)
    green = np.array([[0, 1, 0]], np.float32)
    changed = dataclasses.replace(scene, materials=dataclasses.replace(scene.materials, diffuse_color=green))
    save(changed, tmp_path / "saved.x3d")
    with pytest.warns(SceneFileWarning, match="LOD"):
        np.testing.assert_array_equal(load(tmp_path / "saved.x3d").materials.diffuse_color, green)


def test_textures_outside_the_range_are_clamped_and_others_left_for_the_next_url(tmp_path: Path) -> None:
    pytest.importorskip("OpenImageIO", reason="needs the extra exr")
    write_image(tmp_path / "bright.exr", np.full((2, 2, 3), 2.5))
    write_image(tmp_path / "endless.exr", np.full((2, 2, 3), np.inf))
    write_image(tmp_path / "grey.png", np.full((1, 1, 3), 0.2))
    shape = '<Shape><Appearance><ImageTexture url=\'"{}" "grey.png"\'/></Appearance><Box/></Shape>'
    bright = scene_of(tmp_path, shape.format("bright.exr"), warns="clamped 1 value .*ImageTexture.image .line 1.")
    np.testing.assert_array_equal(bright.textures[0].image, 1.0)
    np.testing.assert_allclose(scene_of(tmp_path, shape.format("endless.exr")).textures[0].image, 0.2, atol=1e-6)


def test_so_many_urls_are_looked_for_and_no_more(tmp_path: Path) -> None:
    write_image(tmp_path / "grey.png", np.full((1, 1, 3), 0.2))
    urls = " ".join(f'"{number}.png"' for number in range(101))
    said = "only the first 100 of 102 urls are looked for"
    scene_of(tmp_path, f"<Shape><Appearance><ImageTexture url='{urls} \"grey.png\"'/></Appearance></Shape>", warns=said)
    again = " ".join(['"no.png"'] * 1000)
    scene = scene_of(tmp_path, f"<Shape><Appearance><ImageTexture url='{again} \"grey.png\"'/></Appearance></Shape>")
    np.testing.assert_allclose(scene.textures[0].image, 0.2, atol=1e-6)


def test_a_unit_of_length_is_named(tmp_path: Path) -> None:
    unit = "<unit category='length' name='cm' conversionFactor='0.01'/>"
    scene_of(tmp_path, "<Shape><Box/></Shape>", head=unit, warns="fields not used: unit of length")
    scene_of(tmp_path, "<Shape><Box/></Shape>", head=unit.replace("0.01", "1"))


def test_a_layer_of_parts_may_say_which_are_seen(tmp_path: Path) -> None:
    body = "<CADLayer visible='true false'><Group/><Group/></CADLayer>"
    scene_of(tmp_path, body, version="3.2", warns=r"CADLayer.visible \(of its children one by one\)")


def test_deep_scenes_are_read_from_deep_programs(tmp_path: Path) -> None:
    body = "<Group>" * 390 + "<Shape><Box/></Shape>" + "</Group>" * 390

    def below(depth: int) -> Scene:
        return below(depth - 1) if depth else scene_of(tmp_path, body)

    assert len(below(sys.getrecursionlimit() - 600).document.shapes) == 1


def corner_normals(order: str) -> np.ndarray:
    """[corners, 3] at (0, 0, 0.2): two strips and a fin below the edge that they share."""
    points = [(-1, -1, 0), (0, -1, 0.2), (0, 1, 0.2), (-1, 1, 0), (1, -1, 0), (1, 1, 0), (0, -1, -1), (0, 1, -1)]
    faces = {"A": (0, 1, 2, 3, -1), "C": (1, 4, 5, 2, -1), "F": (1, 2, 7, 6, -1)}
    faces |= {name.lower(): (*faces[name][3::-1], -1) for name in "AC"}  # from behind
    index = [corner for name in order for corner in faces[name]]
    coord = nodes.Coordinate(point=np.array(points, float))
    mesh = nodes.IndexedFaceSet(coord=coord, coord_index=np.array(index), crease_angle=1.2, solid=True)
    from jaxlight.raster.facesets import indexed_face_set

    triangles = indexed_face_set(mesh, "mesh")
    on_top = np.all(np.isin(triangles.position[:, :, 2], [0, 0.2]), axis=1)
    front = on_top & (np.cross(*np.diff(triangles.position, axis=1).swapaxes(0, 1))[:, 2] > 0)
    at_edge = triangles.position[front][:, :, 2] == 0.2
    found = triangles.normal[front][at_edge]
    return found / np.linalg.norm(found, axis=1, keepdims=True)


@pytest.mark.parametrize("order", ["AC", "ACF", "AFC", "FAC", "ACac", "AaCc", "ACca"])
def test_creases_do_not_depend_on_the_order_of_faces(order: str) -> None:
    np.testing.assert_allclose(corner_normals(order), [(0, 0, 1)] * 6, atol=1e-12)
