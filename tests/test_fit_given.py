"""What fits are given: types and levels of numbers, transparent surfaces, and ties in the order of their names."""

from __future__ import annotations

import re
import warnings
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from fit_scenes import key_light, material, precision, sphere_picture, sphere_samples, sphere_scene
from jaxlight import Camera, Free, SampleBuffer, Scene, View, encode, fit, nodes, rasterize
from jaxlight.fit.problem import make_problem

SIZE = 16
FREE = "Material[body].diffuse_color"


def view_of(dtype: Any, **changes: Any) -> View:
    given = {"target": sphere_picture(SIZE), **changes}
    return View(sphere_samples(SIZE, dtype=dtype), **given)


LEVELS = np.round(255 * np.clip(sphere_picture(SIZE), 0, 1)).astype(np.uint8)


class Wrapped:
    """As tensors of other libraries are: NumPy makes an array of it."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return LEVELS


@pytest.mark.parametrize(
    ("field", "given", "got"),
    [
        ("target", Image.fromarray(LEVELS), "uint8; divide by 255"),
        ("target", LEVELS.tolist(), "int64 above 1"),
        ("target", list(LEVELS), "uint8; divide by 255"),
        ("target", Wrapped(), "uint8; divide by 255"),
        ("background", (255, 255, 255), "int64 above 1"),
    ],
)
def test_levels_are_refused_in_whatever_they_come(field: str, given: Any, got: str) -> None:
    with precision("float32") as dtype, pytest.raises(ValueError, match=rf"View\[0\].{field}: got {got}"):
        make_problem(sphere_scene(dtype=dtype), view_of(dtype, **{field: given}), FREE)


@pytest.mark.parametrize("level", [1.0, 255.0])
def test_floats_that_look_like_levels_are_told(level: float) -> None:
    target = np.round(LEVELS / 255 * level)
    target[0, 0] = np.nan  # nothing is seen there
    with precision("float32") as dtype, warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        make_problem(sphere_scene(dtype=dtype), view_of(dtype, target=target), FREE)
    expected = [] if level == 1 else [f"View[0].target: whole numbers up to {LEVELS.max()}, as levels are"]
    assert [str(one.message).partition(";")[0] for one in told] == expected


def test_random_starts_of_which_nothing_is_drawn_are_told() -> None:
    told = "starts: all 3 are the same, since only location, .* and visibility_range are drawn at random"
    with precision("float32") as dtype, pytest.warns(UserWarning, match=told) as warned:
        fit(sphere_scene(dtype=dtype), view_of(dtype), FREE, starts=3, max_steps=1)
    assert [one.filename for one in warned] == [__file__]


def test_encode_refuses_a_list_of_levels() -> None:
    with pytest.raises(ValueError, match="image: got int32 above 1"):
        encode([0, 128, 255])
    np.testing.assert_array_equal(encode([0, 1]), encode(np.array([0.0, 1.0])))


@pytest.mark.parametrize("dtype", ["bfloat16", "float16"])
def test_scenes_of_half_precision_are_refused(dtype: str) -> None:
    with pytest.raises(ValueError, match=f"scene: expected numbers of float32 or float64, got {dtype}"):
        fit(sphere_scene(dtype=dtype), view_of(jnp.float32), FREE)


def test_samples_of_a_wider_type_than_the_scene_are_refused() -> None:
    with precision("float64"):
        samples = sphere_samples(SIZE, dtype="float64")
        view = View(samples, sphere_picture(SIZE), name="wide")
        with pytest.raises(ValueError, match=r"View\[wide\].samples: expected float32 as the scene has, got float64"):
            fit(sphere_scene(dtype="float32"), view, FREE)


def test_a_field_of_a_narrower_type_is_fitted_in_the_type_of_the_scene() -> None:
    with precision("float64") as dtype:
        scene = sphere_scene(body=material(diffuse_color=(0.5, 0.5, 0.5)), dtype=dtype)
        narrow = eqx.tree_at(lambda s: s.point.location, scene, jnp.asarray([[1.5, 2.0, 3.5]], jnp.float32))
        result = fit(narrow, view_of(dtype), ["PointLight[key].location", FREE])
        assert result.converged, result.message
        assert result.scene.point.location.dtype == dtype
        truth = np.asarray(key_light().location)
        np.testing.assert_allclose(result.value("PointLight[key].location"), truth, rtol=1e-9)


def test_a_view_without_background_says_that_it_does_not_look_through_surfaces() -> None:
    with precision("float32") as dtype:
        said = []
        for transparency, background in ((0.0, None), (0.3, (0, 0, 0)), (0.3, None)):
            scene = sphere_scene(body=material(transparency=transparency), dtype=dtype)
            result = fit(scene, view_of(dtype, background=background, name="front"), FREE)
            said.append([line for line in result.uncertainty.messages() if "`background`" in line])
    assert said[:2] == [[], []]
    assert len(said[2]) == 1 and said[2][0].startswith("View[front] has no `background`") and said[2][0] in str(result)


@pytest.mark.parametrize("alpha", [1.0, 0.5])
@pytest.mark.parametrize("of", ["vertices", "texels"])
def test_surfaces_are_transparent_by_their_colours_and_textures_too(of: str, alpha: float) -> None:
    triangle = nodes.IndexedTriangleSet(
        coord=nodes.Coordinate(point=[(-1, -1, 0), (1, -1, 0), (0, 1, 0)]),
        color=nodes.ColorRGBA(color=[(1, 1, 1, alpha)] * 3) if of == "vertices" else None,
        index=[0, 1, 2],
    )
    texture = nodes.PixelTexture(image=[[(0.5, alpha)]]) if of == "texels" else None
    appearance = nodes.Appearance(material=nodes.Material(name="body"), texture=texture)
    scene = Scene.from_nodes([nodes.Shape(geometry=triangle, appearance=appearance)])
    view = View(rasterize(scene, Camera.look_at((0, 0, 4), (0, 0, 0)), 8), np.zeros((8, 8, 3)))
    assert make_problem(scene, view, FREE)[1].alone == ["View[0]"] * (alpha < 1)


def test_ties_begin_at_what_is_named_first() -> None:
    sun = nodes.DirectionalLight(name="sun", direction=(0, 0, -1), intensity=0.1, global_=True)
    with precision("float32") as dtype:
        scene = sphere_scene(key_light(intensity=0.8), sun, dtype=dtype)
        paths = ["PointLight[key].intensity", "DirectionalLight[sun].intensity"]
        for named in (paths, paths[::-1]):
            problem, description = make_problem(scene, view_of(dtype), Free(named, tied=True))
            assert description.labels == named[:1]
            first = 0.8 if named is paths else 0.1
            np.testing.assert_allclose(problem.parameters.start, [first], rtol=1e-6)


def test_a_tie_has_the_narrowest_bounds_in_whatever_order_they_come() -> None:
    sun = nodes.DirectionalLight(name="sun", intensity=0.5, global_=True)
    scene = sphere_scene(key_light(color=(0.7, 0.7, 0.7)), sun)
    paths = ["PointLight[key].color", "DirectionalLight[sun].intensity"]
    for named in (paths, paths[::-1]):
        parameters = make_problem(scene, view_of(None), Free(named, tied="all"))[0].parameters
        assert (parameters.lower.tolist(), parameters.upper.tolist()) == ([0], [1])


def test_what_is_small_may_start_where_it_is() -> None:
    scene = sphere_scene(nodes.SpotLight(name="ray", beam_width=1e-4))
    parameters = make_problem(scene, view_of(None), "SpotLight[ray].beam_width")[0].parameters
    np.testing.assert_allclose([*parameters.lower, *parameters.start], [1e-7, 1e-4], rtol=1e-6)


def test_the_exposure_of_a_named_view_is_found_by_its_number() -> None:
    with precision("float32") as dtype:
        views = [view_of(dtype), view_of(dtype, name="w", target=sphere_picture(SIZE) / 2)]
        result = fit(sphere_scene(dtype=dtype), views, "View[1].exposure")
        assert result.labels == ("View[w].exposure",)
        assert float(result.value("View[1].exposure")) == float(result.value("View[w].exposure"))
        assert float(result.value("View[1].exposure")) == pytest.approx(0.5, rel=1e-4)
        with pytest.raises(ValueError, match=re.escape("'View[2].exposure' was not free")):
            result.value("View[2].exposure")


def test_what_is_no_view_is_named() -> None:
    with precision("float32") as dtype:
        for given, got in (
            ([], "none"),
            ([view_of(dtype), 3], "a int"),
            (sphere_samples(SIZE, dtype=dtype), "a SampleBuffer"),
        ):
            with pytest.raises(ValueError, match=f"views: expected a View or a list of at least one View, got {got}"):
                fit(sphere_scene(dtype=dtype), given, FREE)


def test_what_is_made_inside_a_transformation_is_told_to_be_made_outside() -> None:
    def made(point: Any) -> Any:
        return SampleBuffer.create(position=point, normal=point, eye=(0, 0, 4)).position_planes

    with pytest.raises(ValueError, match=r"SampleBuffer: position: .*traced ones; call it outside of jax.jit"):
        jax.jit(made)(jnp.ones((1, 3)))
