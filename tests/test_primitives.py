"""Spheres, cylinders and cones: exact against an independent ray caster, closed, whole, however large or near."""

from __future__ import annotations

import math

import jax
import numpy as np
import pytest

from jaxlight import Camera, SampleBuffer, Scene, nodes, rasterize
from jaxlight.raster import geometry_of
from jaxlight.raster.placed import PlacedShapes
from jaxlight.raster.primitives import Primitive
from jaxlight.raster.shapes import world_bounds
from jaxlight.scene.document import PlacedShape
from primitive_oracle import cast

SIZE = 96
RAMP = 256
"""Texels along each side of a texture whose red is s and whose green is t."""


@pytest.fixture(autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def ramp() -> nodes.Appearance:
    place = (np.arange(RAMP) + 0.5) / RAMP
    s, t = np.meshgrid(place, place)
    image = np.stack([s, t, np.zeros_like(s)], axis=-1)
    return nodes.Appearance(texture=nodes.ImageTexture(image=image, repeat_s=False, repeat_t=False))


def texcoord(samples: SampleBuffer) -> np.ndarray:
    """What the texels of a `ramp` say."""
    assert samples.texel_index is not None and samples.texel_weight is not None
    index, weight = (
        np.asarray(samples.in_sample_order(of, axis=-1)) for of in (samples.texel_index, samples.texel_weight)
    )
    row, column = np.divmod(index, RAMP)
    return np.stack([((of + 0.5) / RAMP * weight).sum(axis=0) for of in (column, row)], axis=1)


def random_scene(seed: int) -> tuple[Scene, Camera]:
    """A few primitives, turned, stretched, mirrored, one within the other; the camera anywhere, inside too."""
    random = np.random.default_rng(seed)
    children = []
    for _ in range(random.integers(1, 5)):
        solid = bool(random.integers(2))
        geometry = [
            nodes.Sphere(radius=random.uniform(0.3, 2), solid=solid),
            nodes.Cylinder(radius=random.uniform(0.3, 2), height=random.uniform(0.5, 3), solid=solid),
            nodes.Cone(bottom_radius=random.uniform(0.3, 2), height=random.uniform(0.5, 3), solid=solid),
        ][random.integers(3)]
        shape = nodes.Shape(geometry=geometry, appearance=ramp())
        children.append(
            nodes.Transform(
                translation=tuple(random.normal(0, 1, 3)),
                rotation=(*random.normal(size=3), random.uniform(0, 6)),
                scale=tuple(random.choice([-1, 1], 3) * random.uniform(0.4, 2, 3)),
                scale_orientation=(*random.normal(size=3), random.uniform(0, 6)),
                children=[shape],
            )
        )
    eye = random.normal(0, random.choice([0.3, 5]), 3)
    camera = Camera.look_at(eye, random.normal(0, 0.5, 3), field_of_view=random.uniform(0.4, 2.2))
    return Scene.from_nodes(children), camera


def as_oracle(scene: Scene) -> list[tuple[str, np.ndarray, np.ndarray, bool]]:
    known = []
    for placed in scene.document.shapes:
        match placed.node.geometry:
            case nodes.Sphere(radius=radius, solid=solid):
                known.append(("sphere", np.full(3, radius), placed.to_world, solid))
            case nodes.Cylinder(radius=radius, height=height, solid=solid):
                known.append(("cylinder", np.array([radius, height / 2, radius]), placed.to_world, solid))
            case nodes.Cone(bottom_radius=radius, height=height, solid=solid):
                known.append(("cone", np.array([radius, height / 2, radius]), placed.to_world, solid))
    return known


@pytest.mark.filterwarnings("ignore:rasterize. the camera sees no surface")
@pytest.mark.parametrize("first_seed", [0, 20])
def test_every_ray_meets_what_an_independent_caster_meets(first_seed: int) -> None:
    hits = 0
    for seed in range(first_seed, first_seed + 20):
        scene, camera = random_scene(seed)
        samples = rasterize(scene, camera, SIZE, SIZE)
        expected = cast(camera.position, camera.rays(SIZE, SIZE).direction, as_oracle(scene))
        clear, pixel = expected.margin > 1e-9, np.asarray(samples.pixel)
        assert clear.mean() > 0.99
        seen = np.zeros(SIZE * SIZE, dtype=bool)
        seen[pixel] = True
        np.testing.assert_array_equal(seen[clear], (expected.which >= 0)[clear])
        order = np.flatnonzero(clear[pixel])
        pixel = pixel[order]
        surface = np.array([placed.surface for placed in scene.document.shapes])
        np.testing.assert_array_equal(np.asarray(samples.surface)[order], surface[expected.which[pixel]])
        np.testing.assert_allclose(np.asarray(samples.position)[order], expected.point[pixel], atol=1e-9)
        np.testing.assert_allclose(np.asarray(samples.normal)[order], expected.normal[pixel], atol=1e-6)
        inside = np.clip(expected.texcoord[pixel], 0.5 / RAMP, 1 - 0.5 / RAMP)
        np.testing.assert_allclose(texcoord(samples)[order], inside, atol=1e-6)
        hits += len(order)
    assert hits > 20 * 1000


@pytest.mark.parametrize("gap", [2e-4, 1e-7])
@pytest.mark.parametrize("geometry", ["sphere", "cylinder", "cone"])
def test_nothing_shows_through_what_closely_encloses_it(geometry: str, gap: float) -> None:
    def of(size: float) -> nodes.Node:
        match geometry:
            case "sphere":
                return nodes.Sphere(radius=size)
            case "cylinder":
                return nodes.Cylinder(radius=size, height=2 * size)
            case _:
                return nodes.Cone(bottom_radius=size, height=2 * size)

    inner = nodes.Shape(geometry=of(1.0), appearance=nodes.Appearance(material=nodes.Material(name="inner")))
    outer = nodes.Shape(geometry=of(1 + gap), appearance=nodes.Appearance(material=nodes.Material(name="outer")))
    # Turned about the axis alone: so the one holds the other.
    scene = Scene.from_nodes([inner, nodes.Transform(rotation=(0, 1, 0, 0.02), children=[outer])])
    samples = rasterize(scene, Camera.look_at((0, 1, 3), (0, 0, 0)), 256, 256)
    assert samples.count > 10_000
    assert np.all(np.asarray(samples.surface) == 1)


@pytest.mark.parametrize(("radius", "above"), [(1000.0, 1.0), (1000.0, 0.01), (6.4e6, 1.7)])
def test_the_horizon_of_a_large_sphere_is_exact(radius: float, above: float) -> None:
    scene = Scene.from_nodes([nodes.Shape(geometry=nodes.Sphere(radius=radius))])
    camera = Camera.look_at((0, radius + above, 0), (0, radius + above, -1))
    samples = rasterize(scene, camera, 256, 256)
    ray = camera.rays(256, 256).direction
    below = -ray[:, 1] / np.linalg.norm(ray, axis=1)
    cosine = math.sqrt(above * (2 * radius + above)) / (radius + above)  # of the angle from straight down
    expected = below > cosine
    assert 0.2 < expected.mean() < 0.8
    seen = np.zeros(256 * 256, dtype=bool)
    seen[np.asarray(samples.pixel)] = True
    np.testing.assert_array_equal(seen, expected)


@pytest.mark.parametrize("distance", [3.0, 300.0, 3e5])
@pytest.mark.parametrize("geometry", [nodes.Cylinder(), nodes.Cone()], ids=["cylinder", "cone"])
def test_no_ray_slips_through_a_rim(geometry: nodes.Node, distance: float) -> None:
    """A view along the axis and askew, in which rays pass exactly through edges: what is inside is all filled."""
    scene = Scene.from_nodes([nodes.Shape(geometry=geometry)])
    for toward in ((0, 1, 0), (0, -1, 0), (0, 1, 1), (1, 0.5, 0)):
        way = np.array(toward, dtype=float) / np.linalg.norm(toward)
        up = (0, 0, -1) if toward[0] == toward[2] == 0 else (0, 1, 0)
        camera = Camera.look_at(distance * way, (0, 0, 0), up, field_of_view=2 * math.atan(2.0 / distance))
        samples = rasterize(scene, camera, 128, 128)
        seen = np.zeros((128, 128), dtype=bool)
        seen.reshape(-1)[np.asarray(samples.pixel)] = True
        # Convex: each row is one run.
        for row in seen[seen.any(axis=1)]:
            first, last = np.flatnonzero(row)[[0, -1]]
            assert row[first : last + 1].all()
        assert seen.sum() > 1000


@pytest.mark.parametrize("distance", [3.0, 300.0, 3e5])
@pytest.mark.parametrize(
    ("geometry", "end"),
    [(nodes.Cylinder(), 1), (nodes.Cylinder(), -1), (nodes.Cone(), -1)],
    ids=["top", "bottom", "cone"],
)
def test_rays_to_a_rim_meet_one_of_its_two_faces(geometry: nodes.Node, end: int, distance: float) -> None:
    camera = Camera.look_at((0, distance * end, distance), (0, 0, 0), field_of_view=2 * math.atan(2.0 / distance))
    placed = PlacedShapes.of(Scene.from_nodes([nodes.Shape(geometry=geometry)]))
    faces = placed.prepared(camera, 128, 128)[1]
    assert faces is not None
    angle = np.linspace(0.2, math.pi - 0.2, 2000)
    rim = np.stack([np.cos(angle), np.full(2000, end), np.sin(angle)], axis=1)
    u, v, w = np.linalg.inv(camera.pixel_to_world(128, 128)) @ (rim - camera.position).T
    met = [faces.depths(np.full(2000, row), u / w, v / w)[0] for row in range(len(faces.number))]
    assert len(np.unique(np.concatenate(met))) == 2000


def test_the_apex_of_a_cone_points_along_its_axis() -> None:
    scene = Scene.from_nodes([nodes.Shape(geometry=nodes.Cone())])
    samples = rasterize(scene, Camera.look_at((0, 5, 0), (0, 0, 0), (0, 0, -1)), 33, 33)
    at_apex = np.asarray(samples.pixel) == 33 * 16 + 16
    np.testing.assert_array_equal(np.asarray(samples.position)[at_apex], [(0, 1, 0)])
    np.testing.assert_array_equal(np.asarray(samples.normal)[at_apex], [(0, 1, 0)])


@pytest.mark.parametrize("below", [-4.0, -0.3])
@pytest.mark.parametrize("turned", [0.0, 0.7])
def test_the_apex_of_a_cone_seen_from_inside_is_inside_too(below: float, turned: float) -> None:
    """A ray through it would meet the outside there, if it were taken for a part of the cone above."""
    eye = (0.0, below * math.cos(turned), below * math.sin(turned))
    camera = Camera.look_at(eye, (0, 0, 0), (1, 0, 0))

    def seen(solid: bool) -> SampleBuffer:
        cone = nodes.Shape(geometry=nodes.Cone(bottom=False, solid=solid))
        moved = nodes.Transform(rotation=(1, 0, 0, turned), children=[nodes.Transform(children=[cone])])
        return rasterize(Scene.from_nodes([moved]), camera, 33, 33)

    with pytest.warns(UserWarning, match="sees no surface"):
        assert seen(True).count == 0
    samples = seen(False)
    middle = np.asarray(samples.pixel) == 33 * 16 + 16
    axis = np.array([0, math.cos(turned), math.sin(turned)])
    np.testing.assert_allclose(np.asarray(samples.position)[middle], [axis], atol=1e-12)
    assert np.all(np.asarray(samples.normal) @ axis < -0.44)


def test_the_parts_of_primitives_that_are_switched_off_are_missing() -> None:
    def count(geometry: nodes.Node) -> int:
        primitive = geometry_of(nodes.Shape(geometry=geometry))
        assert isinstance(primitive, Primitive)
        return len(primitive.faces)

    assert (count(nodes.Cylinder()), count(nodes.Cylinder(top=False)), count(nodes.Cylinder(side=False))) == (3, 2, 2)
    assert (count(nodes.Cone()), count(nodes.Cone(side=False, bottom=False))) == (2, 0)


@pytest.mark.parametrize(
    "geometry",
    [nodes.Sphere(radius=0.7), nodes.Cylinder(radius=0.5), nodes.Cone(height=3), nodes.Cone(side=False)],
    ids=["sphere", "cylinder", "cone", "disc"],
)
def test_bounds_are_those_of_many_points(geometry: nodes.Node) -> None:
    random = np.random.default_rng(4)
    to_world = np.hstack([random.normal(size=(3, 3)), random.normal(size=(3, 1))])
    shape = nodes.Shape(geometry=geometry)
    primitive = geometry_of(shape)
    assert isinstance(primitive, Primitive)
    found = world_bounds(PlacedShape(shape, to_world, 0), primitive)
    assert found is not None
    angle = np.linspace(0, 2 * np.pi, 2001)
    ring = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    if isinstance(geometry, nodes.Sphere):
        height = np.linspace(-1, 1, 801)
        points = np.concatenate([ring * math.sqrt(max(1 - y * y, 0)) + [0, y, 0] for y in height])
    else:
        ends = [ring - np.array([0, 1, 0])]
        if isinstance(geometry, nodes.Cylinder):
            ends.append(ring + np.array([0, 1, 0]))
        elif geometry.side:
            ends.append(np.array([[0.0, 1.0, 0.0]]))
        points = np.concatenate(ends)
    points = (points * primitive.half_size) @ to_world[:, :3].T + to_world[:, 3]
    np.testing.assert_allclose(found[0], points.min(axis=0), atol=1e-4)
    np.testing.assert_allclose(found[1], points.max(axis=0), atol=1e-4)


@pytest.mark.parametrize(
    "geometry",
    [
        nodes.Sphere(radius=1e300),
        nodes.Cone(bottom_radius=1e200),
        nodes.Box(size=(1e200, 1, 1)),
        nodes.IndexedFaceSet(
            coord=nodes.Coordinate(point=[(0, 0, 0), (1e300, 0, 0), (0, 1e300, 0)]), coord_index=[0, 1, 2]
        ),
    ],
    ids=["sphere", "cone", "box", "faces"],
)
@pytest.mark.filterwarnings("error")
def test_what_is_too_large_is_named(geometry: nodes.Node) -> None:
    scene = Scene.from_nodes([nodes.Shape(name="huge", geometry=geometry)])
    for given in (Camera.look_at((0, 0, 5), (0, 0, 0)), None):
        with pytest.raises(ValueError, match=r"Shape\[huge\]: lies up to .* from the origin; at most 1e\+100"):
            rasterize(scene, given, 8, 8)


def test_what_a_transform_takes_too_far_away_is_named() -> None:
    ball = nodes.Shape(name="ball", geometry=nodes.Sphere())
    scene = Scene.from_nodes([nodes.Transform(translation=(1e150, 0, 0), children=[ball])])
    with pytest.raises(ValueError, match=r"Shape\[ball\]: lies up to 1e\+150 from the origin; at most 1e\+100"):
        rasterize(scene, Camera.look_at((0, 0, 5), (0, 0, 0)), 8, 8)


@pytest.mark.parametrize(
    "geometry", [nodes.Cone(height=1e-200), nodes.Sphere(radius=1e-200), nodes.Cylinder(height=1e99)]
)
@pytest.mark.filterwarnings("error", "ignore:rasterize. the camera sees no surface")
def test_extreme_sizes_are_rendered_without_complaint(geometry: nodes.Node) -> None:
    samples = rasterize(Scene.from_nodes([nodes.Shape(geometry=geometry)]), Camera.look_at((0, 1, 5), (0, 0, 0)), 9, 9)
    assert np.all(np.isfinite(np.asarray(samples.position)))
    np.testing.assert_allclose(np.linalg.norm(np.asarray(samples.normal), axis=1), 1, rtol=1e-12)
