"""Image files <-> arrays: rows, components, depths, limits, and errors that say what is wrong."""

from __future__ import annotations

import builtins
import errno
import os
import re
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from jaxlight import SceneFileError, read_image, write_image
from jaxlight.formats.images import decode_image
from jaxlight.formats.quantize import quantize


def test_rows_start_at_the_top_and_values_lie_in_the_unit_interval(tmp_path: Path) -> None:
    pixels = np.array([[[255, 0, 0], [0, 51, 0]]], dtype=np.uint8).repeat(2, axis=0)
    pixels[1] = 102
    Image.fromarray(pixels).save(tmp_path / "a.png")
    image = read_image(tmp_path / "a.png")
    assert image.dtype == np.float64
    assert image.tolist() == [[[1, 0, 0], [0, 0.2, 0]], [[0.4] * 3] * 2]


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("components", [1, 2, 3, 4])
def test_png_comes_back_exactly(tmp_path: Path, components: int, bits: int) -> None:
    if bits == 16 and components > 1:
        pytest.importorskip("OpenImageIO")
    rng = np.random.default_rng(components)
    image = rng.integers(0, 2**bits, (5, 4, components)) / (2**bits - 1)
    write_image(tmp_path / "a.png", image, bits=bits)
    again = read_image(tmp_path / "a.png")
    assert again.shape == image.shape
    assert np.array_equal(np.rint(again * (2**bits - 1)), np.rint(image * (2**bits - 1)))
    assert np.allclose(again, image, atol=1e-7, rtol=0)


@pytest.mark.parametrize(("bits", "kind"), [(8, np.uint8), (16, np.uint16)])
def test_integers_are_numbers_rounded_and_clamped(bits: Any, kind: type) -> None:
    largest = 2**bits - 1
    levels = np.arange(largest + 1)
    assert quantize(levels / largest, bits).dtype == kind
    assert np.array_equal(quantize(levels / largest, bits), levels)
    assert np.array_equal(quantize(np.float32(levels / largest), bits), levels)
    beyond = np.array([-1, 0.4999, 0.5001, 7 * largest]) / largest
    assert quantize(beyond, bits).tolist() == [0, 0, 1, largest]
    assert quantize([0.5 / 255, 1.5 / 255]).tolist() == [0, 2]  # halves to the even one


def test_writing_rounds_and_clamps(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.array([[-1, 0.5, 100.4 / 255, 100.6 / 255, 7]]))
    assert np.rint(read_image(tmp_path / "a.png")[0, :, 0] * 255).tolist() == [0, 128, 100, 101, 255]


@pytest.mark.parametrize("kind", [bool, np.int32])
def test_whole_numbers_up_to_1_are_written(tmp_path: Path, kind: type) -> None:
    write_image(tmp_path / "a.png", np.array([[0, 1]], kind))
    assert read_image(tmp_path / "a.png")[0, :, 0].tolist() == [0, 1]


def test_exr_holds_any_number(tmp_path: Path) -> None:
    pytest.importorskip("OpenImageIO")
    image = np.array([[[1e-5, 2, -3], [1000, 0, 0.1], [np.inf, -np.inf, np.finfo(np.float32).max]]], dtype=np.float32)
    write_image(tmp_path / "a.exr", image)
    assert np.array_equal(read_image(tmp_path / "a.exr"), image)


@pytest.mark.parametrize("suffix", ["exr", "png"])
def test_the_content_is_read_and_not_a_file_of_that_name(tmp_path: Path, suffix: str) -> None:
    """What a `data:` address holds has no file."""
    pytest.importorskip("OpenImageIO")
    image = np.random.default_rng(0).integers(0, 2**16, (3, 2, 3)) / 65535
    write_image(tmp_path / f"a.{suffix}", image, bits=8 if suffix == "exr" else 16)
    decoded = decode_image((tmp_path / f"a.{suffix}").read_bytes(), tmp_path / "nowhere")
    np.testing.assert_allclose(decoded, image, atol=1e-7)


def test_an_exr_is_read_in_its_whole_window(tmp_path: Path) -> None:
    library = pytest.importorskip("OpenImageIO")
    for left, top, shown in ((5, 3, slice(None)), (-1, -2, slice(2, None))):
        spec = library.ImageSpec(4, 6, 3, "float")
        spec.x, spec.y, spec.full_width, spec.full_height = left, top, 12, 10
        held = np.random.default_rng(0).uniform(size=(6, 4, 3)).astype(np.float32)
        file = library.ImageOutput.create(str(tmp_path / "a.exr"))
        assert file.open(str(tmp_path / "a.exr"), spec) and file.write_image(held)
        file.close()
        image = read_image(tmp_path / "a.exr")
        assert image.shape == (10, 12, 3)
        place = np.zeros((10, 12, 3))
        place[max(top, 0) : top + 6, max(left, 0) : left + 4] = held[shown, 1 if left < 0 else 0 :]
        np.testing.assert_array_equal(image, place)


def test_an_exr_of_many_channels_is_read_in_those_of_its_picture(tmp_path: Path) -> None:
    library = pytest.importorskip("OpenImageIO")
    spec = library.ImageSpec(2, 2, 40, "half")
    spec.channelnames = tuple(["R", "G", "B"] + [f"x{i}" for i in range(37)])
    file = library.ImageOutput.create(str(tmp_path / "a.exr"))
    assert file.open(str(tmp_path / "a.exr"), spec) and file.write_image(np.full((2, 2, 40), 0.5, np.float32))
    file.close()
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), np.full((2, 2, 3), 0.5))


@pytest.mark.parametrize(
    ("names", "read"),
    [
        (("diffuse.R", "diffuse.G", "diffuse.B", "specular.R", "specular.G", "specular.B"), (0, 1, 2)),
        (("Z", "albedo.A", "albedo.B", "albedo.G", "albedo.R"), (4, 3, 2, 1)),
        (("motion.R", "motion.G", "normal.X", "normal.Y", "normal.Z"), (0, 1)),
    ],
)
def test_an_exr_of_layers_is_read_in_the_first_of_them(
    tmp_path: Path, names: tuple[str, ...], read: tuple[int, ...]
) -> None:
    library = pytest.importorskip("OpenImageIO")
    spec = library.ImageSpec(2, 2, len(names), "float")
    spec.channelnames = names
    pixels = np.tile(np.arange(len(names), dtype=np.float32), (2, 2, 1))
    file = library.ImageOutput.create(str(tmp_path / "a.exr"))
    assert file.open(str(tmp_path / "a.exr"), spec) and file.write_image(pixels)
    file.close()
    image = read_image(tmp_path / "a.exr")
    np.testing.assert_array_equal(image[0, 0], read)


def test_jpeg_is_close_and_has_no_alpha(tmp_path: Path) -> None:
    ramp = np.linspace(0, 1, 32)[None, :, None] * np.ones((32, 1, 3))
    write_image(tmp_path / "a.jpg", ramp)
    assert np.abs(read_image(tmp_path / "a.jpg") - ramp).max() < 4 / 255
    with pytest.raises(ValueError, match="JPEG has no alpha"):
        write_image(tmp_path / "a.jpg", np.zeros((2, 2, 4)))


@pytest.mark.parametrize(("mode", "components"), [("1", 1), ("L", 1), ("LA", 2), ("P", 3), ("RGB", 3), ("CMYK", 3)])
def test_modes_become_components(tmp_path: Path, mode: str, components: int) -> None:
    suffix = "tif" if mode == "CMYK" else "png"
    Image.new(mode, (3, 2)).save(tmp_path / f"a.{suffix}")
    assert read_image(tmp_path / f"a.{suffix}").shape == (2, 3, components)


def test_a_transparent_palette_color_is_alpha(tmp_path: Path) -> None:
    image = Image.new("P", (1, 1))
    image.putpalette([10, 20, 30])
    image.save(tmp_path / "a.png", transparency=0)
    assert np.rint(read_image(tmp_path / "a.png") * 255).tolist() == [[[10, 20, 30, 0]]]


@pytest.mark.parametrize("mark", range(1, 9))
def test_a_cameras_rotation_mark_is_obeyed(tmp_path: Path, mark: int) -> None:
    """By Exif: where the first row and the first column of the file are seen."""
    seen = np.arange(6)[:, None].reshape(2, 3, 1).repeat(3, axis=2) * 10
    stored = seen if mark < 5 else seen.swapaxes(0, 1)  # the first row is then a column that is seen
    stored = stored[:: -1 if mark in (3, 4, 6, 7) else 1, :: -1 if mark in (2, 3, 7, 8) else 1]
    exif = Image.Exif()
    exif[274] = mark
    Image.fromarray(stored.astype(np.uint8)).save(tmp_path / "a.png", exif=exif)
    np.testing.assert_array_equal(np.rint(read_image(tmp_path / "a.png") * 255), seen)
    pytest.importorskip("OpenImageIO")
    write_image(tmp_path / "deep.png", stored / 65535, bits=16)
    plain = (tmp_path / "deep.png").read_bytes()
    header = len(PNG_START) + 25
    marked = plain[:header] + png_chunk(b"eXIf", exif.tobytes().removeprefix(b"Exif\0\0")) + plain[header:]
    (tmp_path / "deep.png").write_bytes(marked)
    np.testing.assert_array_equal(np.rint(read_image(tmp_path / "deep.png") * 65535), seen)


PNG_START = b"\x89PNG\r\n\x1a\n"


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@pytest.mark.parametrize(("depth", "row", "levels"), [(1, 0x40, [0, 1]), (2, 0x1B, [0, 1, 2, 3]), (4, 0x5A, [5, 10])])
def test_the_transparent_grey_of_a_png_of_few_bits_has_alpha_0(
    tmp_path: Path, depth: int, row: int, levels: list[int]
) -> None:
    """PNG 11.3.2: its level is one of the file's."""
    for clear in levels:
        size = png_chunk(b"IHDR", struct.pack(">IIBBBBB", len(levels), 1, depth, 0, 0, 0, 0))
        pixels = png_chunk(b"IDAT", zlib.compress(bytes([0, row]))) + png_chunk(b"IEND", b"")
        (tmp_path / "a.png").write_bytes(PNG_START + size + png_chunk(b"tRNS", struct.pack(">H", clear)) + pixels)
        grey = np.array(levels)
        expected = np.stack([grey / (2**depth - 1), grey != clear], axis=-1)
        np.testing.assert_allclose(read_image(tmp_path / "a.png")[0], expected, atol=1e-15)


@pytest.mark.parametrize("kind", ["uint8", "uint16"])
def test_colours_of_a_tiff_are_not_multiplied_by_its_alpha(tmp_path: Path, kind: str) -> None:
    library = pytest.importorskip("OpenImageIO")
    color, alpha = np.array([[[0.6, 0.4, 1.0]] * 3]), np.array([[[1.0], [0.5], [0.0]]])
    file = library.ImageOutput.create(str(tmp_path / "a.tif"))
    assert file.open(str(tmp_path / "a.tif"), library.ImageSpec(3, 1, 4, kind))
    assert file.write_image(np.concatenate([alpha * color, alpha], axis=2).astype(np.float32))
    file.close()
    expected = np.concatenate([np.where(alpha > 0, color, 0), alpha], axis=2)
    np.testing.assert_allclose(read_image(tmp_path / "a.tif"), expected, atol=1 / 128)


@pytest.mark.parametrize("components", [3, 4])
def test_a_tiff_of_16_bits_keeps_them(tmp_path: Path, components: int) -> None:
    library = pytest.importorskip("OpenImageIO")
    pixels = np.random.default_rng(components).integers(0, 2**16, (3, 4, components)).astype(np.uint16)
    spec = library.ImageSpec(4, 3, components, "uint16")
    spec.attribute("oiio:UnassociatedAlpha", 1)
    file = library.ImageOutput.create(str(tmp_path / "a.tif"))
    assert file.open(str(tmp_path / "a.tif"), spec) and file.write_image(pixels)
    file.close()
    np.testing.assert_allclose(read_image(tmp_path / "a.tif"), pixels / 65535, atol=1e-7)


@pytest.mark.parametrize("left", [40, 0.5])
def test_of_a_damaged_exr_the_message_names_no_other_file(tmp_path: Path, left: float) -> None:
    pytest.importorskip("OpenImageIO")
    write_image(tmp_path / "a.exr", np.random.default_rng(0).uniform(size=(20, 20, 3)))
    data = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(data[: left if left > 1 else int(left * len(data))])
    with pytest.raises(SceneFileError, match=r"a\.exr: (not an image that can be read|damaged image)") as told:
        read_image(tmp_path / "a.exr")
    assert str(told.value).count("/") == str(tmp_path / "a.exr").count("/")


def test_bytes_of_a_damaged_exr_that_are_no_text_are_the_error(tmp_path: Path) -> None:
    pytest.importorskip("OpenImageIO")
    write_image(tmp_path / "a.exr", np.ones((2, 3, 3)))
    (tmp_path / "a.exr").write_bytes((tmp_path / "a.exr").read_bytes().replace(b"chlist\0", b"chlis\xff\0"))
    with pytest.raises(SceneFileError, match=r"a\.exr: .*image.*chlis") as caught:
        read_image(tmp_path / "a.exr")
    assert "codec" not in str(caught.value)


def test_signalling_nan_of_an_exr_is_nan_without_a_word(tmp_path: Path) -> None:
    library = pytest.importorskip("OpenImageIO")
    spec = library.ImageSpec(3, 2, 3, "float")
    spec.attribute("compression", "none")
    file = library.ImageOutput.create(str(tmp_path / "a.exr"))
    assert file.open(str(tmp_path / "a.exr"), spec) and file.write_image(np.full((2, 3, 3), 0.375, np.float32))
    file.close()
    data = (tmp_path / "a.exr").read_bytes()
    assert data.count(struct.pack("<f", 0.375)) == 18
    (tmp_path / "a.exr").write_bytes(data.replace(struct.pack("<f", 0.375), struct.pack("<I", 0x7F800001)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(read_image(tmp_path / "a.exr")).all()


@pytest.mark.parametrize("bits", [8, 16])
def test_a_tiff_in_which_0_is_white_is_no_negative(tmp_path: Path, bits: int) -> None:
    levels = np.array([[0, 1, 2**bits - 1]])
    data = levels.astype(f"<u{bits // 8}").tobytes()
    tags = ((256, 3), (257, 1), (258, bits), (259, 1), (262, 0), (273, 8), (277, 1), (278, 1), (279, len(data)))
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    head = struct.pack("<2sHI", b"II", 42, 8 + len(data))
    (tmp_path / "a.tif").write_bytes(head + data + struct.pack("<H", len(tags)) + entries + b"\0" * 4)
    np.testing.assert_allclose(read_image(tmp_path / "a.tif")[:, :, 0], 1 - levels / (2**bits - 1), atol=1e-15)


def png_of_size(width: int, height: int) -> bytes:
    """A PNG that announces a size and holds no such data."""
    header = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return PNG_START + header + png_chunk(b"IDAT", zlib.compress(b"\0" * 100)) + png_chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not an image"),
        (b"hello", "not an image"),
        (png_of_size(100_000, 100_000), "pixels; at most|not an image"),
        (png_of_size(10, 10), "not an image|damaged"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 1 1\n", "not an image"),
    ],
)
def test_files_that_are_no_images(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(SceneFileError, match=message) as caught:
        read_image(tmp_path / "a.png")
    assert str(caught.value).startswith(str(tmp_path / "a.png"))


def test_whole_numbers_of_32_bits_are_refused(tmp_path: Path) -> None:
    """Nothing says how large they may be; of 16 bits the largest is 65535."""
    Image.fromarray(np.full((2, 3), 2**31 - 1, np.int32)).save(tmp_path / "a.tif")
    with pytest.raises(SceneFileError, match="32 bits; 8 or 16 bits a component are read"):
        read_image(tmp_path / "a.tif")
    Image.fromarray(np.full((2, 3), 65535, np.uint16)).save(tmp_path / "b.tif")
    np.testing.assert_array_equal(read_image(tmp_path / "b.tif"), np.ones((2, 3, 1)))


def test_damaged_images_give_nothing_but_the_error(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    refused = 0
    for suffix in ("png", "jpg", "gif", "bmp", "tif", "webp"):
        path = tmp_path / f"a.{suffix}"
        Image.fromarray(rng.integers(0, 256, (16, 16, 3)).astype(np.uint8)).save(path)
        whole = path.read_bytes()
        for _ in range(40):
            damaged = bytearray(whole[: rng.integers(1, len(whole) + 1)])
            for place in rng.integers(0, len(damaged), 3):
                damaged[place] = rng.integers(0, 256)
            path.write_bytes(bytes(damaged))
            try:
                assert read_image(path).ndim == 3
            except SceneFileError:
                refused += 1
    assert refused > 100


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(SceneFileError, match="no such file"):
        read_image(tmp_path / "none.png")


@pytest.mark.parametrize(
    ("name", "image", "options", "message"),
    [
        ("a.png", np.zeros((2, 2, 5)), {}, r"expected \[height, width, 1 to 4 components\], got shape \[2, 2, 5\]"),
        ("a.png", np.zeros(3), {}, r"got shape \[3\]"),
        ("a.png", np.zeros((0, 2)), {}, r"got shape \[0, 2, 1\]"),
        ("a.png", np.full((2, 2), np.nan), {}, "NaN in 4 pixels"),
        (
            "a.png",
            np.full((2, 2), 128, np.uint8),
            {},
            r"a\.png: got uint8; divide by 255 or use read_image",
        ),
        ("a.png", np.full((2, 2), 128, np.uint16), {}, r"a\.png: got uint16; divide by 65535"),
        ("a.png", np.full((2, 2), 128), {}, r"a\.png: got int64 above 1; divide by the largest level"),
        ("a.exr", np.full((2, 2), 2, np.uint32), {}, r"a\.exr: got uint32 above 1; divide by the largest level"),
        ("a.jpg", np.ones((1, 65501)), {}, r"a\.jpg: 65501 x 1 pixels; JPEG holds at most 65500 a side"),
        ("a.exr", np.full((2, 2), -1e39), {}, r"a\.exr: -1e\+39 is larger than EXR's float32 holds, 3.40282e\+38"),
        ("a.bmp", np.zeros((2, 2)), {}, "ends in .png"),
        ("a.png", np.full((2, 2), 1j), {}, r"a\.png: expected \[height, width, 1 to 4 components\], got array"),
        ("a.png", "abc", {}, r"a\.png: expected \[height, width, 1 to 4 components\], got 'abc'"),
        ("a.png", [[0, 1], [1]], {}, r"a\.png: expected \[height, width, 1 to 4 components\], got \[\[0, 1\], \[1\]\]"),
        ("a.png", np.zeros((2, 2)), {"bits": 12}, "got bits=12"),
        ("a.jpg", np.zeros((2, 2)), {"bits": 16}, "got bits=16"),
    ],
)
def test_what_cannot_be_written(
    tmp_path: Path, name: str, image: np.ndarray, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        write_image(tmp_path / name, image, **options)
    assert os.listdir(tmp_path) == []


def test_without_openimageio_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real_import = builtins.__import__

    def without(name: str, *args: Any, **options: Any) -> Any:
        if name == "OpenImageIO":
            raise ImportError(name)
        return real_import(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    header = struct.pack(">IIBBBBB", 1, 1, 16, 2, 0, 0, 0)
    (tmp_path / "deep.png").write_bytes(b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + header + b"\0" * 20)
    (tmp_path / "a.exr").write_bytes(b"\x76\x2f\x31\x01" + b"\0" * 20)
    for name in ("deep.png", "a.exr"):
        with pytest.raises(ImportError, match=r"needs OpenImageIO: pip install 'jaxlight\[exr\]'"):
            read_image(tmp_path / name)
    for name, bits, what in (("b.exr", 8, "EXR"), ("b.png", 16, "16-bit colour PNG")):
        with pytest.raises(ImportError, match=f"^{re.escape(str(tmp_path / name))}: writing {what} needs OpenImageIO"):
            write_image(tmp_path / name, np.zeros((2, 2, 3)), bits=bits)
    assert sorted(os.listdir(tmp_path)) == ["a.exr", "deep.png"]


def test_the_transparent_grey_of_a_16_bit_png_has_alpha_0(tmp_path: Path) -> None:
    """All 16 bits of it: 300 is as bright as 256 in the first eight."""
    grey = np.array([[0, 300, 256], [65535, 300, 301]], np.uint16)
    Image.fromarray(grey).save(tmp_path / "a.png", transparency=300)
    expected = np.stack([grey / 65535, grey != 300], axis=-1)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), expected)


def test_16_bit_color_is_not_multiplied_by_alpha(tmp_path: Path) -> None:
    pytest.importorskip("OpenImageIO")
    image = np.array([[[1.0, 0.5, 0.25, 0.5], [1, 1, 1, 0]]])
    write_image(tmp_path / "a.png", image, bits=16)
    assert np.allclose(read_image(tmp_path / "a.png"), image, atol=1e-5)


def test_a_place_that_cannot_hold_the_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").touch()
    for name in ("none/a.png", "file/a.png"):
        path = tmp_path / name
        with pytest.raises(FileNotFoundError, match=f"^{re.escape(f'{path}: there is no folder {path.parent}')}$"):
            write_image(path, np.zeros((2, 2)))
    with pytest.raises(IsADirectoryError, match=r"folder\.png: expected a file, got a folder$"):
        write_image(tmp_path / "folder.png", np.zeros((2, 2)))
    assert sorted(os.listdir(tmp_path)) == ["file", "folder.png"]


def test_what_the_system_refuses_is_said_of_the_file_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses(*_: Any, **__: Any) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(tmp_path / ".a.x5z.png"))

    monkeypatch.setattr(os, "open", refuses)
    with pytest.raises(PermissionError, match=f"{re.escape(repr(str(tmp_path / 'a.png')))}$"):
        write_image(tmp_path / "a.png", np.zeros((2, 2)))


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_image(tmp_path / "a.png", np.zeros((2, 2)))
    before = (tmp_path / "a.png").read_bytes()

    def fails(*_: Any, **__: Any) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Image.Image, "save", fails)
    with pytest.raises(OSError, match="disk full"):
        write_image(tmp_path / "a.png", np.ones((2, 2)))
    assert (tmp_path / "a.png").read_bytes() == before
    assert os.listdir(tmp_path) == ["a.png"]
