"""The streamed sums are what the whole Jacobian gives, for every kind of view, loss and prior."""

from __future__ import annotations

import functools
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params

from fit_scenes import PRECISIONS, key_light, material, precision, sphere_picture, sphere_points, sphere_samples
from jaxlight import Free, SampleBuffer, Scene, View, nodes
from jaxlight.fit import normal
from jaxlight.fit.problem import Problem, make_problem

SIZE = 24
FREE = ["Material[body].*", "PointLight[key].location", "PointLight[key].attenuation"]
FEW = ["Material[body].diffuse_color", "Material[body].transparency", "PointLight[key].intensity"]
"""For what is about residuals: quickly compiled."""
ABOUT_RESIDUALS = [
    "grey target", "background", "several samples a pixel over a background", "sensor limits",
    "views of different size and lights",
]  # fmt: skip
LOSS_ALONE = [*ABOUT_RESIDUALS, "grey target + huber", "background + cauchy", "weights and mask"]
"""Of which the loss is asked for without a derivative, too: a program of its own."""
FORWARD_ALONE = [
    "a tie of a colour and an exponent, and a prior", "one of many lights", "a light alone and sensor limits",
    "every number of every material", "materials and ties between them", "nothing but materials + huber",
    "a light of its own in each view of every kind", "every light of every kind, one by one",
]  # fmt: skip
"""Whose gradient in reverse mode, which does not depend on how directions are grouped, is that of others."""


def scene(dtype: Any, small: int = 0, every_kind: bool = False) -> Scene:
    """Two materials under two lamps, and as many small ones close to the sphere, or two of the other kinds."""
    lamps = [key_light(attenuation=(0.9, 0.1, 0.05), ambient_intensity=0.3)]
    lamps += [nodes.PointLight(name="fill", location=(-3.0, 1.0, 2.0), intensity=0.4, color=(0.4, 0.6, 1.0))]
    places = 1.2 * sphere_points(SIZE)[0][:: SIZE**2 // (2 * small)][:small] if small else []
    lamps += [nodes.PointLight(location=place, radius=0.6, intensity=0.2) for place in places]
    shapes = [
        nodes.Shape(appearance=nodes.Appearance(material=one), geometry=nodes.Sphere())
        for one in (material(transparency=0.2), nodes.Material(name="other", diffuse_color=(0.2, 0.5, 0.4)))
    ]
    if every_kind:
        # The right spot reaches the second surface only.
        spots = [
            nodes.SpotLight(
                name=name, location=(x, 1, 3), direction=(-x, -1, -3), beam_width=0.1, cut_off_angle=0.5, global_=x < 0
            )
            for name, x in (("left", -1.0), ("right", 1.0))
        ]
        suns = [
            nodes.DirectionalLight(name=name, direction=(x, -0.5, -1.0), intensity=0.3, global_=True)
            for name, x in (("west", 0.5), ("east", -0.5))
        ]
        lamps += [nodes.Transform(scale=(1.0, 1.5, 1.0), children=[spots[0]]), *suns]
        shapes[1] = nodes.Group(children=[shapes[1], spots[1]])
    return Scene.from_nodes([*shapes, *lamps], dtype=dtype)


def two_surfaces(dtype: Any) -> SampleBuffer:
    points, _ = sphere_points(SIZE)
    return sphere_samples(SIZE, dtype=dtype, surface=(points[:, 0] > 0.1).astype(int), tile=64)


def four_samples_a_pixel(dtype: Any) -> SampleBuffer:
    """Samples of a picture of twice the size, gathered into pixels; some pixels at the edge are partly covered."""
    points, pixel = sphere_points(2 * SIZE)
    row, column = np.divmod(pixel, 2 * SIZE)
    gathered = (row // 2) * SIZE + column // 2
    return SampleBuffer.create(
        position=points, normal=points, eye=(0, 0, 4), pixel=gathered, coverage=np.full(len(points), 0.25),
        width=SIZE, height=SIZE, surface=(points[:, 0] > 0.1).astype(int), tile=64, dtype=dtype,
    )  # fmt: skip


def problem(kind: str, dtype: Any) -> Problem:
    """`kind`: what is particular, and after a plus the loss."""
    kind, _, loss = kind.partition(" + ")
    picture = sphere_picture(SIZE, noise=0.05)
    weight = np.linspace(0.5, 2.0, SIZE**2 * 3).reshape(SIZE, SIZE, 3)
    samples = two_surfaces(dtype)
    plain, limited = View(samples, picture), View(samples, picture, saturated=0.7, dark=0.1)
    free: list[Any] = list(FREE)
    more: dict[str, Any] = {}
    views = {
        "weights and mask": [View(samples, picture, weight=weight, mask=weight[..., 0] > 0.7)],
        "grey target": [View(samples, picture.mean(axis=2))],
        "background": [View(samples, picture, background=(0.3, 0.1, 0.6))],
        "several samples a pixel over a background": [
            View(four_samples_a_pixel(dtype), picture, background=picture[::-1])
        ],
        "sensor limits": [limited],
        "a light alone and sensor limits": [limited],
        "views of different size and lights": [
            View(samples, picture, lights=["PointLight[key]"]),
            View(samples, picture / 2, lights=["PointLight[fill]"], exposure=0.5),
            View(
                sphere_samples(SIZE // 2, dtype=dtype),
                sphere_picture(SIZE // 2),
                lights=["PointLight[fill]", "PointLight[key]"],
            ),
        ],
    }.get(kind, [plain])
    if kind in ABOUT_RESIDUALS:
        free = list(FEW)
    if kind.startswith("views") or "several samples" in kind:
        free += ["View[*].exposure"]
    if loss:
        more = {"loss": loss, "loss_scale": 0.05}
    if kind == "a tie of a colour and an exponent, and a prior":
        free = [Free(["Material[body].specular_color.g", "Material[body].shininess"], tied="all"), *FREE[1:]]
        free += ["PointLight[fill].color", "Material[body].diffuse_color"]
        free += [Free("PointLight[fill].intensity", mean=0.5, deviation=0.01)]
    if kind == "every number of every material":
        free = ["Material[*].*", "PointLight[*].location", "PointLight[*].intensity"]
    if kind == "materials and ties between them":
        # Of one material, of both, of one and a light, of both lights; of one field only one material's.
        free = [
            Free("Material[*].diffuse_color", tied=True),
            Free("PointLight[*].color", tied="all"),
            "Material[*].specular_color.r",
            "Material[body].shininess",
        ]
        free += [Free("Material[body].emissive_color", tied="all"), Free("Material[other].emissive_color", tied="all")]
        free += [Free(["Material[other].transparency", "PointLight[key].intensity"], tied="all")]
    if kind == "nothing but materials":
        free = ["Material[*].diffuse_color", "Material[*].shininess"]
    if kind.startswith("a light of its own in each view"):
        views = [
            View(samples, picture, lights=["PointLight[key]"]),
            View(sphere_samples(SIZE // 2, dtype=dtype), sphere_picture(SIZE // 2), lights=["PointLight[fill]"]),
            View(samples, picture / 2, lights=["SpotLight[left]", "SpotLight[right]"], exposure=0.5),
        ]
        free = ["Material[*].diffuse_color", "PointLight[*].*", "SpotLight[*].location", "SpotLight[left].color"]
        free += ["View[*].exposure", "DirectionalLight[east].intensity"]
    if kind == "exposures of pixels of several samples":
        views = [View(four_samples_a_pixel(dtype), factor * picture, background=(0.3, 0.1, 0.6)) for factor in (1, 0.5)]
        free = ["Material[*].diffuse_color", "View[*].exposure"]
    if kind == "every light of every kind, one by one":
        free = ["PointLight[*].attenuation", "SpotLight[*].location", "SpotLight[*].beam_width"]
        free += ["DirectionalLight[*].*", "Material[*].shininess"]
    small = 40 if "many lights" in kind else 0
    if kind == "many lights":
        free = ["Material[body].*", Free("PointLight[*].intensity"), "PointLight[*].location"]
    if kind == "one of many lights":
        free = ["Material[body].shininess", "PointLight[key].*"]
    if kind == "a light alone and sensor limits":
        free = ["PointLight[fill].location"]
    return make_problem(scene(dtype, small, "every kind" in kind), views, free, **more)[0]


KINDS = [
    "weights and mask", "grey target + huber", "background + cauchy", "several samples a pixel over a background",
    "views of different size and lights", "a tie of a colour and an exponent, and a prior",
    "many lights", "one of many lights", "a light alone and sensor limits",
    "every number of every material", "materials and ties between them", "nothing but materials + huber",
    "a light of its own in each view of every kind", "exposures of pixels of several samples",
    "every light of every kind, one by one",
]  # fmt: skip


RARE = [
    "one of many lights", "a light of its own in each view of every kind", "every light of every kind, one by one",
    "materials and ties between them", "nothing but materials + huber",
]  # fmt: skip
"""What others say as well."""


def dense(problem: Problem, values: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Loss, gradient and Gauss-Newton matrix from the whole Jacobian, in NumPy float64."""

    def flat(v: Any) -> Any:
        return jnp.concatenate([part.reshape(-1) for part in normal.residuals(problem, v)])

    jacobian, residual = jax.jit(jax.jacfwd(lambda v: (flat(v),) * 2, has_aux=True))(values)
    jacobian, residual = np.asarray(jacobian, np.float64), np.asarray(residual, np.float64)
    scale = float(problem.loss_scale)
    size = np.abs(residual) / scale
    prior = np.arange(len(residual)) >= len(residual) - len(values)
    each, weight = residual**2 / 2, np.ones_like(residual)
    if problem.loss_kind == "huber":
        each = np.where(prior | (size <= 1), each, scale**2 * (size - 0.5))
        weight = np.where(prior | (size <= 1), 1, 1 / np.maximum(size, 1))
    if problem.loss_kind == "cauchy":
        each = np.where(prior, each, scale**2 * np.log1p(size**2) / 2)
        weight = np.where(prior, 1, 1 / (1 + size**2))
    return each.sum(), jacobian.T @ (weight * residual), jacobian.T @ (weight[:, None] * jacobian)


@functools.cache
def streamed(kind: str) -> tuple[Problem, dict[str, Any]]:
    """A problem in double precision, and its sums at the start."""
    sums: dict[str, Any] = {"forward": normal.normal_equations}
    if kind not in FORWARD_ALONE:
        sums["reverse"] = normal.loss_and_gradient
    if kind in LOSS_ALONE:
        sums["loss"] = normal.loss
    with precision("float64") as dtype:
        made = problem(kind, dtype)
        found = jax.jit(lambda *given: {name: of(*given) for name, of in sums.items()})(made, made.parameters.start)
        return made, jax.tree.map(np.asarray, found)


@pytest.mark.parametrize("kind", [pytest.param(k, marks=[pytest.mark.thorough] * (k in RARE)) for k in KINDS])
def test_streamed_sums_are_the_dense_ones(kind: str) -> None:
    with precision("float64"):
        made, all_sums = streamed(kind)
        (light_plan,) = {view.plan.point for view in made.views} if "many lights" in kind else (None,)
        assert light_plan is None or light_plan.culled
        loss, gradient, curvature = dense(made, made.parameters.start)
        found = all_sums["forward"]
        assert float(found.loss) == pytest.approx(loss, rel=1e-12)
        scale = np.sqrt(np.diagonal(curvature))
        np.testing.assert_allclose(found.curvature, curvature, rtol=0, atol=1e-11 * np.outer(scale, scale).max())
        np.testing.assert_allclose(found.gradient, gradient, rtol=0, atol=1e-11 * np.abs(gradient).max())
        if "reverse" in all_sums:
            value, slope = all_sums["reverse"]
            assert float(value) == pytest.approx(loss, rel=1e-12)
            np.testing.assert_allclose(slope, gradient, rtol=0, atol=1e-11 * np.abs(gradient).max())
        if "loss" in all_sums:
            assert float(all_sums["loss"]) == pytest.approx(loss, rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "bits"),
    [("weights and mask", PRECISIONS[0]), ("several samples a pixel over a background", PRECISIONS[1])],
)
def test_single_precision_keeps_its_type_and_its_digits(kind: str, bits: str) -> None:
    exact = streamed(kind)[1]["forward"]
    with precision(bits) as dtype:
        made = problem(kind, dtype)
        found = jax.jit(normal.normal_equations)(made, made.parameters.start)
        assert {leaf.dtype for leaf in found} == {jnp.dtype(jnp.float32)}
        scale = np.sqrt(np.maximum(np.diagonal(exact.curvature), 1e-30))
        np.testing.assert_allclose(
            np.asarray(found.curvature) / np.outer(scale, scale),
            np.asarray(exact.curvature) / np.outer(scale, scale),
            rtol=0,
            atol=2e-5,
        )
        assert float(found.loss) == pytest.approx(float(exact.loss), rel=1e-5)


def test_in_forward_mode_numbers_of_lights_move_as_numbers_one_light_at_a_time() -> None:
    """For sums over samples in reverse mode they are spread over lanes and planes, [lights, rows, lanes]."""
    with precision("float64") as dtype:
        samples = sphere_samples(SIZE, dtype=dtype, tile=256)
        made, _ = make_problem(scene(dtype), [View(samples, sphere_picture(SIZE))], ["PointLight[*].intensity"])
        program = jax.make_jaxpr(normal.normal_equations)(made, made.parameters.start)
    moved = _moved_by_stages(program.jaxpr, "weights")
    lights, directions, of_light, rows, lanes = 2, 1, 1, 256 // 64, 64
    assert (lights, directions, of_light, 1, 1) in moved
    assert not {shape for shape in moved if shape[-3:] in [(of_light, 1, lanes), (of_light, rows, lanes)]}
    assert max(shape[0] * shape[1] for shape in moved) == lights * directions


def _moved_by_stages(jaxpr: Any, name: str) -> list[tuple[int, ...]]:
    """The shapes of what moves in the stages of this name that derivatives are taken of."""
    shapes = []
    for equation in jaxpr.eqns:
        if equation.primitive.name == "linear_stage" and f"stage.{name}." in str(equation.source_info.name_stack):
            shapes += [operand.aval.shape for operand in equation.invars[1 + equation.params["known"] :]]
        for inner in jaxprs_in_params(equation.params):
            shapes += _moved_by_stages(inner, name)
    return shapes


@pytest.mark.parametrize(
    ("free", "evaluated"),
    [
        (["Material[body].*", "View[0].exposure"], 1),
        (["Material[body].*", "PointLight[*].location", "PointLight[*].attenuation", "PointLight[*].color"], 2),
        (["Material[body].*", "PointLight[key].location", "PointLight[key].attenuation"], 2),
    ],
)
def test_all_directions_that_need_the_same_lights_share_one_evaluation_of_a_tile(
    free: list[str], evaluated: int
) -> None:
    """Of all lights, of lights one by one, of a light alone; groups of directions are several of each."""
    with precision("float32") as dtype:
        samples = sphere_samples(SIZE, dtype=dtype, tile=256)
        made, _ = make_problem(scene(dtype), [View(samples, sphere_picture(SIZE))], free)
        program = jax.make_jaxpr(normal.normal_equations)(made, made.parameters.start)
    assert len(made.columns.groups) > evaluated
    assert _stages_called("weights", program.jaxpr) == evaluated


def _stages_called(name: str, jaxpr: Any) -> int:
    """How many stages of this name there are, their derivatives left out."""
    called = 0
    for equation in jaxpr.eqns:
        scope = str(equation.source_info.name_stack).rsplit("/", 1)[-1]
        called += equation.primitive.name == "cond" and scope.endswith(f"stage.{name}")
        called += sum(_stages_called(name, inner) for inner in jaxprs_in_params(equation.params))
    return called


@pytest.mark.parametrize(
    ("free", "directions"),
    [
        (FREE, [4, 2, 3, 3]),  # three colours and transparency; ambient and exponent; an attenuation; a place
        (["Material[*].diffuse_color"], [1]),
        (["Material[*].*", "PointLight[key].location"], [4, 2, 3]),
        ([Free("Material[*].diffuse_color", tied=True), "PointLight[key].color.b"], [1, 1]),
        ([Free("Material[body].diffuse_color", tied="all"), "View[0].exposure"], [2]),
        ([Free(["Material[body].specular_color.g", "Material[body].shininess"], tied="all")], [1]),
        (["Material[body].shininess", "PointLight[*].color", "PointLight[*].intensity"], [4, 1]),
    ],
)
def test_a_colour_s_components_share_one_derivative(free: list[Any], directions: list[int]) -> None:
    with precision("float32") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE))
        columns = make_problem(scene(dtype), view, free)[0].columns
    assert [group.directions for group in columns.groups] == directions


def test_what_is_of_one_view_shares_derivatives_with_what_is_of_another() -> None:
    made = problem("a light of its own in each view of every kind", jnp.float32)
    strengths = 1 + 1 + 3  # of the light that shone in no view, of the left spot, of the points together
    surfaces = 1 + 1  # colours of both materials, exposures of all views
    reach = 3 + 1  # attenuation and radius of the points
    places = 3 + 2 * 3  # of the points together, of two spots in one view
    assert [group.directions for group in made.columns.groups] == [strengths, surfaces, reach, places]


@pytest.mark.parametrize(
    ("free", "differentiated"),
    [
        ("Material[body].emissive_color", {"colored"}),
        ("PointLight[key].intensity", {"colored", "weights"}),
        ("Material[body].shininess", {"colored", "weights", "exponents"}),
        ("PointLight[key].attenuation", {"colored", "weights"}),
        ("PointLight[key].location", {"colored", "weights"}),
    ],
)
@pytest.mark.parametrize("function", [normal.normal_equations, normal.loss_and_gradient])
def test_what_no_free_number_moves_is_not_differentiated(function: Any, free: str, differentiated: set[str]) -> None:
    with precision("float32") as dtype:
        lit = scene(dtype)
        picture = sphere_picture(SIZE)
        made = make_problem(lit, View(sphere_samples(SIZE, dtype=dtype), picture), [free])[0]
        program = jax.jit(function).lower(made, made.parameters.start).as_text(debug_info=True)
    stages = set(re.findall(r"stage\.(\w+)\.change", program)) - {"residual"}
    assert stages == differentiated


def test_settled_numbers_are_at_their_best_and_the_others_where_they_were() -> None:
    with precision("float64") as dtype:
        made = problem("weights and mask", dtype)
        values = made.parameters.start
        settled, loss = jax.jit(normal.settled)(made, values)
        at_best = jax.jit(normal.normal_equations)(made, settled)
        colors = np.any(np.asarray(made.columns.linear().channels) > 0, axis=0)
    assert colors.sum() == 9, "diffuse, specular and emissive colour"
    np.testing.assert_array_equal(np.asarray(settled)[~colors], np.asarray(values)[~colors])
    assert float(loss) == pytest.approx(float(at_best.loss), rel=1e-12)
    length = np.sqrt(np.maximum(np.diagonal(at_best.curvature), 1e-30))
    lower, upper = (np.asarray(a) for a in (made.parameters.lower, made.parameters.upper))
    downhill = np.asarray(settled) - np.asarray(at_best.gradient) / length**2
    left = (np.clip(downhill, lower, upper) - np.asarray(settled))[colors] * length[colors]
    assert np.abs(left).max() < 1e-9 * np.sqrt(2 * float(loss))


@pytest.mark.parametrize("kind", ["grey target + huber", "sensor limits"])
def test_residuals_that_are_not_linear_are_not_settled(kind: str) -> None:
    with precision("float64") as dtype:
        made = problem(kind, dtype)
        values, loss = jax.jit(normal.settled)(made, made.parameters.start)
        np.testing.assert_array_equal(values, made.parameters.start)
        assert float(loss) == pytest.approx(float(jax.jit(normal.loss)(made, values)), rel=1e-12)


def test_sensor_limits_are_computed_with_only_where_a_view_has_some() -> None:
    with precision("float64") as dtype:
        samples, picture = sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE)

        def made(**limits: float) -> Problem:
            return make_problem(scene(dtype), [View(samples, picture), View(samples, picture, **limits)], FEW)[0]

        without, beyond = made(dark=-np.inf, saturated=np.inf), made(saturated=100.0)
        ((plain,), (limited,)) = without.views, beyond.views
        assert plain.saturated is None and plain.dark is None and limited.dark is None
        np.testing.assert_array_equal(limited.saturated, [np.inf, 100.0])
        sums = [jax.jit(normal.normal_equations)(one, one.parameters.start) for one in (without, beyond)]
    jax.tree.map(lambda own, other: np.testing.assert_allclose(own, other, rtol=1e-12, atol=1e-12), *sums)


@pytest.mark.parametrize(
    ("free", "together"),
    [
        (["Material[body].*", "PointLight[*].color", "PointLight[*].intensity"], 9),
        (["Material[body].specular_color", "PointLight[*].color"], 6),
        (["Material[body].shininess", "PointLight[*].intensity", "View[0].exposure"], 2),
        ([Free(["Material[body].diffuse_color.r", "PointLight[key].intensity"], tied="all")], 0),
    ],
)
def test_what_multiplies_each_other_is_not_settled_together(free: list[Any], together: int) -> None:
    with precision("float32") as dtype:
        view = View(sphere_samples(SIZE, dtype=dtype), sphere_picture(SIZE))
        columns = make_problem(scene(dtype), view, free)[0].columns.linear()
    assert np.count_nonzero(np.any(np.asarray(columns.channels) > 0, axis=0)) == together
