"""Colours of the vertices and faces of mesh files: all of their digits."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from jaxlight.scene import nodes as n
from test_meshes import rewritten, shapes_of


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


@pytest.mark.parametrize("with_material", [False, True])
@pytest.mark.parametrize(("kind", "dtype"), [(5121, np.uint8), (5123, np.uint16), (5126, np.float32)])
def test_colors_of_a_glb_keep_all_their_digits(tmp_path: Path, kind: int, dtype: Any, with_material: bool) -> None:
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    colors = np.array([[10, 20, 250, 255], [1, 2, 3, 255], [77, 88, 99, 255]])
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=colors.astype(np.uint8))
    own = colors / 255 * (1 if dtype == np.float32 else np.iinfo(dtype).max)
    own = (own if dtype == np.float32 else np.round(own)).astype(dtype)
    own[:, :3] -= np.asarray(0.001 if dtype == np.float32 else 1, dtype)
    data = trimesh.Scene(mesh).export(file_type="glb")
    length = struct.unpack_from("<I", data, 12)[0]
    rest = data[20 + length + 8 :]
    rest += b"\0" * (-len(rest) % 4)

    def change(header: dict) -> None:
        header["bufferViews"].append({"buffer": 0, "byteOffset": len(rest), "byteLength": own.nbytes})
        accessor = {"bufferView": len(header["bufferViews"]) - 1, "componentType": kind, "type": "VEC4", "count": 3}
        header["accessors"].append({**accessor, "normalized": dtype != np.float32})
        header["buffers"][0]["byteLength"] = len(rest) + own.nbytes
        primitive = header["meshes"][0]["primitives"][0]
        primitive["attributes"]["COLOR_0"] = len(header["accessors"]) - 1
        primitive.pop("material", None)
        if with_material:
            header["materials"] = [{}]
            primitive["material"] = 0

    changed = rewritten(data, change)
    head = struct.unpack_from("<I", changed, 12)[0]
    chunk = rest + own.tobytes()
    changed = changed[: 20 + head] + struct.pack("<I", len(chunk)) + b"BIN\0" + chunk
    (tmp_path / "a.glb").write_bytes(changed)
    (shape,) = shapes_of(tmp_path / "a.glb")
    largest = 1 if dtype == np.float32 else np.iinfo(dtype).max
    np.testing.assert_allclose(shape.geometry.color.color, own[:, :3] / largest, rtol=1e-6)
    assert (shape.appearance.material.diffuse_color == (0.8, 0.8, 0.8)) == (not with_material)


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
