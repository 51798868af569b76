"""Mesh files -> shapes: geometry, normals, colours, materials and hierarchy kept; nothing read from elsewhere."""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial

from jaxlight import Scene, SceneFileError, SceneFileWarning, load, save
from jaxlight.formats import read_nodes
from jaxlight.formats.mesh_graph import transform_from_matrix
from jaxlight.formats.mesh_materials import material_from_gltf, material_from_mtl
from jaxlight.scene import nodes as n
from jaxlight.scene.nodes import nodes_equal
from jaxlight.scene.transforms import transform_matrix

OBJ = """mtllib box.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vt 0.5 0.5
usemtl red
f 1/1 2/2 3/3
f 1/5 3/3 4/4
usemtl blue
f 1/1 2/2 5/5
"""
MTL = """newmtl red
Ka 0.2 0.1 0
Kd 0.8 0.4 0
Ks 0.25 0.5 1
Ke 0.1 0 0
Ns 32
d 0.75
illum 2
map_Kd -s 1 1 1 red.png
map_bump bumps.png
newmtl blue
Kd 0 0 1
Tr 0.5
"""


def shapes_of(path: Path) -> list[n.Shape]:
    return [placed.node for placed in load(path).document.shapes]


def triangles(geometry: n.Node) -> np.ndarray:
    """[triangles, 3 corners, xyz] of a face set."""
    assert isinstance(geometry, n.IndexedFaceSet) and geometry.coord is not None
    faces = geometry.coord_index.reshape(-1, 4)
    assert np.all(faces[:, 3] == -1)
    return geometry.coord.point[faces[:, :3]]


@pytest.fixture
def obj(tmp_path: Path) -> Path:
    (tmp_path / "box.obj").write_text(OBJ)
    (tmp_path / "box.mtl").write_text(MTL)
    Image.fromarray(np.array([[[255, 0, 0]], [[0, 255, 0]]], dtype=np.uint8)).save(tmp_path / "red.png")
    return tmp_path / "box.obj"


def test_obj_with_materials_texture_and_seams(obj: Path) -> None:
    with pytest.warns(SceneFileWarning, match="mtl map_bump x1"):
        red, blue = sorted(shapes_of(obj), key=lambda shape: shape.appearance.material.name, reverse=True)
    assert red.appearance is not None and blue.appearance is not None
    material = red.appearance.material
    assert material is not None and material.name == "red"
    assert material.diffuse_color == (0.8, 0.4, 0)
    assert material.specular_color == (0.25, 0.5, 1)
    assert material.emissive_color == (0.1, 0, 0)
    assert material.shininess == 32 / 128
    assert material.transparency == 0.25
    assert material.ambient_intensity == pytest.approx(0.25)
    assert red.appearance.texture is not None and red.appearance.texture.image is not None
    assert red.appearance.texture.image.tolist() == [[[0, 1, 0]], [[1, 0, 0]]]  # row 0 is the bottom
    geometry = red.geometry
    assert isinstance(geometry, n.IndexedFaceSet)
    expected = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
    assert np.array_equal(triangles(geometry), expected)
    assert len(geometry.coord.point) == 4
    corners = geometry.tex_coord_index.reshape(-1, 4)[:, :3]
    uv = geometry.tex_coord.point[corners]
    assert np.array_equal(uv, [[[0, 0], [1, 0], [1, 1]], [[0.5, 0.5], [1, 1], [0, 1]]])
    assert blue.appearance.material is not None
    assert (blue.appearance.material.diffuse_color, blue.appearance.material.transparency) == ((0, 0, 1), 0.5)
    assert blue.appearance.texture is None


@pytest.mark.filterwarnings("ignore::jaxlight.SceneFileWarning")
def test_what_an_obj_names_is_read_from_its_folder_only(obj: Path, tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    for reference in ("../box.mtl", str(tmp_path / "box.mtl"), "http://127.0.0.1:9/box.mtl"):
        (inside / "a.obj").write_text(OBJ.replace("box.mtl", reference))
        with pytest.warns(SceneFileWarning, match=r"outside the scene's folder|is an absolute path|is an address"):
            (shape,) = shapes_of(inside / "a.obj")[:1]
        assert nodes_equal(shape.appearance, n.Appearance(material=n.Material()))
    (inside / "a.obj").write_text(OBJ)
    (inside / "box.mtl").write_text(MTL.replace("-s 1 1 1 red.png", "../red.png"))
    with pytest.warns(SceneFileWarning, match="'../red.png' is outside the scene's folder"):
        assert all(shape.appearance.texture is None for shape in shapes_of(inside / "a.obj"))


def test_a_missing_material_library_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(OBJ)
    with pytest.warns(SceneFileWarning, match="'box.mtl': no such file"):
        load(tmp_path / "a.obj")


@pytest.mark.parametrize(
    "libraries", ["mtllib my red.mtl blue.MTL none.mtl\n", "mtllib my red.mtl\nmtllib none.mtl\nmtllib blue.MTL\n"]
)
def test_all_material_libraries_are_read_and_the_first_that_has_a_material_counts(
    tmp_path: Path, libraries: str
) -> None:
    (tmp_path / "my red.mtl").write_text("newmtl red\nKd 1 0 0")
    (tmp_path / "blue.MTL").write_text("newmtl red\nKd 0 1 0\nnewmtl blue\nKd 0 0 1")
    (tmp_path / "a.obj").write_text(OBJ.replace("mtllib box.mtl\n", libraries))
    with pytest.warns(SceneFileWarning, match="'none.mtl': no such file"):
        shapes = shapes_of(tmp_path / "a.obj")
    colors = {shape.appearance.material.name: shape.appearance.material.diffuse_color for shape in shapes}
    assert colors == {"red": (1, 0, 0), "blue": (0, 0, 1)}


def test_material_libraries_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.obj").write_text(OBJ + "".join(f"mtllib {number}.mtl\n" for number in range(1001)))
    with pytest.raises(SceneFileError, match="names more than 1000 material files"):
        load(tmp_path / "a.obj")
    monkeypatch.setattr("jaxlight.formats.mesh_folder.MAX_FILE_BYTES", len(MTL) + 10)
    for name in ("box.mtl", "more.mtl"):
        (tmp_path / name).write_text(MTL.replace("map_", "# "))
    (tmp_path / "a.obj").write_text(OBJ + "mtllib more.mtl\n")
    with pytest.warns(SceneFileWarning, match="more.mtl: material files of more than 0 MiB"):
        assert len(shapes_of(tmp_path / "a.obj")) == 2


@pytest.mark.parametrize("file_type", ["ply", "stl", "stl_ascii"])
def test_ply_and_stl(tmp_path: Path, file_type: str) -> None:
    box = trimesh.creation.box(extents=(1, 2, 3))
    content = box.export(file_type=file_type)
    path = tmp_path / f"box.{file_type[:3]}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    (shape,) = shapes_of(path)
    assert isinstance(shape.geometry, n.IndexedFaceSet) and shape.geometry.coord is not None
    assert len(shape.geometry.coord.point) == 8
    assert np.allclose(triangles(shape.geometry), box.triangles)
    assert not shape.geometry.solid
    assert shape.geometry.crease_angle == pytest.approx(np.pi / 3)
    assert nodes_equal(shape.appearance, n.Appearance(material=n.Material()))


def test_normals_of_a_file_are_kept(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    assert ball.vertex_normals.shape == ball.vertices.shape
    (tmp_path / "ball.ply").write_bytes(ball.export(file_type="ply", vertex_normal=True))
    (shape,) = shapes_of(tmp_path / "ball.ply")
    assert isinstance(shape.geometry, n.IndexedFaceSet) and shape.geometry.normal is not None
    assert np.allclose(shape.geometry.normal.vector, ball.vertex_normals, atol=1e-6)


# --- glTF -----------------------------------------------------------------------------------------------------------


def rewritten(glb: bytes, change: object) -> bytes:
    """The glb with its JSON header changed by a function."""
    length = struct.unpack_from("<I", glb, 12)[0]
    header = json.loads(glb[20 : 20 + length])
    change(header)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = glb[20 + length :]
    return struct.pack("<4s4I", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


MATRIX = trimesh.transformations.compose_matrix(
    scale=[1, 2, -3], angles=[0.1, 0.2, 0.3], translate=[1, 2, 3], shear=[0.1, 0.2, 0]
)


@pytest.fixture
def glb() -> bytes:
    box = trimesh.creation.box()
    pixels = Image.fromarray(np.array([[[255, 0, 0, 255]], [[0, 255, 0, 0]]], dtype=np.uint8))
    material = PBRMaterial(name="red", baseColorTexture=pixels)
    box.visual = trimesh.visual.TextureVisuals(uv=np.random.default_rng(0).random((8, 2)), material=material)
    scene = trimesh.Scene()
    turn = trimesh.transformations.rotation_matrix(np.pi, [1, 1, 0])
    scene.add_geometry(box, node_name="a", geom_name="box", transform=MATRIX)
    scene.graph.update(frame_from="a", frame_to="b", matrix=turn, geometry="box")
    scene.add_geometry(trimesh.creation.icosphere(subdivisions=1), node_name="c", geom_name="ball")
    return scene.export(file_type="glb")


def test_gltf_hierarchy_is_kept(tmp_path: Path, glb: bytes) -> None:
    (tmp_path / "a.glb").write_bytes(glb)
    read = read_nodes(tmp_path / "a.glb")
    (outer,) = [node for node in read.children if isinstance(node, n.Transform)]
    assert outer.name == "a"
    assert any(isinstance(child, n.Transform) and child.name == "b" for child in outer.children)
    scene = Scene.from_nodes(read.children)
    expected = trimesh.load_scene(tmp_path / "a.glb")
    placed = {tuple(np.round(shape.to_world.ravel(), 6)) for shape in scene.document.shapes}
    wanted = {tuple(np.round(expected.graph[name][0][:3].ravel(), 6)) for name in expected.graph.nodes_geometry}
    assert placed == wanted


def test_gltf_materials_are_exact_shared_and_named(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        header["materials"][0]["pbrMetallicRoughness"] |= {
            "baseColorFactor": [0.123456789, 0.5, 0.25, 0.5],
            "metallicFactor": 0.0,
            "roughnessFactor": 0.5,
        }

    (tmp_path / "a.glb").write_bytes(rewritten(glb, change))
    with pytest.warns(SceneFileWarning, match="glTF baseColorFactor under a texture"):
        scene = load(tmp_path / "a.glb")
    (red,) = [node for node in scene.document.materials if node.name == "red"]
    assert red.diffuse_color == (0.123456789, 0.5, 0.25)
    assert red.transparency == 0  # alphaMode is OPAQUE
    assert red.shininess == pytest.approx((2 / 0.5**4 - 2) / 128)
    (texture,) = scene.document.textures
    assert texture.image is not None
    assert texture.image.tolist() == [[[0, 1, 0]], [[1, 0, 0]]]  # opaque: without alpha; row 0 is the bottom
    boxes = [placed.node for placed in scene.document.shapes if placed.node.appearance.texture]
    assert len(boxes) == 2
    assert boxes[0] is boxes[1]
    assert boxes[0].geometry.solid


def test_gltf_alpha_and_double_sides(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        header["materials"][0] |= {"alphaMode": "BLEND", "doubleSided": True}
        header["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = [1, 1, 1, 0.25]

    (tmp_path / "a.glb").write_bytes(rewritten(glb, change))
    with pytest.warns(SceneFileWarning, match="glTF baseColorFactor under a texture"):
        scene = load(tmp_path / "a.glb")
    (box,) = {placed.node.geometry for placed in scene.document.shapes if placed.node.appearance.texture}
    assert not box.solid
    assert next(node for node in scene.document.materials if node.name == "red").transparency == 0.75
    assert scene.document.textures[0].image.shape == (2, 1, 4)


@pytest.mark.parametrize("blended_first", [True, False])
def test_one_image_under_two_alpha_modes_is_two_textures(tmp_path: Path, glb: bytes, blended_first: bool) -> None:
    def change(header: dict) -> None:
        (red,) = header["materials"]
        blended, opaque = red | {"name": "blended", "alphaMode": "BLEND"}, red | {"name": "opaque"}
        header["materials"] = [blended, opaque]
        (textured,) = [mesh for mesh in header["meshes"] if "material" in mesh["primitives"][0]]
        meshes = [
            {"name": f"m{row}", "primitives": [textured["primitives"][0] | {"material": row}]}
            for row in ((0, 1) if blended_first else (1, 0))
        ]
        header |= {"meshes": meshes, "nodes": [{"mesh": 0}, {"mesh": 1}], "scenes": [{"nodes": [0, 1]}]}

    (tmp_path / "a.glb").write_bytes(rewritten(glb, change))
    appearances = [shape.appearance for shape in shapes_of(tmp_path / "a.glb")]
    components = {a.material.name: a.texture.image.shape[2] for a in appearances}
    assert components == {"blended": 4, "opaque": 3}


def test_the_pixels_of_embedded_images_are_bounded_together(
    tmp_path: Path, glb: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    def change(header: dict) -> None:
        (red,) = header["materials"]
        header["images"] = header["images"] * 3
        header["textures"] = [{"source": i} for i in range(3)]
        header["materials"] = [
            red | {"pbrMetallicRoughness": {"baseColorTexture": {"index": i}}, "name": str(i)} for i in (0, 0, 1, 2)
        ]
        (textured,) = [mesh for mesh in header["meshes"] if "material" in mesh["primitives"][0]]
        primitives = [textured["primitives"][0] | {"material": row} for row in range(4)]
        header |= {"meshes": [{"primitives": primitives}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}]}

    monkeypatch.setattr("jaxlight.formats.x3d_textures.MAX_PIXELS", 4)  # two images of 2 x 1
    (tmp_path / "a.glb").write_bytes(rewritten(glb, change))
    with pytest.warns(SceneFileWarning, match="1 file not used: the scene's textures have more than 4 pixels together"):
        shapes = shapes_of(tmp_path / "a.glb")
    found = {s.appearance.material.name: s.appearance.texture is not None for s in shapes}
    assert found == {"0": True, "1": True, "2": False}


@pytest.mark.filterwarnings("ignore:.*colours of vertices:jaxlight.SceneFileWarning")  # positions stand for them
@pytest.mark.parametrize("colored_first", [True, False])
@pytest.mark.parametrize("unlit", [True, False])
def test_an_unlit_material_gives_way_to_the_colours_of_its_own_mesh_only(
    tmp_path: Path, glb: bytes, colored_first: bool, unlit: bool
) -> None:
    def change(header: dict) -> None:
        (red,) = header["materials"]
        red["pbrMetallicRoughness"] = {"baseColorFactor": [1, 0, 0, 1]}
        red["extensions"] = {"KHR_materials_unlit": {}} if unlit else {}
        (textured,) = [mesh for mesh in header["meshes"] if "material" in mesh["primitives"][0]]
        plain = textured["primitives"][0]
        positions = plain["attributes"]["POSITION"]
        colored = plain | {"attributes": {**plain["attributes"], "COLOR_0": positions}}
        pair = [{"name": "colored", "primitives": [colored]}, {"name": "plain", "primitives": [plain]}]
        meshes = pair if colored_first else pair[::-1]
        header |= {"meshes": meshes, "nodes": [{"mesh": 0}, {"mesh": 1}], "scenes": [{"nodes": [0, 1]}]}

    (tmp_path / "a.glb").write_bytes(rewritten(glb, change))
    materials = {shape.name: shape.appearance.material for shape in shapes_of(tmp_path / "a.glb")}
    if unlit:
        assert materials["colored"] is None
        assert materials["plain"].emissive_color == (1, 0, 0)
    else:
        assert materials["colored"] is materials["plain"] is not None


def below(*children: list[int]) -> list[dict]:
    """Nodes of a glTF header."""
    return [{"mesh": 0, "children": own} for own in children]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda h: h.update(extensionsRequired=["KHR_draco_mesh_compression"]), "needs the glTF extension KHR_draco"),
        (lambda h: h["accessors"][0].update(count=10**12), "announces 1.*, far more than its"),
        (lambda h: h["accessors"].append({"count": 10**6, "type": "VEC3", "componentType": 5126}), "announces 1"),
        (lambda h: h["accessors"][0].update(count=float("inf")), r"accessors\[0\].count: expected a whole .* got inf"),
        (
            lambda h: [a.update(count=s * 10**12) for a, s in zip(h["accessors"], (1, -1), strict=False)],
            r"glTF accessors\[1\].count: expected a whole number >= 0, got -1000000",
        ),
        (
            lambda h: h["accessors"][0].update(count=-1),
            r"glTF accessors\[0\].count: expected a whole number >= 0, got -1",
        ),
        (lambda h: h.update(materials=[1]), r"glTF materials\[0\]: expected an object, got 1"),
        (lambda h: h.update(scenes=[{"nodes": []}]), "holds no triangles"),
        (lambda h: h["accessors"][0].update(sparse={"count": 1}), "glTF accessor 0 is sparse"),
        (lambda h: h["bufferViews"][0].update(byteLength=3), "which end after .* bytes; its bufferView has 3"),
        (lambda h: h["nodes"][0].update(mesh=9), "glTF node 0 has 9 of the file's 2 meshes"),
        (lambda h: h["nodes"][0].update(mesh="x"), "glTF node 0 has 'x' of"),
        (lambda h: h["nodes"][0].update(children=[-1]), "glTF node 0 has -1 of the file's"),
        (
            lambda h: h.update(nodes=below([1, 2], [3], [3], [])),
            "glTF node 3 is a child of node 1 and of node 2;",
        ),
        (lambda h: h.update(nodes=below([1, 1], [])), "glTF node 1 is a child of node 0 and of node 0; a node has one"),
        (lambda h: h.update(nodes=below([], [2], [1])), "glTF node 2 stands below itself"),
        (lambda h: h["scenes"][0].update(nodes=[77]), "glTF scene 0 has 77 of"),
        (
            lambda h: h["nodes"][0].update(translation=[0, math.nan, 0]),
            r"nodes\[0\].translation: expected 3 finite numbers",
        ),
        (lambda h: h["meshes"][0]["primitives"][0].update(indices=88), "glTF mesh 0 has 88 of"),
    ],
)
def test_damaged_gltf_headers_are_errors(tmp_path: Path, glb: bytes, change: object, message: str) -> None:
    (tmp_path / "a.glb").write_bytes(rewritten(glb, change))
    with pytest.raises(SceneFileError, match=message):
        load(tmp_path / "a.glb")


PLY = b"""ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
3 %s 1 2
"""


@pytest.mark.parametrize(
    "change", [{"matrix": [0] * 16}, {"scale": [0, 1, 1]}, {"matrix": [1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}]
)
def test_what_is_scaled_to_nothing_is_left_out(tmp_path: Path, glb: bytes, change: dict) -> None:
    def added(header: dict) -> None:
        mesh = next(node["mesh"] for node in header["nodes"] if "mesh" in node)
        header["nodes"].append({"mesh": mesh, **change})
        header["scenes"][0]["nodes"].append(len(header["nodes"]) - 1)

    (tmp_path / "whole.glb").write_bytes(glb)
    (tmp_path / "a.glb").write_bytes(rewritten(glb, added))
    with pytest.warns(SceneFileWarning, match="node scaled to nothing, left out with its children x1"):
        assert len(shapes_of(tmp_path / "a.glb")) == len(shapes_of(tmp_path / "whole.glb"))


def test_primitives_and_targets_that_are_not_read_are_named(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        mesh = header["meshes"][0]
        mesh["primitives"] += [{**mesh["primitives"][0], "mode": mode} for mode in (2, 3, 6)]
        mesh["weights"] = [0.5]

    (tmp_path / "a.glb").write_bytes(rewritten(glb, change))
    expected = "glTF LINE_LOOP x1, glTF LINE_STRIP x1, glTF TRIANGLE_FAN x1; .*glTF weights of morph targets"
    with pytest.warns(SceneFileWarning, match=expected):
        load(tmp_path / "a.glb")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", b"not a mesh", "holds no triangles|not a obj file"),
        ("a.stl", b"solid x", "holds no triangles|not a stl file"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "holds no triangles|not a ply file"),
        ("a.glb", b"glTF\x02\x00\x00\x00", "truncated"),
        ("a.ply", b"v 0 0 0", "the content is not .ply"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "a.obj:4: an index is out of range: .* v index 9"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 0/1 2/1 3/1\n", "a.obj:5: a face has the index 0"),
        ("a.ply", PLY % b"-1", "a face has the index -1"),
        ("a.stl", bytes(80) + b"\x02\0\0\0" + bytes(60), "announces 2 triangles, which take 184"),
        ("a.obj", b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "a.obj:2: a v has '1 0 nan', expected finite numbers"),
    ],
)
def test_files_that_are_no_meshes(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneFileError, match=message):
        load(tmp_path / name)


@pytest.mark.parametrize("seed", range(20))
def test_every_matrix_that_can_be_inverted_becomes_a_transform(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    half_turn = trimesh.transformations.rotation_matrix(np.pi, rng.normal(size=3))[:3, :3]
    linear = [
        rng.normal(size=(3, 3)),  # any: rotation, stretch and shear, half of them mirrored
        turn @ np.diag(rng.normal(size=3)),
        half_turn,
        np.diag([-1.0, 1.0, 1.0]),
        turn * 1e-6,
    ][seed % 5]
    matrix[:3, :3], matrix[:3, 3] = linear, rng.normal(size=3)
    transform = transform_from_matrix(matrix)
    assert np.allclose(transform_matrix(transform), matrix[:3], atol=1e-9 * np.abs(linear).max(), rtol=1e-9)
    if seed % 5 in (1, 2, 4):
        assert transform.scale_orientation == (0, 0, 1, 0)


def test_mtl_rules_at_their_edges() -> None:
    plain = material_from_mtl("m", {}, 1.0)
    assert nodes_equal(plain, n.Material(name="m"))
    shiny = material_from_mtl(
        "m", {"ns": 500.0, "kd": [2, 0, 0], "ks": [1, 1, 1], "illum": ["1"], "ka": [9, 9, 9]}, 500
    )
    assert shiny.shininess == 1
    assert shiny.diffuse_color == (1, 0, 0)
    assert shiny.specular_color == (0, 0, 0)  # illum 1 has no highlights
    assert shiny.ambient_intensity == 1


def test_gltf_rules_at_their_edges() -> None:
    rough = material_from_gltf("m", {"pbrMetallicRoughness": {"metallicFactor": 0.0}}, see_through=False)
    assert rough.diffuse_color == (1, 1, 1)
    assert (rough.specular_color, rough.shininess) == ((0, 0, 0), 0)
    mirror = {"pbrMetallicRoughness": {"roughnessFactor": 0.0, "baseColorFactor": [0.5, 0.25, 0, 1]}}
    metal = material_from_gltf("m", mirror, see_through=True)
    assert metal.diffuse_color == (0, 0, 0)
    assert (metal.specular_color, metal.shininess) == ((1, 1, 0), 1)
    assert metal.transparency == 0


@pytest.mark.filterwarnings("ignore::jaxlight.SceneFileWarning")
def test_a_mesh_saved_as_x3d_comes_back(obj: Path, glb: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(glb)
    for path in (obj, tmp_path / "a.glb"):
        scene = load(path)
        save(scene, tmp_path / "saved.x3d")
        again = load(tmp_path / "saved.x3d")
        assert len(again.document.shapes) == len(scene.document.shapes)
        for ours, theirs in zip(scene.document.shapes, again.document.shapes, strict=True):
            assert np.allclose(ours.to_world, theirs.to_world, atol=1e-12)
            assert nodes_equal(ours.node.geometry, theirs.node.geometry)
        assert nodes_equal(scene.document.materials, again.document.materials)
        assert np.array_equal(scene.textures[0].image, again.textures[0].image)
