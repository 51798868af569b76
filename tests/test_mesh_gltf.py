"""What glTF says about textures beyond their pixels, and its extensions: applied, named, or refused."""

from __future__ import annotations

import json
import math
import re
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial

from jaxlight import SceneFileError, SceneFileWarning, load
from jaxlight.formats.mesh_materials import material_from_gltf
from jaxlight.scene import nodes as n
from test_mesh_damage import corners
from test_meshes import rewritten, shapes_of

UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
"""t up, as trimesh has them; in the file t points down."""
GLOSSY = "KHR_materials_pbrSpecularGlossiness"


@pytest.fixture
def glb() -> bytes:
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    image = Image.fromarray(np.arange(12, dtype=np.uint8).reshape(2, 2, 3))
    material = PBRMaterial(name="m", baseColorTexture=image)
    square.visual = trimesh.visual.TextureVisuals(uv=UV, material=material)
    return trimesh.Scene(square).export(file_type="glb")


def changed_texture(header: dict, transform: dict | None = None, wraps: dict | None = None, **use: int) -> None:
    (material,) = header["materials"]
    texture = material["pbrMetallicRoughness"]["baseColorTexture"]
    texture.update(use)
    if transform is not None:
        texture["extensions"] = {"KHR_texture_transform": transform}
        header["extensionsUsed"] = header["extensionsRequired"] = ["KHR_texture_transform"]
    if wraps is not None:
        header["samplers"] = [{}, wraps]
        header["textures"][texture["index"]]["sampler"] = 1


def one_shape(tmp_path: Path, data: bytes) -> n.Shape:
    (tmp_path / "a.glb").write_bytes(data)
    (shape,) = shapes_of(tmp_path / "a.glb")
    return shape


def transformed(down: np.ndarray, offset: tuple, rotation: float, scale: tuple) -> np.ndarray:
    """KHR_texture_transform as a product of matrices: translation rotation scale."""
    c, s = math.cos(rotation), math.sin(rotation)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    move = np.array([[1, 0, offset[0]], [0, 1, offset[1]], [0, 0, 1]])
    matrix = move @ turn @ np.diag([*scale, 1])
    return np.array([(matrix @ [u, v, 1])[:2] for u, v in down])


@pytest.mark.parametrize(
    ("offset", "rotation", "scale"),
    [((0.25, 0.5), 0.0, (1, 1)), ((0, 0), 0.5, (1, 1)), ((0, 1), 0, (1, -1)), ((0.1, -0.2), 2.0, (3.0, 0.5))],
)
def test_texture_transforms_are_applied(
    tmp_path: Path, glb: bytes, offset: tuple, rotation: float, scale: tuple
) -> None:
    transform = {"offset": offset, "rotation": rotation, "scale": scale}
    plain = one_shape(tmp_path, glb)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shape = one_shape(tmp_path, rewritten(glb, lambda header: changed_texture(header, transform)))
    before, after = (corners(s.geometry, "tex_coord", "point").reshape(-1, 2) for s in (plain, shape))
    down = before * (1, -1) + (0, 1)
    expected = transformed(down, offset, rotation, scale) * (1, -1) + (0, 1)
    assert np.allclose(after, expected, atol=1e-12)


def test_the_example_of_the_extension_shows_the_lower_left_quarter_turned(tmp_path: Path, glb: bytes) -> None:
    """ "This example utilizes only the lower left quadrant of the source image, rotated clockwise 90 degrees"."""
    transform = {"offset": [0, 1], "rotation": math.pi / 2, "scale": [0.5, 0.5]}
    shape = one_shape(tmp_path, rewritten(glb, lambda header: changed_texture(header, transform)))
    uv = corners(shape.geometry, "tex_coord", "point")
    square = {
        tuple(position[:2]): tuple(np.round(st, 9) + 0.0)
        for position, st in zip(
            corners(shape.geometry, "coord", "point").reshape(-1, 3), uv.reshape(-1, 2), strict=True
        )
    }
    # Turned clockwise, the image's lower left corner is at the upper left of the square.
    assert square == {(0, 1): (0, 0), (1, 1): (0, 0.5), (1, 0): (0.5, 0.5), (0, 0): (0.5, 0)}


@pytest.mark.parametrize(
    ("wraps", "repeats"),
    [
        ({}, (True, True)),
        ({"wrapS": 10497, "wrapT": 10497}, (True, True)),
        ({"wrapS": 33071}, (False, True)),
        ({"wrapT": 33071}, (True, False)),
        ({"wrapS": 33071, "wrapT": 33071}, (False, False)),
    ],
)
def test_samplers_clamp_or_repeat(tmp_path: Path, glb: bytes, wraps: dict, repeats: tuple[bool, bool]) -> None:
    shape = one_shape(tmp_path, rewritten(glb, lambda header: changed_texture(header, wraps=wraps)))
    texture = shape.appearance.texture
    assert (texture.repeat_s, texture.repeat_t) == repeats


def test_mirrored_textures_are_named(tmp_path: Path, glb: bytes) -> None:
    with pytest.warns(SceneFileWarning, match="glTF wrapT MIRRORED_REPEAT"):
        shape = one_shape(tmp_path, rewritten(glb, lambda header: changed_texture(header, wraps={"wrapT": 33648})))
    assert shape.appearance.texture.repeat_t


def test_one_image_clamped_and_repeated_is_two_textures(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        (material,) = header["materials"]
        (mesh,) = header["meshes"]
        header["samplers"] = [{"wrapS": 33071}]
        header["textures"] = [{"source": 0}, {"source": 0, "sampler": 0}]
        header["materials"] = [
            material | {"pbrMetallicRoughness": {"baseColorTexture": {"index": index}}} for index in (0, 1)
        ]
        mesh["primitives"] = [mesh["primitives"][0] | {"material": row} for row in (0, 1)]

    (tmp_path / "a.glb").write_bytes(rewritten(glb, change))
    assert {shape.appearance.texture.repeat_s for shape in shapes_of(tmp_path / "a.glb")} == {True, False}


@pytest.mark.parametrize("by_transform", [False, True])
def test_a_texture_takes_the_set_of_coordinates_that_it_names(tmp_path: Path, glb: bytes, by_transform: bool) -> None:
    def change(header: dict) -> None:
        (primitive,) = header["meshes"][0]["primitives"]
        second = primitive["attributes"].pop("TEXCOORD_0")
        primitive["attributes"] |= {"TEXCOORD_2": second}
        changed_texture(header, transform={"texCoord": 2} if by_transform else None, texCoord=1 if by_transform else 2)

    shape = one_shape(tmp_path, rewritten(glb, change))
    uv = corners(shape.geometry, "tex_coord", "point")
    assert np.array_equal(uv, corners(shape.geometry, "coord", "point")[:, :, :2])
    with pytest.raises(SceneFileError, match="glTF material 0 needs TEXCOORD_3, which a mesh has not"):
        one_shape(tmp_path, rewritten(glb, lambda header: changed_texture(header, texCoord=3)))


def test_texture_coordinates_of_integers_are_refused(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        (primitive,) = header["meshes"][0]["primitives"]
        header["accessors"][primitive["attributes"]["TEXCOORD_0"]] |= {"componentType": 5123, "normalized": True}

    with pytest.raises(SceneFileError, match="glTF material 0 has a TEXCOORD_0 of integers; jaxlight reads floats"):
        one_shape(tmp_path, rewritten(glb, change))


@pytest.mark.parametrize("name", ["KHR_materials_clearcoat", "KHR_lights_punctual", "KHR_texture_transform_2"])
def test_an_extension_that_is_needed_and_not_read_is_an_error(tmp_path: Path, glb: bytes, name: str) -> None:
    (tmp_path / "a.glb").write_bytes(rewritten(glb, lambda header: header.update(extensionsRequired=[name])))
    with pytest.raises(SceneFileError, match=f"needs the glTF extension {name}, .* it reads KHR_materials_unlit, "):
        load(tmp_path / "a.glb")


def test_extensions_that_are_used_and_not_read_are_named(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        header["extensionsUsed"] = ["EXT_mesh_gpu_instancing", "KHR_materials_clearcoat", "KHR_materials_unlit"]
        header["materials"][0]["extensions"] = {"KHR_materials_clearcoat": {"clearcoatFactor": 1}}

    with pytest.warns(SceneFileWarning, match="glTF EXT_mesh_gpu_instancing x1, glTF KHR_materials_clearcoat x1$"):
        one_shape(tmp_path, rewritten(glb, change))


def test_specular_glossiness(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        (material,) = header["materials"]
        texture = material.pop("pbrMetallicRoughness")["baseColorTexture"]
        glossy = {"diffuseFactor": [0.8, 0.4, 0.2, 0.5], "specularFactor": [0.25, 0.125, 0], "glossinessFactor": 0.5}
        glossy |= {"diffuseTexture": texture, "specularGlossinessTexture": texture}
        material |= {"alphaMode": "BLEND", "extensions": {GLOSSY: glossy}}
        header["extensionsUsed"] = header["extensionsRequired"] = [GLOSSY]

    with pytest.warns(SceneFileWarning, match="glTF specularGlossinessTexture x1$"):
        shape = one_shape(tmp_path, rewritten(glb, change))
    material, texture = shape.appearance.material, shape.appearance.texture
    exponent = 2 / 0.5**4 - 2
    specular = np.array([0.25, 0.125, 0])
    assert np.allclose(material.diffuse_color, np.array([0.8, 0.4, 0.2]) * 0.75 + specular * 0.5)
    assert np.allclose(material.specular_color, np.minimum(specular * 0.5 * (exponent + 8) / 8, 1))
    assert material.shininess == pytest.approx(exponent / 128)
    assert material.transparency == 0.5
    pixels = np.flipud(np.arange(12).reshape(2, 2, 3)) / 255
    assert np.array_equal(texture.image[:, :, :3], pixels)


def test_metallic_and_glossy_descriptions_of_a_metal_agree() -> None:
    color = [0.9, 0.6, 0.3]
    metal = {"pbrMetallicRoughness": {"baseColorFactor": [*color, 1], "roughnessFactor": 0.25}}
    glossy = {"diffuseFactor": [0, 0, 0, 1], "specularFactor": color, "glossinessFactor": 0.75}
    first = material_from_gltf("m", metal, see_through=False)
    second = material_from_gltf("m", {"extensions": {GLOSSY: glossy}}, see_through=False)
    for field in ("diffuse_color", "specular_color", "shininess", "transparency"):
        assert np.allclose(getattr(first, field), getattr(second, field))


@pytest.mark.parametrize("outside", [False, True])
def test_a_texture_that_is_no_image_is_named(tmp_path: Path, glb: bytes, outside: bool) -> None:
    def change(header: dict) -> None:
        if outside:
            header["images"] = [{"uri": "wood.png"}]

    (tmp_path / "wood.png").write_bytes(b"xx")
    name = "wood.png" if outside else "glTF image 0"
    with pytest.warns(SceneFileWarning, match=f"1 file not used: '{name}': no image that can be read"):
        assert one_shape(tmp_path, rewritten(glb.replace(b"\x89PNG", b"\x88PNG"), change)).appearance.texture is None


def test_primitives_that_share_numbers_are_bounded_together(
    tmp_path: Path, glb: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each becomes a mesh of its own, for a few bytes of the header."""
    for name, value in (("_MOST_ENTRIES", 10_000), ("_SHARED", 0.1)):
        monkeypatch.setattr(f"jaxlight.formats.gltf_checks.{name}", value)

    def repeated(header: dict) -> None:
        header["meshes"][0]["primitives"] *= 2000

    with pytest.raises(
        SceneFileError, match=r"its primitives have \d+ entries of accessors; .* at most 10000 are read"
    ):
        one_shape(tmp_path, rewritten(glb, repeated))


def attributes(header: dict) -> dict:
    return header["meshes"][0]["primitives"][0]["attributes"]


def textured(header: dict, use: object) -> None:
    header["materials"][0]["pbrMetallicRoughness"] = {"baseColorTexture": use}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda h: h["accessors"][0].update(count="three"),
            "accessors[0].count: expected a whole number >= 0, got 'three'",
        ),
        (lambda h: h["accessors"][0].update(type="FOO"), "accessors[0].type: expected 'SCALAR' or 'VEC2' or"),
        (lambda h: h["accessors"][0].pop("type"), "accessors[0]: expected an object with type, got {"),
        (lambda h: h["accessors"][0].update(componentType=[]), "accessors[0].componentType: expected 5120 or 5121 or"),
        (
            lambda h: h["accessors"][0].update(byteOffset=-4),
            "accessors[0].byteOffset: expected a whole number >= 0, got -4",
        ),
        (lambda h: h["accessors"][0].update(bufferView=99), "accessor 0 has 99 of the file's"),
        (
            lambda h: h["bufferViews"][0].update(byteOffset=-36),
            "bufferViews[0].byteOffset: expected a whole number >= 0",
        ),
        (lambda h: h["bufferViews"][0].update(buffer=5), "bufferView 0 has 5 of the file's 1 buffers"),
        (lambda h: h["bufferViews"][0].pop("byteLength"), "bufferViews[0]: expected an object with byteLength"),
        (lambda h: h["images"][0].update(bufferView="a"), "image 0 has 'a' of the file's"),
        (lambda h: h["textures"][0].update(source=1), "texture 0 has 1 of the file's 1 images"),
        (lambda h: h["meshes"][0].update(name={"a": 1}), "meshes[0].name: expected a string, got {'a': 1}"),
        (lambda h: h["meshes"][0].pop("primitives"), "meshes[0]: expected an object with primitives, got {"),
        (lambda h: h["meshes"][0]["primitives"][0].update(material=9), "mesh 0 has 9 of the file's 1 materials"),
        (lambda h: h["meshes"][0]["primitives"][0].update(material=-1), "mesh 0 has -1 of the file's 1 materials"),
        (lambda h: h["meshes"][0]["primitives"][0].update(mode="4"), "primitives[0].mode: expected a whole number >="),
        (
            lambda h: h["meshes"][0]["primitives"][0].pop("attributes"),
            "primitives[0]: expected an object with attributes",
        ),
        (lambda h: h["nodes"][0].update(scale=[1, 1]), "nodes[0].scale: expected 3 finite numbers, got [1, 1]"),
        (lambda h: h["nodes"][0].update(scale="big"), "nodes[0].scale: expected 3 finite numbers, got 'big'"),
        (lambda h: h["nodes"][0].update(rotation=[0, 0, 1]), "nodes[0].rotation: expected 4 finite numbers"),
        (lambda h: h["nodes"][0].update(translation=[1] * 4), "nodes[0].translation: expected 3 finite numbers"),
        (lambda h: h["nodes"][0].update(matrix=[1, 2]), "nodes[0].matrix: expected 16 finite numbers, got [1, 2]"),
        (lambda h: h["nodes"][0].update(children=1), "nodes[0].children: expected a list, got 1"),
        (lambda h: h["buffers"].append({"byteLength": 1}), "buffer 1 has no uri; only buffer 0 may stand in a glb"),
        (lambda h: h["nodes"][0].update(scale=[10**30, 0, math.inf]), "nodes[0].scale: expected 3 finite numbers"),
        (lambda h: h["bufferViews"][0].update(byteOffset=10**9), "bufferView 0 ends after 10"),
        (lambda h: h["buffers"][0].update(byteLength=10**9), "buffer 0 has 1000000000 bytes, the file holds"),
        (lambda h: h["accessors"][0].update(count=4), "mesh 0 has 4 corners of triangles; each needs 3"),
        (lambda h: h["accessors"][0].update(type="VEC2", count=3), "mesh 0 has indices of VEC2, expected SCALAR"),
        (lambda h: h["accessors"][0].update(componentType=5126), "mesh 0 has indices of floats"),
        (lambda h: attributes(h).update(POSITION=0), "mesh 0 has a POSITION of SCALAR, expected VEC3"),
        (lambda h: attributes(h).update(COLOR_0=2), "mesh 0 has a COLOR_0 of VEC2, expected VEC3 or VEC4"),
        (lambda h: h["accessors"][1].update(count=0), "mesh 0 has a POSITION without entries"),
        (
            lambda h: h["bufferViews"][1].update(byteStride=8),
            "accessor 1 has entries of 12 bytes; its bufferView has a byteStride of 8",
        ),
        (lambda h: h["bufferViews"][1].update(byteStride=0), "accessor 1 has entries of 12 bytes; its bufferView has"),
        (lambda h: h["asset"].update(version="1.0"), "glTF of version 1.0; jaxlight reads 2.0"),
        (lambda h: h["asset"].update(version="two"), "glTF of version two; jaxlight reads 2.0"),
        (
            lambda h: h["asset"].update(version="2.1", minVersion="2.1"),
            "needs a reader of glTF 2.1; jaxlight reads 2.0",
        ),
        (lambda h: h["asset"].update(minVersion="3.0"), "needs a reader of glTF 3.0; jaxlight reads 2.0"),
        (lambda h: h.update(scene=3), "header has 3 of the file's 1 scenes"),
        (lambda h: h.pop("scenes"), "glTF without scenes: nothing says which of its nodes are shown"),
        (lambda h: h.update(scenes=[]), "glTF without scenes: nothing says which of its nodes are shown"),
        (
            lambda h: h["nodes"][-1].update(matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2]),
            "has a matrix of last row [0.0, 0.0, 0.0, 2.0], expected [0, 0, 0, 1]",
        ),
        (lambda h: textured(h, {"index": "0"}), "material 0 has '0' of the file's 1 textures"),
        (
            lambda h: textured(h, {}),
            "materials[0].pbrMetallicRoughness.baseColorTexture: expected an object with index",
        ),
        (lambda h: textured(h, 0), "materials[0].pbrMetallicRoughness.baseColorTexture: expected an object, got 0"),
        (
            lambda h: changed_texture(h, {"scale": [1]}),
            "KHR_texture_transform.scale: expected 2 finite numbers, got [1]",
        ),
    ],
)
def test_values_of_other_types_are_named(tmp_path: Path, glb: bytes, change: object, message: str) -> None:
    with pytest.raises(SceneFileError, match=f"a.glb: .*{re.escape(message)}"):
        one_shape(tmp_path, rewritten(glb, change))


@pytest.mark.parametrize("name", ["NORMAL", "TEXCOORD_0", "TEXCOORD_1", "COLOR_0"])
@pytest.mark.parametrize("short", [False, True])
def test_attributes_of_other_counts_than_positions_are_named(
    tmp_path: Path, glb: bytes, name: str, short: bool
) -> None:
    def change(header: dict) -> None:
        (primitive,) = header["meshes"][0]["primitives"]
        own = primitive["attributes"]
        kept = own["TEXCOORD_0" if name.startswith("TEX") else "POSITION"]
        changed = kept if short else own["POSITION"]
        header["accessors"].append({**header["accessors"][changed], "count": 3})
        primitive["attributes"] = {"POSITION": own["POSITION"], name: kept}
        primitive["attributes"][name if short else "POSITION"] = len(header["accessors"]) - 1
        header["meshes"][0]["primitives"].insert(0, {"attributes": {}, "mode": 0})

    counts = f"{3 if short else 4} entries of {name} for {4 if short else 3} of POSITION"
    with pytest.raises(SceneFileError, match=f"a.glb: glTF mesh 0, primitive 1, has {counts}"):
        one_shape(tmp_path, rewritten(glb, change))


def test_what_has_no_material_has_that_of_an_empty_one(tmp_path: Path) -> None:
    """glTF 2.0, 3.7.2.1."""
    data = trimesh.Scene([trimesh.creation.box(), trimesh.creation.box()]).export(file_type="glb")

    def change(header: dict) -> None:
        header["materials"] = [{}]
        header["meshes"][0]["primitives"][0]["material"] = 0
        header["meshes"][1]["primitives"][0].pop("material", None)

    (tmp_path / "a.glb").write_bytes(rewritten(data, change))
    stated, assumed = shapes_of(tmp_path / "a.glb")
    assert n.nodes_equal((stated.appearance,), (assumed.appearance,))
    assert n.nodes_equal((assumed.appearance.material,), (material_from_gltf("", {}, see_through=False),))
    assert assumed.geometry.solid is stated.geometry.solid is True


def test_alpha_that_cuts_is_named(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        header["materials"] = [{"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.75]}}]

    with pytest.warns(SceneFileWarning, match=r"fields not used: glTF alphaMode MASK \(read as BLEND\) x1"):
        shape = one_shape(tmp_path, rewritten(glb, change))
    assert shape.appearance.material.transparency == 0.25


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        ({"roughnessFactor": None}, "roughnessFactor: expected a finite number, got None"),
        ({"metallicFactor": math.nan}, "metallicFactor: expected a finite number, got nan"),
        ({"baseColorFactor": "red"}, "baseColorFactor: expected 4 finite numbers, got 'red'"),
        ({"baseColorFactor": [0.5, 0.5]}, "baseColorFactor: expected 4 finite numbers, got [0.5, 0.5]"),
    ],
)
def test_factors_of_other_types_are_named(tmp_path: Path, glb: bytes, factors: dict, message: str) -> None:
    where = f"glTF materials[0].pbrMetallicRoughness.{message}"
    with pytest.raises(SceneFileError, match=re.escape(where)):
        one_shape(tmp_path, rewritten(glb, lambda h: h["materials"][0].update(pbrMetallicRoughness=factors)))


def test_factors_out_of_range_are_clamped_and_named(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        factors = {"baseColorFactor": [2, 0.5, -1, 1], "roughnessFactor": 1, "metallicFactor": 3}
        header["materials"] = [{"pbrMetallicRoughness": factors, "emissiveFactor": [0, 0, 4]}]

    said = r"clamped 3 values .*Roughness.baseColorFactor, .*Roughness.metallicFactor, .*materials\[0\].emissiveFactor$"
    with pytest.warns(SceneFileWarning, match=said):
        material = one_shape(tmp_path, rewritten(glb, change)).appearance.material
    assert (material.diffuse_color, material.emissive_color) == ((1, 0.5, 0), (0, 0, 1))


def test_a_node_with_a_camera_keeps_its_mesh_and_children(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        header["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}}]
        header["nodes"] = [{"camera": 0, "translation": [1, 0, 0], "children": [1]}, {"camera": 0, "mesh": 0}]
        header["scenes"] = [{"nodes": [0]}]

    (tmp_path / "a.glb").write_bytes(rewritten(glb, change))
    with pytest.warns(SceneFileWarning, match="glTF cameras x1"):
        (placed,) = load(tmp_path / "a.glb").document.shapes
    assert placed.to_world[:, 3].tolist() == [1, 0, 0]


def test_large_whole_numbers_are_numbers(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        glossy = {"glossinessFactor": 10**30}
        header["materials"] = [{"extensions": {GLOSSY: glossy}}]
        header["nodes"][0]["scale"] = [10**20] * 3

    with pytest.warns(SceneFileWarning, match="glossinessFactor"):
        assert one_shape(tmp_path, rewritten(glb, change)).appearance.material.shininess == 1


def test_later_versions_that_need_no_later_reader_are_read(tmp_path: Path, glb: bytes) -> None:
    change = {"version": "2.10", "minVersion": "2.0"}
    assert one_shape(tmp_path, rewritten(glb, lambda header: header["asset"].update(change))).geometry is not None


def test_texture_coordinates_of_integers_without_a_texture_are_left_out(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        header["materials"] = [{}]
        header["accessors"][attributes(header)["TEXCOORD_0"]] |= {"componentType": 5123, "normalized": True}

    assert one_shape(tmp_path, rewritten(glb, change)).geometry.tex_coord is None


def test_integers_may_be_written_as_decimals(tmp_path: Path, glb: bytes) -> None:
    """As glTF 2.0 says of its JSON encoding."""

    def change(value: object) -> object:
        if isinstance(value, dict):
            return {name: change(own) for name, own in value.items()}
        if isinstance(value, list):
            return [change(own) for own in value]
        return float(value) if type(value) is int else value

    whole = one_shape(tmp_path, glb)
    decimals = one_shape(tmp_path, rewritten(glb, lambda header: header.update(change(dict(header)))))
    np.testing.assert_array_equal(decimals.geometry.coord_index, whole.geometry.coord_index)
    np.testing.assert_array_equal(decimals.geometry.coord.point, whole.geometry.coord.point)
    assert decimals.appearance.texture is not None


def test_what_later_versions_add_is_left_out(tmp_path: Path, glb: bytes) -> None:
    """glTF's lists of words and modes are open, and a primitive need not have positions."""

    def change(header: dict) -> None:
        header["materials"][0]["alphaMode"] = "QUANTIZE"
        (primitive,) = header["meshes"][0]["primitives"]
        more = [{**primitive, "mode": 7}, {"attributes": {"_FOO": 0}}, {"attributes": {"TEXCOORD_0": 1}, "mode": 0}]
        header["meshes"][0]["primitives"] += more

    expected = "glTF POINTS x1, glTF mode 7 x1, glTF primitive without POSITION x1; .*alphaMode QUANTIZE"
    with pytest.warns(SceneFileWarning, match=expected):
        assert type(one_shape(tmp_path, rewritten(glb, change)).geometry) is n.IndexedFaceSet


def test_what_draws_no_triangles_need_not_be_readable(tmp_path: Path, glb: bytes) -> None:
    def change(header: dict) -> None:
        (primitive,) = header["meshes"][0]["primitives"]
        header["accessors"].append({**header["accessors"][attributes(header)["POSITION"]], "sparse": {}})
        points = {"attributes": {"POSITION": len(header["accessors"]) - 1}, "mode": 0}
        header["meshes"][0]["primitives"] = [points, primitive]

    with pytest.warns(SceneFileWarning, match="glTF POINTS x1"):
        assert one_shape(tmp_path, rewritten(glb, change)).geometry is not None


def test_buffers_beside_the_file_hold_entries_too(tmp_path: Path) -> None:
    """The header alone is far shorter than what it announces."""
    mesh = trimesh.creation.icosphere(subdivisions=4)
    files = trimesh.Scene(mesh).export(file_type="gltf")
    header = json.loads(files["model.gltf"])
    for buffer in header["buffers"]:
        (tmp_path / buffer["uri"]).write_bytes(files[buffer["uri"]])
    chunk = json.dumps(header).encode()
    chunk += b" " * (-len(chunk) % 4)
    (tmp_path / "a.glb").write_bytes(struct.pack("<4s4I", b"glTF", 2, 20 + len(chunk), len(chunk), 0x4E4F534A) + chunk)
    (shape,) = shapes_of(tmp_path / "a.glb")
    assert np.count_nonzero(shape.geometry.coord_index == -1) == len(mesh.faces)
    last = header["buffers"][-1]
    (tmp_path / last["uri"]).write_bytes(files[last["uri"]][:-1])
    held = f"'{last['uri']}' holds {last['byteLength'] - 1} of them: truncated"
    with pytest.raises(SceneFileError, match=rf"buffer \d+ has {last['byteLength']} bytes, {re.escape(held)}"):
        shapes_of(tmp_path / "a.glb")


def test_factors_that_round_beyond_1_are_not_named(tmp_path: Path, glb: bytes) -> None:
    factors = {"baseColorFactor": [1.0000001, 0.5, -1e-8, 1], "roughnessFactor": 1.0}
    data = rewritten(glb, lambda header: header.update(materials=[{"pbrMetallicRoughness": factors}]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert one_shape(tmp_path, data).appearance.material.diffuse_color == (1, 0.5, 0)
