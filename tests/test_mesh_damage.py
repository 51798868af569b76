"""OBJ, PLY and STL files that are damaged, cut off or uneven: an error that says where, or all of what they hold."""

from __future__ import annotations

import re
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from jaxlight import SceneFileError, SceneFileWarning, load
from jaxlight.scene import nodes as n
from test_meshes import shapes_of, triangles

QUADS = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
f -4/-4/-1 -3/-3/-1 -2/-2/-1 -1/-1/-1
v 5 0 0
v 6 0 0
v 6 1 0
v 5 1 0
vt 0.5 0
vt 0.25 0
vt 0.25 0.5
vt 0.5 0.5
vn 0 1 0
f -4/-4/-1 -3/-3/-1 -2/-2/-1 -1/-1/-1
"""


def corners(geometry: n.Node, field: str, values: str) -> np.ndarray:
    """[triangles, 3 corners, ...] of vertex data of a face set."""
    index = getattr(geometry, f"{field}_index")
    index = index if len(index) else geometry.coord_index
    return getattr(getattr(geometry, field), values)[index.reshape(-1, 4)[:, :3]]


def obj_shapes(tmp_path: Path, text: str) -> list[n.Shape]:
    (tmp_path / "a.obj").write_text(text)
    return shapes_of(tmp_path / "a.obj")


def test_relative_indices_count_from_the_face_back(tmp_path: Path) -> None:
    (relative,) = obj_shapes(tmp_path, QUADS)
    absolute = QUADS.replace("-4/-4/-1 -3/-3/-1 -2/-2/-1 -1/-1/-1", "1/1/1 2/2/1 3/3/1 4/4/1", 1)
    absolute = absolute.replace("-4/-4/-1 -3/-3/-1 -2/-2/-1 -1/-1/-1", "5/5/2 6/6/2 7/7/2 8/8/2", 1)
    (expected,) = obj_shapes(tmp_path, absolute)
    assert np.array_equal(triangles(relative.geometry), triangles(expected.geometry))
    assert sorted(triangles(relative.geometry)[:, :, 0].max(axis=1).tolist()) == [1, 1, 6, 6]
    for field, values in (("tex_coord", "point"), ("normal", "vector")):
        found = corners(relative.geometry, field, values)
        assert np.array_equal(found, corners(expected.geometry, field, values))
        assert len(np.unique(found.reshape(-1, found.shape[2]), axis=0)) > 1


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_continued_lines_comments_tabs_and_marks(tmp_path: Path, end: str) -> None:
    lines = ["\ufeffv 0 0 0", "v\t1 0 0 # second", "# c:\\", "v 0 1 0", "  f 1 \\", "-2\\", "-1 # all", ""]
    (tmp_path / "a.obj").write_bytes(end.join(lines).encode())
    (shape,) = shapes_of(tmp_path / "a.obj")
    assert triangles(shape.geometry).tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]


def test_faces_of_all_forms_in_one_file(tmp_path: Path) -> None:
    """Six numbers are a hexagon, a triangle with texture coordinates, or one with normals."""
    head = "".join(f"v {x} {y} 0\nvt {x} {y}\n" for x, y in [(0, 0), (2, 0), (3, 1), (2, 2), (0, 2), (-1, 1)])
    head += "vn 0 0 1\n"
    with pytest.warns(SceneFileWarning, match=r"face without vt .* now at vt 0 0 x2.*obj normals of faces"):
        (shape,) = obj_shapes(tmp_path, f"{head}f 1/1 2/2 3/3\nf 1 2 3 4 5 6\nf 4//1 5//1 6//1\n")
    found = triangles(shape.geometry)
    area = np.linalg.norm(np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(1 + 6 + 1)
    uv = corners(shape.geometry, "tex_coord", "point")
    assert uv[0].tolist() == [[0, 0], [2, 0], [3, 1]]
    assert not np.any(uv[1:])
    assert shape.geometry.normal is None


def test_texture_coordinates_and_normals_of_other_materials_stay(tmp_path: Path) -> None:
    head = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0 7\nvt 1 0 7\nvt 0 1 7\nvn 0 0 1\n"
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 1 0\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shapes = obj_shapes(tmp_path, f"{head}usemtl a\nf 1/1/1 2/2/1 3/3/1\nusemtl b\nf 1 2 3\n")
    a, b = sorted(shapes, key=lambda shape: shape.appearance.material.name)
    assert a.geometry.tex_coord.point.tolist() == [[0, 0], [1, 0], [0, 1]]
    assert a.geometry.normal is not None
    assert b.geometry.tex_coord is None and b.geometry.normal is None


def test_colours_of_obj_vertices_beside_texture_coordinates_are_kept(tmp_path: Path) -> None:
    text = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
    (shape,) = obj_shapes(tmp_path, text)
    assert corners(shape.geometry, "color", "color").tolist() == [[[1, 0, 0], [0, 1, 0], [0, 0, 1]]]


def test_what_an_obj_has_besides_faces_and_whole_colours_is_named(tmp_path: Path) -> None:
    text = "v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5\nl 1 2\nsurf 0 1 0 1 1 2 3\nf 1/1 2/1 3/1\n"
    with pytest.warns(SceneFileWarning, match="obj l x1, obj surf x1; .*colours of vertices, as not all have some x1"):
        (shape,) = obj_shapes(tmp_path, text)
    assert not shape.geometry.color
    assert np.all(corners(shape.geometry, "tex_coord", "point") == (0.5, 0))


@pytest.mark.parametrize(
    ("polygon", "area"),
    [
        ([(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)], 10),
        ([(4, 0), (1, 1), (0, 4), (0, 0)], 4),
        ([(0, 0), (4, 0), (4, 4), (0, 4)], 16),
    ],
)
@pytest.mark.parametrize("first", range(4))
def test_concave_faces_cover_what_is_in_them_and_look_where_they_did(
    tmp_path: Path, polygon: list[tuple[float, float]], area: float, first: int
) -> None:
    polygon = polygon[first:] + polygon[:first]
    text = "".join(f"v {x} {y} 1\nvt {x} {y}\n" for x, y in polygon) + "v 9 9 9\nvt 9 9\n"
    face = " ".join(f"{corner}/{corner}" for corner in range(1, len(polygon) + 1))
    (shape,) = obj_shapes(tmp_path, f"{text}f 1/1 2/2 {len(polygon) + 1}/{len(polygon) + 1}\nf {face}\n")
    found = triangles(shape.geometry)
    uv = corners(shape.geometry, "tex_coord", "point")
    assert np.array_equal(found[..., :2], uv)
    flat = found[np.all(found[..., 2] == 1, axis=1)]
    cross = np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])
    assert np.all(cross[:, 2] > 0) and cross[:, 2].sum() / 2 == pytest.approx(area)
    assert len(found) == len(flat) + 1


def library(folder: Path, content: str | bytes, material: str = "red") -> n.Shape:
    """The shape of one triangle of that material of this library."""
    (folder / "a.mtl").write_bytes(content if isinstance(content, bytes) else content.encode())
    (shape,) = obj_shapes(folder, f"mtllib a.mtl\n{TRIANGLE}usemtl {material}\nf 1/1 2/2 3/3\n")
    return shape


@pytest.mark.parametrize(
    ("content", "material"),
    [
        ("\ufeffnewmtl red\nKd 1 0 0\n", "red"),
        ("newmtl red\nKd 1 0 0\n".encode("utf-16"), "red"),
        (b"# caf\xe9\nnewmtl red\nKd 1 0 0\n", "red"),
        ("newmtl red  # the first\nKd 1 0 0 # of them\nKs 0 0 0", "red # one"),
        ("newmtl red  wine\rKd 1 0 0\r", "red \t wine"),
        ("newmtl Material #25\nKd 1 0 0\nnewmtl Material #26\nKd 0 1 0", "Material #25"),
    ],
)
def test_materials_are_found_whatever_stands_around_their_names(
    tmp_path: Path, content: str | bytes, material: str
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert library(tmp_path, content, material).appearance.material.diffuse_color == (1, 0, 0)


def test_a_material_that_no_library_has_is_named(tmp_path: Path) -> None:
    with pytest.warns(SceneFileWarning, match="no material file has the material 'Red'"):
        library(tmp_path, "newmtl red\nKd 1 0 0\n", "Red")


@pytest.mark.parametrize(
    ("reference", "noted"),
    [
        ("-s 1 1 1 -o 0 -clamp off my wood.png", None),
        ("my wood.png # oak", None),
        ("-clamp on my wood.png", "mtl map_Kd -clamp x1"),
        ("-mm 0 0.5 -s 2 2 my wood.png", "mtl map_Kd -mm x1, mtl map_Kd -s x1"),
    ],
)
def test_options_of_textures_are_told_from_their_names(tmp_path: Path, reference: str, noted: str | None) -> None:
    Image.new("RGB", (1, 1), (255, 0, 0)).save(tmp_path / "wood.png")
    Image.new("RGB", (1, 1), (0, 255, 0)).save(tmp_path / "my wood.png")
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        shape = library(tmp_path, f"newmtl red\nmap_Kd {reference}\n")
    assert shape.appearance.texture.image.tolist() == [[[0, 1, 0]]]
    assert [str(warning.message).partition("fields not used: ")[2] for warning in heard] == ([noted] if noted else [])


@pytest.mark.parametrize(
    ("line", "field", "value", "noted"),
    [
        ("Kd 0.5", "diffuse_color", (0.5, 0.5, 0.5), ""),
        ("Ks 0.25 # grey", "specular_color", (0.25, 0.25, 0.25), ""),
        ("Kd 0.1 0.2", "diffuse_color", (0.8, 0.8, 0.8), "Kd of .*: 1 number or 3 numbers, got '0.1 0.2'"),
        ("Kd 0.1 nan 0.3", "diffuse_color", (0.8, 0.8, 0.8), "Kd of material 'odd' is left out.* got '0.1 nan 0.3'"),
        ("Ks spectral a.rfl", "specular_color", (0, 0, 0), "Ks of material 'odd' is left out.* got 'spectral a.rfl'"),
        ("d -halo 0.5", "transparency", 0, "d of material 'odd' is left out: 1 number, got '-halo 0.5'"),
        ("d 0.25", "transparency", 0.75, ""),
        ("Ke 0.1 0.2 0.3", "emissive_color", (0.1, 0.2, 0.3), ""),
        ("Ns 3 4", "shininess", 0.2, "Ns of material 'odd' is left out: 1 number, got '3 4'"),
    ],
)
def test_an_unusual_number_of_one_material_changes_no_other(
    tmp_path: Path, line: str, field: str, value: object, noted: str
) -> None:
    (tmp_path / "a.mtl").write_text(f"newmtl good\nKd 1 0 0\nnewmtl odd\n{line}\n")
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        shapes = obj_shapes(tmp_path, f"mtllib a.mtl\n{TRIANGLE}usemtl good\nf 1 2 3\nusemtl odd\nf 1 2 3\n")
    materials = {shape.appearance.material.name: shape.appearance.material for shape in shapes}
    assert materials["good"].diffuse_color == (1, 0, 0)
    assert getattr(materials["odd"], field) == value
    assert len(heard) == bool(noted) and all(re.search(noted, str(warning.message)) for warning in heard)


@pytest.mark.parametrize(
    ("line", "field", "value"),
    [
        ("Kd 1.5 0.25 -1", "diffuse_color", (1, 0.25, 0)),
        ("Ke 3", "emissive_color", (1, 1, 1)),
        ("d 1.5", "transparency", 0),
        ("Tr -1", "transparency", 0),
        ("Ns 500", "shininess", 1),
        ("Ns -3", "shininess", 0),
    ],
)
def test_numbers_of_a_material_out_of_range_are_named(tmp_path: Path, line: str, field: str, value: object) -> None:
    keyword, _, numbers = line.partition(" ")
    with pytest.warns(SceneFileWarning, match=rf"clamped 1 value .*: {keyword} of material 'red' \({numbers}\)$"):
        assert getattr(library(tmp_path, f"newmtl red\n{line}\n").appearance.material, field) == value


def test_a_texture_that_is_no_image_is_named(tmp_path: Path) -> None:
    (tmp_path / "wood.png").write_bytes(b"xx")
    with pytest.warns(SceneFileWarning, match="1 file not used: 'wood.png': no image that can be read"):
        assert library(tmp_path, "newmtl red\nmap_Kd wood.png\n").appearance.texture is None


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\nvn 0 0 1\n"


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ("v 1 b 0\nf 1 2 3", "a.obj:9: a v has '1 b 0', expected numbers"),
        ("vn 1d0 0 0\nf 1 2 3", "a.obj:9: a vn has '1d0 0 0', expected numbers"),
        ("f 1/1 2/2 3/9", "a.obj:9: .*out of range: a face has the vt index 9, the file 4 vt"),
        ("f 1//1 2//1 3//5", "a.obj:9: .*the vn index 5, the file 1 vn"),
        ("f 1/1 2/2 3/3\nf 1/0 2/2 3/3", r"a.obj:10: a face has the index 0 \(vt\)"),
        ("f 1//0 2//1 3//1", r"a.obj:9: a face has the index 0 \(vn\)"),
        ("f 1 2 \\\n 0", r"a.obj:9: a face has the index 0 \(v\)"),
        ("# one\\\nf 1 2 3\nf 1 2 4", "a.obj:11: .*the v index 4, the file 3 v"),
        ("f -4 -3 -2\nv 2 0 0", "a.obj:9: a face has the v index -4, but 3 v stand before it"),
        (f"f 1 2 {'9' * 5000}", "a.obj:9: .*out of range: a face has the v index 9{40}, the file 3 v"),
        (f"f 1 2 -{'9' * 5000}", "a.obj:9: a face has the v index -9{39}, but 3 v stand before it"),
        ("f 1/-5 2/2 3/3\nvt 0 0", "a.obj:9: a face has the vt index -5, but 4 vt"),
        ("f 1 2 3\nf 1 2", "a.obj:10: a face has 2 corners"),
        ("f 1 2 3\nf 1 2 x", "a.obj:10: a face has the corner 'x'; allowed are v, v/vt"),
        ("f 1/1/1/1 2 3", "a.obj:9: a face has the corner '1/1/1/1'"),
        ("f 1.5 2 3", "a.obj:9: a face has the corner '1.5'"),
        ("v 1 0\nv 0 1 0 4\nf 1 4 5", "a.obj:9: a v has 2 numbers, expected 3 or more"),
        ("vn 0 1 # z\nf 1 2 3", "a.obj:9: a vn has 2 numbers"),
        ("v 1_0 0 0\nf 1 2 3", "a.obj:9: a v has '1_0 0 0', expected numbers"),
        ("v \N{ARABIC-INDIC DIGIT ONE} 0 0\nf 1 2 3", "a.obj:9: a v has '\N{ARABIC-INDIC DIGIT ONE} 0 0', expected"),
        ("v 1e999 0 0\nf 1 2 3\nf 1 2 4", "a.obj:9: a v has '1e999 0 0', expected finite numbers"),
        ("vt nan 0\nf 1/1 2/2 3/5", "a.obj:9: a vt has 'nan 0', expected finite numbers"),
        ("vn 0 0 -inf\nf 1//1 2//1 3//2", "a.obj:9: a vn has '0 0 -inf', expected finite numbers"),
    ],
)
def test_faces_that_do_not_fit_their_obj_are_errors_with_line(tmp_path: Path, faces: str, message: str) -> None:
    with pytest.raises(SceneFileError, match=message):
        obj_shapes(tmp_path, f"{TRIANGLE}{faces}\n")


def test_numbers_of_an_obj_that_nothing_needs_may_be_infinite(tmp_path: Path) -> None:
    unused = "v nan 0 0\nvt inf 0\nvt 0 0 nan\nvn nan 0 0\nf 1/6/1 2/6/1 3/6/1\nf 1/1/2 2/2 3/3\n"
    with pytest.warns(SceneFileWarning, match="obj normals of faces, as not all have some"):
        (shape,) = obj_shapes(tmp_path, TRIANGLE + unused)
    assert len(triangles(shape.geometry)) == 2


@pytest.mark.parametrize("group", ["off", "0", "1"])
def test_smoothing_groups_are_named_where_faces_have_no_normals(tmp_path: Path, group: str) -> None:
    bare = f"{TRIANGLE}s {group}\nf 1 2 3\nf 3 2 1\n"
    with pytest.warns(SceneFileWarning, match=r"obj s \(smoothing groups\) of faces without normals, .* x2$"):
        obj_shapes(tmp_path, bare)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        obj_shapes(tmp_path, f"{TRIANGLE}s {group}\nf 1//1 2//1 3//1\n")
        obj_shapes(tmp_path, f"{TRIANGLE}f 1 2 3\n")


# --- ply ------------------------------------------------------------------------------------------------------------

PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
{vertex}element face {faces}
property list uchar int vertex_indices
{face}end_header
"""
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def ply_text(rows: str, faces: int, vertex: str = "", face: str = "") -> str:
    names = {"{vertex}": vertex, "{face}": face}
    properties = {key: "".join(f"property {name}\n" for name in text.split(";") if name) for key, text in names.items()}
    return PLY.format(vertex=properties["{vertex}"], face=properties["{face}"], faces=faces) + rows


@pytest.mark.parametrize(
    ("vertices", "face_rows", "announced", "message"),
    [
        (4, "3 0 1 2\n3 0 2 3\n", 3, r"announces 7 rows \(4 vertex, 3 face\), but holds 6: truncated"),
        (4, "", 2, "announces 6 rows .* holds 4"),
        (3, "3 0 1 2\n", 1, "announces 5 rows .* holds 4"),
        (4, "3 0 1 2\n3 0 2", 2, "a.ply:15: a face has not all of its 1 properties"),
        (4, "3 0 1 2\n3 0 2 q\n", 2, "a.ply:15: a face"),
        (4, "3 0 1 2\n3 0 2 3\n3 0 1 3\n", 2, "announces 6 rows .* holds 7"),
    ],
)
def test_an_ascii_ply_that_holds_less_than_it_announces_is_an_error(
    tmp_path: Path, vertices: int, face_rows: str, announced: int, message: str
) -> None:
    rows = "".join("{} {} {}\n".format(*position) for position in SQUARE[:vertices])
    (tmp_path / "a.ply").write_text(ply_text(rows + face_rows, announced))
    with pytest.raises(SceneFileError, match=message):
        load(tmp_path / "a.ply")


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("vertex 4", "vertex four", "a.ply:3: expected element NAME COUNT, got 'element vertex four'"),
        ("vertex 4", "vertex -4", "a.ply:3: expected element NAME COUNT, got 'element vertex -4'"),
        ("vertex 4", f"vertex {'9' * 5000}", "a.ply:3: expected element NAME COUNT, got 'element vertex 99"),
        (
            "element vertex 4\n",
            "",
            "a.ply:3: expected property TYPE NAME or .* behind an element, got 'property float x'",
        ),
        ("float y", "flaot y", "a.ply:5: expected property TYPE NAME or .*, got 'property flaot y'"),
        ("list uchar", "list float", "a.ply:8: expected property TYPE NAME or .*, got 'property list float int"),
        ("float z", "float w", "a.ply:3: the vertices have no property z"),
        ("property list uchar int vertex_indices\n", "", "a.ply:7: the faces have no list vertex_indices"),
        (" 1.0", " 2.0", "a.ply:2: expected the line format ascii or binary_little_endian or .*, got 'format"),
        ("format", "comment", "a ply header without the line format ascii or"),
        ("end_header", "end", "a ply without the line end_header"),
    ],
)
def test_a_damaged_ply_header_is_an_error_with_line(
    tmp_path: Path, before: str, after: str, message: str, binary: bool
) -> None:
    data = ply("binary_little_endian" if binary else "ascii", [(0, 1, 2)]).replace(b"vertex 5", b"vertex 4")
    assert before.encode() in data
    (tmp_path / "a.ply").write_bytes(data.replace(before.encode(), after.encode(), 1))
    with pytest.raises(SceneFileError, match=message):
        load(tmp_path / "a.ply")


def test_a_ply_header_is_read_whatever_its_comments_and_their_places(tmp_path: Path) -> None:
    data = ply("ascii", [(0, 1, 2)]).replace(b"vertex_indices", b"corners")
    data = data.replace(b"ply\n", "ply\ncomment café\n\n".encode("latin-1"), 1)
    (tmp_path / "a.ply").write_bytes(data)
    assert len(triangles(shapes_of(tmp_path / "a.ply")[0].geometry)) == 1


COLORS = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)]


@pytest.mark.parametrize("faces", ["3 0 1 2\n3 0 2 3\n", "4 0 1 2 3\n"])
@pytest.mark.parametrize("binary", [False, True])
def test_ply_colours_normals_and_texture_coordinates_of_vertices(tmp_path: Path, faces: str, binary: bool) -> None:
    vertex = "uchar red;uchar green;uchar blue;float s;float t;float nx;float ny;float nz"
    rows = [(*p, *color, p[0], p[1], 0, 0, 1) for p, color in zip(SQUARE, COLORS, strict=True)]
    text = ply_text("".join(" ".join(map(str, row)) + "\n" for row in rows) + faces, faces.count("\n"), vertex)
    data = text.encode()
    if binary:
        kind = [("xyz", "<f4", 3), ("rgb", "u1", 3), ("st", "<f4", 2), ("n", "<f4", 3)]
        body = np.array([(r[:3], r[3:6], r[6:8], r[8:]) for r in rows], dtype=kind).tobytes()
        for face in faces.split("\n")[:-1]:
            count, *index = map(int, face.split())
            body += bytes([count]) + np.array(index, dtype="<i4").tobytes()
        head = text.partition("end_header\n")[0].replace("ascii", "binary_little_endian")
        data = f"{head}end_header\n".encode() + body
    (tmp_path / "a.ply").write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (shape,) = shapes_of(tmp_path / "a.ply")
    position = triangles(shape.geometry)
    assert len(position) == 2
    assert np.array_equal(corners(shape.geometry, "tex_coord", "point"), position[:, :, :2])
    assert np.all(corners(shape.geometry, "normal", "vector") == (0, 0, 1))
    color_of = {place: np.array(color) / 255 for place, color in zip(SQUARE, COLORS, strict=True)}
    expected = [[color_of[tuple(map(int, p))] for p in face] for face in position]
    assert np.array_equal(corners(shape.geometry, "color", "color"), expected)


def test_ply_data_of_vertices_lost_beside_texture_coordinates_of_faces_is_named(tmp_path: Path) -> None:
    vertex = "uchar red;uchar green;uchar blue;float nx;float ny;float nz"
    rows = "".join("{} {} {} 255 0 0 0 0 1\n".format(*position) for position in SQUARE)
    rows += "3 0 1 2 6 0 0 1 0 1 1\n3 0 2 3 6 0.5 0 1 1 0 1\n"
    (tmp_path / "a.ply").write_text(ply_text(rows, 2, vertex, "list uchar float texcoord"))
    with pytest.warns(
        SceneFileWarning, match="ply colours of vertices beside texture .*ply normals of vertices beside"
    ):
        (shape,) = shapes_of(tmp_path / "a.ply")
    uv = [[[0, 0], [1, 0], [1, 1]], [[0.5, 0], [1, 1], [0, 1]]]
    assert corners(shape.geometry, "tex_coord", "point").tolist() == uv


# --- stl ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("start", [b"a header", b"solid a header"])
@pytest.mark.parametrize("change", [-1, -50, 1])
def test_a_binary_stl_of_another_length_is_an_error(tmp_path: Path, start: bytes, change: int) -> None:
    whole = trimesh.creation.box().export(file_type="stl")
    whole = start.ljust(80, b" ") + whole[80:]
    (tmp_path / "a.stl").write_bytes(whole)
    assert len(triangles(shapes_of(tmp_path / "a.stl")[0].geometry)) == 12
    (tmp_path / "a.stl").write_bytes(whole[:change] if change < 0 else whole + bytes(change))
    message = f"announces 12 triangles, which take 684 bytes, but has {684 + change}: truncated"
    with pytest.raises(SceneFileError, match=message):
        load(tmp_path / "a.stl")


def ascii_stl(name: str = "") -> str:
    facet = (
        "facet normal 0 0 1\n outer loop\n  vertex 0 0 0\n  vertex 1e0 0 0\n  vertex +.0 1. -0\n endloop\nendfacet\n"
    )
    return f"solid {name}\n{facet}{facet.replace('0 0 0', '2 0 0')}endsolid {name}\n"


def test_every_truncation_of_an_ascii_stl_is_an_error(tmp_path: Path) -> None:
    first = ascii_stl("a")
    whole = first + ascii_stl("b")
    last = len("endsolid")
    ends = (first.rindex("endsolid") + last, whole.rindex("endsolid") + last)
    for length in (*range(1, ends[0]), *range(len(first) + 5, ends[1])):
        (tmp_path / "a.stl").write_text(whole[:length])
        with pytest.raises(SceneFileError, match=r"not a stl file, or truncated|holds no triangles"):
            load(tmp_path / "a.stl")
    (tmp_path / "a.stl").write_text(whole)
    assert sum(len(triangles(shape.geometry)) for shape in shapes_of(tmp_path / "a.stl")) == 4


def test_damaged_vertices_of_an_ascii_stl_are_errors(tmp_path: Path) -> None:
    for damage in ("vertex 1e0 0", "vertex 1e0 0 z", "vertx 1e0 0 0"):
        (tmp_path / "a.stl").write_text(ascii_stl().replace("vertex 1e0 0 0", damage, 1))
        with pytest.raises(SceneFileError, match="2 facet, 2 endfacet, 5 vertex"):
            load(tmp_path / "a.stl")


def test_names_of_solids_are_no_statements(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_text(ascii_stl("Facet vertex endsolid").replace("\n", "\r\n"))
    assert len(triangles(shapes_of(tmp_path / "a.stl")[0].geometry)) == 2


def ply(kind: str, faces: list[tuple[int, ...]], *, colored: bool = False) -> bytes:
    """A flat ply of five vertices."""
    places = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 2, 0)]
    colors = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue")) if colored else ""
    head = f"ply\nformat {kind} 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\n{colors}end_header\n"
    if kind == "ascii":
        rows = [" ".join(map(str, place)) for place in places]
        rows += [" ".join(map(str, [len(face), *face, *((9, 8, 7) if colored else ())])) for face in faces]
        return (head + "\n".join(rows) + "\n").encode()
    body = b"".join(struct.pack("<3f", *place) for place in places)
    body += b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) + b"987" * colored for face in faces)
    return head.encode() + body


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_a_ply_of_quads_is_read_without_the_colours_of_its_faces(tmp_path: Path, kind: str) -> None:
    (tmp_path / "a.ply").write_bytes(ply(kind, [(0, 1, 2, 3), (1, 4, 2, 0)], colored=True))
    with pytest.warns(SceneFileWarning, match="ply colours of faces that have more than three corners x1"):
        (shape,) = shapes_of(tmp_path / "a.ply")
    assert len(triangles(shape.geometry)) == 4 and shape.geometry.color is None


def test_faces_of_several_sizes_are_read_of_an_ascii_ply_only(tmp_path: Path) -> None:
    faces = [(0, 1, 2, 3), (1, 4, 2)]
    (tmp_path / "a.ply").write_bytes(ply("ascii", faces))
    assert len(triangles(shapes_of(tmp_path / "a.ply")[0].geometry)) == 3
    (tmp_path / "a.ply").write_bytes(ply("binary_little_endian", faces))
    with pytest.raises(SceneFileError, match="faces of one size; of several an ascii ply may be"):
        load(tmp_path / "a.ply")
