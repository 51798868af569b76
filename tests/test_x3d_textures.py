"""Textures that X3D files name: read from beside the file, absent and named otherwise."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jaxlight import SceneFileWarning, load, read_image
from jaxlight.formats import read_nodes
from jaxlight.scene import nodes as n
from x3d_text import x3d

TEXTURED = "<Shape><Appearance><ImageTexture url='{}'/></Appearance></Shape>"


def texture_of(path: Path, url: str) -> n.ImageTexture:
    path.write_text(x3d(TEXTURED.format(url)))
    (shape,) = read_nodes(path).children
    texture = shape.appearance.texture
    assert isinstance(texture, n.ImageTexture)
    return texture


def test_textures_come_from_beside_the_file_with_the_bottom_row_first(tmp_path: Path) -> None:
    pixels = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    (tmp_path / "maps").mkdir()
    Image.fromarray(pixels).save(tmp_path / "maps" / "a b.png")
    expected = pixels[::-1] / 255.0
    for url in ('"maps/a b.png"', '"maps/a%20b.png"', "maps/a b.png", '"missing.png" "./maps/a b.png"'):
        texture = texture_of(tmp_path / "scene.x3d", url)
        assert np.array_equal(texture.image, expected)


@pytest.mark.parametrize(
    ("url", "reason"),
    [
        ("missing.png", "no such file"),
        ("../secret.png", "outside the scene's folder"),
        ("link.png", "outside the scene's folder"),
        ("{absolute}", "is an absolute path; only files beside the scene are read"),
        ("{beside}", "is an absolute path; only files beside the scene are read"),
        ("C:\\\\secret.png", "is an absolute path"),
        ("http://127.0.0.1:9/a.png", "is an address"),
        ("file:///etc/passwd", "is an address"),
        ("note.png", "not an image"),
        ("data:image/png;base64,AAAA", "not an image"),
        ("\x7f" * 5000, "no such file"),
    ],
)
def test_textures_that_cannot_be_had_are_absent_and_named(tmp_path: Path, url: str, reason: str) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    Image.new("RGB", (2, 2)).save(tmp_path / "secret.png")
    (folder / "link.png").symlink_to(tmp_path / "secret.png")
    (folder / "note.png").write_text("not a picture")
    Image.new("RGB", (2, 2)).save(folder / "beside.png")
    url = url.format(absolute=tmp_path / "secret.png", beside=folder / "beside.png")
    with pytest.warns(SceneFileWarning, match=f"1 file not used.*{reason}.*line 3"):
        texture = texture_of(folder / "scene.x3d", f'"{url}"')
    assert texture.image is None


def test_a_texture_in_the_address_itself(tmp_path: Path) -> None:
    content = io.BytesIO()
    Image.new("RGB", (1, 1), (255, 0, 0)).save(content, "PNG")
    url = f"data:image/png;base64,{base64.b64encode(content.getvalue()).decode()}"
    texture = texture_of(tmp_path / "scene.x3d", f'"{url}"')
    assert texture.image is not None and texture.image.tolist() == [[[1, 0, 0]]]


def test_the_pixels_of_all_textures_are_bounded_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file counts once, and when the limit is passed no further file is decoded."""
    for name in "abcd":
        Image.new("RGB", (2, 1)).save(tmp_path / f"{name}.png")
    (tmp_path / "scene.x3d").write_text(x3d("".join(TEXTURED.format(f"{name}.png") for name in "aabcd")))
    monkeypatch.setattr("jaxlight.formats.x3d_textures.MAX_PIXELS", 4)
    decoded = []
    monkeypatch.setattr(
        "jaxlight.formats.x3d_textures.read_image", lambda path: decoded.append(path.stem) or read_image(path)
    )
    with pytest.warns(SceneFileWarning, match="2 files not used: the scene's textures have more than 4 pixels"):
        shapes = read_nodes(tmp_path / "scene.x3d").children
    there = [shape.appearance.texture.image is not None for shape in shapes]
    assert there == [True, True, True, False, False]
    assert decoded == ["a", "b", "c"]


def test_nodes_of_one_picture_share_its_pixels(tmp_path: Path) -> None:
    """Some bytes of a file must not cost the memory of a picture each."""
    Image.new("RGB", (2, 1)).save(tmp_path / "a.png")
    (tmp_path / "scene.x3d").write_text(x3d(TEXTURED.format("a.png").replace("/></Shape>", "/><Box/></Shape>") * 3))
    scene = load(tmp_path / "scene.x3d")
    assert len(scene.textures) == 3
    assert len({id(texture.image) for texture in scene.textures}) == 1
    assert len({id(node.image) for node in scene.document.textures}) == 1
    assert not np.asarray(scene.document.textures[0].image).flags.writeable
