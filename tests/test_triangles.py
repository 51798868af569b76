"""Geometry nodes as triangles: areas, orientation, normals, texture mapping, attributes, errors. (For curved ones see
test_primitives.py.)"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from counted_work import at_most_calls
from jaxlight import load, nodes, rasterize
from jaxlight.raster import Triangles, geometry_of
from jaxlight.scene.polygons import MAX_CONCAVE_CORNERS


def triangles_of(geometry: nodes.Node | None, name: str = "", **appearance: object) -> Triangles:
    look = nodes.Appearance(**appearance) if appearance else None
    triangles = geometry_of(nodes.Shape(geometry=geometry, appearance=look, name=name))
    assert isinstance(triangles, Triangles)
    return triangles


def area_vectors(triangles: Triangles) -> np.ndarray:
    a, b, c = np.moveaxis(triangles.position, 1, 0)
    return np.cross(b - a, c - a) / 2


def volume(triangles: Triangles) -> float:
    """Enclosed volume by the divergence theorem; positive when faces are counterclockwise outside."""
    return float(np.einsum("ij,ij->", area_vectors(triangles), triangles.position.mean(axis=1)) / 3)


def test_a_box_is_closed_outside_out_and_of_the_right_volume() -> None:
    triangles = triangles_of(nodes.Box(size=(1, 2, 3)))
    np.testing.assert_allclose(volume(triangles), 6, rtol=1e-12)
    # Closed: the area vectors of a closed surface cancel.
    np.testing.assert_allclose(area_vectors(triangles).sum(axis=0), 0, atol=1e-12)
    assert np.all(np.einsum("ij,ikj->ik", area_vectors(triangles), triangles.normal) > 0)


def texcoord_at(
    triangles: Triangles, point: tuple[float, float, float], normal: tuple[float, float, float]
) -> np.ndarray:
    """The texture coordinate of the corner at `point` whose normal is `normal`."""
    is_there = np.linalg.norm(triangles.position - np.array(point), axis=2) < 1e-9
    is_there &= np.linalg.norm(triangles.normal - np.array(normal), axis=2) < 1e-9
    found = triangles.texcoord[is_there]
    assert len(found), "no such corner"
    assert np.ptp(found, axis=0).max() < 1e-12
    return found[0]


@pytest.mark.parametrize(
    ("normal", "low_left", "up_right"),
    [
        ((0, 0, 1), (-1, -1, 1), (1, 1, 1)),
        ((0, 0, -1), (1, -1, -1), (-1, 1, -1)),
        ((1, 0, 0), (1, -1, 1), (1, 1, -1)),
        ((-1, 0, 0), (-1, -1, -1), (-1, 1, 1)),
        ((0, 1, 0), (-1, 1, 1), (1, 1, -1)),
        ((0, -1, 0), (-1, -1, -1), (1, -1, 1)),
    ],
)
def test_the_texture_stands_upright_on_each_face_of_a_box(normal: tuple, low_left: tuple, up_right: tuple) -> None:
    """X3D 13.3.1: upright seen from outside; top seen with -z up, bottom with +z up."""
    box = triangles_of(nodes.Box())
    np.testing.assert_allclose(texcoord_at(box, low_left, normal), (0, 0))
    np.testing.assert_allclose(texcoord_at(box, up_right, normal), (1, 1))


SQUARE = nodes.Coordinate(point=[(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])


def test_default_texture_coordinates_follow_the_bounding_box() -> None:
    """X3D 13.3.6: s along the longest side, t along the next, up to the ratio of the two; ties x, y, z."""
    wide = nodes.Coordinate(point=[(0, 2, 5), (0, 2, 1), (0, 4, 1), (0, 4, 5)])
    triangles = triangles_of(nodes.IndexedFaceSet(coord=wide, coord_index=[0, 1, 2, 3]))
    expected = (triangles.position[..., [2, 1]] - [1, 2]) / 4
    np.testing.assert_allclose(triangles.texcoord, expected)
    tie = triangles_of(nodes.IndexedFaceSet(coord=SQUARE, coord_index=[0, 1, 2, 3]))
    np.testing.assert_allclose(tie.texcoord, tie.position[..., :2])


def test_texture_transform_follows_the_clause() -> None:
    """X3D 18.4.8: Tc' = -C S R C T Tc, spelled out with 3 x 3 matrices."""

    def shift(x: float, y: float) -> np.ndarray:
        return np.array([[1, 0, x], [0, 1, y], [0, 0, 1]])

    cosine, sine = math.cos(0.4), math.sin(0.4)
    rotation = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    matrix = shift(-0.3, -0.1) @ np.diag([2, 3, 1]) @ rotation @ shift(0.3, 0.1) @ shift(0.5, -0.2)
    transform = nodes.TextureTransform(center=(0.3, 0.1), rotation=0.4, scale=(2, 3), translation=(0.5, -0.2))
    plain, moved = triangles_of(nodes.Box()), triangles_of(nodes.Box(), texture_transform=transform)
    homogeneous = np.concatenate([plain.texcoord, np.ones((12, 3, 1))], axis=2)
    np.testing.assert_allclose(moved.texcoord, (homogeneous @ matrix.T)[..., :2], atol=1e-15)


CUBE = nodes.Coordinate(point=[(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
CUBE_FACES = [0, 2, 3, 1, -1, 4, 5, 7, 6, -1, 0, 1, 5, 4, -1, 2, 6, 7, 3, -1, 0, 4, 6, 2, -1, 1, 3, 7, 5]


def cube(**fields: object) -> Triangles:
    return triangles_of(nodes.IndexedFaceSet(coord=CUBE, coord_index=CUBE_FACES, **fields))


def test_crease_angle_decides_edge_by_edge() -> None:
    """X3D 13.3.6: smooth where the angle between the faces' normals is less than the crease angle."""
    flat, smooth = cube(crease_angle=math.pi / 2), cube(crease_angle=math.pi / 2 + 1e-9)
    expected = area_vectors(flat) / np.linalg.norm(area_vectors(flat), axis=1, keepdims=True)
    np.testing.assert_allclose(flat.normal, np.repeat(expected[:, None], 3, axis=1), atol=1e-15)
    np.testing.assert_allclose(smooth.normal, smooth.position / math.sqrt(3), atol=1e-15)


def test_a_crease_separates_the_smooth_parts_of_a_vertex() -> None:
    """A roof of four strips, 0.3 radians apart but for a ridge of 1.2 in the middle: two smooth halves."""
    turns = np.cumsum([0.0, 0.3, 1.2, 0.3])
    path = np.concatenate([[(0.0, 0.0)], np.cumsum(np.stack([np.cos(turns), np.sin(turns)], axis=1), axis=0)])
    points = [(x, y, z) for x, y in path for z in (0.0, 1.0)]
    faces = [index for i in range(4) for index in (2 * i, 2 * i + 1, 2 * i + 3, 2 * i + 2, -1)]
    roof = triangles_of(nodes.IndexedFaceSet(coord=nodes.Coordinate(point=points), coord_index=faces, crease_angle=0.5))
    angle = np.arctan2(-roof.normal[..., 0], roof.normal[..., 1])  # of a flat face: its turn
    face = np.repeat(np.arange(4), 2)
    for number, ends in enumerate([(0.0, 0.15), (0.15, 0.3), (1.5, 1.65), (1.65, 1.8)]):
        np.testing.assert_allclose(np.unique(np.round(angle[face == number], 9)), ends, atol=1e-9)


ROOF = [(0, 0, 1), (0, 0, -1), (1, -1, -1), (1, -1, 1), (-1, -1, 1), (-1, -1, -1), (0, 0, 0)]


@pytest.mark.parametrize(
    ("left", "empty"),
    [
        pytest.param([0, 1, 5, 4], [0, 1], id="two corners"),
        pytest.param([0, 1, 5, 4], [0, 1, 1], id="a repeated corner"),
        pytest.param([0, 6, 1, 5, 4], [0, 1, 6], id="three corners on a line"),
    ],
)
def test_faces_without_area_do_not_smooth_a_crease(left: list[int], empty: list[int]) -> None:
    """A ridge of a right angle, whose two faces have a third between them that nobody sees."""
    faces = [0, 3, 2, 1, -1, *left, -1, *empty, -1]
    roof = nodes.IndexedFaceSet(coord=nodes.Coordinate(point=ROOF), coord_index=faces, crease_angle=1.0)
    drawn = triangles_of(roof).without_degenerate()
    flat = area_vectors(drawn) / np.linalg.norm(area_vectors(drawn), axis=1, keepdims=True)
    np.testing.assert_allclose(drawn.normal, np.repeat(flat[:, None], 3, axis=1), atol=1e-15)


def test_a_face_that_is_flat_but_for_rounding_does_not_turn_normals() -> None:
    """Slivers along an edge of a pyramid, in many attitudes: their own normals are nothing but rounding."""
    points = np.array([(0, 0, 0.5), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0.3, 0, 0.35)])
    sides = [0, 1, 2, -1, 0, 2, 3, -1, 0, 3, 4, -1, 0, 4, 1, -1]
    random = np.random.default_rng(2)
    for _ in range(50):
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        turn *= np.linalg.det(turn)
        coord = nodes.Coordinate(point=points @ turn.T)
        for geometry in (
            nodes.IndexedFaceSet(coord=coord, coord_index=[*sides, 0, 5, 1], crease_angle=3.0),
            nodes.IndexedTriangleSet(coord=coord, index=[i for i in [*sides, 0, 5, 1] if i >= 0]),
        ):
            drawn = triangles_of(geometry).without_degenerate()
            at_top = np.all(np.abs(drawn.position - points[0] @ turn.T) < 1e-9, axis=2)
            assert np.sum(at_top) == 4
            np.testing.assert_allclose(drawn.normal[at_top], np.tile(turn[:, 2], (4, 1)), atol=1e-12)


@pytest.mark.parametrize("sides", [4, 3])
@pytest.mark.parametrize("repeated", range(3))
def test_a_face_that_visits_a_vertex_twice_counts_once(sides: int, repeated: int) -> None:
    """A triangle written as four corners, the top of a pyramid twice, has the normals of one written as three."""
    points = [(0, 0, 0.5), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)]
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]][:sides]

    def normals_at_the_top(faces: list[list[int]]) -> np.ndarray:
        index = [i for face in faces for i in (*face, -1)]
        found = triangles_of(
            nodes.IndexedFaceSet(coord=nodes.Coordinate(point=points), coord_index=index, crease_angle=3.0)
        ).without_degenerate()
        return found.normal[found.position[..., 2] == 0.5]

    expected = normals_at_the_top(faces)
    faces[repeated] = [*faces[repeated][1:], 0, 0]
    np.testing.assert_allclose(normals_at_the_top(faces), expected, atol=1e-15)


def test_faces_that_share_a_repeated_corner_and_no_edge_keep_their_normals() -> None:
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (-1, 0, 0.2), (-1, -1, 0.2)]
    faces = [0, 0, 1, 2, -1, 0, 0, 3, 4, -1]
    drawn = triangles_of(
        nodes.IndexedFaceSet(coord=nodes.Coordinate(point=points), coord_index=faces, crease_angle=1.0)
    ).without_degenerate()
    flat = area_vectors(drawn) / np.linalg.norm(area_vectors(drawn), axis=1, keepdims=True)
    np.testing.assert_allclose(drawn.normal, np.repeat(flat[:, None], 3, axis=1), atol=1e-15)


def test_clockwise_faces_are_turned_round_and_their_normals_with_them() -> None:
    """`ccw` FALSE: the front is where the corners run clockwise; generated normals point there."""
    ccw, cw = cube(), cube(ccw=False)
    np.testing.assert_allclose(volume(cw), -volume(ccw))
    assert np.all(np.einsum("ij,ikj->ik", area_vectors(cw), cw.normal) > 0)
    given = nodes.Normal(vector=[(0, 0, 1)])
    kept = cube(ccw=False, normal=given, normal_index=[0] * 6, normal_per_vertex=False)
    assert np.all(kept.normal == (0, 0, 1))


def test_normal_per_vertex_false_makes_flat_normals() -> None:
    np.testing.assert_array_equal(cube(crease_angle=4.0, normal_per_vertex=False).normal, cube().normal)


L_SHAPE = [(0, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0), (1, 2, 0), (0, 2, 0)]


@pytest.mark.parametrize("start", range(6))
@pytest.mark.parametrize("reverse", [False, True])
def test_concave_faces_are_cut_into_their_own_area(start: int, reverse: bool) -> None:
    points = L_SHAPE[start:] + L_SHAPE[:start]
    points = points[::-1] if reverse else points
    face = nodes.IndexedFaceSet(coord=nodes.Coordinate(point=points), coord_index=list(range(6)), convex=False)
    areas = area_vectors(triangles_of(face))[:, 2] * (-1 if reverse else 1)
    assert np.all(areas > 0)
    np.testing.assert_allclose(areas.sum(), 3)


@pytest.mark.parametrize("repeated", range(6))
def test_a_repeated_corner_leaves_a_concave_face_what_it_is(repeated: int) -> None:
    points = L_SHAPE[1 : repeated + 1] + L_SHAPE[repeated:] + L_SHAPE[:1]
    face = nodes.IndexedFaceSet(coord=nodes.Coordinate(point=points), coord_index=list(range(7)), convex=False)
    areas = area_vectors(triangles_of(face))[:, 2]
    assert np.all(areas >= 0)
    np.testing.assert_allclose(areas.sum(), 3)


def test_repeated_corners_are_no_obstacle_to_cutting() -> None:
    corners = [(0, 0), (1, 0), (1, -1), (1, -1), (2, -1), (2, 0), (3, 0), (3, 0), (3, 1), (0, 1)]
    points = [(x, y, 0) for x, y in corners]
    face = nodes.IndexedFaceSet(coord=nodes.Coordinate(point=points), coord_index=list(range(10)), convex=False)
    areas = area_vectors(triangles_of(face))[:, 2]
    assert np.all(areas >= 0)
    np.testing.assert_allclose(areas.sum(), 4)


H_SHAPE = [(0, 0), (1, 0), (1, 2), (2, 2), (2, 0), (3, 0), (3, 5), (2, 5), (2, 3), (1, 3), (1, 5), (0, 5)]


def test_corners_on_a_line_are_cut_right_in_every_attitude() -> None:
    """Corners of a letter lie on lines through others, but for rounding, once the letter is turned."""
    random = np.random.default_rng(1)
    flat = np.pad(np.array(H_SHAPE, float), ((0, 0), (0, 1)))
    for _ in range(100):
        points = flat @ np.linalg.qr(random.normal(size=(3, 3)))[0]
        face = nodes.IndexedFaceSet(coord=nodes.Coordinate(point=points), coord_index=list(range(12)), convex=False)
        areas = np.linalg.norm(area_vectors(triangles_of(face)), axis=1)
        np.testing.assert_allclose(areas.sum(), 11)


def test_a_star_with_a_bridge_to_its_hole_keeps_the_hole() -> None:
    outer = [
        (math.cos(a) * r, math.sin(a) * r, 0) for a, r in zip(np.arange(10) * math.pi / 5, [2, 1] * 5, strict=True)
    ]
    hole = [(0.3, 0, 0), (0, -0.3, 0), (-0.3, 0, 0), (0, 0.3, 0)]
    ring = [*outer, outer[0], *hole, hole[0]]
    triangles = triangles_of(
        nodes.IndexedFaceSet(coord=nodes.Coordinate(point=ring), coord_index=list(range(len(ring))), convex=False)
    )
    areas = area_vectors(triangles)[:, 2]
    assert np.all(areas > 0)
    np.testing.assert_allclose(areas.sum(), 10 * math.sin(math.pi / 5) - 0.18)


def test_random_simple_polygons_keep_their_area() -> None:
    random = np.random.default_rng(5)
    for count in (5, 17, 60):
        angles = np.sort(random.uniform(0, 2 * math.pi, count))
        radii = random.uniform(0.2, 1.0, count)
        x, y = radii * np.cos(angles), radii * np.sin(angles)
        points = np.stack([x, y, 0.3 * x - 0.2 * y], axis=1)
        shape = nodes.IndexedFaceSet(coord=nodes.Coordinate(point=points), coord_index=list(range(count)), convex=False)
        areas = area_vectors(triangles_of(shape))[:, 2]
        assert np.all(areas >= -1e-15)
        np.testing.assert_allclose(areas.sum(), (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2, rtol=1e-12)


def test_a_spiral_of_thousands_of_corners_is_cut_with_little_work() -> None:
    """Nearly every corner is no ear, and half of them turn right."""
    angle = np.linspace(0, 20 * math.pi, 1600)
    inner, outer = (np.stack([r * np.cos(angle), r * np.sin(angle), 0 * r], 1) for r in (1 + angle, 2 + angle))
    ring = np.concatenate([outer, inner[::-1]])
    face = nodes.IndexedFaceSet(coord=nodes.Coordinate(point=ring), coord_index=list(range(3200)), convex=False)
    with at_most_calls(1_000_000):
        areas = area_vectors(triangles_of(face))[:, 2]
    x, y, _ = ring.T
    assert len(areas) == 3198 and np.all(areas > 0)
    np.testing.assert_allclose(areas.sum(), (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2, rtol=1e-12)


COLORS = nodes.Color(color=[(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)])
TWO_FACES = [0, 1, 2, -1, 0, 2, 3, -1]


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, [[0, 1, 2], [0, 2, 3]]),
        ({"color_index": [3, 2, 1, -1, 0, 0, 1, -1]}, [[3, 2, 1], [0, 0, 1]]),
        ({"color_per_vertex": False}, [[0, 0, 0], [1, 1, 1]]),
        ({"color_per_vertex": False, "color_index": [3, 1]}, [[3, 3, 3], [1, 1, 1]]),
    ],
    ids=["vertex", "vertex-indexed", "face", "face-indexed"],
)
def test_colours_per_vertex_and_per_face(fields: dict, expected: list) -> None:
    """X3D 13.3.6: index lists default to coordIndex (vertices) or to the order of the faces."""
    triangles = triangles_of(nodes.IndexedFaceSet(coord=SQUARE, coord_index=TWO_FACES, color=COLORS, **fields))
    assert triangles.color is not None
    np.testing.assert_array_equal(triangles.color, COLORS.color[np.array(expected)])


def test_triangle_sets_take_attributes_by_vertex_and_drop_remainders() -> None:
    """X3D Rendering: vertices share the mean of their triangles' normals; a last incomplete triple is ignored."""
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    indexed = triangles_of(
        nodes.IndexedTriangleSet(coord=nodes.Coordinate(point=points), index=[0, 1, 2, 0, 3, 1, 0, 1], color=COLORS)
    )
    assert len(indexed) == 2
    np.testing.assert_allclose(indexed.normal[0], [(0, 0.5**0.5, 0.5**0.5)] * 2 + [(0, 0, 1)])
    np.testing.assert_array_equal(indexed.color, COLORS.color[[[0, 1, 2], [0, 3, 1]]])
    flat = nodes.IndexedTriangleSet(
        coord=nodes.Coordinate(point=points), index=[0, 1, 2, 0, 3, 1], normal_per_vertex=False
    )
    np.testing.assert_allclose(triangles_of(flat).normal[1], [(0, 1, 0)] * 3)
    plain = triangles_of(nodes.TriangleSet(coord=nodes.Coordinate(point=points)))
    np.testing.assert_array_equal(plain.position, [points[:3]])
    np.testing.assert_array_equal(plain.normal, [[(0, 0, 1)] * 3])


def test_what_is_too_much_is_ignored() -> None:
    """As X3D says of one or two corners; and of colours by face nobody asks for those of faces that are not there."""
    coord = nodes.Coordinate(point=[*SQUARE.point[:3], (9, 9, 9)])
    three = nodes.Color(color=[(1, 0, 0)] * 3)
    indexed = nodes.IndexedTriangleSet(coord=coord, index=[0, 1, 2, 9], color=three)
    by_face = nodes.IndexedFaceSet(
        coord=coord, coord_index=[0, 1, 2, -1], color=three, color_index=[0, 7], color_per_vertex=False
    )
    for geometry in (nodes.TriangleSet(coord=coord, color=three), indexed, by_face):
        assert len(triangles_of(geometry)) == 1


def test_faces_without_area_are_dropped() -> None:
    points = nodes.Coordinate(point=[(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0)])
    faces = nodes.IndexedFaceSet(coord=points, coord_index=[0, 1, 2, -1, 0, 0, 1, -1, 0, 1, -1, 0, 1, 3, -1])
    assert len(triangles_of(faces)) == 1
    assert len(triangles_of(None)) == 0


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        (
            nodes.IndexedFaceSet(coord=SQUARE, coord_index=[0, 1, 4]),
            r"Shape\[wall\].geometry.coord_index: index 4, but coord has 4 entries",
        ),
        (
            nodes.IndexedFaceSet(coord=nodes.Coordinate(), coord_index=[0, 1, 2]),
            "index 2, but coord has 0 entries",
        ),
        (
            nodes.IndexedFaceSet(coord=SQUARE, coord_index=TWO_FACES, color=COLORS, color_index=[0, 1, 2]),
            "color_index: expected -1 in the same places as in coord_index",
        ),
        (
            nodes.IndexedFaceSet(coord=SQUARE, coord_index=TWO_FACES, color=COLORS, color_index=[0, 1, 2, 0, -1, 2, 3]),
            "color_index: expected -1 in the same places as in coord_index",
        ),
        (
            nodes.IndexedFaceSet(
                coord=SQUARE, coord_index=TWO_FACES, color=COLORS, color_index=[1], color_per_vertex=False
            ),
            "color_index: expected an index >= 0 for each of 2 faces, got 1",
        ),
        (
            nodes.IndexedFaceSet(coord=SQUARE, coord_index=TWO_FACES, normal=nodes.Normal(vector=[(0, 0, 1)] * 3)),
            "coord_index: index 3, but normal has 3 entries",
        ),
        (
            nodes.IndexedFaceSet(
                coord=SQUARE,
                coord_index=TWO_FACES,
                tex_coord=nodes.TextureCoordinate(point=[(0, 0)]),
                tex_coord_index=[0, 0, 0, -1, 0, 0, 9, -1],
            ),
            "tex_coord_index: index 9, but tex_coord has 1 entries",
        ),
        (nodes.IndexedTriangleSet(coord=SQUARE, index=[0, 1, 5]), "geometry.index: index 5, but coord has 4 entries"),
        (nodes.IndexedTriangleSet(coord=SQUARE, index=[0, 1, -1]), "index: expected indices >= 0"),
        (
            nodes.TriangleSet(coord=SQUARE, color=nodes.Color(color=[(1, 1, 1)])),
            "geometry.coord: index 2, but color has 1 entries",
        ),
        (
            nodes.IndexedFaceSet(
                coord=nodes.Coordinate(point=[(i % 2 + 1.0, math.sin(i), 0) for i in range(MAX_CONCAVE_CORNERS + 1)]),
                coord_index=list(range(MAX_CONCAVE_CORNERS + 1)),
                convex=False,
            ),
            "face 0 is concave and has 10001 corners",
        ),
        (
            nodes.IndexedFaceSet(
                coord=nodes.Coordinate(point=[(i % 2 + 1.0, math.sin(i), 0) for i in range(5999)]),
                coord_index=[*range(5999), -1] * 3,
                convex=False,
            ),
            "3 concave faces have 17997 corners together; the squares of their numbers of corners may come to 10{8}",
        ),
    ],
)
def test_bad_indices_name_the_shape_and_the_field(geometry: nodes.Node, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        triangles_of(geometry, "wall")


@pytest.mark.filterwarnings("error")
def test_faces_that_are_too_large_are_named_without_a_warning_before(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1e200 0 0\nv 1e200 1e200 0\nv 5e199 1e199 0\nf 1 2 3 4\n"
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(ValueError, match=r"lies up to 1e\+200 from the origin"):
        rasterize(load(tmp_path / "a.obj"), None, 8, 8)
