"""TIFF files whose strips and tiles cover the picture are read; others are damaged."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from jaxlight import SceneFileError, read_image
from jaxlight.formats.images import read_levels


def write_tiff(path: Path, pixels: np.ndarray, tile: int, **attributes: Any) -> None:
    """By OpenImageIO; `tile` 0: in strips of 7 rows."""
    library = pytest.importorskip("OpenImageIO")
    height, width, components = pixels.shape
    spec = library.ImageSpec(width, height, components, str(pixels.dtype))
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("tiff:RowsPerStrip", 7)
    spec.tile_width = spec.tile_height = tile
    for name, value in attributes.items():
        spec.attribute(name, value)
    file = library.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_image(pixels)
    file.close()


@pytest.mark.parametrize("planes", ["contig", "separate"])
@pytest.mark.parametrize("tile", [0, 16])
@pytest.mark.parametrize("compression", ["none", "lzw", "zip", "packbits"])
@pytest.mark.parametrize(("kind", "components"), [("uint8", 1), ("uint8", 3), ("uint8", 4), ("uint16", 3)])
def test_strips_and_tiles_of_a_tiff_are_read_where_they_cover_it(
    tmp_path: Path, kind: str, components: int, compression: str, tile: int, planes: str
) -> None:
    largest = np.iinfo(kind).max
    pixels = np.random.default_rng(tile).integers(1, largest, (50, 37, components), dtype=kind)
    write_tiff(tmp_path / "a.tif", pixels, tile, compression=compression, planarconfig=planes)
    np.testing.assert_allclose(read_image(tmp_path / "a.tif"), pixels / largest, atol=1e-7)
    change_tag(tmp_path / "a.tif", 257, 700)
    with pytest.raises(SceneFileError, match="image"):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize(
    ("mode", "compression"),
    [
        *(("1", method) for method in (None, "tiff_lzw", "group4")),
        *(("L", method) for method in (None, "tiff_lzw", "tiff_adobe_deflate", "packbits", "jpeg")),
        *(("RGB", method) for method in (None, "tiff_lzw", "jpeg")),
        *((mode, None) for mode in ("P", "RGBA", "CMYK", "F", "LA")),
    ],
)
@pytest.mark.parametrize("strip", [1 << 16, 296])
def test_tiffs_of_pillow_are_read_where_they_are_whole(
    tmp_path: Path, mode: str, compression: str | None, strip: int
) -> None:
    """Strips of 8 rows, or all in one; of two pages the first one."""
    levels = np.random.default_rng(0).integers(0, 256, (50, 37, 3), dtype=np.uint8)
    pages = [Image.fromarray(levels).convert(mode), Image.new(mode, (5, 90))]
    bytes_a_row = {"1": 5, "RGB": 111, "LA": 74, "RGBA": 148, "CMYK": 148, "F": 148}.get(mode, 37)
    options = {"compression": compression, "strip_size": bytes_a_row * 8 if strip < 1 << 16 else strip}
    pages[0].save(tmp_path / "a.tif", save_all=True, append_images=pages[1:], **options)
    assert read_image(tmp_path / "a.tif").shape[:2] == (50, 37)
    change_tag(tmp_path / "a.tif", 257, 700)
    with pytest.raises(SceneFileError, match="image"):
        read_image(tmp_path / "a.tif")


def change_tag(path: Path, tag: int, value: int) -> None:
    """Let the first page of a TIFF say another number."""
    data = bytearray(path.read_bytes())
    (start,) = struct.unpack_from("<I", data, 4)
    for place in range(start + 2, start + 2 + 12 * struct.unpack_from("<H", data, start)[0], 12):
        if struct.unpack_from("<H", data, place)[0] == tag:
            struct.pack_into("<HII", data, place + 2, 4, 1, value)
    path.write_bytes(data)


def test_a_tiff_whose_strips_do_not_cover_it_is_not_read_as_black(tmp_path: Path) -> None:
    Image.new("RGB", (7, 9), (9, 9, 9)).save(tmp_path / "a.tif")
    change_tag(tmp_path / "a.tif", 257, 900_000)
    message = "damaged image: its 1 strips or tiles do not cover 7 x 900000 pixels"
    with pytest.raises(SceneFileError, match=message):
        read_image(tmp_path / "a.tif")
    Image.new("L", (7, 9), 9).save(tmp_path / "b.tif")
    change_tag(tmp_path / "b.tif", 257, 900_000)
    with pytest.raises(SceneFileError, match=message):
        read_levels(tmp_path / "b.tif")


def test_a_damaged_tiff_of_16_bits_is_told_in_words(tmp_path: Path) -> None:
    """Of what is compressed by zip OpenImageIO gives no reason."""
    write_tiff(tmp_path / "a.tif", np.full((16, 16, 3), 300, np.uint16), 0, compression="zip")
    with Image.open(tmp_path / "a.tif") as image:
        (strip, *_) = image.tag_v2[273]
    data = bytearray((tmp_path / "a.tif").read_bytes())
    data[strip : strip + 8] = bytes(8)
    (tmp_path / "a.tif").write_bytes(data)
    with pytest.raises(SceneFileError, match=r"damaged image: \S"):
        read_image(tmp_path / "a.tif")
