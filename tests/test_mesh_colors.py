"""Colours of the vertices and faces of mesh files: all of their digits."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from jaxlight import SceneFileWarning
from jaxlight.scene import nodes as n
from test_meshes import rewritten, shapes_of

UNLIT = "KHR_materials_unlit"


@pytest.mark.parametrize("alpha", [255, 128])
def test_vertex_colors_are_kept_with_alpha_if_any_is_not_one(tmp_path: Path, alpha: int) -> None:
    box = trimesh.creation.box()
    colors = np.random.default_rng(0).integers(0, 256, (8, 4)).astype(np.uint8)
    colors[:, 3] = alpha
    box.visual = trimesh.visual.ColorVisuals(box, vertex_colors=colors)
    (tmp_path / "box.ply").write_bytes(box.export(file_type="ply"))
    (shape,) = shapes_of(tmp_path / "box.ply")
    color = shape.geometry.color
    assert type(color) is (n.Color if alpha == 255 else n.ColorRGBA)
    expected = colors[:, : color.color.shape[1]] / 255
    assert np.array_equal(color.color, expected)


PLY_COLORS = {"ushort": (65535, 32768, 1), "float": (0.3, 0.2, 0.1), "uchar": (255, 128, 1)}


@pytest.mark.parametrize("element", ["vertex", "face"])
@pytest.mark.parametrize("kind", PLY_COLORS)
def test_colors_of_a_ply_keep_all_their_digits(tmp_path: Path, kind: str, element: str) -> None:
    red, green, blue = PLY_COLORS[kind]
    fields = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
    own = f" {red} {green} {blue}"
    text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    text += (fields if element == "vertex" else "") + "element face 1\nproperty list uchar int vertex_indices\n"
    text += (fields if element == "face" else "") + "end_header\n"
    text += "".join(f"{place}{own if element == 'vertex' else ''}\n" for place in ("0 0 0", "1 0 0", "0 1 0"))
    (tmp_path / "a.ply").write_text(f"{text}3 0 1 2{own if element == 'face' else ''}\n")
    (shape,) = shapes_of(tmp_path / "a.ply")
    largest = {"ushort": 65535, "float": 1, "uchar": 255}[kind]
    expected = np.array([red, green, blue]) / largest
    assert len(shape.geometry.color.color) == (3 if element == "vertex" else 1)
    for color in shape.geometry.color.color:
        np.testing.assert_allclose(color, expected, rtol=1e-6)


def glb_with_colors(colors: np.ndarray, material: dict | None = None) -> bytes:
    """A glb of one triangle whose vertices have these colours, as they are."""
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    data = trimesh.Scene(mesh).export(file_type="glb")
    length = struct.unpack_from("<I", data, 12)[0]
    rest = data[20 + length + 8 :]
    rest += b"\0" * (-len(rest) % 4)
    kind = {"uint8": 5121, "uint16": 5123, "float32": 5126}[colors.dtype.name]

    def change(header: dict) -> None:
        header["bufferViews"].append({"buffer": 0, "byteOffset": len(rest), "byteLength": colors.nbytes})
        view, columns = len(header["bufferViews"]) - 1, colors.shape[1]
        accessor = {"bufferView": view, "componentType": kind, "type": f"VEC{columns}", "count": len(colors)}
        header["accessors"].append({**accessor, "normalized": kind != 5126})
        header["buffers"][0]["byteLength"] = len(rest) + colors.nbytes
        primitive = header["meshes"][0]["primitives"][0]
        primitive["attributes"]["COLOR_0"] = len(header["accessors"]) - 1
        if material is not None:
            header["materials"], primitive["material"] = [material], 0

    changed = rewritten(data, change)
    head = struct.unpack_from("<I", changed, 12)[0]
    chunk = rest + colors.tobytes()
    return changed[: 20 + head] + struct.pack("<I", len(chunk)) + b"BIN\0" + chunk


@pytest.mark.parametrize("with_material", [False, True])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_colors_of_a_glb_keep_all_their_digits(tmp_path: Path, dtype: Any, with_material: bool) -> None:
    colors = np.array([[10, 20, 250, 255], [1, 2, 3, 255], [77, 88, 99, 255]])
    own = colors / 255 * (1 if dtype == np.float32 else np.iinfo(dtype).max)
    own = (own if dtype == np.float32 else np.round(own)).astype(dtype)
    own[:, :3] -= np.asarray(0.001 if dtype == np.float32 else 1, dtype)
    (tmp_path / "a.glb").write_bytes(glb_with_colors(own, {} if with_material else None))
    (shape,) = shapes_of(tmp_path / "a.glb")
    largest = 1 if dtype == np.float32 else np.iinfo(dtype).max
    np.testing.assert_allclose(shape.geometry.color.color, own[:, :3] / largest, rtol=1e-6)
    assert shape.appearance.material.diffuse_color == (1.0, 1.0, 1.0)


def test_face_colors_are_kept(tmp_path: Path) -> None:
    text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    text += "element face 2\nproperty list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\n"
    text += "property uchar blue\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n3 0 1 2 255 0 0\n3 1 3 2 0 0 255\n"
    (tmp_path / "faces.ply").write_text(text)
    (shape,) = shapes_of(tmp_path / "faces.ply")
    assert isinstance(shape.geometry, n.IndexedFaceSet) and not shape.geometry.color_per_vertex
    assert shape.geometry.color.color.tolist() == [[1, 0, 0], [0, 0, 1]]


@pytest.mark.parametrize("material", ["", "usemtl none\n", "mtllib a.mtl\nusemtl red\n"])
def test_colors_of_an_obj_keep_all_their_digits(tmp_path: Path, material: str) -> None:
    colors = [[0.5, 0.25, 0.1], [0.123456, 0.2, 0.3], [0, 0, 1]]
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 1 0 0\n")
    vertices = "".join(f"v {place} {' '.join(map(str, own))}\n" for place, own in zip(PLACES, colors, strict=True))
    (tmp_path / "a.obj").write_text(f"{vertices}f 3 2 1\n{material}f 1 2 3\n")
    shapes = shapes_of(tmp_path / "a.obj")
    assert len(shapes) == 1 + bool(material)
    for shape in shapes:
        assert sorted(shape.geometry.color.color.tolist()) == sorted(colors)
    assert {shape.appearance.material.diffuse_color for shape in shapes} == (
        {(0.8, 0.8, 0.8), (1, 0, 0)} if "red" in material else {(0.8, 0.8, 0.8)}
    )


PLACES = ("0 0 0", "1 0 0", "0 1 0")


@pytest.mark.parametrize(
    ("materials", "opaque"),
    [(None, True), ([{}], True), ([{"alphaMode": "OPAQUE"}], True), ([{"alphaMode": "BLEND"}], False)],
)
def test_alpha_of_glb_colors_is_read_unless_the_material_is_opaque(
    tmp_path: Path, materials: list | None, opaque: bool
) -> None:
    """glTF 3.9.6; without a material there is the default one (3.7.2.1), opaque and seen from one side."""
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.full((3, 4), 64, np.uint8))

    def change(header: dict) -> None:
        primitive = header["meshes"][0]["primitives"][0]
        primitive.pop("material", None)
        header.pop("materials", None)
        if materials is not None:
            header["materials"], primitive["material"] = materials, 0

    (tmp_path / "a.glb").write_bytes(rewritten(trimesh.Scene(mesh).export(file_type="glb"), change))
    (shape,) = shapes_of(tmp_path / "a.glb")
    assert type(shape.geometry.color) is (n.Color if opaque else n.ColorRGBA)
    assert shape.geometry.solid


def painted(folder: Path, color: tuple[int, ...], material: dict, texture: str = "") -> n.Shape:
    """The shape of a glb of one triangle whose vertices have this colour, with this material and mode of a texture."""
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.full((3, 4), color, np.uint8))

    def change(header: dict) -> None:
        header["materials"], header["meshes"][0]["primitives"][0]["material"] = [material], 0
        if texture:
            Image.new(texture, (1, 1)).save(folder / "t.png")
            header |= {"images": [{"uri": "t.png"}], "textures": [{"source": 0}]}
            material["pbrMetallicRoughness"] |= {"baseColorTexture": {"index": 0}}

    (folder / "a.glb").write_bytes(rewritten(trimesh.Scene(mesh).export(file_type="glb"), change))
    (shape,) = shapes_of(folder / "a.glb")
    return shape


@pytest.mark.parametrize(
    ("metallic", "alpha_mode", "expected"),
    [(0, "OPAQUE", (0.4, 0.1, 0)), (0, "BLEND", (0.4, 0.1, 0, 0.1)), (1, "OPAQUE", (0.2, 0.05, 0))],
)
def test_colors_of_glb_vertices_are_scaled_by_their_material(
    tmp_path: Path, metallic: float, alpha_mode: str, expected: tuple[float, ...]
) -> None:
    """glTF 3.9.2 and 3.7.2.1: COLOR_0 scales the base colour, of which rough metal scatters less."""
    factors = {"baseColorFactor": [0.8, 0.5, 0.25, 0.5], "metallicFactor": metallic, "roughnessFactor": 0.5}
    shape = painted(tmp_path, (128, 51, 0, 51), {"pbrMetallicRoughness": factors, "alphaMode": alpha_mode})
    for color in shape.geometry.color.color:
        np.testing.assert_allclose(color, np.array(expected) * ((128 / 127.5, 1, 1, 1)[: len(expected)]))


def test_colors_of_glb_vertices_scale_what_scatters_of_specular_glossiness(tmp_path: Path) -> None:
    glossy = {"diffuseFactor": [0.8, 0.4, 0.2, 1], "specularFactor": [0.25, 0.125, 0], "glossinessFactor": 0.5}
    material = {"extensions": {"KHR_materials_pbrSpecularGlossiness": glossy}}
    shape = painted(tmp_path, (51, 51, 255, 255), material)
    expected = np.array([0.16, 0.08, 0.2]) * 0.75 + np.array([0.25, 0.125, 0]) * 0.5
    np.testing.assert_allclose(shape.geometry.color.color[0], expected)


@pytest.mark.parametrize("unlit", [False, True])
def test_white_colors_of_glb_vertices_leave_their_material_what_is_shaded(tmp_path: Path, unlit: bool) -> None:
    extensions = {UNLIT: {}} if unlit else {}
    factors = {"baseColorFactor": [0.8, 0.5, 0.25, 1], "metallicFactor": 0}
    shape = painted(tmp_path, (255,) * 4, {"pbrMetallicRoughness": factors, "extensions": extensions})
    assert shape.geometry.color is None
    material = shape.appearance.material
    assert (material.emissive_color if unlit else material.diffuse_color) == (0.8, 0.5, 0.25)


def test_colors_of_unlit_glb_vertices_are_scaled_by_their_base_color(tmp_path: Path) -> None:
    factors = {"baseColorFactor": [0.8, 0.5, 0.25, 1]}
    shape = painted(tmp_path, (0, 51, 255, 255), {"pbrMetallicRoughness": factors, "extensions": {UNLIT: {}}})
    assert shape.appearance.material is None
    np.testing.assert_allclose(shape.geometry.color.color[0], (0, 0.1, 0.25))


@pytest.mark.parametrize(
    ("texture", "alpha_mode", "base", "color", "noted"),
    [
        ("RGB", "OPAQUE", (0.8, 0.5, 0.25, 1), (255,) * 4, ["baseColorFactor"]),
        ("RGB", "OPAQUE", (1, 1, 1, 1), (255, 255, 0, 255), ["COLOR_0"]),
        ("RGB", "OPAQUE", (0.5, 1, 1, 1), (255, 255, 0, 255), ["baseColorFactor", "COLOR_0"]),
        ("RGBA", "BLEND", (1, 1, 1, 0.5), (255,) * 4, ["baseColorFactor"]),
        ("RGBA", "OPAQUE", (1, 1, 1, 0.5), (255,) * 4, []),
        ("RGB", "BLEND", (1, 1, 1, 0.5), (255,) * 4, []),
        ("L", "OPAQUE", (0.8, 0.5, 0.25, 1), (255, 255, 0, 255), []),
    ],
)
def test_what_a_texture_of_a_glb_replaces_is_named(
    tmp_path: Path, texture: str, alpha_mode: str, base: tuple, color: tuple, noted: list[str]
) -> None:
    material = {"pbrMetallicRoughness": {"baseColorFactor": list(base)}, "alphaMode": alpha_mode}
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always", SceneFileWarning)
        painted(tmp_path, color, material, texture)
    said = " ".join(str(warning.message) for warning in heard)
    for name in ("baseColorFactor", "COLOR_0"):
        named = f"glTF {name} under a texture, but with texture_mode='modulate' x1" in said
        assert named == (name in noted)


@pytest.mark.parametrize("texture", ["RGB", "L"])
def test_a_base_color_under_the_texture_of_an_unlit_material_is_named(tmp_path: Path, texture: str) -> None:
    factors = {"baseColorFactor": [0.5, 1, 1, 1]}
    with pytest.warns(SceneFileWarning, match="glTF baseColorFactor under the texture of an unlit material x1"):
        painted(tmp_path, (255,) * 4, {"pbrMetallicRoughness": factors, "extensions": {UNLIT: {}}}, texture)


def triangle_ply(rows: str, kind: str, names: tuple[str, ...], face: str = "3 0 1 2") -> str:
    """A ply of one triangle whose vertices have properties of these names and one type; each row is theirs."""
    fields = "".join(f"property {kind} {name}\n" for name in names)
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    body = "".join(f"{place} {rows}\n" for place in PLACES)
    return f"{head}{fields}element face 1\nproperty list uchar int vertex_indices\nend_header\n{body}{face}\n"


@pytest.mark.parametrize(
    "names", [("diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"), ("r", "g", "b", "a")]
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_colors_of_a_ply_have_several_names(tmp_path: Path, names: tuple[str, ...], end: str) -> None:
    text = triangle_ply("255 128 1 51", "uchar", names)
    (tmp_path / "a.ply").write_bytes(text.replace("\n", end).encode())
    (shape,) = shapes_of(tmp_path / "a.ply")
    np.testing.assert_array_equal(shape.geometry.color.color[0], np.array([255, 128, 1, 51]) / 255)


def test_other_names_of_ply_colors_are_left_where_the_usual_ones_are(tmp_path: Path) -> None:
    names = ("red", "green", "blue", "r", "g", "b", "diffuse_red")
    (tmp_path / "a.ply").write_text(triangle_ply("255 128 1 9 9 9 9", "uchar", names))
    (shape,) = shapes_of(tmp_path / "a.ply")
    np.testing.assert_array_equal(shape.geometry.color.color[0], np.array([255, 128, 1]) / 255)


@pytest.mark.parametrize(
    ("kinds", "row"),
    [
        (("uchar", "float"), "255 51 0 0.5"),
        (("ushort", "uchar"), "65535 13107 0 128"),
        (("float", "uchar"), "1 0.2 0 128"),
    ],
)
def test_each_color_of_a_ply_has_a_type_of_its_own(tmp_path: Path, kinds: tuple[str, str], row: str) -> None:
    text = triangle_ply(row, kinds[0], ("red", "green", "blue", "alpha"))
    (tmp_path / "a.ply").write_text(text.replace(f"{kinds[0]} alpha", f"{kinds[1]} alpha"))
    (shape,) = shapes_of(tmp_path / "a.ply")
    np.testing.assert_allclose(shape.geometry.color.color[0], (1, 0.2, 0, 0.5), atol=0.002)


def test_bytes_beside_colors_of_0_to_255_stay_what_they_are(tmp_path: Path) -> None:
    text = triangle_ply("255 51 0 128", "float", ("red", "green", "blue", "alpha"))
    (tmp_path / "a.ply").write_text(text.replace("float alpha", "uchar alpha"))
    with pytest.warns(SceneFileWarning, match="read as 0 to 255"):
        (shape,) = shapes_of(tmp_path / "a.ply")
    np.testing.assert_array_equal(shape.geometry.color.color[0], (1, 0.2, 0, 128 / 255))


def test_a_comment_of_a_ply_may_say_anything(tmp_path: Path) -> None:
    text = triangle_ply("255 51 0", "uchar", ("red", "green", "blue"))
    (tmp_path / "a.ply").write_text(
        text.replace("element vertex", "comment the header ends with end_header\nelement vertex")
    )
    (shape,) = shapes_of(tmp_path / "a.ply")
    np.testing.assert_array_equal(shape.geometry.color.color[0], (1, 0.2, 0))


@pytest.mark.parametrize("name", ["a.obj", "a.ply"])
def test_colors_of_0_to_255_are_told_from_those_of_0_to_1(tmp_path: Path, name: str) -> None:
    if name == "a.obj":
        vertices = ("v 0 0 0 255 51 0", "v 1 0 0 1 1 1 7", "v 0 1 0 0 0 127.5")
        (tmp_path / name).write_text("\n".join([*vertices, "f 1 2 3", "usemtl a", "f 2 3 1"]))
    else:
        (tmp_path / name).write_text(triangle_ply("255 51 0", "float", ("red", "green", "blue")))
    with pytest.warns(SceneFileWarning, match=f"{name[2:]} colours above 2, read as 0 to 255 x1"):
        shapes = shapes_of(tmp_path / name)
    for shape in shapes:
        np.testing.assert_array_equal(shape.geometry.color.color.max(axis=0)[:2], (1, 0.2))
        assert shape.geometry.coord.point.max() == 1


@pytest.mark.parametrize(
    ("name", "color", "expected", "noted"),
    [
        ("a.obj", "0.5 -0.25 1", (0.5, 0, 1), "-0.25 to 1"),
        ("a.obj", "510 0 51", (1, 0, 0.2), "0 to 2"),
        ("a.obj", "1.5 0 0.5", (1, 0, 0.5), "0 to 1.5"),
        ("a.ply", "1.5 0 0.5", (1, 0, 0.5), "0 to 1.5"),
        ("a.ply", "-1 0.25 0.5", (0, 0.25, 0.5), "-1 to 0.5"),
        ("a.glb", "2 0.5 0.25", (1, 0.5, 0.25), "0.25 to 2"),
    ],
)
def test_colors_out_of_range_are_clamped_and_named(
    tmp_path: Path, name: str, color: str, expected: tuple, noted: str
) -> None:
    if name == "a.obj":
        (tmp_path / name).write_text("".join(f"v {place} {color}\n" for place in PLACES) + "f 1 2 3\n")
    elif name == "a.ply":
        (tmp_path / name).write_text(triangle_ply(color, "float", ("red", "green", "blue")))
    else:
        (tmp_path / name).write_bytes(glb_with_colors(np.array([color.split()] * 3, np.float32)))
    with pytest.warns(SceneFileWarning, match=rf"clamped 1 value .*: colours of vertices \({noted}\)"):
        (shape,) = shapes_of(tmp_path / name)
    for own in shape.geometry.color.color:
        np.testing.assert_allclose(own, expected)
