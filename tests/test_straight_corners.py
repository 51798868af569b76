"""Faces with corners on a straight line are cut so that no ray slips through between their triangles."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

import jaxlight
from jaxlight import nodes
from jaxlight.raster import Triangles, geometry_of
from jaxlight.scene.flatness import FLAT

STAIR = [(1, 2), (2, 2), (2, 1), (3, 1), (3, 0), (0, 0), (0, 3), (1, 3)]
TENTHS = [(0.5, 0.1), (0.4, 0.1), (0.4, 0.2), (0.3, 0.2), (0.3, 0.0), (0.5, 0.0)]
STEP = [(0, 0), (2, 0), (2, 1), (1, 1), (0, 1), (0, 2), (1, 2), (2, 2)]
STEP_FACES = [[2, 3, 4, 0, 1], [4, 3, 6, 5], [3, 2, 7, 6]]
Polygon = Sequence[tuple[float, float]]


def face_set(points: np.ndarray, faces: list[list[int]], *, convex: bool) -> nodes.IndexedFaceSet:
    index = np.array([i for face in faces for i in (*face, -1)])
    return nodes.IndexedFaceSet(
        coord=nodes.Coordinate(point=points), coord_index=index, convex=convex, solid=False, crease_angle=0.0
    )


def in_space(polygon: Sequence[tuple[float, float]] | np.ndarray) -> np.ndarray:
    return np.pad(np.array(polygon, float), ((0, 0), (0, 1)))


def drawn(geometry: nodes.IndexedFaceSet) -> Triangles:
    found = geometry_of(nodes.Shape(geometry=geometry))
    assert isinstance(found, Triangles)
    return found


def areas(triangles: Triangles) -> np.ndarray:
    a, b, c = np.moveaxis(triangles.position, 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def signed_area(polygon: np.ndarray) -> float:
    x, y = polygon.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


def turns(count: int) -> list[np.ndarray]:
    """Rotations at random."""
    random = np.random.default_rng(3)
    found = [np.linalg.qr(random.normal(size=(3, 3)))[0] for _ in range(count)]
    return [turn * np.linalg.det(turn) for turn in found]


def holes(
    polygon: Polygon, faces: list[list[int]], viewpoint: nodes.Viewpoint, width: int, rotation: tuple, *, convex: bool
) -> int:
    """Pixels of background more than a thousandth of a unit within a polygon, seen along -z before it is turned."""
    shape = nodes.Shape(geometry=face_set(in_space(polygon), faces, convex=convex))
    scene = jaxlight.Scene.from_nodes([nodes.Transform(rotation=rotation, children=(shape, viewpoint))])
    is_drawn = np.zeros(width * width, dtype=bool)
    is_drawn[np.asarray(jaxlight.rasterize(scene, None, width, width).pixel)] = True
    x, y, distance = np.asarray(viewpoint.position, float)
    pixel = (np.arange(width) + 0.5 - width / 2) * 2 * math.tan(viewpoint.field_of_view / 2) / width * distance
    at = np.stack(np.meshgrid(pixel + x, y - pixel), axis=-1).reshape(-1, 2)
    return int(np.sum(is_well_inside(np.array(polygon, float)[outline(faces)], at) & ~is_drawn))


def outline(faces: list[list[int]]) -> list[int]:
    """The edges that only one face has, one after the other."""
    edges = [(a, b) for face in faces for a, b in zip(face, [*face[1:], face[0]], strict=True)]
    following = {a: b for a, b in edges if (b, a) not in edges}
    path = [next(iter(following))]
    while following[path[-1]] != path[0]:
        path.append(following[path[-1]])
    return path


def is_well_inside(polygon: np.ndarray, at: np.ndarray) -> np.ndarray:
    """By the even-odd rule."""
    inside, near = np.zeros((2, len(at)), dtype=bool)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[1] != b[1]:
            crosses = a[0] + (at[:, 1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) > at[:, 0]
            inside ^= crosses & ((a[1] > at[:, 1]) != (b[1] > at[:, 1]))
        along = np.clip((at - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        near |= np.linalg.norm(at - a - along[:, None] * (b - a), axis=1) < 1e-3 * np.ptp(polygon)
    return inside & ~near


@pytest.mark.parametrize(
    ("polygon", "faces", "position", "field", "convex", "width", "rotation"),
    [
        pytest.param(STAIR, [[*range(8)]], (1.5, 1.5, 4), 0.6, False, 64, (0, 1, 0, 2.4), id="stair"),
        pytest.param(STAIR, [[*range(8)]], (1.5, 1.5, 4), 0.6, False, 512, (0, 1, 0, 2.4), id="stair-512"),
        pytest.param(TENTHS, [[*range(6)]], (0.4, 0.1, 0.3), 0.9, False, 40, (0, 0, 1, 0), id="but-for-rounding"),
        pytest.param(STEP, STEP_FACES, (1, 1, 4), 0.6, True, 41, (-1.1, 0.4, -1.1, 1.3), id="convex"),
    ],
)
def test_no_ray_slips_through(
    polygon: Polygon,
    faces: list[list[int]],
    position: tuple[float, float, float],
    field: float,
    convex: bool,
    width: int,
    rotation: tuple,
) -> None:
    viewpoint = nodes.Viewpoint(position=position, field_of_view=field)
    assert holes(polygon, faces, viewpoint, width, rotation, convex=convex) == 0
    random = np.random.default_rng(4)
    for _ in range(24):
        attitude = (*random.normal(size=3), float(random.uniform(-3, 3)))
        assert holes(polygon, faces, viewpoint, 41, attitude, convex=convex) == 0


def stairs(random: np.random.Generator) -> np.ndarray:
    """Steps up and down over a floor, with corners between corners here and there."""
    count = int(random.integers(2, 30))
    top: list[tuple[float, float]] = []
    for step in range(count):
        height = float(random.integers(1, 5))
        top += [(step, height), *[(step + 0.5, height)] * int(random.integers(2)), (step + 1, height)]
    floor = [(float(i), 0.0) for i in range(count + 1) if i in (0, count) or random.integers(2)]
    ring = [*floor, *top[::-1]]
    return np.array([a for a, b in zip(ring, [*ring[1:], ring[0]], strict=True) if a != b])


def plate(random: np.random.Generator) -> np.ndarray:
    """A row of square holes, each with a bridge to a corner below it."""
    count = int(random.integers(1, 5))
    ring: list[tuple[float, float]] = []
    for x in range(0, 4 * count, 4):
        ring += [(x, 0), (x + 1, 1), (x + 1, 3), (x + 3, 3), (x + 3, 1), (x + 1, 1), (x, 0)]
    return np.array([*ring, (4 * count, 0), (4 * count, 4), (0, 4)], float)


@pytest.mark.parametrize("polygon_of", [stairs, plate])
@pytest.mark.parametrize("unit", [1.0, 0.1])
def test_every_triangle_of_a_concave_face_has_an_area(
    polygon_of: Callable[[np.random.Generator], np.ndarray], unit: float
) -> None:
    random = np.random.default_rng(6)
    for turn in [np.eye(3), *turns(60)]:
        polygon = polygon_of(random)
        polygon = np.roll(polygon, random.integers(len(polygon)), axis=0)[:: random.choice((1, -1))]
        points = in_space(polygon * unit) @ turn.T
        found = drawn(face_set(points, [[*range(len(points))]], convex=False))
        edges = np.linalg.norm(found.position[:, [1, 2, 0]] - found.position, axis=2).max(axis=1)
        assert len(found) == len(points) - 2, "a triangle without area was left out"
        assert np.all(2 * areas(found) > 2 * FLAT * edges**2)
        np.testing.assert_allclose(areas(found).sum(), abs(signed_area(polygon * unit)), rtol=1e-12)


def corner_numbers(triangles: Triangles, points: np.ndarray) -> np.ndarray:
    """[T, 3], which of the points each corner is."""
    number = {tuple(point): i for i, point in enumerate(points.tolist())}
    return np.array([[number[tuple(corner)] for corner in triangle] for triangle in triangles.position.tolist()])


def edges_with_one_triangle(corners: np.ndarray) -> set[frozenset[int]]:
    count = Counter(frozenset(edge) for a, b, c in corners.tolist() for edge in ((a, b), (b, c), (c, a)))
    assert max(count.values()) <= 2
    return {edge for edge, times in count.items() if times == 1}


def strips(rows: int, midpoints: int) -> tuple[np.ndarray, list[list[int]], set[frozenset[int]]]:
    """Rows of cells, each with so many corners between those of its lower and upper side; the outer edges.

    The lower row of cells has one cell where the upper one has several, so that they share corners, not sides.
    """
    wide = midpoints + 1
    points = [(x, y) for y in range(rows + 1) for x in range(3 * wide + 1)]
    across = 3 * wide + 1
    faces = []
    for row in range(rows):
        for cell in range(3):
            low, high = row * across + cell * wide, (row + 1) * across + cell * wide
            lower, upper = range(low, low + wide + 1), range(high, high + wide + 1)
            if row % 2:
                faces += [[a, a + 1, b + 1, b] for a, b in zip(lower[:-1], upper[:-1], strict=True)]
            else:
                face = [*lower, *upper[::-1]]
                faces.append(face[cell:] + face[:cell])
    ends = [[y * across, (y + 1) * across] for y in range(rows)]
    outer = {frozenset((a + side, b + side)) for a, b in ends for side in (0, across - 1)}
    outer |= {frozenset((x + y, x + y + 1)) for x in range(across - 1) for y in (0, rows * across)}
    return in_space(points), faces, outer


@pytest.mark.parametrize("convex", [True, False])
@pytest.mark.parametrize("midpoints", [1, 2, 5])
def test_meshes_of_faces_with_midpoints_share_all_inner_edges(midpoints: int, convex: bool) -> None:
    """Faces of five and more corners, some by a fan around another corner, some by ears."""
    points, faces, outer = strips(4, midpoints)
    for turn in [np.eye(3), *turns(20)]:
        turned = points @ turn.T
        found = drawn(face_set(turned, faces, convex=convex))
        np.testing.assert_allclose(areas(found).sum(), 4 * 3 * (midpoints + 1), rtol=1e-12)
        assert edges_with_one_triangle(corner_numbers(found, turned)) == outer


@pytest.mark.parametrize("convex", [True, False])
@pytest.mark.parametrize("first", range(7))
def test_a_pentagon_with_a_corner_between_others(first: int, convex: bool) -> None:
    """Also one that stands twice there: all edges of the outline are edges of triangles."""
    corners = [(0, 0), (1, 0), (1, 0), (2, 0), (2, 1), (1, 2), (0, 1)]
    corners = corners[first:] + corners[:first]
    points = in_space(corners)
    found = drawn(face_set(points, [[*range(7)]], convex=convex))
    np.testing.assert_allclose(areas(found).sum(), 3)
    place = [list(dict.fromkeys(corners)).index(corner) for corner in corners]
    cut = np.array(place)[corner_numbers(found, points)]
    assert edges_with_one_triangle(cut) == {
        frozenset((a, b)) for a, b in zip(place, [*place[1:], place[0]], strict=True) if a != b
    }


@pytest.mark.parametrize("convex", [True, False])
def test_faces_without_straight_corners_keep_their_fans(convex: bool) -> None:
    """Beside one that has some: each around its first corner, in order."""
    angle = np.arange(7) * 2 * math.pi / 7
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = in_space(np.concatenate([ring, ring + 3, [(8, 0), (9, 0), (10, 0), (9, 1)]]))
    faces = [[*range(14, 18)], [3, 4, 5, 6, 0, 1, 2], [*range(7, 14)]]
    found = corner_numbers(drawn(face_set(points, faces, convex=convex)), points)
    fans = [[face[0], *pair] for face in faces[1:] for pair in itertools.pairwise(face[1:])]
    np.testing.assert_array_equal([row for row in found.tolist() if max(row) < 14], fans)
    assert len(found) == len(fans) + 2


def test_a_face_that_is_too_large_for_ears_stays_a_fan() -> None:
    """Two long sides of many corners: no fan will do, and a convex face is no error."""
    x = np.linspace(0, 1, 6000)
    polygon = np.concatenate([np.stack([x, 0 * x], axis=1), np.stack([x[::-1], 0 * x + 1], axis=1)])
    found = drawn(face_set(in_space(polygon), [[*range(12000)]], convex=True))
    np.testing.assert_allclose(areas(found).sum(), 1)


@pytest.mark.parametrize("face", [[0, 1, 2, 3], [0, 1, 0, 2], [0, 0, 1, 1, 2]])
def test_faces_without_area_stay_what_they_are(face: list[int]) -> None:
    points = in_space([(0, 0), (1, 0), (2, 0), (3, 0)])
    assert len(drawn(face_set(points, [face], convex=True))) == 0


def test_obj_faces_with_straight_corners_share_all_inner_edges(tmp_path: Path) -> None:
    """Quads that are triangles with a midpoint, and faces of more corners, beside each other."""
    points, faces, outer = strips(4, 2)
    apex = len(points)
    points = np.concatenate([points, [(4.5, 6.0, 0.0)]])
    last = 4 * 10
    faces += [[last, last + 1, last + 2, apex], [last + 2, last + 3, last + 4, apex]]
    faces += [[last + 4, last + 5, last + 6, apex], [last + 6, last + 7, last + 8, last + 9, apex]]
    lines = ["v " + " ".join(map(str, point)) for point in points.tolist()]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
    (tmp_path / "mesh.obj").write_text("\n".join(lines))
    scene = jaxlight.load(tmp_path / "mesh.obj")
    assert scene.document is not None
    (shape,) = scene.document.shapes
    found = geometry_of(shape.node)
    assert isinstance(found, Triangles)
    outer = {edge for edge in outer if min(edge) < last} | {frozenset((last, apex)), frozenset((last + 9, apex))}
    assert edges_with_one_triangle(corner_numbers(found, points)) == outer
