"""First hits of primary rays: against brute force, watertight, exact at ties, whatever way the work is cut up, with
embree's guesses and without."""

from __future__ import annotations

import sys

import jax
import numpy as np
import pytest
import trimesh

from jaxlight.raster import Camera, depth_buffer, embree_depth, rasterize, visibility
from jaxlight.raster.depth_buffer import Boxes, rows_of
from jaxlight.raster.visibility import Prepared, barycentric, first_hits, prepare
from jaxlight.scene import Scene, nodes
from raster_oracle import first_hits as cast
from raster_oracle import margin

EYE = np.zeros(3)


def seen(
    triangles: np.ndarray, width: int, height: int, *, camera: Camera | None = None, cull: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """[height * width]: triangle (-1: none), depth, and the rays [height * width, 3] in world space."""
    camera = camera or Camera(EYE, np.eye(3), 1.2)
    with np.errstate(invalid="ignore"):
        to_camera = (triangles - camera.position) @ camera.rotation
    corners = np.ascontiguousarray(np.moveaxis(to_camera, 0, 2))
    prepared = Prepared.front_to_back(
        [prepare(corners, camera.pixel_to_camera(width, height), width, height, cull=cull)]
    )
    pixel, number, _ = first_hits(prepared, None, width, height)
    row = rows_of(prepared.number, number)
    which, depth = np.full(width * height, -1), np.full(width * height, np.inf)
    which[pixel] = number
    weight = barycentric(prepared, row, pixel % width + 0.5, pixel // width + 0.5)
    depth[pixel] = -np.einsum("nc,nc->n", weight, to_camera[which[pixel]][..., 2])
    return which, depth, camera.rays(width, height).direction


def soup(seed: int, count: int, size: float) -> np.ndarray:
    """Random triangles in front of, around and behind the eye."""
    random = np.random.default_rng(seed)
    middle = random.uniform((-3, -3, -6), (3, 3, 1), (count, 3))
    return middle[:, None] + random.normal(0, size, (count, 3, 3))


@pytest.mark.parametrize("size", [0.05, 0.5, 4.0])
@pytest.mark.parametrize("shape", [(37, 29), (1, 1), (150, 3), (97, 201)])
def test_agrees_with_brute_force(size: float, shape: tuple[int, int]) -> None:
    """Also with triangles that reach behind the eye, and with ones larger than the picture."""
    width, height = shape
    triangles = soup(int(100 * size) + width, 60, size)
    which, depth, rays = seen(triangles, width, height)
    expected, along = cast(EYE, rays, triangles)
    clear = margin(EYE, rays, triangles) > 1e-9
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(which[clear], expected[clear])
    hit = clear & (which >= 0)
    np.testing.assert_allclose(depth[hit], along[hit], rtol=1e-10)


def test_back_faces_are_left_out_on_request() -> None:
    triangles = soup(3, 80, 0.7)
    which, _, rays = seen(triangles, 60, 50, cull=True)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    is_front = np.einsum("ij,ij->i", normals, triangles[:, 0]) < 0
    expected, _ = cast(EYE, rays, triangles[is_front])
    expected = np.where(expected >= 0, np.flatnonzero(is_front)[expected], -1)
    clear = margin(EYE, rays, triangles) > 1e-9
    np.testing.assert_array_equal(which[clear], expected[clear])


@pytest.mark.parametrize("seed", range(6))
def test_no_ray_slips_out_of_a_closed_mesh(seed: int) -> None:
    """From inside, every ray meets the mesh, whether it passes through corners and edges or not."""
    random = np.random.default_rng(seed)
    mesh = trimesh.creation.icosphere(subdivisions=3)
    triangles = mesh.vertices[mesh.faces] * 10.0 ** random.uniform(-6, 6)
    turn = trimesh.transformations.random_rotation_matrix(random.uniform(size=3))[:3, :3]
    which, _, _ = seen(triangles, 131, 77, camera=Camera(triangles.mean(axis=(0, 1)), turn, 2.0))
    assert np.all(which >= 0)


def test_rays_through_shared_corners_and_edges_meet_exactly_one_side() -> None:
    """A grid of squares whose corners and diagonals lie exactly on rays: no holes, and the smaller number counts."""
    x = np.arange(-8.0, 9.0)
    points = np.stack(np.meshgrid(x, x, [-16.0], indexing="ij"), axis=-1)[:, :, 0]
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    triangles = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2).reshape(-1, 3, 3)
    # 16 pixels for 16 units at distance 16: the rays through pixel centres meet the diagonals' middles.
    camera = Camera.from_intrinsics(fx=16, fy=16, cx=8, cy=8, pixel_center=0.5)
    facing = Camera(camera.position, np.eye(3), None, camera.intrinsics)
    which, depth, _ = seen(triangles, 16, 16, camera=facing)
    np.testing.assert_array_equal(np.sort(which), np.arange(0, 512, 2))
    np.testing.assert_allclose(depth, 16, rtol=1e-15)


@pytest.mark.parametrize("reverse", [False, True])
def test_of_coincident_triangles_the_first_counts(reverse: bool) -> None:
    square = np.array([[[-9, -9, -5], [9, -9, -5], [9, 9, -5]], [[-9, -9, -5], [9, 9, -5], [-9, 9, -5]]], dtype=float)
    twice = np.concatenate([square, square[::-1] if reverse else square])
    which, _, _ = seen(twice, 40, 30)
    assert set(which.tolist()) == {0, 1}


@pytest.mark.parametrize("chunk", [64, 5000])
@pytest.mark.parametrize(("small", "block"), [(2, 8), (16, 64), (200, 256)])
def test_how_the_work_is_cut_up_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, chunk: int, small: int, block: int
) -> None:
    triangles = np.concatenate([soup(11, 300, 0.1), soup(12, 30, 2.0), soup(13, 20, (3, 3, 1e-4))])
    expected = seen(triangles, 90, 70)
    monkeypatch.setattr(depth_buffer, "_CHUNK", chunk)
    for module in (depth_buffer, visibility):
        monkeypatch.setattr(module, "SMALL", small)
        monkeypatch.setattr(module, "BLOCK", block)
    found = seen(triangles, 90, 70)
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(found[1], expected[1])


def test_of_walls_that_pass_through_each_other_every_part_in_front_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall begins in front of another by far less than a thousandth of its distance."""
    tilts = np.random.default_rng(14).normal(0, (0, 0, 2e-2), (20, 3, 3))
    walls = np.array([[[-40.0, -40, -5], [40, -40, -5], [0, 60, -5]]]) + tilts
    expected = cast(EYE, Camera(EYE, np.eye(3), 1.2).rays(90, 70).direction, walls)[0]
    monkeypatch.setattr(depth_buffer, "_CHUNK", 64)
    for module in (depth_buffer, visibility):
        monkeypatch.setattr(module, "SMALL", 2)
        monkeypatch.setattr(module, "BLOCK", 8)
    np.testing.assert_array_equal(seen(walls, 90, 70)[0], expected)


def test_a_triangle_seen_edge_on_is_not_seen() -> None:
    edge_on = np.array([[[0.0, -1, -2], [0, 1, -3], [0, 1, -9]]])
    assert np.all(seen(edge_on, 9, 9)[0] == -1)
    behind = np.array([[[-1.0, -1, 2], [1, -1, 2], [0, 1, 2]]])
    assert np.all(seen(behind, 9, 9)[0] == -1)


def test_agrees_with_embree_but_for_its_single_precision() -> None:
    """Where the two disagree, the ray passes within single precision of an edge."""
    scenes = pytest.importorskip("embreex.rtcore_scene")
    meshes = pytest.importorskip("embreex.mesh_construction")
    mesh = trimesh.creation.icosphere(subdivisions=5)
    points = mesh.vertices * (1 + 0.1 * np.sin(7 * mesh.vertices[:, :1]))
    camera = Camera.look_at((0.2, 0.4, 2.5), (0, 0, 0), field_of_view=0.8)
    which, _, rays = seen(points[mesh.faces], 301, 203, camera=camera)
    scene = scenes.EmbreeScene()
    meshes.TriangleMesh(scene, (points - camera.position).astype(np.float32), mesh.faces.astype(np.int32))
    theirs = scene.run(np.zeros(rays.shape, np.float32), rays.astype(np.float32))
    differ = np.flatnonzero(which != theirs)
    assert len(differ) < 1e-3 * len(rays)
    assert (which >= 0).mean() > 0.3
    if len(differ):
        assert margin(camera.position, rays[differ], points[mesh.faces]).max() < 1e-6


def test_a_speck_does_not_show_through_what_is_just_in_front() -> None:
    """A speck's depth rounds by far more than the gap; it must not come out before its nearest corner."""
    random = np.random.default_rng(81)
    wall = np.array([[[-40.0, -40, -5], [40, -40, -5], [0, 60, -5]]])
    for _ in range(200):
        toward = np.array([0.5, 0.5, 1]) @ Camera(EYE, np.eye(3), 1.2).pixel_to_camera(2, 2).T
        speck = toward * 5 * (1 + 1e-8) + random.normal(0, (1e-5, 1e-5, 0), (60, 3, 3))
        which, _, _ = seen(np.concatenate([speck, wall]), 2, 2)
        np.testing.assert_array_equal(which, 60)


def needles(seed: int, count: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    middle, along = random.uniform((-3, -3, -6), (3, 3, -1), (count, 3)), random.normal(0, 0.5, (count, 3))
    return np.stack([middle - along, middle + along, middle + random.normal(0, 0.01, (count, 3))], axis=1)


def layers(seed: int, count: int, across: tuple[float, float]) -> np.ndarray:
    """Triangles of one size at some distance."""
    random = np.random.default_rng(seed)
    middle = random.uniform((across[0], -4, -6), (across[1], 4, -3), (count, 3))
    return middle[:, None] + random.normal(0, 0.5, (count, 3, 3))


def closed_meshes() -> np.ndarray:
    ball, box = trimesh.creation.icosphere(subdivisions=4), trimesh.creation.box((1.0, 2.0, 1.0))
    parts = [ball.vertices[ball.faces] + (x, 0.1 * x, -3) for x in (-1.0, 0.0, 0.3)]
    return np.concatenate([*parts, box.vertices[box.faces] + (1, 1, -4), ball.vertices[ball.faces] * 9])


def degenerate() -> np.ndarray:
    """Edge-on, flat, pointlike, coincident, far too large, far too small and not finite, in front of a soup."""
    fan = np.array([[[0.0, y, -2], [0, y + 1, -3], [0, y + 1, -9]] for y in np.linspace(-2, 1, 9)])
    odd = soup(35, 12, 0.5)
    odd[0, 1] = odd[0, 0]
    odd[1] = odd[1, 0]
    odd[2, 2] = (odd[2, 0] + odd[2, 1]) / 2
    odd[3] *= 1e30
    odd[4] *= 1e-30
    odd[5, 0, 0], odd[6, 1, 1] = np.nan, np.inf
    tilted = fan + np.array([[[1e-9, 0, 0], [0, 0, 0], [-1e-12, 0, 0]]])
    scene = soup(36, 300, 0.4)
    return np.concatenate([fan, odd, tilted, scene, scene[::-1], scene[:50] * (1 + 1e-9)])


def everywhere(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Lets embree guess whatever the scene; the list grows by the number of guesses of each picture."""
    pytest.importorskip("embreex")
    for name, value in (("_OVERDRAW", 0), ("_FRONT", 1 << 20), ("_LARGEST", 1 << 40), ("_CLOSED", 0.0)):
        monkeypatch.setattr(embree_depth, name, value)
    counts: list[int] = []

    def likely_hits(*arguments):
        found = embree_depth.likely_hits(*arguments)
        counts.append(0 if found is None else len(found[0]))
        return found

    monkeypatch.setattr(visibility, "likely_hits", likely_hits)
    return counts


def without_embreex(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if it were not installed."""
    for name in ("embreex", "embreex.mesh_construction", "embreex.rtcore_scene"):
        monkeypatch.setitem(sys.modules, name, None)


SCENES = {
    "small triangles": soup(31, 3000, 0.1),
    "large triangles": soup(32, 200, 2.0),
    "slivers": soup(33, 500, (1, 1, 1e-4)),
    "needles": needles(34, 2000),
    "closed meshes": closed_meshes(),
    "degenerate": degenerate(),
    "tiny units": soup(37, 500, 0.3) * 1e-12,
    "huge units": soup(38, 500, 0.3) * 1e12,
}


@pytest.mark.parametrize("cull", [False, True])
@pytest.mark.parametrize("scene", SCENES)
def test_embree_changes_nothing(monkeypatch: pytest.MonkeyPatch, scene: str, cull: bool) -> None:
    """Bit for bit; and most of its guesses are hits, so that something was there to be changed."""
    with monkeypatch.context() as patch:
        without_embreex(patch)
        expected = seen(SCENES[scene], 133, 97, cull=cull)
    guesses = everywhere(monkeypatch)
    found = seen(SCENES[scene], 133, 97, cull=cull)
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(found[1], expected[1])
    assert guesses[0] > 0.9 * np.count_nonzero(expected[0] >= 0) > 0


@pytest.mark.parametrize("seed", range(4))
def test_wrong_guesses_change_nothing(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """Any triangle, at any pixel that its box holds, the last of all included."""
    triangles = np.concatenate([soup(41 + seed, 300, 0.2), soup(51 + seed, 30, 2.0), degenerate()])
    monkeypatch.setattr(visibility, "likely_hits", lambda *_: None)
    expected = seen(triangles, 90, 70)

    def wrong(prepared: Prepared, boxes: Boxes, *_: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        random = np.random.default_rng(seed)
        box = random.integers(len(boxes.row), size=20_000)
        x = random.integers(boxes.low_x[box], boxes.high_x[box], endpoint=True)
        return box, x, random.integers(boxes.low_y[box], boxes.high_y[box], endpoint=True)

    monkeypatch.setattr(visibility, "likely_hits", wrong)
    found = seen(triangles, 90, 70)
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(found[1], expected[1])


@pytest.mark.parametrize(
    ("triangles", "is_asked"),
    [
        (layers(61, 20_000, (-4, 4)), True),
        (layers(62, 2_000, (-4, 4)), False),
        (layers(63, 20_000, (0, 4)), False),
        (needles(64, 20_000), False),
        (closed_meshes(), False),
    ],
    ids=["many layers", "few layers", "half the picture empty", "needles", "large triangles in front"],
)
def test_embree_is_asked_only_where_it_pays(
    monkeypatch: pytest.MonkeyPatch, triangles: np.ndarray, is_asked: bool
) -> None:
    asked: list[bool] = []
    monkeypatch.setattr(embree_depth, "_embree", lambda: asked.append(True))
    seen(triangles, 128, 128)
    assert asked == [True] * is_asked


def test_the_buffers_are_the_same_without_embreex(monkeypatch: pytest.MonkeyPatch) -> None:
    """Through the public door, several rays a pixel."""
    points = soup(71, 6000, 0.2).reshape(-1, 3)
    index = np.insert(np.arange(len(points)).reshape(-1, 3), 3, -1, axis=1).ravel()
    mesh = nodes.IndexedFaceSet(coord=nodes.Coordinate(point=points), coord_index=index, solid=False)
    scene = Scene.from_nodes([nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()), geometry=mesh)])
    camera = Camera(EYE, np.eye(3), 1.2)
    with monkeypatch.context() as patch:
        without_embreex(patch)
        assert embree_depth._embree() is None
        expected = rasterize(scene, camera, 128, 128, samples=2)
    guesses = everywhere(monkeypatch)
    found = rasterize(scene, camera, 128, 128, samples=2)
    assert len(guesses) == 2 and min(guesses) > 0
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(ours, theirs)
