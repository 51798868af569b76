"""Arguments that are none are refused by name, with what came and what is allowed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight import (
    Camera,
    Fit,
    Free,
    LightingOptions,
    Orthographic,
    SampleBuffer,
    Scene,
    View,
    check_gradients,
    compare,
    fit,
    fitted_values,
    load,
    nodes,
    rasterize,
    read_image,
    samples_from_maps,
    save,
    shade,
    sum_over_samples,
    write_image,
    write_report,
)
from jaxlight.formats.levels import is_chosen
from jaxlight.image import encode, resolve

DIFFUSE = "Material[0].diffuse_color"


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A sphere under a point light."""
    ball = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()), geometry=nodes.Sphere())
    return Scene.from_nodes([ball, nodes.PointLight(location=(0, 0, 3), name="lamp")])


@pytest.fixture(scope="module")
def view(scene: Scene) -> View:
    """Of the scene, black."""
    samples = rasterize(scene, Camera.look_at((0, 0, 5), (0, 0, 0)), 8, 8)
    return View(samples, np.zeros((8, 8, 3)))


@pytest.fixture(scope="module")
def result(scene: Scene, view: View) -> Fit:
    """A fit of one step."""
    return fit(scene, view, DIFFUSE, max_steps=1)


FREE: list[tuple[Any, str]] = [
    (lambda s: s.materials.diffuse_color[5], "fails on this scene: index 5 is out of bounds"),
    (lambda s: s.spot.location, "fails on this scene: 'NoneType' object has no attribute 'location'"),
    (lambda s: s.materials.diffuse_color.at[0], "fails on this scene: .* no attribute 'at'"),
    ("Material[\u00b2].diffuse_color", "the scene has no field"),
    ("View[\u00b2].exposure", "there is no field"),
    ([], "free: no field is free"),
    (Free([]), "free: expected a path or several"),
    (3, "free: expected a field path, a function of the scene or a Free, got 3"),
]


@pytest.mark.parametrize(("free", "message"), FREE)
def test_fields_that_are_none(scene: Scene, view: View, free: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fit(scene, view, [free] if callable(free) else free)


OTHERS: list[tuple[Callable[[Scene, View, Fit], Any], str]] = [
    (lambda s, v, r: fit(s, v, DIFFUSE, loss_scale=0.5), "loss_scale: squares have none; .* got 0.5"),
    (lambda s, v, r: fit(s, v, DIFFUSE, log="a.npz", checkpoint="a.npz"), "log: expected another file than the check"),
    (lambda s, v, r: fit(s, v, DIFFUSE, progress=5), "progress: expected a function of a Step, got 5"),
    (lambda s, v, r: fitted_values(r), "problem: expected the problem of a fit .* got Fit"),
    (lambda s, v, r: check_gradients(s, v.samples, 3), "fields: expected paths"),
    (lambda s, v, r: check_gradients(s, v.samples, seed="a"), "seed: expected a whole number >= 0, got 'a'"),
    (lambda s, v, r: write_report("a.html", r, ["a"]), "views: expected a View or a list of them"),
    (lambda s, v, r: write_report("a.html", r, v, title=None), "title: expected a string, got None"),
    (lambda s, v, r: write_report("a.html", r, None), "views: expected a View or a list of them"),
    (lambda s, v, r: write_report("a.html", r, v, warnings=[3]), "warnings: expected a string, got 3"),
    (
        lambda s, v, r: write_report("a.html", r, View(rasterize(s, width=4), np.zeros((4, 4, 3)))),
        r"View\[0\].samples: expected 8 x 8 pixels as in the fit, got 4 x 4 pixels",
    ),
    (
        lambda s, v, r: write_report(
            "a.html", r, View(SampleBuffer.create(np.ones((1, 3)), np.ones((1, 3)), (0, 0, 5)), np.ones((1, 3)))
        ),
        r"View\[0\].samples: expected 8 x 8 pixels as in the fit, got no pixels",
    ),
    (lambda s, v, r: write_report(None, r, v), "write_report: path: expected a path, got None"),
    (lambda s, v, r: write_report("", r, v), "write_report: path: expected a path, got ''"),
    (lambda s, v, r: write_report("a.html", r, v, transfer=None), "transfer: expected 'none' or 'srgb', got None"),
    (lambda s, v, r: r.value(None), "path: expected a string, got None"),
    (lambda s, v, r: load(None), "load: path: expected a path, got None"),
    (lambda s, v, r: load(3), "load: path: expected a path, got 3"),
    (lambda s, v, r: load(b"a.x3d"), "load: path: expected a path, got b'a.x3d'"),
    (lambda s, v, r: read_image(None), "read_image: path: expected a path, got None"),
    (lambda s, v, r: save(s, 5), "save: path: expected a path, got 5"),
    (lambda s, v, r: write_image(None, v.target), "write_image: path: expected a path, got None"),
    (lambda s, v, r: fit(s, v, DIFFUSE, log=3), "log: expected a path, got 3"),
    (lambda s, v, r: fitted_values(r.problem, max_steps=0), "max_steps: expected a whole number >= 1, got 0"),
    (lambda s, v, r: fitted_values(r.problem, solver=3), "solver: expected a BoundedLevenbergMarquardt, got 3"),
    (
        lambda s, v, r: samples_from_maps(v.target, Orthographic(), depth=0, texel_per_pixel="no"),
        "samples_from_maps: texel_per_pixel: expected True or False, got 'no'",
    ),
    (
        lambda s, v, r: samples_from_maps(v.target, Orthographic(), depth=0, normal_y_down=1),
        "samples_from_maps: normal_y_down: expected True or False, got 1",
    ),
    (
        lambda s, v, r: samples_from_maps(
            v.target, Orthographic(), depth=0, normal_frame=np.array(["camera", "world"])
        ),
        "samples_from_maps: normal_frame: expected 'camera' or 'world', got array",
    ),
    (lambda s, v, r: Orthographic(None), "Orthographic.pixel_size: expected a finite number > 0, got None"),
    (lambda s, v, r: Orthographic("a"), "Orthographic.pixel_size: expected a finite number > 0, got 'a'"),
    (lambda s, v, r: Orthographic(center=(0, 0, np.nan)), "Orthographic.center: expected 3 finite numbers"),
    (
        lambda s, v, r: Camera.default(s).rays(0, 10),
        r"rays: width: expected a whole number of pixels in \[1, 32768\], got 0",
    ),
    (lambda s, v, r: Camera.default(s).rays(3, 2.5), r"rays: height: expected .* in \[1, 32768\], got 2.5"),
    (
        lambda s, v, r: Camera((0, 0, 5), np.eye(3), 0.8).pixel_to_camera(0, 0),
        r"pixel_to_camera: width: expected a whole number in \[1, \d+\], got 0",
    ),
    (lambda s, v, r: save(replace(s, document=None), "a.x3d"), "save: scene: expected .* whose document is None"),
    (lambda s, v, r: rasterize(replace(s, document=None)), "rasterize: scene: expected .* whose document is None"),
    (lambda s, v, r: Camera.default(replace(s, document=None)), "Camera.default: expected .* whose document is None"),
    (
        lambda s, v, r: fit(s, v, Free(DIFFUSE, lower=np.ma.masked_array(np.zeros(3), [0, 0, 1]))),
        "diffuse_color: lower: got a masked array, 1 of whose 3 numbers are masked",
    ),
    (lambda s, v, r: compare(v.target, v.target, peak=0), "compare: peak: expected a finite number > 0, got 0"),
    (
        lambda s, v, r: LightingOptions(support_level=np.array([1, 2])),
        r"support_level: expected 1 or 2 or 3, got array",
    ),
    (lambda s, v, r: v.samples.in_storage_order("no"), "in_storage_order: expected real numbers, got 'no'"),
    (lambda s, v, r: sum_over_samples(3, s, v.samples), "function: expected a function of colours, got 3"),
    (
        lambda s, v, r: sum_over_samples(lambda c, p: c, s, v.samples, "no"),
        r"planes\[0\]: expected real numbers, got 'no'",
    ),
    (lambda s, v, r: sum_over_samples(lambda c: 1j * c, s, v.samples), "function: expected real numbers, got complex"),
    (lambda s, v, r: resolve("no", v.samples), "resolve: values: expected real numbers, got 'no'"),
    (
        lambda s, v, r: shade(s, jax.tree.map(lambda leaf: leaf[None], v.samples)),
        r"samples: position_planes: expected shape \[1, 3, 64\], got \[1, 1, 3, 64\]: .* jax.vmap",
    ),
    (lambda s, v, r: Camera.look_at(np.full(3, 1j), (0, 0, 0)), r"look_at: eye: expected \[3\] numbers, got array"),
    (
        lambda s, v, r: jax.jit(lambda angle: nodes.Background(sky_angle=angle).sky_angle)(np.ones(1)),
        "Background.sky_angle: expected numbers, got traced ones; call it outside of jax.jit",
    ),
    (lambda s, v, r: nodes.Switch(which_choice=0.9), "which_choice: expected a whole number, got 0.9"),
]


@pytest.mark.parametrize(("act", "message"), OTHERS)
def test_other_arguments_that_are_none(
    scene: Scene,
    view: View,
    result: Fit,
    act: Callable[[Scene, View, Fit], Any],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message):
        act(scene, view, result)
    assert not list(tmp_path.iterdir())


HALF = np.ma.masked_array(np.ones((8, 8, 3)), mask=np.arange(192).reshape(8, 8, 3) % 2 == 0, fill_value=0)
"""A picture of which NumPy would give the masked half for numbers."""
MASKED: dict[str, Callable[[View], Any]] = {
    r"View\[0\].target": lambda v: View(v.samples, HALF),
    r"View\[0\].weight": lambda v: View(v.samples, v.target, weight=HALF),
    r"View\[0\].noise": lambda v: View(v.samples, v.target, noise=HALF),
    r"View\[0\].background": lambda v: View(v.samples, v.target, background=HALF),
    r"View\[0\].mask": lambda v: View(v.samples, v.target, mask=HALF[..., 0]),
    "samples_from_maps: normal": lambda v: samples_from_maps(HALF, Orthographic(), depth=0),
    "samples_from_maps: mask": lambda v: samples_from_maps(v.target, Orthographic(), depth=0, mask=HALF[..., 0]),
    "samples_from_maps: surface": lambda v: samples_from_maps(
        HALF.data, Orthographic(), depth=0, surface=HALF[..., 0].astype(int)
    ),
    "SampleBuffer: position": lambda v: SampleBuffer.create(HALF[0], HALF[0].data, (0, 0, 5)),
    "SampleBuffer: surface": lambda v: SampleBuffer.create(
        HALF[0].data, HALF[0].data, (0, 0, 5), surface=HALF[0, :, 0].astype(int)
    ),
    "SampleBuffer: normal": lambda v: v.samples.with_rows(normal=HALF[0]),
    "Camera.look_at: eye": lambda v: Camera.look_at(HALF[0, 0], (0, 0, 0)),
    "compare: reference": lambda v: compare(v.target, HALF),
    "compare: mask": lambda v: compare(v.target, v.target, HALF[..., 0]),
    "a.png": lambda v: write_image("a.png", HALF),
    "image": lambda v: encode(HALF),
    "Material.diffuse_color": lambda v: nodes.Material(diffuse_color=HALF[0, 0]),
    "Material.shininess": lambda v: nodes.Material(shininess=np.ma.masked),
    "Coordinate.point": lambda v: nodes.Coordinate(point=HALF[0]),
    "IndexedFaceSet.coord_index": lambda v: nodes.IndexedFaceSet(coord_index=HALF[0, 0].astype(int)),
    "PixelTexture.image": lambda v: nodes.PixelTexture(image=HALF),
    "Background.sky_angle": lambda v: nodes.Background(sky_angle=HALF[0, 0]),
}


@pytest.mark.parametrize("where", MASKED)
def test_masked_numbers_are_not_taken_for_numbers(
    where: str, scene: Scene, view: View, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=rf"^{where}: got a masked array, \d+ of whose \d+ numbers are masked; "):
        fit(scene, MASKED[where](view), DIFFUSE)


def test_masked_arrays_of_which_nothing_is_masked_are_arrays(view: View) -> None:
    whole = np.ma.masked_array(HALF.data)
    assert nodes.Coordinate(point=whole[0]).point.shape == (8, 3)
    assert compare(whole, whole).largest == 0


def test_a_masked_array_for_which_there_is_a_mask_names_it(scene: Scene, view: View) -> None:
    with pytest.raises(ValueError, match=r"give its data, and False where it is masked as mask="):
        fit(scene, View(view.samples, HALF), DIFFUSE)
    with pytest.raises(ValueError, match=r"give its data, and False where it is masked as mask="):
        samples_from_maps(HALF, Orthographic(), depth=0)


def test_a_result_is_described_without_what_it_was_made_from(result: Fit) -> None:
    described = repr(result)
    assert "outcome=" in described and "diffuse_color" in described
    assert not any(f"{name}=" in described for name in ("document", "problem", "description", "state"))
    assert len(described) < 4000


def test_a_log_replaces_logs_only(scene: Scene, view: View, tmp_path: Path) -> None:
    other, log = tmp_path / "scene.x3d", tmp_path / "log.jsonl"
    other.write_text("<X3D/>")
    with pytest.raises(ValueError, match=r"scene.x3d is no log of a fit, and is not replaced by one"):
        fit(scene, view, DIFFUSE, max_steps=1, log=other)
    assert other.read_text() == "<X3D/>"
    for _ in range(2):
        fit(scene, view, DIFFUSE, max_steps=1, log=log)
    assert log.read_text().count('"begin"') == 1


TRACED: dict[str, Callable[[Scene, View, Path], Any]] = {
    "compare": lambda scene, view, folder: compare(scene.point.location, np.zeros((1, 3))),
    "write_image": lambda scene, view, folder: write_image(folder / "image.png", scene.point.location),
    "save": lambda scene, view, folder: save(scene, folder / "scene.x3d"),
    "fit": lambda scene, view, folder: fit(scene, view, DIFFUSE),
    "check_gradients": lambda scene, view, folder: check_gradients(scene, view.samples),
}


@pytest.mark.parametrize("name", TRACED)
def test_what_needs_numbers_refuses_traced_ones(name: str, scene: Scene, view: View, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"^{name}: .* call it outside of jax.jit"):
        jax.jit(lambda scene: TRACED[name](scene, view, tmp_path))(scene)
    assert not list(tmp_path.iterdir())


def test_numbers_that_are_known_are_compared_inside_jit_too() -> None:
    known = np.zeros((2, 2))
    assert jax.jit(lambda x: x + compare(known, known).pixels)(1.0) == 5


def test_numbers_of_any_kind_are_numbers() -> None:
    """Whatever NumPy makes of a list of them."""
    third = [jnp.bfloat16(1 / 3)] * 3
    assert nodes.Material(diffuse_color=third).diffuse_color == tuple(float(jnp.bfloat16(1 / 3)) for _ in third)
    assert nodes.Material(shininess=Decimal("0.25"), transparency=Fraction(1, 4)).shininess == 0.25
    with pytest.raises(ValueError, match="shininess: expected a finite number"):
        nodes.Material(shininess=np.array(["0.25"], object)[0])
    mask = jnp.array([0.0, 0.2, 0.6, 1.0], jnp.bfloat16)
    assert is_chosen(mask).tolist() == [False, False, True, True]
    with pytest.raises(ValueError, match="mask: 1 of its 4 numbers are NaN"):
        is_chosen(mask.at[0].set(jnp.nan))


class Foreign:
    """Numbers of another library, whose types NumPy does not know."""

    dtype = object()

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return np.full((2, 3, 3), 0.5)


def test_arrays_of_other_libraries_are_numbers() -> None:
    np.testing.assert_array_equal(encode(Foreign(), "none"), np.full((2, 3, 3), 0.5))
