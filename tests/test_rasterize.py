"""Samples of rasterised scenes: positions, normals, colours, texels, sides, order, coverage, errors."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest
from PIL import Image

from jaxlight import Camera, SampleBuffer, Scene, load, nodes, rasterize, read_image
from jaxlight.raster.pattern import morton
from jaxlight.raster.texels import bilinear_texels

REFERENCE = Path(__file__).parent / "data" / "view3dscene"
VIEW = Camera.look_at((1.0, 2.0, 8.0), (0, 0, 0), field_of_view=0.7)


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def shape(geometry: nodes.Node, **appearance: object) -> nodes.Shape:
    return nodes.Shape(geometry=geometry, appearance=nodes.Appearance(material=nodes.Material(), **appearance))


def rows(samples: SampleBuffer) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, unit normals, and the unit rays from the eye."""
    position, normal = np.asarray(samples.position), np.array(samples.normal)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    ray = position - np.asarray(samples.eye)
    return position, normal, ray / np.linalg.norm(ray, axis=1, keepdims=True)


def directions(samples: SampleBuffer, camera: Camera) -> np.ndarray:
    """The rays through the centres of the samples' pixels."""
    assert samples.width is not None and samples.height is not None
    return camera.rays(samples.width, samples.height).direction[np.asarray(samples.pixel)]


# --- places and normals -----------------------------------------------------------------------------------------------

ELLIPSOID = nodes.Transform(
    translation=(0.3, -0.2, 0.5),
    rotation=(1, 2, 3, 0.8),
    scale=(1.5, 0.7, -1.1),
    children=[shape(nodes.Sphere(radius=1.2))],
)


def test_samples_of_a_transformed_sphere_lie_on_it_and_carry_its_normals() -> None:
    scene = Scene.from_nodes([ELLIPSOID])
    samples = rasterize(scene, VIEW, 101, 83)
    to_world = scene.document.shapes[0].to_world
    inverse = np.linalg.inv(to_world[:, :3])
    position, normal, ray = rows(samples)
    local = (position - to_world[:, 3]) @ inverse.T
    np.testing.assert_allclose(np.linalg.norm(local, axis=1), 1.2, rtol=1e-12)
    exact = local @ inverse  # inverse transpose, then normalised
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    np.testing.assert_allclose(normal, exact, atol=1e-12)
    expected = directions(samples, VIEW)
    np.testing.assert_allclose(ray, expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-12)


def test_the_outline_of_a_sphere_is_true_to_a_sixteenth_of_a_pixel() -> None:
    scene, (width, height) = Scene.from_nodes([shape(nodes.Sphere(radius=1.5))]), (203, 151)
    samples = rasterize(scene, VIEW, width, height)
    hit = np.zeros(width * height, dtype=bool)
    hit[np.asarray(samples.pixel)] = True
    rays = VIEW.rays(width, height).direction
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance = np.linalg.norm(np.cross(VIEW.position, rays), axis=1)
    # A pixel is this wide where the rays touch the sphere.
    pixel = 2 * math.tan(0.35) / height * np.linalg.norm(VIEW.position)
    assert np.all(hit[distance < 1.5 - pixel / 16])
    assert not np.any(hit[distance > 1.5])


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.2])
@pytest.mark.parametrize("geometry", [nodes.Sphere, nodes.Cylinder, nodes.Cone], ids=["sphere", "cylinder", "cone"])
def test_samples_at_outlines_lie_on_the_side_that_is_seen(geometry: type, turn: float) -> None:
    """Where a flat triangle lies behind the middle of its curved surface, the hidden side is nearer to it."""
    turned = nodes.Transform(rotation=(1, 0, 0, turn), children=[shape(geometry())])
    for size in (255, 256, 512):
        samples = rasterize(Scene.from_nodes([turned]), nodes.Viewpoint(position=(0, 0, 3)), size, size, dtype=float)
        _, normal, ray = rows(samples)
        assert np.max(np.einsum("ij,ij->i", normal, ray)) < 1e-7


@pytest.mark.parametrize("solid", [True, False])
@pytest.mark.parametrize("geometry", [nodes.Cylinder, nodes.Cone], ids=["cylinder", "cone"])
def test_open_cylinders_and_cones_show_their_inside_only_if_not_solid(geometry: type, solid: bool) -> None:
    ends = {"bottom": False} if geometry is nodes.Cone else {"bottom": False, "top": False}
    turned = nodes.Transform(rotation=(1, 0, 0, -1.2), children=[shape(geometry(solid=solid, **ends))])
    scene = Scene.from_nodes([turned])
    samples = rasterize(scene, VIEW, 90, 70)
    position, normal, ray = rows(samples)
    local = position @ scene.document.shapes[0].to_world[:, :3]
    radius = 1.0 if geometry is nodes.Cylinder else (1 - local[:, 1]) / 2
    np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 2]), radius, atol=1e-12)
    # Normals always face the viewer: of back faces they are turned round.
    assert np.all(np.einsum("ij,ij->i", normal, ray) < 0)
    inwards = (
        np.einsum("ij,ij->i", (normal @ scene.document.shapes[0].to_world[:, :3])[:, [0, 2]], local[:, [0, 2]]) < 0
    )
    assert np.any(inwards) != solid


def test_mirroring_keeps_the_outside_outside() -> None:
    plain = rasterize(Scene.from_nodes([shape(nodes.Box(size=(1, 2, 3)))]), VIEW, 64, 64)
    mirrored = nodes.Transform(scale=(-1, 1, 1), children=[shape(nodes.Box(size=(1, 2, 3)))])
    again = rasterize(Scene.from_nodes([mirrored]), VIEW, 64, 64)
    np.testing.assert_array_equal(np.asarray(again.pixel), np.asarray(plain.pixel))
    np.testing.assert_allclose(rows(again)[1], rows(plain)[1], atol=1e-15)
    np.testing.assert_allclose(np.asarray(again.position), np.asarray(plain.position), atol=1e-12)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("dtype", ["float16", "bfloat16", "float32"])
@pytest.mark.parametrize("scale", [1e-20, 1e-4, 1.0, 300.0, 1e20])
def test_normals_are_of_length_one_however_a_shape_is_scaled(scale: float, dtype: str) -> None:
    """Float types of few bits hold neither the squares of small scales nor those of large ones."""
    size = (2 / scale, 2 / scale, 2 / scale)
    turned = nodes.Transform(rotation=(1, 1, 0.3, 0.8), children=[shape(nodes.Box(size=size))])
    scene = Scene.from_nodes([nodes.Transform(scale=(scale, scale, scale), children=[turned])])
    samples = rasterize(scene, VIEW, 12, 12, dtype=dtype)
    normal = np.asarray(samples.normal, np.float64)
    eps = float(jax.numpy.finfo(dtype).eps)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=eps)
    side = normal @ scene.document.shapes[0].to_world[:, :3] / scale
    np.testing.assert_allclose(np.abs(side).max(axis=1), 1, atol=2 * eps)


@pytest.mark.filterwarnings("error")
def test_a_normal_of_zero_stays_zero() -> None:
    corners = nodes.Coordinate(point=[(-1, -1, 0), (1, -1, 0), (0, 1, 0)])
    geometry = nodes.TriangleSet(coord=corners, normal=nodes.Normal(vector=np.zeros((3, 3))))
    samples = rasterize(Scene.from_nodes([shape(geometry)]), VIEW, 12, 12)
    np.testing.assert_array_equal(np.asarray(samples.normal), np.zeros((samples.count, 3)))
    assert samples.count


PLANE = nodes.Coordinate(point=[(-3, -1, 4), (3, -1, 4), (3, 1, -6), (-3, 1, -6)])


def on_plane(samples: SampleBuffer) -> tuple[np.ndarray, np.ndarray]:
    """Where the rays of the samples meet PLANE, exactly: world positions, and (right, up) in [0, 1]^2."""
    corner, right, up = np.array([-3.0, -1, 4]), np.array([6.0, 0, 0]), np.array([0.0, 2, -10])
    normal = np.cross(right, up)
    ray = directions(samples, VIEW)
    position = VIEW.position + ray * ((corner - VIEW.position) @ normal / (ray @ normal))[:, None]
    return position, np.stack([(position - corner) @ right / 36, (position - corner) @ up / 104], axis=1)


def test_attributes_are_interpolated_in_perspective() -> None:
    """A plane that runs away from the viewer, with normals of different length and a colour at each corner."""
    normals = np.array([(0, 1, 0), (0, 1, 1), (1, 2, 0), (-1, 1, 0.5)])
    colors = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)])
    geometry = nodes.IndexedFaceSet(
        coord=PLANE,
        coord_index=[0, 1, 2, 3],
        normal=nodes.Normal(vector=normals),
        color=nodes.Color(color=colors),
        solid=False,
    )
    samples = rasterize(Scene.from_nodes([shape(geometry)]), VIEW, 77, 64)
    position, (s, t) = on_plane(samples)[0], on_plane(samples)[1].T
    np.testing.assert_allclose(np.asarray(samples.position), position, atol=1e-12)
    # The square is cut from corner 0 to corner 2.
    low = np.stack([1 - s, s - t, t, 0 * s], axis=1)
    high = np.stack([1 - t, 0 * s, s, t - s], axis=1)
    weight = np.where((t <= s)[:, None], low, high)
    normal = weight @ normals
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(np.asarray(samples.normal), normal, atol=1e-12)
    assert samples.color is not None
    np.testing.assert_allclose(np.asarray(samples.color), weight @ colors, atol=1e-12)


def test_texels_are_those_around_the_texture_coordinate() -> None:
    image = np.random.default_rng(2).uniform(size=(5, 7, 3))
    texcoord = nodes.TextureCoordinate(point=[(-0.4, 0), (2.3, 0), (2.3, 1.7), (-0.4, 1.7)])
    geometry = nodes.IndexedFaceSet(coord=PLANE, coord_index=[0, 1, 2, 3], tex_coord=texcoord, solid=False)
    texture = nodes.PixelTexture(image=image, repeat_t=False)
    samples = rasterize(Scene.from_nodes([shape(geometry, texture=texture)]), VIEW, 77, 64)
    assert samples.texel_index is not None and samples.texel_weight is not None
    index = np.asarray(samples.in_sample_order(samples.texel_index)).T
    weight = np.asarray(samples.in_sample_order(samples.texel_weight)).T
    found = np.einsum("nk,nkc->nc", weight, image.reshape(-1, 3)[index])
    s, t = on_plane(samples)[1].T * [[2.7], [1.7]] - [[0.4], [0.0]]
    column, row = (s % 1) * 7 - 0.5, np.clip(t, 0, 1) * 5 - 0.5
    expected = np.zeros((len(s), 3))
    for i in range(5):
        for j in range(7):
            # A tent around each texel; columns repeat, rows continue at the edge.
            across = np.maximum(1 - np.abs((column - j + 3.5) % 7 - 3.5), 0)
            along = np.maximum(1 - np.abs(np.clip(row, 0, 4) - i), 0)
            expected += (across * along)[:, None] * image[i, j]
    np.testing.assert_allclose(found, expected, atol=1e-11)


def test_bilinear_weights_at_texel_centres_and_far_outside() -> None:
    at = np.array([[0.5 / 4, 0.5 / 2], [1e6 + 3.5 / 4, -1e6 + 1.5 / 2], [1.0, 1.0], [0.0, 0.0]])
    index, weight = bilinear_texels(at, 4, 2, repeat_s=True, repeat_t=True)
    np.testing.assert_allclose(weight.sum(axis=1), 1)
    assert index[0][np.argmax(weight[0])] == 0 and weight[0].max() == 1
    assert index[1][np.argmax(weight[1])] == 7 and weight[1].max() > 1 - 1e-8
    assert sorted(index[2].tolist()) == sorted(index[3].tolist()) == [0, 3, 4, 7]
    index, weight = bilinear_texels(at, 4, 2, repeat_s=False, repeat_t=False)
    assert (index * weight).sum(axis=1).tolist() == [0, 3, 7, 0]


# --- the buffer -------------------------------------------------------------------------------------------------------


def test_surfaces_follow_each_other_and_pixels_the_morton_curve() -> None:
    random = np.random.default_rng(3)
    spheres = [
        nodes.Transform(translation=tuple(random.uniform(-2, 2, 3)), children=[shape(nodes.Sphere())]) for _ in range(6)
    ]
    samples = rasterize(Scene.from_nodes(spheres), VIEW, 93, 71)
    surface, pixel = np.asarray(samples.surface), np.asarray(samples.pixel)
    assert len(np.unique(pixel)) == samples.count
    assert np.all(np.diff(surface) >= 0)
    code = morton(pixel % 93, pixel // 93)
    assert np.all(np.diff(code)[np.diff(surface) == 0] > 0)
    assert morton(np.array([0b101]), np.array([0b011])).tolist() == [0b011011]


def test_vertex_colours_of_three_and_four_components_share_a_buffer() -> None:
    def square(x: float, color: nodes.Node | None) -> nodes.Node:
        points = [(x, -1, 0), (x + 1, -1, 0), (x + 1, 1, 0), (x, 1, 0)]
        faces = nodes.IndexedFaceSet(
            coord=nodes.Coordinate(point=points), coord_index=[0, 1, 2, 3], color=color, color_per_vertex=False
        )
        return shape(faces)

    children = [
        square(-1.5, nodes.Color(color=[(0.1, 0.2, 0.3)])),
        square(-0.5, nodes.ColorRGBA(color=[(0.4, 0.5, 0.6, 0.7)])),
        square(0.5, None),
    ]
    samples = rasterize(Scene.from_nodes(children), Camera.look_at((0, 0, 6), (0, 0, 0)), 30, 30)
    assert samples.color is not None
    x, color = np.asarray(samples.position)[:, 0], np.asarray(samples.color)
    np.testing.assert_allclose(color[x < -0.5], np.tile([0.1, 0.2, 0.3, 1], ((x < -0.5).sum(), 1)))
    middle = (x > -0.5) & (x < 0.5)
    np.testing.assert_allclose(color[middle], np.tile([0.4, 0.5, 0.6, 0.7], (middle.sum(), 1)))


@pytest.mark.parametrize("samples_per_pixel", [2, 4, 9, 16])
def test_coverage_is_the_area_of_a_pixel_that_a_shape_covers(samples_per_pixel: int) -> None:
    geometry = nodes.Box(size=(2, 2, 0.01))
    tilted = nodes.Transform(rotation=(0, 0, 1, 0.3), children=[shape(geometry)])
    camera = Camera.look_at((0, 0, 10), (0, 0, 0))
    samples = rasterize(Scene.from_nodes([tilted]), camera, 32, 32, samples=samples_per_pixel)
    covered = np.bincount(np.asarray(samples.pixel), np.asarray(samples.coverage), 32 * 32)
    assert covered.max() <= 1 + 1e-12
    # A pixel on the outline (8 units long, crossing at most 1.3 pixels a pixel's width) is right to one sample in k.
    pixel_side = 2 * math.tan(math.pi / 8) * 9.995 / 32
    assert abs(covered.sum() * pixel_side**2 - 4) < 1.3 * 8 * pixel_side / samples_per_pixel
    # More than one sample tells apart how far a pixel is covered.
    assert len(np.unique(np.round(covered, 9))) > 2


@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
def test_positions_that_lose_their_digits_are_told(dtype: str) -> None:
    """float32 keeps 7 digits: at 1e5 sizes from the origin 2 are left for what the picture shows, in float64 enough."""

    def told(distance: float, dtype: str) -> bool:
        there = nodes.Transform(translation=(0, distance, 0), children=[shape(nodes.Sphere()), nodes.Viewpoint()])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            rasterize(Scene.from_nodes([there]), width=8, dtype=dtype)
        assert all("from the origin" in str(one.message) for one in caught)
        return bool(caught)

    assert [told(distance, dtype) for distance in (0, 1e3, 1e6)] == [False, False, True]
    assert not told(1e6, "float64")


def test_one_sample_a_pixel_is_the_first_of_many_patterns() -> None:
    samples = rasterize(Scene.from_nodes([ELLIPSOID]), VIEW, 40, 30)
    assert samples.coverage is None
    assert (samples.width, samples.height) == (40, 30)
    np.testing.assert_array_equal(np.asarray(samples.camera_to_world), VIEW.rotation)
    np.testing.assert_array_equal(np.asarray(samples.pixel_to_world), VIEW.pixel_to_world(40, 30))


def test_a_viewpoint_of_the_scene_is_taken_with_its_transforms() -> None:
    view = nodes.Viewpoint(position=(0, 0, 9))
    scene = Scene.from_nodes([shape(nodes.Box()), nodes.Transform(translation=(1, 0, 0), children=[view])])
    assert rasterize(scene, view, 8, 8).eye.tolist() == [1, 0, 9]
    assert rasterize(scene, None, 8, 8).eye.tolist() == [1, 0, 9]
    assert rasterize(scene, nodes.Viewpoint(position=(0, 0, 7)), 8, 8).eye.tolist() == [0, 0, 7]


@pytest.mark.parametrize(
    ("children", "reason"),
    [
        ([nodes.Group()], "no shape of the scene has geometry"),
        ([nodes.Shape()], "no shape of the scene has geometry"),
        ([nodes.Transform(translation=(0, 0, 90), children=[shape(nodes.Box())])], "the camera sees no surface"),
    ],
)
def test_nothing_to_see_is_an_empty_buffer_and_a_warning(children: list, reason: str) -> None:
    with pytest.warns(UserWarning, match=reason):
        samples = rasterize(Scene.from_nodes(children), VIEW, 12, 9)
    assert samples.count == 0
    assert samples.position.shape == (0, 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"width": 0}, r"width: expected a whole number of pixels in \[1, 32768\], got 0"),
        ({"height": -3}, "height: expected a whole number"),
        ({"width": 12.0}, "width: expected a whole number"),
        ({"width": 10**9}, "width: expected a whole number"),
        ({"width": 20000, "height": 20000}, "20000 x 20000 pixels with 1 samples each exceed"),
        ({"samples": 0}, "whole number of samples a pixel"),
        ({"width": 4096, "height": 4096, "samples": 64}, "exceed"),
        ({"camera": (0, 0, 10)}, "camera: expected a Camera, a Viewpoint or None"),
    ],
)
def test_errors_say_what_is_wrong(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        rasterize(Scene.from_nodes([shape(nodes.Box())]), **arguments)


@pytest.mark.parametrize("camera", [VIEW, nodes.Viewpoint(), None])
def test_something_else_than_a_scene_is_refused(camera: Camera | nodes.Viewpoint | None) -> None:
    with pytest.raises(ValueError, match="rasterize: scene: expected a Scene, got str"):
        rasterize("scene.x3d", camera, 8, 8)


def test_a_shape_used_again_and_again_may_not_become_too_many_triangles() -> None:
    """Few bytes of a file can place a shape a million times."""
    corners = np.random.default_rng(0).normal(size=(300_000, 3))
    many = shape(nodes.TriangleSet(coord=nodes.Coordinate(point=corners)))
    scene = Scene.from_nodes([nodes.Group(children=[nodes.Group(children=[many] * 20)] * 20)])
    with pytest.raises(ValueError, match=r"^the scene has more than 33554432 triangles.*336 of 400 placed shapes"):
        rasterize(scene, VIEW, 8, 8)
    with pytest.raises(ValueError, match=r"^the scene has more than 33554432 triangles.*336 of 400 placed shapes"):
        Camera.view_all(scene)


def test_a_picture_whose_height_is_not_given_is_square() -> None:
    samples = rasterize(Scene.from_nodes([shape(nodes.Sphere())]), VIEW, 12)
    assert (samples.width, samples.height) == (12, 12)


def test_sizes_may_be_numbers_of_numpy() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        samples = rasterize(Scene.from_nodes([ELLIPSOID]), VIEW, np.int64(8), np.int32(6), np.uint8(2))
    assert [type(size) for size in (samples.width, samples.height)] == [int, int]
    assert (samples.width, samples.height) == (8, 6)
    created = SampleBuffer.create(
        np.zeros((1, 3)), np.ones((1, 3)), (0, 0, 1), pixel=[0], width=np.int64(2), height=np.int32(2)
    )
    assert type(created.width) is int and type(created.height) is int


# --- against an independent program (tests/data/view3dscene) ----------------------------------------------------------


def test_normals_agree_with_an_independent_program() -> None:
    """Crease angles, sides, `solid`: what max(0, n) looks like under three lights along the axes."""
    reference = read_image(REFERENCE / "normals.png")
    samples = rasterize(load(REFERENCE / "normals.x3d"), None, 480, 384)
    picture = np.full((384 * 480, 3), 0.2)
    picture[np.asarray(samples.pixel)] = np.maximum(rows(samples)[1], 0)
    error = np.abs(picture.reshape(reference.shape) - reference).max(axis=2)
    # Both round to 8 bits' steps; pixels on an edge may fall to either side.
    assert samples.count > 60_000
    assert np.count_nonzero(error > 1.01 / 255) <= 20


def test_texture_mapping_agrees_with_an_independent_program() -> None:
    """Every primitive from four sides, default mappings, a concave face, TextureTransform."""
    reference = read_image(REFERENCE / "texture_mapping.png")
    scene = load(REFERENCE / "texture_mapping.x3d")
    samples = rasterize(scene, None, 480, 384)
    ramp = np.asarray(Image.open(REFERENCE / "ramp.png"))[::-1].reshape(-1, 3) / 255
    index = np.asarray(samples.in_sample_order(samples.texel_index)).T
    weight = np.asarray(samples.in_sample_order(samples.texel_weight)).T
    picture = np.full((384 * 480, 3), 0.2)
    picture[np.asarray(samples.pixel)] = np.einsum("nk,nkc->nc", weight, ramp[index])
    error = np.abs(picture.reshape(reference.shape) - reference).max(axis=2)
    # Its circles are polygons of 30 sides, and it blurs textures that are seen at a flat angle.
    assert np.count_nonzero(error > 2.01 / 255) < 0.02 * samples.count
    assert np.count_nonzero(error > 0.1) < 0.006 * samples.count
