"""Samples from maps agree with rasterised ones; encodings, frames, masks, files, errors."""

from __future__ import annotations

import gc
import io
import os
import re
import struct
import warnings
import zipfile
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from PIL import Image

from jaxlight import Camera, Orthographic, SampleBuffer, Scene, nodes, rasterize, samples_from_maps, write_image
from jaxlight.image import sky

WIDTH, HEIGHT = 41, 33
CAMERA = Camera.look_at((1.0, 2.0, 8.0), (0, 0, 0), field_of_view=0.5)
SCENE = Scene.from_nodes([nodes.Shape(geometry=nodes.Sphere(radius=1.5))])


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


@pytest.fixture
def seen() -> SampleBuffer:
    return rasterize(SCENE, CAMERA, WIDTH, HEIGHT)


def picture(samples: SampleBuffer, values: np.ndarray) -> np.ndarray:
    """[height, width, ...] with NaN where nothing is seen."""
    image = np.full((HEIGHT * WIDTH, *values.shape[1:]), np.nan)
    image[np.asarray(samples.pixel)] = values
    return image.reshape(HEIGHT, WIDTH, *values.shape[1:])


def assert_same(found: SampleBuffer, expected: SampleBuffer) -> None:
    np.testing.assert_array_equal(np.asarray(found.pixel), np.asarray(expected.pixel))
    np.testing.assert_allclose(np.asarray(found.position), np.asarray(expected.position), atol=1e-12)
    unit = [
        np.asarray(s.normal) / np.linalg.norm(np.asarray(s.normal), axis=1, keepdims=True) for s in (found, expected)
    ]
    np.testing.assert_allclose(*unit, atol=1e-12)
    np.testing.assert_array_equal(np.asarray(found.eye), np.asarray(expected.eye))
    np.testing.assert_array_equal(np.asarray(found.camera_to_world), np.asarray(expected.camera_to_world))


def test_positions_and_normals_of_the_world(seen: SampleBuffer) -> None:
    normal, position = picture(seen, np.asarray(seen.normal)), picture(seen, np.asarray(seen.position))
    assert_same(samples_from_maps(normal, CAMERA, position=position, normal_frame="world"), seen)


@pytest.mark.parametrize("kind", ["z", "distance"])
def test_depth_and_normals_of_the_camera(seen: SampleBuffer, kind: str) -> None:
    away = np.asarray(seen.position) - CAMERA.position
    depth = -(away @ CAMERA.rotation)[:, 2] if kind == "z" else np.linalg.norm(away, axis=1)
    found = samples_from_maps(
        picture(seen, np.asarray(seen.normal) @ CAMERA.rotation),
        CAMERA,
        depth=picture(seen, depth),
        depth_kind=kind,
    )
    assert_same(found, seen)
    in_camera = samples_from_maps(
        picture(seen, np.asarray(seen.normal) @ CAMERA.rotation),
        CAMERA,
        position=picture(seen, away @ CAMERA.rotation),
        position_frame="camera",
    )
    assert_same(in_camera, seen)


def test_intrinsics_of_a_photograph(seen: SampleBuffer) -> None:
    """A depth map of a calibrated camera: x = (u - cx) z / fx, y = (v - cy) z / fy in OpenCV's axes."""
    depth = np.random.default_rng(0).uniform(1, 2, (HEIGHT, WIDTH))
    camera = Camera.from_intrinsics(fx=50, fy=60, cx=20.3, cy=15.1)
    found = samples_from_maps(np.tile([0.0, 0, 1], (HEIGHT, WIDTH, 1)), camera, depth=depth)
    row, column = np.divmod(np.asarray(found.pixel), WIDTH)
    z = depth[row, column]
    expected = np.stack([(column - 20.3) * z / 50, (row - 15.1) * z / 60, z], axis=1)
    np.testing.assert_allclose(np.asarray(found.position), expected, atol=1e-12)
    # The camera's own z axis points at the viewer, which is backwards in OpenCV's axes.
    np.testing.assert_allclose(np.asarray(found.normal)[0], (0, 0, -1), atol=1e-15)


def test_files_hold_the_same_maps(seen: SampleBuffer, tmp_path: Path) -> None:
    normal, position = picture(seen, np.asarray(seen.normal)), picture(seen, np.asarray(seen.position))
    np.savez(tmp_path / "maps.npz", normal=normal, position=position)
    np.save(tmp_path / "normal.npy", normal)
    np.savez(tmp_path / "single.npz", anything=position)
    mask = np.isfinite(normal[..., 0])
    Image.fromarray((255 * mask).astype(np.uint8)).save(tmp_path / "mask.png")
    for normals, positions in (("maps.npz", "maps.npz"), ("normal.npy", "single.npz")):
        found = samples_from_maps(
            tmp_path / normals,
            CAMERA,
            position=str(tmp_path / positions),
            mask=tmp_path / "mask.png",
            normal_frame="world",
        )
        assert_same(found, seen)


def test_colour_images_hold_normals_as_two_c_minus_one(seen: SampleBuffer, tmp_path: Path) -> None:
    normal = np.asarray(seen.normal) @ CAMERA.rotation
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    coded = np.nan_to_num(picture(seen, (normal * [1, -1, 1] + 1) / 2), nan=0.5)
    Image.fromarray(np.round(255 * coded).astype(np.uint8)).save(tmp_path / "normals.png")
    mask = np.isfinite(picture(seen, normal)[..., 0])
    found = samples_from_maps(tmp_path / "normals.png", CAMERA, depth=1.0, mask=mask, normal_y_down=True)
    expected = normal @ CAMERA.rotation.T
    # Half a step of 1 / 255 in c is one in n, in each of three components.
    assert np.linalg.norm(np.asarray(found.normal) - expected, axis=1).max() <= 3**0.5 / 255
    as_array = samples_from_maps(coded, CAMERA, depth=1.0, mask=mask, normal_encoding="color", normal_y_down=True)
    np.testing.assert_allclose(np.asarray(as_array.normal), expected, atol=1e-12)


def test_the_content_of_a_picture_says_whether_it_holds_colours(tmp_path: Path) -> None:
    pytest.importorskip("OpenImageIO")
    write_image(tmp_path / "vectors.exr", np.tile([0.0, 0.6, 0.8], (3, 4, 1)))
    write_image(tmp_path / "colors.png", np.tile([0.5, 0.8, 0.9], (3, 4, 1)))
    for name, new in (("vectors.exr", "vectors.png"), ("colors.png", "colors.exr")):
        (tmp_path / name).rename(tmp_path / new)
        found = samples_from_maps(tmp_path / new, CAMERA, depth=1.0, normal_frame="world")
        np.testing.assert_allclose(np.asarray(found.normal), np.tile([0.0, 0.6, 0.8], (12, 1)), atol=0.005)


def test_colours_of_normals_may_be_rounded_and_anything_outside_the_mask() -> None:
    coded, mask = np.tile([0.5, 0.5, 1.003], (3, 4, 1)), np.eye(3, 4)
    coded[mask == 0] = 128
    found = samples_from_maps(coded, CAMERA, depth=1.0, mask=mask, normal_encoding="color")
    np.testing.assert_allclose(np.asarray(found.normal), np.tile(1.006 * CAMERA.rotation[:, 2], (3, 1)), atol=1e-12)


def test_whole_numbers_are_vectors() -> None:
    found = samples_from_maps(3 * NORMAL.astype(int), CAMERA, depth=1.0)
    np.testing.assert_allclose(np.asarray(found.normal)[0], 3 * CAMERA.rotation[:, 2], atol=1e-12)


@pytest.mark.filterwarnings("error")
def test_without_a_mask_what_is_not_finite_or_zero_is_left_out() -> None:
    normal = np.tile([0.0, 0, 1], (4, 5, 1))
    normal[0, 0], normal[1, 1, 2], normal[1, 2], depth = 0, np.nan, (np.inf, 0, -np.inf), np.ones((4, 5))
    depth[2, 2], depth[3, 3], depth[3, 4] = np.inf, 0, -1
    found = samples_from_maps(normal, CAMERA, depth=depth)
    assert set(range(20)) - set(np.asarray(found.pixel).tolist()) == {0, 6, 7, 12, 18, 19}


@pytest.mark.parametrize("background", [(0, 0, 0, 255), (127, 127, 127, 255), (128, 128, 128, 255), (128, 128, 255, 0)])
def test_without_a_mask_colours_that_hold_no_normal_are_left_out(tmp_path: Path, background: tuple) -> None:
    levels = np.full((4, 5, 4), (128, 128, 255, 255), np.uint8)
    levels[1:3, 2:] = background
    levels[0, 0, :3], levels[0, 1, :3] = (0, 128, 128), (126, 128, 128)  # faint, but vectors
    Image.fromarray(levels).save(tmp_path / "normals.png")
    for normal in (tmp_path / "normals.png", levels / 255):
        found = samples_from_maps(normal, CAMERA, depth=1.0, normal_encoding="color")
        assert set(range(20)) - set(np.asarray(found.pixel).tolist()) == {7, 8, 9, 12, 13, 14}
        everywhere = samples_from_maps(normal, CAMERA, depth=1.0, mask=np.ones((4, 5)), normal_encoding="color")
        assert everywhere.count == 20


def test_a_fourth_component_of_vectors_is_no_alpha() -> None:
    assert samples_from_maps(np.tile([0.0, 0, 1, 0], (4, 5, 1)), CAMERA, depth=1.0).count == 20


def test_a_depth_of_three_equal_channels_may_have_holes() -> None:
    depth = np.ones((4, 5, 3))
    depth[2, 2] = np.nan
    found = samples_from_maps(np.tile([0.0, 0, 1], (4, 5, 1)), CAMERA, depth=depth)
    assert set(range(20)) - set(np.asarray(found.pixel).tolist()) == {12}
    depth[2, 2, 1] = 1
    with pytest.raises(ValueError, match="depth: expected one channel, got a colour image"):
        samples_from_maps(np.tile([0.0, 0, 1], (4, 5, 1)), CAMERA, depth=depth)


@pytest.mark.parametrize(("bright", "dark"), [(0.5, 0.49), (np.uint8(128), np.uint8(127)), (True, False)])
def test_a_mask_leaves_out_what_is_darker_than_one_half(bright: Any, dark: Any) -> None:
    shown = np.arange(20).reshape(4, 5) % 3 == 0
    found = samples_from_maps(np.tile([0.0, 0, 1], (4, 5, 1)), CAMERA, depth=1.0, mask=np.where(shown, bright, dark))
    assert set(np.asarray(found.pixel).tolist()) == set(np.flatnonzero(shown).tolist())


def test_orthographic_views() -> None:
    turn = Camera.look_at((3, 1, 2), (0, 0, 0)).rotation
    view = Orthographic(pixel_size=0.5, center=(1.0, 2.0, 3.0), rotation=turn)
    found = samples_from_maps(np.tile([0.0, 0, 1], (4, 6, 1)), view, depth=2.0)
    position, (row, column) = np.asarray(found.position), np.divmod(np.asarray(found.pixel), 6)
    expected = np.stack([(column - 2.5) / 2, (1.5 - row) / 2, np.full(24, -2.0)], axis=1) @ turn.T + [1, 2, 3]
    np.testing.assert_allclose(position, expected, atol=1e-12)
    to_viewer = np.asarray(found.eye) - position
    to_viewer /= np.linalg.norm(to_viewer, axis=1, keepdims=True)
    np.testing.assert_allclose(to_viewer, np.tile(turn[:, 2], (24, 1)), atol=1e-6)
    assert found.pixel_to_world is not None
    np.testing.assert_allclose(np.asarray(found.pixel_to_world) @ (2.5, 1.5, 1), -turn[:, 2], atol=1e-6)


@pytest.mark.parametrize(
    ("pixel_size", "height", "x"), [(0.1, 24, 3.0), (1.0, 24, 2e4), (1.0, 24, 3.0), (20.0, 2, 3.0)]
)
def test_parallel_rays_in_few_bits(pixel_size: float, height: int, x: float) -> None:
    """float16 holds no eye a million sizes away; the one that it holds is as far off as its digits can tell."""
    turn = Camera.look_at((3, 1, 2), (0, 0, 0)).rotation
    for rotation in (np.eye(3), turn):
        view = Orthographic(pixel_size, (x, -2.0, 1.0), rotation)
        found = samples_from_maps(np.tile([0.0, 0, 1], (height, height, 1)), view, depth=1.0, dtype="float16")
        to_viewer = np.asarray(found.eye, float) - np.asarray(found.position, float)
        to_viewer /= np.linalg.norm(to_viewer, axis=1, keepdims=True)
        angle = np.linalg.norm(np.cross(to_viewer, rotation[:, 2]), axis=1)
        assert angle.max() < 2**-10


@pytest.mark.parametrize(
    ("pixel_size", "dtype", "stated"),
    [(20.0, "float16", "1024 .* float16 holds"), (1e32, "float32", "1e.06 .* float32")],
)
def test_an_eye_that_no_type_holds_far_enough_away_is_refused(pixel_size: float, dtype: str, stated: str) -> None:
    message = f"samples_from_maps: view: .*Orthographic.* {stated}.*; .*smaller pixel_size.* dtype"
    with pytest.raises(ValueError, match=message):
        samples_from_maps(NORMAL, Orthographic(pixel_size), depth=1.0, dtype=dtype)


def test_every_pixel_can_have_its_own_texel() -> None:
    albedo = np.random.default_rng(1).uniform(size=(3, 4, 3))
    found = samples_from_maps(np.tile([0.0, 0, 1], (3, 4, 1)), CAMERA, depth=1.0, texel_per_pixel=True)
    assert found.texel_index is not None and found.texel_weight is not None
    index = np.asarray(found.in_sample_order(found.texel_index))
    weight = np.asarray(found.in_sample_order(found.texel_weight))
    texture = albedo[::-1].reshape(-1, 3)  # row 0 of a texture is its bottom
    np.testing.assert_array_equal(
        np.einsum("kn,knc->nc", weight, texture[index]), albedo.reshape(-1, 3)[np.asarray(found.pixel)]
    )


def test_colours_and_surfaces_by_pixel() -> None:
    color, surface = np.random.default_rng(1).uniform(size=(3, 4, 4)), np.arange(12).reshape(3, 4) % 3
    found = samples_from_maps(np.tile([0.0, 0, 1], (3, 4, 1)), CAMERA, depth=1.0, color=color, surface=surface)
    pixel = np.asarray(found.pixel)
    np.testing.assert_array_equal(np.asarray(found.color), color.reshape(-1, 4)[pixel])
    np.testing.assert_array_equal(np.asarray(found.surface), surface.ravel()[pixel])


NORMAL = np.tile([0.0, 0, 1], (3, 4, 1))


def test_a_depth_of_whole_levels_is_a_share_of_the_largest_in_a_picture_only(tmp_path: Path) -> None:
    depth = np.full((3, 4), 2000, np.uint16)
    np.save(tmp_path / "depth.npy", depth)
    Image.fromarray(depth).save(tmp_path / "depth.png")
    view = Orthographic()
    for given, expected in ((depth, 2000), (tmp_path / "depth.npy", 2000), (tmp_path / "depth.png", 2000 / 65535)):
        found = samples_from_maps(NORMAL, view, depth=given)
        np.testing.assert_allclose(np.asarray(found.position)[:, 2], -expected, rtol=1e-12)


def test_files_hold_the_surface_of_each_pixel(tmp_path: Path) -> None:
    surface = np.arange(12, dtype=np.uint8).reshape(3, 4) % 3
    np.save(tmp_path / "a.npy", surface.astype(np.int64))
    np.savez(tmp_path / "a.npz", surface=surface, normal=NORMAL)
    np.save(tmp_path / "one.npy", np.int32(2))
    Image.fromarray(surface).save(tmp_path / "a.png")
    Image.fromarray(surface.astype(np.uint16)).save(tmp_path / "a.tif")
    indices = Image.fromarray(surface).convert("P")
    indices.putpalette([255, 0, 0, 0, 255, 0, 0, 0, 255])
    indices.save(tmp_path / "indices.png")
    for name in ("a.npy", "a.npz", "a.png", "a.tif", "indices.png"):
        found = samples_from_maps(NORMAL, CAMERA, depth=1.0, surface=tmp_path / name)
        np.testing.assert_array_equal(np.asarray(found.surface), surface.ravel()[np.asarray(found.pixel)])
    assert set(np.asarray(samples_from_maps(NORMAL, CAMERA, depth=1.0, surface=tmp_path / "one.npy").surface)) == {2}


def test_surfaces_of_files_are_whole_numbers(tmp_path: Path) -> None:
    levels = np.zeros((3, 4, 3), np.uint8)
    Image.fromarray(levels).save(tmp_path / "colors.png")
    for name in ("grey.jpg", "grey.gif"):
        Image.fromarray(levels[..., 0]).save(tmp_path / name)
    np.save(tmp_path / "floats.npy", levels[..., 0] / 2)
    for name, message in (
        ("colors.png", r"colors\.png: expected a PNG or TIFF of grey levels of 8 or 16 bits, .* got a PNG of mode RGB"),
        ("grey.jpg", r"grey\.jpg: expected .*, got a JPEG of mode L"),
        ("grey.gif", r"grey\.gif: expected .*, got a GIF of mode"),
        ("floats.npy", r"surface: expected .* integers of shape \[3, 4\], got float64 \[3, 4\]"),
        ("nowhere.npy", r"surface: .*nowhere\.npy: no such file"),
        ("nowhere.png", "no such file"),
    ):
        with pytest.raises(ValueError, match=message):
            samples_from_maps(NORMAL, CAMERA, depth=1.0, surface=tmp_path / name)


HOLE = NORMAL.copy()
HOLE[1, 2] = np.nan


@pytest.mark.parametrize(
    ("normal", "arguments", "message"),
    [
        (NORMAL, {}, "either position or depth"),
        (NORMAL, {"depth": 1.0, "position": NORMAL}, "either position or depth"),
        (NORMAL[..., :2], {"depth": 1.0}, r"normal: expected \[height, width, 3\], got \[3, 4, 2\]"),
        (NORMAL, {"depth": np.ones((4, 3))}, r"depth: expected shape \[3, 4\], got \[4, 3\]"),
        (NORMAL, {"position": np.ones((3, 4, 2))}, r"position: expected shape \[3, 4, 3\]"),
        (NORMAL, {"depth": 1.0, "mask": np.ones((3, 3))}, r"mask: expected shape \[3, 4\]"),
        (HOLE, {"depth": 1.0, "mask": np.ones((3, 4))}, "1 pixels inside the mask .* the first at row 1, column 2"),
        (
            NORMAL.astype(np.uint8),
            {"depth": 1.0},
            "normal: got uint8; divide by 255; with normal_encoding='color', or give",
        ),
        (NORMAL, {"depth": 1.0, "color": np.ones((3, 4, 3), np.uint16)}, "color: got uint16; divide by 65535, or give"),
        (
            NORMAL,
            {"depth": 1.0, "color": np.full((3, 4, 3), 200)},
            "color: got int64 above 1; .*, or give the image file",
        ),
        (
            np.tile([128, 128, 255], (3, 4, 1)),
            {"depth": 1.0, "normal_encoding": "color"},
            r"12 pixels have a normal that is no colour in \[0, 1\] .*, the first at row 0, column 0",
        ),
        (
            np.tile([0.5, -0.5, 1.0], (3, 4, 1)),
            {"depth": 1.0, "normal_encoding": "color", "mask": np.eye(3, 4)},
            "3 pixels have a normal that is no colour",
        ),
        (NORMAL, {"depth": 1.0, "mask": np.full((3, 4), np.nan)}, "mask: 12 of its 12 numbers are NaN"),
        (NORMAL, {"depth": 0.0}, "no pixel shows a surface"),
        (NORMAL, {"depth": 1.0, "normal_frame": "view"}, "normal_frame: expected 'camera' or 'world', got 'view'"),
        (NORMAL, {"depth": 1.0, "normal_encoding": "rgb"}, "normal_encoding: expected 'vector' or 'color'"),
        (NORMAL, {"depth": 1.0, "surface": np.zeros((3, 3), int)}, "surface: expected"),
        (NORMAL, {"depth": "nowhere.npy"}, "depth: nowhere.npy: no such file"),
        ("nowhere.png", {"depth": 1.0}, "no such file"),
        ("words", {"depth": 1.0}, "no such file"),
        (object(), {"depth": 1.0}, "normal: expected numbers"),
    ],
)
def test_errors_name_the_map(normal: object, arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        samples_from_maps(normal, CAMERA, **arguments)


def test_behind_parallel_rays_the_sky_has_the_colour_of_their_direction() -> None:
    """They lead down at 45 degrees, three quarters of the way from the zenith to the nadir."""
    half = 0.5**0.5
    view = Orthographic(rotation=np.array([[1, 0, 0], [0, half, half], [0, -half, half]]))
    stops = nodes.Background(sky_color=[(1, 0, 0), (0, 1, 0), (0, 0, 1)], sky_angle=(np.pi / 2, np.pi))
    found = sky(Scene.from_nodes([stops]), samples_from_maps(NORMAL, view, depth=0.0))
    np.testing.assert_allclose(found, np.tile([0, 0.5, 0.5], (3, 4, 1)), atol=1e-6)


def test_errors_of_views_and_files(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="view: expected a Camera or an Orthographic view"):
        samples_from_maps(NORMAL, "front", depth=1.0)
    with pytest.raises(ValueError, match="pixel_size: expected a finite number > 0"):
        Orthographic(pixel_size=0)
    with pytest.raises(ValueError, match=r"^Orthographic.rotation: expected a rotation matrix, got \[\[2.0"):
        Orthographic(rotation=2 * np.eye(3))
    np.savez(tmp_path / "two.npz", a=NORMAL, b=NORMAL)
    with pytest.raises(ValueError, match=r"two\.npz: holds a, b; none is named 'normal'"):
        samples_from_maps(tmp_path / "two.npz", CAMERA, depth=1.0)
    np.save(tmp_path / "objects.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match=r"normal: .*objects\.npy: not a NumPy array file of numbers$"):
        samples_from_maps(tmp_path / "objects.npy", CAMERA, depth=1.0)
    (tmp_path / "garbage.npy").write_bytes(b"nothing that NumPy knows")
    with pytest.raises(ValueError, match=r"normal: .*garbage\.npy: not a NumPy array file of numbers$"):
        samples_from_maps(tmp_path / "garbage.npy", CAMERA, depth=1.0)
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(ValueError, match=r"broken\.npz: not an array file"):
        samples_from_maps(tmp_path / "broken.npz", CAMERA, depth=1.0)


def test_an_array_file_that_cannot_be_read_is_closed(tmp_path: Path) -> None:
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 nothing")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with pytest.raises(ValueError, match="not an array file"):
            samples_from_maps(tmp_path / "broken.npz", CAMERA, depth=1.0)
        gc.collect()
    assert not [warning for warning in said if "broken.npz" in str(warning.message)]


def npy(kind: str, shape: str, data: bytes = b"") -> bytes:
    """A file of this header."""
    header = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def npz(data: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytearray:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr("a.npy", data)
    return bytearray(file.getvalue())


def of_method(data: bytes, method: int, flags: int = 0) -> bytes:
    """An archive that says that its member is packed in another way."""
    archive = npz(data)
    for start in (8, archive.index(b"PK\x01\x02") + 10):
        archive[start] = method
        archive[start - 2] |= flags
    return bytes(archive)


WHOLE = npy("'<f8'", "(3, 4)", np.full((3, 4), 4.0).tobytes())
LZMA = npz(WHOLE, zipfile.ZIP_LZMA)
DAMAGED = {
    "more entries than memory has": npy("'<f8'", "(1000000000000,)", b"x" * 64),
    "a size that no integer type holds": npy("'<f8'", f"({2**70},)", b"x" * 64),
    "a truth value as size": npy("'<f8'", "(True,)", b"x" * 8),
    "a negative size": npy("'<f8'", "(-3, -4)", b"x" * 96),
    "a name as size": npy("'<f8'", "('a',)"),
    "numbers missing": WHOLE[:-1],
    "names": npy("'<U2'", "(3, 4)", b"\0" * 96),
    "an unknown type": npy("'zz'", "(3, 4)", b"x" * 96),
    "a header cut inside of brackets": b"\x93NUMPY\x01\x00\x10\x00(((((((((((((((\n",
    "a header cut off": WHOLE[:20],
    "brackets in brackets": npy("'<f8'", "(" * 200 + ")" * 200),
    "a version that is none": b"\x93NUMPY\x09\x00" + b"\0" * 20,
    "a damaged member": bytes(LZMA[:50] + b"\xff" * 10 + LZMA[60:]),
    "an encrypted member": of_method(WHOLE, zipfile.ZIP_DEFLATED, flags=1),
    "an unknown method": of_method(WHOLE, 99),
    "a member that is cut off": bytes(npz(WHOLE[:-1])),
    "no member": bytes(npz(b"")[-22:-12]) + bytes(12),
}


@pytest.mark.parametrize("damage", DAMAGED)
@pytest.mark.parametrize("what", ["depth", "surface"])
def test_damaged_array_files_are_errors_that_name_the_map_and_the_file(tmp_path: Path, damage: str, what: str) -> None:
    file = tmp_path / "a.npy"
    file.write_bytes(DAMAGED[damage])
    with pytest.raises(ValueError, match=rf"^samples_from_maps: {what}: {re.escape(str(file))}: \w"):
        samples_from_maps(NORMAL, CAMERA, **{"depth": 1.0, what: file})


@pytest.mark.parametrize("data", [WHOLE, bytes(npz(WHOLE)), bytes(LZMA)])
def test_what_an_array_file_is_says_its_content(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.npy").write_bytes(data)
    found = samples_from_maps(NORMAL, CAMERA, depth=tmp_path / "a.npy")
    assert_same(found, samples_from_maps(NORMAL, CAMERA, depth=4.0))


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.float16, np.uint16, np.int64, ">f8"])
@pytest.mark.parametrize("suffix", ["npy", "npz"])
def test_array_files_of_all_types_are_read(tmp_path: Path, kind: Any, suffix: str) -> None:
    depth = np.asfortranarray(np.arange(1, 13).reshape(3, 4).astype(kind))
    file = tmp_path / f"a.{suffix}"
    np.save(file, depth) if suffix == "npy" else np.savez_compressed(file, depth=depth, normal=NORMAL)
    found = samples_from_maps(NORMAL if suffix == "npy" else file, CAMERA, depth=file)
    assert_same(found, samples_from_maps(NORMAL, CAMERA, depth=depth.astype(float)))


@pytest.mark.parametrize("name", ["pipe.npy", "folder.npz"])
def test_what_is_no_file_is_refused_at_once(tmp_path: Path, name: str) -> None:
    is_pipe = name == "pipe.npy"
    os.mkfifo(tmp_path / name) if is_pipe else (tmp_path / name).mkdir()
    message = "is a pipe or a device; only files are read" if is_pipe else "is a folder"
    for what in ("depth", "surface"):
        with pytest.raises(ValueError, match=f"samples_from_maps: {what}: .*{name}: {message}"):
            samples_from_maps(NORMAL, CAMERA, **{"depth": 1.0, what: tmp_path / name})


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("depth", r"expected shape \[3, 4\], got \[16384, 16384\]"),
        ("mask", r"expected shape \[3, 4\], got \[16384, 16384\]"),
        ("position", r"expected shape \[3, 4, 3\], got \[16384, 16384\]"),
        ("color", r"expected shape \[3, 4, 3\], got \[16384, 16384\]"),
        ("surface", r"expected a row of Scene.surfaces or integers of shape \[3, 4\], got shape \[16384, 16384\]"),
    ],
)
def test_a_map_of_another_size_is_refused_before_it_is_read(tmp_path: Path, what: str, message: str) -> None:
    (tmp_path / "bomb.npz").write_bytes(npz(npy("'|u1'", "(16384, 16384)")))
    geometry = {} if what == "position" else {"depth": 1.0}
    with pytest.raises(ValueError, match=rf"samples_from_maps: {what}: .*bomb\.npz: {message}"):
        samples_from_maps(NORMAL, CAMERA, **{**geometry, what: tmp_path / "bomb.npz"})


def test_an_archive_that_would_unpack_to_too_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez_compressed(tmp_path / "a.npz", normal=np.ones((10, 10, 3), np.float16))
    monkeypatch.setattr("jaxlight.raster.array_files.MAX_NUMBERS", 300)
    assert samples_from_maps(tmp_path / "a.npz", CAMERA, depth=1.0).count == 100
    monkeypatch.setattr("jaxlight.raster.array_files.MAX_NUMBERS", 299)
    with pytest.raises(ValueError, match=r"a\.npz: shape \[10, 10, 3\] has 300 numbers; at most 299 are read"):
        samples_from_maps(tmp_path / "a.npz", CAMERA, depth=1.0)
    (tmp_path / "bomb.npz").write_bytes(npz(npy("'|u1'", "(32768, 8192, 3)")))
    with pytest.raises(ValueError, match="has 805306368 numbers; at most 299 are read"):
        samples_from_maps(tmp_path / "bomb.npz", CAMERA, depth=1.0)
