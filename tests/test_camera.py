"""Cameras: Viewpoints under transforms, OpenCV's convention, framing, rays, errors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jaxlight import Camera, Scene, nodes
from jaxlight.raster.pattern import sample_pattern


def project(camera: Camera, point: np.ndarray, width: int, height: int) -> np.ndarray:
    """Place of a world point in the picture, pixels from the top left corner."""
    away = np.linalg.solve(camera.pixel_to_world(width, height), np.asarray(point) - camera.position)
    return away[:2] / away[2]


@pytest.mark.parametrize(("width", "height"), [(640, 480), (480, 640), (33, 33)])
def test_field_of_view_spans_the_smaller_dimension(width: int, height: int) -> None:
    camera = Camera.from_viewpoint(nodes.Viewpoint(position=(1, 2, 3), field_of_view=0.8))
    side = min(width, height)
    np.testing.assert_allclose(project(camera, (1, 2, -7), width, height), (width / 2, height / 2), atol=1e-12)
    top = project(camera, (1, 2 + 10 * math.tan(0.4), -7), width, height)
    np.testing.assert_allclose(top, (width / 2, height / 2 - side / 2), atol=1e-10)
    right = project(camera, (1 + 10 * math.tan(0.4), 2, -7), width, height)
    np.testing.assert_allclose(right, (width / 2 + side / 2, height / 2), atol=1e-10)


def test_a_viewpoint_moves_with_the_transforms_above_it() -> None:
    view = nodes.Viewpoint(position=(0, 0, 4), orientation=(0, 1, 0, math.pi / 2))
    inner = nodes.Transform(rotation=(0, 1, 0, math.pi / 2), scale=(2, 3, 4), children=[view])
    scene = Scene.from_nodes([nodes.Transform(translation=(10, 0, 0), children=[inner])])
    camera = Camera.from_viewpoint(scene.document.viewpoints[0])
    # Scaled to (0, 0, 16), turned a quarter to (16, 0, 0), shifted. Two quarter turns: it looks along +z.
    np.testing.assert_allclose(camera.position, (26, 0, 0), atol=1e-12)
    np.testing.assert_allclose(camera.rotation @ (0, 0, -1), (0, 0, 1), atol=1e-12)
    np.testing.assert_allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.rotation) > 0


def test_intrinsics_follow_opencv() -> None:
    """u = fx x / z + cx with x_camera = R x + t; the centre of the first pixel is at 0."""
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    shift = np.array([0.1, -0.2, 3.0])
    matrix = np.array([[500, 2.0, 311], [0, 510, 247], [0, 0, 1]])
    camera = Camera.from_intrinsics(matrix, R=turn, t=shift)
    point = np.array([0.3, 0.5, -0.4])
    u, v, w = matrix @ (turn @ point + shift)
    np.testing.assert_allclose(project(camera, point, 640, 480), (u / w + 0.5, v / w + 0.5), rtol=1e-12)
    np.testing.assert_allclose(camera.position, -turn.T @ shift, atol=1e-12)
    halves = Camera.from_intrinsics(fx=500, fy=500, cx=320, cy=240, pixel_center=0.5)
    np.testing.assert_allclose(project(halves, (0, 0, 5), 640, 480), (320, 240), atol=1e-12)


def test_a_translation_may_be_a_column() -> None:
    assert Camera.from_intrinsics(np.eye(3), t=np.ones((3, 1))).position.tolist() == [-1, -1, -1]


def test_a_rotation_of_few_digits_is_made_one() -> None:
    written = np.round(Camera.look_at((1, 2, 3), (0, 0, 0)).rotation, 5)
    rotation = Camera.from_intrinsics(np.eye(3), R=written).rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


def test_look_at_and_view_all_put_things_in_the_picture() -> None:
    camera = Camera.look_at((3, 4, 5), (1, 1, 1), up=(0, 1, 0), field_of_view=0.7)
    np.testing.assert_allclose(project(camera, (1, 1, 1), 100, 80), (50, 40), atol=1e-10)
    assert project(camera, (1, 1.1, 1), 100, 80)[1] < 40
    shape = nodes.Shape(geometry=nodes.Box(size=(1, 50, 3)))
    scene = Scene.from_nodes([nodes.Transform(translation=(100, 0, 0), children=[shape])])
    corners = np.array([(x, y, z) for x in (99.5, 100.5) for y in (-25, 25) for z in (-1.5, 1.5)])
    for direction in ((0, 0, -1), (1, 2, 3), (0, -1, 0)):
        framed = Camera.view_all(scene, direction)
        places = np.array([project(framed, corner, 60, 60) for corner in corners])
        assert places.min() >= 0
        assert places.max() <= 60
        assert np.ptp(places, axis=0).max() > 30 or direction == (0, -1, 0)


def test_the_default_camera() -> None:
    """The first Viewpoint; else X3D's own if it shows everything at a fair size; else one that frames the shapes."""
    box = nodes.Shape(geometry=nodes.Box())
    near, far = nodes.Viewpoint(position=(0, 0, 5)), nodes.Viewpoint(position=(0, 0, 50))
    assert Camera.default(Scene.from_nodes([box, near, far])).position[2] == 5
    assert Camera.default(Scene.from_nodes([box])).position.tolist() == [0, 0, 10]
    too_small, too_large, just_too_large = (nodes.Box(size=(size, size, size)) for size in (0.05, 80, 4.6))
    for shape in (too_small, too_large, just_too_large):
        scene = Scene.from_nodes([nodes.Shape(geometry=shape)])
        assert Camera.default(scene).position.tolist() == Camera.view_all(scene).position.tolist()
    assert Camera.default(Scene.from_nodes([nodes.Group()])).position.tolist() == [0, 0, 10]


def test_what_has_no_size_is_seen_from_a_distance() -> None:
    speck = nodes.Transform(translation=(1, 2, 3), children=[nodes.Shape(geometry=nodes.Sphere(radius=1e-20))])
    camera = Camera.view_all(Scene.from_nodes([speck]))
    assert camera.position[2] > 4


def test_rays_run_row_by_row_through_the_sample_points() -> None:
    camera = Camera.look_at((1, 2, 3), (0, 0, 0))
    origin, direction = camera.rays(7, 5, samples=3)
    np.testing.assert_array_equal(origin, (1, 2, 3))
    assert direction.shape == (7 * 5 * 3, 3)
    pattern = sample_pattern(3)
    for row, column, sample in ((0, 0, 0), (4, 6, 2), (2, 3, 1)):
        ray = direction[(row * 7 + column) * 3 + sample]
        np.testing.assert_allclose(project(camera, origin + ray, 7, 5), (column, row) + pattern[sample], atol=1e-12)
        np.testing.assert_allclose(ray @ camera.rotation[:, 2], -1)  # one unit of depth


def test_distances_and_directions_of_any_length() -> None:
    box = Scene.from_nodes([nodes.Shape(geometry=nodes.Box())])
    for size in (1e-310, 1e-200, 1e200):
        for along in ((0, 0, -size), (0, -size, 0), (size, size, 0)):
            small = Camera.look_at((0, 0, 0), along, up=(0, 0.5 * size, -size))
            np.testing.assert_allclose(small.rotation, Camera.look_at((0, 0, 0), np.sign(along), (0, 0.5, -1)).rotation)
            np.testing.assert_allclose(
                Camera.view_all(box, along).rotation, Camera.view_all(box, np.sign(along)).rotation
            )


@pytest.mark.parametrize("samples", [1, 2, 4, 5, 8, 16, 64, 256])
def test_sample_patterns_fill_every_row_and_column(samples: int) -> None:
    pattern = sample_pattern(samples)
    for axis in range(2):
        np.testing.assert_allclose(np.sort(pattern[:, axis]), (np.arange(samples) + 0.5) / samples)
    np.testing.assert_allclose(pattern.mean(axis=0), 0.5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Camera.look_at((0, 0, 0), (0, 0, 0)), "eye and target are the same point"),
        (lambda: Camera.look_at((0, 0, 0), (0, 2, 0)), "points along the view"),
        (lambda: Camera.look_at((0, 0, math.nan), (0, 2, 0)), r"look_at: eye: expected \[3\] finite numbers"),
        (lambda: Camera.look_at((0, 0, 1), (0, 0, 0), field_of_view=math.pi), r"radians in \(0, pi\)"),
        (lambda: Camera(np.zeros(3), np.diag([1, 1, -1.0]), 1.0), "expected a rotation matrix"),
        (lambda: Camera.look_at((0, 0, 1), (0, 0, 0), field_of_view="wide"), "radians in .*, got 'wide'"),
        (lambda: Camera.look_at((0, 0, 1), (0, 0, 0), field_of_view=True), "radians in .*, got True"),
        (lambda: Camera(np.zeros(3), np.eye(3)), "either field_of_view or intrinsics"),
        (lambda: Camera.from_intrinsics(), "a matrix K, or all of fx, fy, cx, cy"),
        (lambda: Camera.from_intrinsics(fx=1, fy=1, cx=2), "a matrix K, or all of fx, fy, cx, cy"),
        (lambda: Camera.from_intrinsics(np.eye(4)), r"K: expected \[3, 3\] finite numbers"),
        (lambda: Camera.from_intrinsics(np.diag([-1.0, 1, 1])), "with fx, fy > 0"),
        (lambda: Camera.from_intrinsics(np.eye(3), R=np.ones((3, 3))), "R: expected a rotation matrix"),
        (lambda: Camera.from_intrinsics(np.eye(3), t=[1, 2]), "t: expected"),
        (
            lambda: Camera.from_intrinsics(np.eye(3), t=[[1, 2], [3]]),
            r"t: expected \[3\] numbers, got \[\[1, 2\], \[3\]\]",
        ),
        (
            lambda: Camera.from_intrinsics(np.eye(3), pixel_center="a"),
            "pixel_center: expected a finite number, got 'a'",
        ),
        (lambda: Camera.from_viewpoint(3), "from_viewpoint: expected a Viewpoint, got int"),
        (lambda: Camera.default([nodes.Shape()]), "Camera.default: expected a Scene, got list"),
        (lambda: Camera.view_all("a.x3d"), "Camera.view_all: expected a Scene, got str"),
        (lambda: Camera.view_all(Scene.from_nodes([nodes.Group()])), "no shape with geometry"),
        *(
            (
                lambda angle=angle: Camera.view_all(
                    Scene.from_nodes([nodes.Shape(geometry=nodes.Box())]), (1, 0, 0), angle
                ),
                rf"Camera.view_all: field_of_view: expected radians in \(0, pi\), got {angle}",
            )
            for angle in (0.0, -1.0, math.nan, 7.0)
        ),
        (lambda: sample_pattern(0), r"whole number of samples a pixel in \[1, 256\], got 0"),
        (lambda: sample_pattern(2.0), "whole number"),
    ],
)
def test_errors_say_what_is_wrong(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
