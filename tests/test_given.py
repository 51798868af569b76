"""Arguments in the forms in which people have them: scalars and arrays of NumPy and JAX, one thing or several."""

from __future__ import annotations

import collections
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight import (
    Camera,
    Free,
    LightingOptions,
    Orthographic,
    SampleBuffer,
    Scene,
    View,
    check_gradients,
    compare,
    compiler_options,
    decode,
    fit,
    load,
    nodes,
    rasterize,
    read_image,
    samples_from_maps,
    save,
    write_image,
)
from jaxlight.fit.free import RequestError
from jaxlight.fit.problem import make_problem
from jaxlight.given import plain, several

INTENSITY = "PointLight[lamp].intensity"
GREY = np.full((8, 8, 3), 0.25)
BALL = nodes.Shape(
    appearance=nodes.Appearance(
        material=nodes.Material(), texture=nodes.PixelTexture(image=np.full((8, 8, 3), 0.5), name="t")
    ),
    geometry=nodes.Sphere(),
)


class Place:
    """A path of another library's."""

    def __init__(self, path: Any) -> None:
        self.path = path

    def __fspath__(self) -> Any:
        return self.path


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A textured sphere under a lamp."""
    return Scene.from_nodes([BALL, nodes.PointLight(location=(0, 0, 3), name="lamp")])


@pytest.fixture(scope="module")
def view(scene: Scene) -> View:
    """Of the scene, grey."""
    return View(rasterize(scene, Camera.look_at((0, 0, 5), (0, 0, 0)), 8, 8), GREY)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (np.str_("a"), "a"),
        (np.array("a"), "a"),
        (np.bool_(True), True),
        (jnp.array(True), True),
        (np.float32(0.5), 0.5),
        (np.array(3), 3),
    ],
)
def test_scalars_are_what_python_has(given: Any, expected: Any) -> None:
    assert plain(given) == expected and type(plain(given)) is type(expected)
    assert several(given) == [expected]


@pytest.mark.parametrize(
    "given", [["a"], ("a",), {"a"}, {"a": 1}.keys(), iter(["a"]), np.array(["a"]), "a", collections.deque("a")]
)
def test_several_come_in_whatever_gives_them(given: Any) -> None:
    assert several(given) == ["a"]


def test_what_is_alone_stays_so() -> None:
    assert several(b"ab") == [b"ab"] and several(None) == [None] and several([]) == []
    assert jax.make_jaxpr(lambda x: several(x)[0] + 1)(0.5)


ALIKE: dict[str, Callable[[Any], Any]] = {
    "Material.shininess": lambda v: nodes.Material(shininess=v).shininess,
    "Camera.look_at": lambda v: Camera.look_at((0, 0, 5), (0, 0, 0), field_of_view=v).field_of_view,
    "Camera.view_all": lambda v: Camera.view_all(Scene.from_nodes([BALL]), field_of_view=v).position[2],
    "compare": lambda v: compare(GREY, GREY / 2, peak=v).psnr,
    "decode": lambda v: float(decode(v)),
}
HALVES: list[Any] = [
    np.float32(0.5), np.array(0.5, ">f8"), np.longdouble(0.5), np.array(0.5, object), jnp.array(0.5),
    np.ma.array(0.5),
]  # fmt: skip


@pytest.mark.parametrize("name", ALIKE)
def test_a_number_is_one_in_whatever_type(name: str) -> None:
    assert [ALIKE[name](half) for half in HALVES] == [ALIKE[name](0.5)] * len(HALVES)


WIDTHS: list[Any] = [np.int64(4), np.uint8(4), np.array(4), np.array(4, ">i4"), jnp.array(4)]


@pytest.mark.parametrize("width", WIDTHS)
def test_a_whole_number_is_one_in_whatever_type(width: Any, scene: Scene) -> None:
    camera = Camera.look_at((0, 0, 5), (0, 0, 0))
    samples = rasterize(scene, camera, width, width, width)
    assert (samples.width, samples.height) == (4, 4) and np.asarray(samples.coverage)[0] == 0.25
    assert camera.rays(width, width).direction.shape == (16, 3)


ROWS = np.arange(6.0).reshape(2, 3) / 8
ARRAYS: list[Any] = [
    ROWS.astype(">f8"), ROWS.astype(np.longdouble), ROWS.astype(object), np.ma.array(ROWS), np.asfortranarray(ROWS),
    np.repeat(ROWS, 2, axis=1)[:, ::2], ROWS.tolist(), jnp.asarray(ROWS),
]  # fmt: skip


@pytest.mark.parametrize("rows", ARRAYS)
def test_rows_are_rows_in_whatever_type(rows: Any) -> None:
    buffer = SampleBuffer.create(rows, ROWS, (0, 0, 5), color=ROWS)
    np.testing.assert_array_equal(buffer.position, ROWS)
    np.testing.assert_array_equal(buffer.with_rows(color=rows).color, ROWS)
    np.testing.assert_array_equal(decode(rows, "none"), ROWS)
    assert buffer.in_storage_order(rows, axis=0).shape[0] == buffer.slots


def test_levels_are_divided_in_whatever_order_of_bytes() -> None:
    assert compare(np.full((2, 2), 65535, ">u2"), np.ones((2, 2))).largest == 0


def test_array_files_of_python_2_give_no_warning(tmp_path: Path) -> None:
    np.save(tmp_path / "n.npy", np.tile([0.0, 0, 1], (2, 2, 1)))
    data = (tmp_path / "n.npy").read_bytes()
    (tmp_path / "n.npy").write_bytes(data.replace(b"(2, 2, 3), }   ", b"(2L, 2L, 3L), }"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert samples_from_maps(tmp_path / "n.npy", Orthographic(), depth=0).count == 4


def test_maps_whose_background_is_infinite_give_no_warning() -> None:
    normal, depth = np.tile([0.0, 0, 1], (4, 4, 1)), np.full((4, 4), np.inf)
    depth[1:3, 1:3] = 2.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert samples_from_maps(normal, Orthographic(), depth=depth).count == 4
        position = np.where(np.isinf(depth)[..., None], np.inf, 1.0) * np.ones(3)
        assert samples_from_maps(normal, Orthographic(), position=position, position_frame="camera").count == 4


def test_options_of_numpy_are_those_of_python() -> None:
    given = LightingOptions(np.str_("modulate"), np.bool_(False), np.array(True), np.int64(2))
    assert repr(given) == repr(LightingOptions("modulate", False, True, 2))


def test_nodes_come_in_whatever_gives_them() -> None:
    array = np.empty(1, object)
    array[0] = BALL
    for children in (iter([BALL]), {BALL}, array, np.array(BALL, object), {1: BALL}.values()):
        assert nodes.Group(children=children).children == (BALL,)
    assert Scene.from_nodes(np.array(BALL, object)).document.children == (BALL,)


def test_paths_come_in_whatever_gives_them(scene: Scene, view: View) -> None:
    once = Free((path for path in [INTENSITY]), tied=True)
    for free in (np.array(INTENSITY), np.array([INTENSITY]), {INTENSITY}, iter([INTENSITY]), once, {INTENSITY: None}):
        assert make_problem(scene, np.array(view, object), free)[1].labels == [INTENSITY]
    lamp = View(view.samples, GREY, lights=np.array("PointLight[lamp]"))  # type: ignore[arg-type]
    assert make_problem(scene, lamp, INTENSITY)[1].labels == [INTENSITY]


def test_files_come_by_whatever_gives_a_path(scene: Scene, tmp_path: Path) -> None:
    assert save(scene, Place(str(tmp_path / "a.x3d"))) == (tmp_path / "a.x3d",)  # type: ignore[arg-type]
    np.save(tmp_path / "n.npy", np.tile([0.0, 0, 1], (2, 2, 1)))
    assert samples_from_maps(Place(str(tmp_path / "n.npy")), Orthographic(), depth=0).count == 4


PATHS: dict[str, Callable[[Any, Scene, View], Any]] = {
    "load: path": lambda path, scene, view: load(path),
    "read_image: path": lambda path, scene, view: read_image(path),
    "save: path": lambda path, scene, view: save(scene, path),
    "write_image: path": lambda path, scene, view: write_image(path, GREY),
    "log": lambda path, scene, view: fit(scene, view, INTENSITY, log=path),
    "checkpoint": lambda path, scene, view: fit(scene, view, INTENSITY, checkpoint=path),
    "samples_from_maps: normal": lambda path, scene, view: samples_from_maps(path, Orthographic(), depth=0),
}
NO_PATHS: list[Any] = ["", "a\0.npz", "\ud800", Place(b"a.x3d"), Place(None)]


@pytest.mark.parametrize("where", PATHS)
def test_what_is_no_path_is_named(
    where: str, scene: Scene, view: View, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for path in NO_PATHS:
        with pytest.raises(ValueError, match=rf"^{where}: expected a path, got "):
            PATHS[where](path, scene, view)
    assert not list(tmp_path.iterdir())


TEXELS = "Texture[t].image"
REFUSED: list[tuple[Callable[[Scene, View], Any], str]] = [
    (lambda s, v: nodes.Material(name=np.array(["a", "b"])), r"^Material.name: expected a string, got \['a' 'b'\]"),
    (lambda s, v: Scene.from_nodes("a.x3d"), "Scene.from_nodes: expected a node or a list of nodes, got 'a.x3d'"),
    (lambda s, v: Scene.from_nodes(BALL, dtype="\ud800"), "dtype: expected a floating-point type"),
    (lambda s, v: Camera.look_at((0, 0, 5), (0, 0, 0), field_of_view=np.complex128(1)), r"radians in \(0, pi\)"),
    (lambda s, v: Camera.default(s).rays(2**63, 1), r"rays: width: expected .* pixels in \[1, 32768\], got 922337"),
    (lambda s, v: Camera.default(s).pixel_to_world(10**400, 1), r"width: expected a whole number in \[1, "),
    (lambda s, v: rasterize(s, width=np.timedelta64(4, "s")), "rasterize: width: expected a whole number of pixels"),
    (lambda s, v: v.samples.with_rows(position=np.full((1, 3), "0.5")), "position: expected real numbers, got"),
    (lambda s, v: v.samples.with_rows(position=np.zeros(1, [("a", "f8")])), "position: expected real numbers, got"),
    (lambda s, v: v.samples.with_rows(position=[[10**400] * 3]), "position: expected real numbers, got"),
    (lambda s, v: v.samples.in_storage_order(np.ones(v.samples.count), None), "axis: expected a finite number, got"),
    (lambda s, v: LightingOptions(support_level=True), "support_level: expected 1 or 2 or 3, got True"),
    (lambda s, v: LightingOptions(fog_unlit="no"), "fog_unlit: expected True or False, got 'no'"),
    (lambda s, v: compiler_options(all_cores=[True]), "all_cores: expected True or False, got"),
    (lambda s, v: compare(GREY, GREY, peak=True), "compare: peak: expected a finite number > 0, got True"),
    (lambda s, v: write_image("a.png", GREY, bits=np.array([8, 8])), "bits: expected a whole number >= 1, got"),
    (lambda s, v: check_gradients(s, v.samples, [None]), "fields: expected paths such as .*, got None"),
    (lambda s, v: check_gradients(s, v.samples, [[INTENSITY]]), "fields: expected paths such as"),
    (lambda s, v: check_gradients(s, v.samples, []), "fields: none is named; leave it out to check all of them"),
    (lambda s, v: fit(s, v, b"Fog.color"), "free: expected a field path, .* got b'Fog.color'"),
    (lambda s, v: fit(s, v, Free(iter([]))), "free: expected a path or several, got"),
    (lambda s, v: fit(s, v, Free(INTENSITY, tied=np.array([1, 2]))), "tied: expected True, False or 'all', got"),
    (
        lambda s, v: fit(s, v, Free(TEXELS, tied="")),
        r"^Texture\[t\].image: tied: expected True, False or 'all', got ''",
    ),
    (lambda s, v: fit(s, v, Free(TEXELS, upper="1")), r"upper: expected one number, one a component, .* got '1'"),
    (lambda s, v: fit(s, v, Free(TEXELS, upper=10**400)), "upper: expected one number, one a component, .* got 1000"),
    (
        lambda s, v: fit(s, v, Free("PointLight[*].intensity", mean=1e30, deviation=0.1)),
        r"^PointLight\[lamp\].intensity: mean: so many deviations from the start that .* more than float32 holds",
    ),
    (lambda s, v: fit(s, v, Free(TEXELS, mean=1e30, deviation=1)), r"^Texture\[t\].image: mean: so many deviations"),
    (lambda s, v: fit(s, v, INTENSITY, loss=np.array(["huber"] * 2)), "loss: expected 'squares', 'huber' or 'cau"),
    (lambda s, v: fit(s, v, INTENSITY, loss="huber", loss_scale=1e25), "loss_scale: expected .* float32 holds, got"),
    (lambda s, v: fit(s, v, INTENSITY, resume="no"), "resume: expected True or False, got 'no'"),
    (lambda s, v: fit(s, v, INTENSITY, overwrite=1), "overwrite: expected True or False, got 1"),
    (
        lambda s, v: fit(s, v, INTENSITY, starts=10**25),
        r"starts: expected a whole number in \[1, 100000\], got 1000",
    ),
]


@pytest.mark.parametrize(("act", "message"), REFUSED)
def test_what_does_not_fit_is_named(act: Callable[[Scene, View], Any], message: str, scene: Scene, view: View) -> None:
    with pytest.raises(ValueError, match=message), warnings.catch_warnings():
        warnings.simplefilter("error")
        act(scene, view)


def test_what_is_no_list_is_named_without_a_word_of_jax() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for stream in (iter([1.0]), {1: 1.0}.values()):
            with pytest.raises(ValueError, match=r"Coordinate\.point: expected finite numbers"):
                nodes.Coordinate(point=stream)


def test_an_error_about_what_is_free_says_which_it_is(scene: Scene, view: View) -> None:
    with pytest.raises(RequestError, match=r"intensity starts at 1, outside its bounds \[5, inf\]") as caught:
        fit(scene, view, [TEXELS, Free("PointLight[*].intensity", lower=5)])
    assert caught.value.place == 1
