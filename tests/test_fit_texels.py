"""Whole textures among the free fields: eliminated, not kept in a matrix, and as exact as if they were."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import key_light, material, precision
from jaxlight import Free, SampleBuffer, Scene, View, fit, fitted_values, nodes, shade
from jaxlight.fit import chosen, normal
from jaxlight.fit.curvature import ArrowCurvature
from jaxlight.fit.problem import make_problem
from jaxlight.fit.uncertainty import uncertainty

TEXELS, SIZE = 12, 36
SKIN = "Texture[skin].image"
FREE: list[Any] = [SKIN, "Material[body].specular_color", "Material[body].shininess", "PointLight[*].location"]


def skin(components: int = 3) -> np.ndarray:
    """A picture with slopes and steps, values in [0.1, 0.9]."""
    row, column = np.mgrid[0:TEXELS, 0:TEXELS] / TEXELS
    planes = [0.5 + 0.3 * np.sin(7 * column + 3 * row), 0.5 + 0.3 * np.cos(9 * row), np.where(column < 0.5, 0.3, 0.7)]
    return np.stack(planes[:components] + [np.ones_like(row)] * (components > 3), axis=2)


def scene(image: np.ndarray, dtype: Any, **changes: Any) -> Scene:
    texture = nodes.PixelTexture(image=image, name="skin")
    shape = nodes.Shape(appearance=nodes.Appearance(material=material(**changes), texture=texture))
    lamps = [key_light(color=(1, 1, 1)), key_light(name="left", location=(-2.0, 1.0, 3.0), intensity=0.5)]
    return Scene.from_nodes([shape, *lamps], dtype=dtype)


def start(dtype: Any, components: int = 3, **changes: Any) -> Scene:
    body = {"specular_color": (0.3, 0.3, 0.3), "shininess": 0.2, **changes}
    made = scene(np.full((TEXELS, TEXELS, components), 0.5), dtype, **body)
    return jax.tree.map(lambda a: a, made)


def bumpy(view: int, dtype: Any, *, nearest: bool = False) -> SampleBuffer:
    """Samples of a bumpy patch that shows the texture, seen from a place of its own."""
    across = (np.arange(SIZE) + 0.5) / SIZE
    u, v = np.meshgrid(across, across)
    x, y = 2 * u - 1, 2 * v - 1
    z = 0.3 * np.sin(3 * x) * np.cos(2 * y)
    normal_ = np.stack([-0.9 * np.cos(3 * x) * np.cos(2 * y), 0.6 * np.sin(3 * x) * np.sin(2 * y), np.ones_like(x)], -1)
    shift = 0.3 * view
    s, t = ((w.ravel() * (TEXELS - 1) + shift).clip(0, TEXELS - 1.001) for w in (u, v))
    if nearest:
        index, weight = (np.round(t) * TEXELS + np.round(s)).astype(int)[:, None], np.ones((len(s), 1))
        index, weight = np.repeat(index, 4, axis=1), np.pad(weight, ((0, 0), (0, 3)))
    else:
        i, j = np.floor(t).astype(int), np.floor(s).astype(int)
        f, g = t - i, s - j
        index = np.stack([i * TEXELS + j, i * TEXELS + j + 1, (i + 1) * TEXELS + j, (i + 1) * TEXELS + j + 1], 1)
        weight = np.stack([(1 - f) * (1 - g), (1 - f) * g, f * (1 - g), f * g], 1)
    eye = (1.5 * np.cos(1.6 * view), 1.5 * np.sin(1.6 * view), 4.0)
    return SampleBuffer.create(
        np.stack([x, y, z], -1).reshape(-1, 3), normal_.reshape(-1, 3), eye, texel_index=index, texel_weight=weight,
        pixel=np.arange(SIZE**2), width=SIZE, height=SIZE, dtype=dtype,
    )  # fmt: skip


def views(truth: Scene, dtype: Any, *, nearest: bool = False, noise: float = 0.0) -> list[View]:
    """Two pictures of the truth (how a texture is shaded is tested elsewhere)."""
    made = []
    for number in range(2):
        samples = bumpy(number, dtype, nearest=nearest)
        picture = np.asarray(shade(truth, samples), np.float64)[:, :3].reshape(SIZE, SIZE, 3)
        made.append(View(samples, picture + noise * np.random.default_rng(number).normal(size=picture.shape)))
    return made


def test_texture_material_and_lights_are_found_together() -> None:
    with precision("float64") as dtype:
        truth = scene(skin(), dtype)
        result = fit(start(dtype), views(truth, dtype), FREE)
        assert result.converged and result.accepted_steps <= 10, result.message
        np.testing.assert_allclose(result.value(SKIN), skin(), atol=1e-9)
        np.testing.assert_array_equal(result.scene.textures[0].image, result.value(SKIN))
        np.testing.assert_allclose(result.value("Material[body].shininess"), 0.3, atol=1e-9)
        np.testing.assert_allclose(result.value("PointLight[left].location"), (-2, 1, 3), atol=1e-8)
        assert len(result.values) == len(result.labels) == 10
        assert f"{SKIN}: 12 x 12 texels" in str(result)
        assert result.uncertainty.well_posed


@pytest.mark.parametrize("nearest", [(False, False), (False, True)], ids=["four", "both"])
def test_the_arrow_is_the_dense_matrix(monkeypatch: pytest.MonkeyPatch, nearest: tuple[bool, bool]) -> None:
    """The same problem with the texels kept as single numbers gives the matrix that the arrow stands for.

    But for the prior of neighbours, which those do not have: it says nothing of other numbers, nor of a texture that is
    brighter everywhere, and is never negative.
    """
    with precision("float64") as dtype:
        image = np.full((TEXELS, TEXELS, 4), 0.5)
        image[..., 0] += 0.01 * np.arange(TEXELS)
        priors = {"total_variation": 0.1, "deviation": 0.3}
        fields = [Free(SKIN, **priors), "Material[body].shininess", "PointLight[key].intensity"]
        truth = scene(skin(4), dtype)
        first, second = (views(truth, dtype, nearest=own, noise=0.05)[row] for row, own in enumerate(nearest))
        seen = [first, dataclasses.replace(second, lights="PointLight[*]")]  # in a stack of its own
        arrow, _ = make_problem(scene(image, dtype), seen, fields, loss="cauchy", loss_scale=0.1)
        made = jax.jit(normal.normal_equations)(arrow, arrow.parameters.start)
        assert isinstance(made.curvature, ArrowCurvature)
        size, numbers = arrow.parameters.start.shape[0], arrow.parameters.few
        identity = jnp.eye(size)
        whole = np.asarray(jax.jit(jax.vmap(lambda v: made.curvature.product(v, arrow.sampling)))(identity))

        loss, slope = jax.jit(jax.value_and_grad(lambda v: normal.loss(arrow, v)))(arrow.parameters.start)
        np.testing.assert_allclose(made.gradient, slope, rtol=0, atol=1e-10 * np.abs(slope).max())
        assert float(made.loss) == pytest.approx(float(loss), rel=1e-12)
        np.testing.assert_allclose(whole, whole.T, rtol=0, atol=1e-12 * np.abs(whole).max())
        rows = np.abs(whole[numbers:, numbers:]).sum(axis=1)
        assert np.all(np.asarray(made.curvature.row_sum) >= rows * (1 - 1e-9))

        monkeypatch.setattr(chosen, "MIN_BLOCK", 10**9)
        plain = Free(SKIN, deviation=priors["deviation"])
        dense, _ = make_problem(scene(image, dtype), seen, [plain, *fields[1:]], loss="cauchy", loss_scale=0.1)
        plain_sums = jax.jit(normal.normal_equations)(dense, dense.parameters.start)
        # The dense problem's texels come first and hold alpha too.
        colors = np.arange(image.size).reshape(image.shape)[..., :3].reshape(-1)
        order = np.concatenate([image.size + np.arange(numbers), colors])
        expected = np.asarray(plain_sums.curvature)[np.ix_(order, order)]
        extra = whole - expected
        np.testing.assert_allclose(extra[:numbers], 0, atol=1e-11 * np.abs(expected).max())
        np.testing.assert_allclose(extra.sum(axis=1), 0, atol=1e-9 * np.abs(extra).max())
        assert np.linalg.eigvalsh(extra).min() > -1e-9 * np.abs(extra).max()


def test_strength_against_texture_is_named() -> None:
    with precision("float32") as dtype:
        truth = scene(skin(), dtype, specular_color=(0, 0, 0))
        fields = [SKIN, "PointLight[*].intensity"]
        body = {"specular_color": (0.0, 0.0, 0.0)}
        result = fit(start(dtype, **body), views(truth, dtype), fields)
        assert result.uncertainty.messages() == [
            "PointLight[key].intensity and PointLight[left].intensity can be traded for Texture[skin].image: "
            "only their product is seen"
        ]
        assert np.all(np.isinf(result.uncertainty.standard_error))
        strength = result.value("PointLight[key].intensity") / 0.9
        np.testing.assert_allclose(result.value(SKIN) * strength, skin(), atol=1e-4)


@pytest.mark.parametrize("prior", ["deviation", "smoothness"])
def test_what_priors_of_texels_tell_of_a_number_is_as_uncertain_as_they_are(prior: str) -> None:
    """Strength and texture can be traded: without the prior nothing is known, however precise the picture is."""
    with precision("float64") as dtype:
        random, deviation, strength, texels = np.random.default_rng(0), 0.2, 0.7, 25
        image = random.uniform(0.2, 0.8, (5, 5, 3))
        body = nodes.Material(ambient_intensity=0.0)
        shape = nodes.Shape(appearance=nodes.Appearance(material=body, texture=nodes.PixelTexture(image=image)))
        lamp = nodes.DirectionalLight(direction=(0, 0, -1), intensity=strength, global_=True)
        row = np.arange(4 * texels)
        samples = SampleBuffer.create(
            np.stack([row, 0 * row, 0 * row], 1) / texels, np.tile([0.0, 0.0, 1.0], (len(row), 1)), (0, 0, 4),
            texel_index=np.repeat(row[:, None] % texels, 4, axis=1), texel_weight=np.tile([1, 0, 0, 0], (len(row), 1)),
            dtype=dtype,
        )  # fmt: skip
        colors = np.tile(image.reshape(-1, 3), (4, 1))
        left = 1e-3 * random.normal(size=colors.shape)
        fields = [Free("Texture[0].image", **{prior: deviation}), "DirectionalLight[0].intensity"]
        problem, description = make_problem(
            Scene.from_nodes([shape, lamp], dtype=dtype), View(samples, strength * colors + left), fields
        )
        found = uncertainty(problem, description, problem.parameters.start)
    of_texel = strength * np.kron(np.tile(np.eye(texels), (4, 1)), np.eye(3))
    jacobian = np.concatenate([colors.reshape(-1, 1), of_texel], axis=1)
    pictures, priors = jacobian.T @ jacobian, np.zeros((1 + 3 * texels, 1 + 3 * texels))
    step = np.eye(5)[1:] - np.eye(5)[:-1]
    pairs = np.kron(step.T @ step, np.eye(5)) + np.kron(np.eye(5), step.T @ step)
    priors[1:, 1:] = np.kron(pairs if prior == "smoothness" else np.eye(texels), np.eye(3)) / deviation**2
    inverse = np.linalg.inv(pictures + priors)
    variance = np.sum(left**2) / (left.size - np.sum(inverse * pictures))
    covariance = inverse @ (variance * pictures + priors) @ inverse
    assert found.noise == pytest.approx(np.sqrt(variance), rel=1e-2)
    assert found.standard_error[0] == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-4)


def test_a_fit_of_textures_alone_has_an_uncertainty_of_no_numbers() -> None:
    with precision("float64") as dtype:
        truth = scene(skin(), dtype)
        result = fit(scene(np.full((TEXELS, TEXELS, 3), 0.5), dtype), views(truth, dtype), SKIN)
    assert result.converged and result.labels == ()
    assert result.uncertainty.well_posed and result.uncertainty.messages() == []
    assert str(result.uncertainty) == "the pictures determine every texel that is free"


def test_texels_stay_in_their_bounds_and_what_no_sample_sees_stays() -> None:
    with precision("float64") as dtype:
        truth = scene(skin(), dtype)
        samples = bumpy(0, dtype)
        lit = np.asarray(shade(truth, samples))[:, :3]
        left = np.asarray(samples.position)[:, 0] < 0.2
        view = View(samples, np.where(lit > 0.4, 3.0, lit), mask=left)
        result = fit(start(dtype), view, [Free(SKIN, upper=0.8)])
        image = result.value(SKIN)
        assert result.converged, result.message
        assert image.max() == 0.8 and image.min() >= 0
        np.testing.assert_array_equal(image[:, -3:], 0.5)
        known = result.uncertainty
        said = "48 of 144 texels of Texture[skin].image are seen in no view: what is not seen keeps its start"
        assert known.messages() == [said] and not known.well_posed
        found = fit(start(dtype), view, [Free(SKIN, upper=0.8, smoothness=0.1)], max_steps=1).uncertainty
        assert found.unseen_texels == () and found.well_posed


def test_an_ambiguity_is_named_where_a_texel_of_it_lies_on_a_bound() -> None:
    body: dict[str, Any] = {"specular_color": (0.0, 0.0, 0.0)}
    bright = skin() / skin().max()
    with precision("float32") as dtype:
        seen = views(scene(bright, dtype, **body), dtype)
        best = fit(scene(bright, dtype, **body), seen, [SKIN, "PointLight[*].intensity"])
        values = np.asarray(best.state.values, np.float64)
        for rounding in (-4, 4):
            strength = np.where(np.arange(len(values)) < 2, 1 + rounding * np.finfo(dtype).eps, 1)
            found = uncertainty(best.problem, best.description, (values * strength).astype(dtype))
            assert np.any(values == 1) and not found.well_posed and found.rank == 1, found.messages()


@pytest.mark.parametrize("black", [0.0, 0.25])
def test_textures_of_which_many_colours_lie_on_a_bound_are_told(black: float) -> None:
    image = np.where(np.random.default_rng(5).random((TEXELS, TEXELS, 1)) < black, 0, skin())
    with precision("float64") as dtype:
        result = fit(start(dtype), views(scene(image, dtype), dtype, noise=0.02), FREE)
    told = [line for line in result.uncertainty.messages() if "lie on a bound: where noise put them there" in line]
    assert len(told) == (black > 0)
    assert all(
        re.match(r"\d+ of the 432 colours of Texture\[skin\]\.image that are seen lie on", line) for line in told
    )


@pytest.mark.parametrize("prior", ["smoothness", "total_variation"])
def test_neighbour_priors_fill_what_is_not_seen_and_calm_what_is_noisy(prior: str) -> None:
    with precision("float64") as dtype:
        truth = scene(skin(), dtype)
        noisy = View(bumpy(0, dtype), views(truth, dtype, noise=0.2)[0].target, noise=0.2)
        errors = []
        for options in ({}, {prior: 0.08}):
            flat = scene(np.full_like(skin(), 0.5), dtype)
            result = fit(flat, noisy, [Free(SKIN, **options)], rtol=1e-4, atol=1e-5)
            assert result.converged, result.message
            errors.append(float(np.sqrt(np.mean((result.value(SKIN) - skin()) ** 2))))
        assert errors[1] < 0.8 * errors[0], errors


# ruff: noqa: E501
WRONG: dict[str, tuple[Any, str]] = {
    "bounds": (Free(SKIN, lower=0.6), "Texture[skin].image: 432 texels start outside their bounds"),
    "size of bounds": (Free(SKIN, upper=np.ones((2, 5))), "Texture[skin].image: upper: expected one number, one a component, or an image"),
    "endless mean": (Free(SKIN, mean=np.inf, deviation=0.1), "Texture[skin].image: mean: expected finite numbers, got inf"),
    "smooth to the last bit": (Free(SKIN, smoothness=1e-30), "Texture[skin].image: smoothness and total_variation: too small"),
    "prior": (Free(SKIN, mean=0.3), "Texture[skin].image: a prior mean needs a deviation"),
    "smoothness": (Free(SKIN, smoothness=0.0), "Texture[skin].image: smoothness: expected a number > 0, got 0.0"),
    "smoothness in words": (Free(SKIN, smoothness="a"), "Texture[skin].image: smoothness: expected a number > 0, got 'a'"),
    "deviation": (Free(SKIN, deviation=-1), "Texture[skin].image: deviation: expected a number > 0, got -1"),
    "NaN bound": (Free(SKIN, lower=np.nan), "Texture[skin].image: lower: expected one number, one a component, or an image"),
    "bound in words": (Free(SKIN, upper="a"), "Texture[skin].image: upper: expected one number, one a component, or an image"),
    "reversed bounds": (Free(SKIN, lower=0.9, upper=[0.1, 1, 1]), "Texture[skin].image: 144 texels have a lower bound above their upper bound"),
    "smooth beyond numbers": (Free(SKIN, smoothness=1e-160), "Texture[skin].image: smoothness and total_variation: too"),
    "sure beyond numbers": (Free(SKIN, deviation=1e-160), "a prior's deviation is too small"),
    "not a texture": (Free("Material[body].shininess", smoothness=1.0), "smoothness and total_variation are for whole textures"),
    "twice": ([SKIN, SKIN + "[0][0][1]"], "Texture[0].image is named twice"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_bad_requests_are_refused(case: str) -> None:
    request, message = WRONG[case]
    with precision("float32") as dtype:
        view = View(bumpy(0, dtype), np.zeros((SIZE, SIZE, 3)))
        with pytest.raises(ValueError, match=message.replace("[", r"\[").replace("]", r"\]")):
            fit(start(dtype), view, request)


def test_several_samples_a_pixel_are_refused_with_textures() -> None:
    with precision("float32") as dtype:
        whole = bumpy(0, dtype)
        samples = SampleBuffer.create(
            whole.position, whole.normal, (0, 0, 4), pixel=np.arange(SIZE**2) // 4, coverage=np.full(SIZE**2, 0.25),
            width=SIZE, height=SIZE, texel_index=np.zeros((SIZE**2, 4), int), texel_weight=np.full((SIZE**2, 4), 0.25),
        )  # fmt: skip
        with pytest.raises(ValueError, match="whole textures cannot be fitted to views with several samples a pixel"):
            fit(start(dtype), View(samples, np.zeros((SIZE, SIZE, 3))), SKIN)


def test_fitted_values_of_textures_are_refused() -> None:
    view = View(bumpy(0, np.float32), np.full((SIZE**2, 3), 0.5))
    problem, _ = make_problem(start(np.float32), view, FREE)
    with pytest.raises(ValueError, match="fits of whole textures are not supported"):
        fitted_values(problem)
