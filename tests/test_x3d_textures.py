"""Textures that X3D files name: read from beside the file, absent and named otherwise."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jaxlight import SceneFileWarning
from jaxlight.formats import read_nodes
from jaxlight.scene import nodes as n
from x3d_text import x3d

TEXTURED = "<Shape><Appearance><ImageTexture url='{}'/></Appearance></Shape>"


def texture_of(path: Path, url: str) -> n.ImageTexture:
    path.write_text(x3d(TEXTURED.format(url)))
    (shape,) = read_nodes(path).children
    texture = shape.appearance.texture  # type: ignore[attr-defined]
    assert isinstance(texture, n.ImageTexture)
    return texture


def test_textures_come_from_beside_the_file_with_the_bottom_row_first(tmp_path: Path) -> None:
    pixels = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    (tmp_path / "maps").mkdir()
    Image.fromarray(pixels).save(tmp_path / "maps" / "a b.png")
    expected = pixels[::-1] / 255.0
    for url in ('"maps/a b.png"', '"maps/a%20b.png"', "maps/a b.png", '"missing.png" "./maps/a b.png"'):
        texture = texture_of(tmp_path / "scene.x3d", url)
        assert np.array_equal(texture.image, expected)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("url", "reason"),
    [
        ("missing.png", "no such file"),
        ("../secret.png", "outside the scene's folder"),
        ("link.png", "outside the scene's folder"),
        ("{absolute}", "outside the scene's folder"),
        ("C:\\\\secret.png", "outside the scene's folder"),
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
    url = url.replace("{absolute}", str(tmp_path / "secret.png"))
    with pytest.warns(SceneFileWarning, match=f"1 file not used.*{reason}.*line 3"):
        texture = texture_of(folder / "scene.x3d", f'"{url}"')
    assert texture.image is None


def test_a_texture_in_the_address_itself(tmp_path: Path) -> None:
    content = io.BytesIO()
    Image.new("RGB", (1, 1), (255, 0, 0)).save(content, "PNG")
    url = f"data:image/png;base64,{base64.b64encode(content.getvalue()).decode()}"
    texture = texture_of(tmp_path / "scene.x3d", f'"{url}"')
    assert texture.image is not None and texture.image.tolist() == [[[1, 0, 0]]]
