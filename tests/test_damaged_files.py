"""Files that strangers damaged, by accident or on purpose, end in SceneFileError and in nothing else."""

from __future__ import annotations

import random
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from counted_work import at_most_calls
from jaxlight import SceneFileError, load
from test_mesh_damage import ply
from x3d_text import x3d

SEED = 20_240_817
TOKENS = [
    *(b'"', b"'", b"<", b">", b"/>", b"&", b"\0", b"\xff", b"", b"true", b"-->", b"]]>"),
    *(b"-1", b"nan", b"inf", b"1e999", b"9" * 30, b"0x7fffffff", b"-0", b"1e308", b"1e-320", b"0"),
    *(b'DEF="a"', b'USE="a"', b'<Group DEF="a">', b"</Group>", b"<LOD>", b"containerField='children'"),
]
EVERYTHING = x3d(
    """<Transform DEF='t' rotation='0 1 0 90'><SpotLight DEF='s'/><PointLight attenuation='1 1 1'/>
<Shape visible='false'><Appearance><Material DEF='m'/><ImageTexture url='"t.png" "x.png"'/><TextureTransform/>
</Appearance>
<IndexedFaceSet coordIndex='0 1 2 -1 0 2 3 -1' colorIndex='0 1 2 -1 0 1 2 -1' texCoordIndex='0 1 2 -1 0 1 2 -1'
 normalPerVertex='false' normalIndex='0 1'><Coordinate point='0 0 0 1 0 0 0 1 0 0 0 1'/>
<Color color='1 0 0, 0 1 0, 0 0 1'/><Normal vector='0 0 1 0 0 1'/><TextureCoordinate point='0 0 1 0 0 1'/>
</IndexedFaceSet></Shape></Transform>
<Shape><Appearance><Material USE='m'/><PixelTexture image='2 2 3 0xff0000 0x00ff00 0 1'/></Appearance>
<IndexedTriangleSet index='0 1 2'><Coordinate DEF='C' point='0 0 0 1 0 0 0 1 0'/></IndexedTriangleSet></Shape>
<Shape><TriangleSet><Coordinate USE='C'/><ColorRGBA color='1 0 0 1 0 1 0 1 0 0 1 .5'/></TriangleSet></Shape>
<LOD><Script><Sphere DEF='q'/></Script><Box/></LOD><Shape><Sphere USE='q'/></Shape><Fog visibilityRange='10'/>
<Background skyAngle='1' skyColor='0 0 0 1 1 1'/><Viewpoint/><NavigationInfo headlight='false'/>
<Switch whichChoice='0'><Group/></Switch><LayerSet activeLayer='1'><Layer><Group USE='t'/></Layer></LayerSet>""",
    version="4.0",
    head="<head><unit category='angle' name='degree' conversionFactor='0.0174'/></head>",
).replace("<Script><Sphere DEF='q'/></Script><Box/>", "<Script><Sphere DEF='q'/></Script>")
OBJ = """mtllib a.mtl
usemtl red
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
vt 0 0
vt 1 0
vt 0 1
vn 0 0 1
vn 0 1 0
f 1/1/1 2/2/1 3/3/1
usemtl blue
f 1/1/2 2/2/2 4/3/2
f 1 2 3 4
"""


def seeds(folder: Path) -> dict[str, bytes]:
    """A whole file of every format; what they name lies in the folder."""
    Image.new("RGB", (4, 4), (1, 2, 3)).save(folder / "t.png")
    (folder / "a.mtl").write_text("newmtl red\nKd 1 0 0\nmap_Kd t.png\nnewmtl blue\nKd 0 0 1\nd 0.5\nNs 20\n")
    box = trimesh.creation.box()
    plain = {"a.stl": box.export(file_type="stl"), "b.stl": box.export(file_type="stl_ascii").encode()}
    box.visual = trimesh.visual.ColorVisuals(box, vertex_colors=np.arange(32, dtype=np.uint8).reshape(8, 4))
    plain |= {"a.ply": box.export(file_type="ply"), "b.ply": box.export(file_type="ply", encoding="ascii")}
    material = trimesh.visual.material.PBRMaterial(
        name="red", baseColorFactor=[0.5, 0.2, 0.1, 1.0], baseColorTexture=Image.new("RGB", (4, 2), (255, 0, 0))
    )
    box.visual = trimesh.visual.TextureVisuals(uv=np.linspace(0, 1, 16).reshape(8, 2), material=material)
    scene = trimesh.Scene()
    turn = trimesh.transformations.rotation_matrix(1, [1, 2, 3])
    scene.add_geometry(box, node_name="a", transform=turn)
    scene.add_geometry(trimesh.creation.icosphere(subdivisions=0), node_name="b", parent_node_name="a")
    return {**plain, "a.glb": scene.export(file_type="glb"), "a.obj": OBJ.encode(), "a.x3d": EVERYTHING.encode()}


def damaged(whole: bytes, count: int, rng: random.Random) -> Iterator[bytes]:
    """Truncated, with bytes changed, pieces cut out, repeated or replaced by words that matter."""
    for _ in range(count):
        data = bytearray(whole)
        for _ in range(rng.choice([1, 1, 2, 5, 20])):
            start = rng.randrange(len(data) + 1)
            end = min(len(data), start + rng.choice([0, 1, 2, 5, 30, 300]))
            kind = rng.randrange(6)
            if kind == 0:
                data[start:end] = rng.choice(TOKENS)
            elif kind == 1:
                del data[start:end]
            elif kind == 2:
                data[start:end] = rng.randbytes(end - start)
            elif kind == 3:
                place = rng.randrange(len(data) + 1)
                data[place:place] = data[start:end]
            elif kind == 4 and rng.random() < 0.2:
                del data[start:]
        yield bytes(data)


@pytest.mark.parametrize("name", ["a.x3d", "a.obj", "a.ply", "b.ply", "a.stl", "b.stl", "a.glb"])
def test_damaged_files_give_a_scene_or_the_error(tmp_path: Path, name: str) -> None:
    rng = random.Random(SEED)
    whole = seeds(tmp_path)[name]
    path = tmp_path / name
    refused = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path.write_bytes(whole)
        assert load(path).document.shapes
        for data in damaged(whole, 800 if name == "a.x3d" else 150, rng):
            path.write_bytes(data)
            try:
                load(path)
            except SceneFileError as error:
                refused += 1
                assert str(error).startswith(str(path)) and "\n" not in str(error)
    assert refused > 20


def test_every_truncation_of_an_x3d_file_is_the_error(tmp_path: Path) -> None:
    whole = EVERYTHING.encode()
    path = tmp_path / "a.x3d"
    last = whole.rindex(b">")
    for length in [*range(0, 200), *range(200, last, 37), last]:
        path.write_bytes(whole[:length])
        with pytest.raises(SceneFileError):
            load(path)


BOMBS = {
    "comments before html": b"<!---->" * 1200 + b"<X3D>",
    "one huge quote": x3d(
        "<Shape><Appearance><ImageTexture url='\"" + '\\"' * 500_000 + "'/></Appearance></Shape>"
    ).encode(),
    "a huge name": x3d(f"<Group USE='{'a' * 1_000_000}'/>").encode(),
    "many unknown names": x3d("".join(f"<N{i}/>" for i in range(20_000))).encode(),
    "a huge image": x3d("<Shape><Appearance><PixelTexture image='8000 8000 4 0'/></Appearance></Shape>").encode(),
    "huge integers": x3d(f"<Switch whichChoice='{'9' * 100_000}'/>").encode(),
    "a long chain of detours": x3d(
        "".join(f"<Text><Group DEF='g{i}'><Group USE='g{i + 1}'/></Group></Text>" for i in range(5000))
        + "<Group USE='g0'/>"
    ).encode(),
}


@pytest.mark.parametrize("name", BOMBS)
def test_files_made_to_hang_or_flood_do_not(tmp_path: Path, name: str) -> None:
    path = tmp_path / "bomb.x3d"
    path.write_bytes(BOMBS[name])
    said = ""
    with warnings.catch_warnings(record=True) as caught, at_most_calls(2_000_000):
        warnings.simplefilter("always")
        try:
            load(path)
        except SceneFileError as error:
            said = str(error)
    assert said or caught
    assert all(len(text) < 5000 for text in [said, *(str(warning.message) for warning in caught)])


@pytest.mark.parametrize(
    ("face", "message"),
    [
        ("3 0 1 5", "a.ply:17: an index is out of range: a face has the index 5, the file 5 vertices"),
        ("3 0 1 -1", "a.ply:17: an index is out of range: a face has the index -1, the file 5 vertices"),
        ("3 0 1 1.5", "a.ply:17: a face has vertex_indices 1.5, expected a whole number from -2147483648 to"),
        ("3 0 1 nan", "a.ply:17: a face has vertex_indices nan, expected a whole number"),
        ("3 0 1 1_0", "a.ply:17: a face has not all of its 1 properties"),
        (
            "2.5 0 1 2",
            "a.ply:17: a face has a list vertex_indices of the size 2.5, expected a whole number from 0 to 255",
        ),
        (
            "-1 0 1 2",
            "a.ply:17: a face has a list vertex_indices of the size -1, expected a whole number from 0 to 255",
        ),
    ],
)
def test_indices_of_an_ascii_ply_that_are_none_are_errors_with_line(tmp_path: Path, face: str, message: str) -> None:
    (tmp_path / "a.ply").write_bytes(ply("ascii", [(0, 1, 2)] * 2) + f"{face}\n".encode())
    text = (tmp_path / "a.ply").read_text().replace("element face 2", "element face 3")
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(SceneFileError, match=message):
        load(tmp_path / "a.ply")
