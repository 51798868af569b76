"""Every singular point of the equation: at the point, and 1, 2 and 16 ulp to both sides, against exact answers.

The equation's families of adversarial cases, values and derivatives, and the scalar factors by themselves.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.stress.judge import Block, Judged, Precision
from mpmath import mp, mpf

import answers
from answers import Mode, plan_of
from cases_to_scenes import structure
from jaxlight import SampleBuffer, Scene, nodes, shade
from jaxlight.lighting import elementary, factors, highlight
from jaxlight.lighting.vectors import Vector, inverse_length, unit
from oracle.adversarial import FAMILIES, adversarial_cases
from oracle.case import Case, Light, Material, Sample
from oracle.paths import float_paths

SEED = 3
POINTS = 12
"""Singular points of each family."""
STRUCTURES = 4
"""Kinds of scene that are compiled: those that most cases have."""
VALUES, DERIVATIVES = 4.0, 16.0
"""Errors that are allowed, in ulp x condition."""


@functools.cache
def cases() -> list[Case]:
    """Of every family the cases around its points, as far as they have one of the commonest structures."""
    drawn = [case for family in FAMILIES for case in adversarial_cases(SEED, 7 * POINTS, (family,))]
    shapes = [structure(case) for case in drawn]
    commonest = sorted(set(shapes), key=shapes.count)[-STRUCTURES:]
    return [case for case, shape in zip(drawn, shapes, strict=True) if shape in commonest]


@functools.cache
def judged() -> tuple[Judged, Judged]:
    """Values and derivatives of all cases."""
    block = Block(cases(), "float32")
    return block.judge_values(), block.judge_derivatives("reverse")


def of_family(family: str) -> np.ndarray:
    """Places of the family's cases."""
    return np.array([i for i, case in enumerate(cases()) if case.label.startswith(f"{family}[")], dtype=int)


HELD = [family for family in FAMILIES if len(of_family(family))]


def test_hardly_a_family_is_left_out() -> None:
    assert len(HELD) >= len(FAMILIES) - 6
    assert len(cases()) > 1000


@pytest.mark.parametrize("family", FAMILIES)
def test_a_plan_can_be_made_of_every_family(family: str) -> None:
    for case in adversarial_cases(SEED, 8, (family,)):
        assert plan_of(case)


@pytest.mark.parametrize("family", HELD)
def test_values(family: str) -> None:
    values, _ = judged()
    own = of_family(family)
    assert values.finite[own].all()
    asked = own[~np.isnan(values.relative[own])]
    worst = max(asked, key=lambda i: values.relative[i], default=None)
    assert worst is None or values.relative[worst] <= VALUES, cases()[worst]


@pytest.mark.parametrize("family", HELD)
def test_derivatives(family: str) -> None:
    _, derivatives = judged()
    own = of_family(family)
    assert derivatives.finite[own].all()
    asked = own[~np.isnan(derivatives.relative[own])]
    worst = max(asked, key=lambda i: derivatives.relative[i], default=None)
    assert worst is None or derivatives.relative[worst] <= DERIVATIVES, cases()[worst]


def one_light(location: tuple, eye: tuple, position: tuple, normal: tuple, shininess: float) -> Case:
    """A sample under one white point light."""
    return Case(
        sample=Sample(position=position, normal=normal, eye=eye),
        material=Material(shininess=shininess, specular_color=(0.36, 0.4, 0.23), emissive_color=(0.86, 0.86, 0.43)),
        lights=(Light(kind="point", location=location, intensity=0.75, ambient_intensity=0.1),),
    )


@pytest.mark.parametrize(
    ("precision", "offset"), [("float64", 2.0**-20), ("float64", 2.0**-18), ("float64", 2.0**-16), ("float32", 2.0**-8)]
)
def test_a_light_opposite_the_viewer_in_one_plane_with_the_normal(precision: Precision, offset: float) -> None:
    """L + V nearly vanishes, but its direction is known: only a length of H that fits its rounding shows that."""
    case = one_light((1.0, -4.0, -3.0), (3.0, -2.0, -5.0), (2.0, -3.0 - offset, -4.0), (-1.0, 0.0, 1.0), 1 / 128)
    judged = Block([case], precision).judge_values()
    assert judged.finite.all() and judged.relative[0] <= VALUES


@pytest.mark.parametrize("offset", [2.0**-19, 2.0**-16, 2.0**-12])
@pytest.mark.parametrize("mode", ["reverse", "forward"])
def test_slopes_under_a_light_opposite_the_viewer_in_one_plane_with_the_normal(offset: float, mode: Mode) -> None:
    """L + V turns by symmetry only, and 1 / |L + V| must not bring back what rounding has left of other parts."""
    case = one_light((-2.0 - offset, -2.0, 2.0), (-4.0, 0.0, 0.0), (-3.0, -1.0, 1.0), (0.0, -1.0, 1.0), 1 / 128)
    judged = Block([case], "float64").judge_derivatives(mode)
    assert judged.finite.all() and judged.relative[0] <= DERIVATIVES


def test_the_slope_of_a_grazing_highlight() -> None:
    """N . H is a small difference whose derivative along x is as small, and must keep its digits.

    The last of them hang on how the cotangents are rounded, so many colours are looked at.
    """
    case = one_light((2.0, 2.0, 0.0), (1.0, 4.0, 2.0), (3.0, 3.0, 1.0), (0.0, 1.0 - 2.0**-20, -1.0), 1e-6)
    colors = np.random.default_rng(3).uniform(0.1, 1, (60, 3)).tolist()
    cases = [
        dataclasses.replace(case, material=dataclasses.replace(case.material, specular_color=(r, g, b)))
        for r, g, b in colors
    ]
    (exact,) = Block(cases, "float64").derivatives
    with jax.enable_x64(True):
        computed = answers.derivatives(cases, np.dtype("float64"), "reverse", chunk=len(cases))
    errors = exact.error_in_ulp(computed, 64) / exact.condition
    along_x = errors[:, exact.paths.index(("sample", "position", 0)), :3]
    assert np.median(along_x) <= 2 * DERIVATIVES
    assert along_x.max() <= 16 * DERIVATIVES


@pytest.mark.parametrize("size", [1e-35, 1e-34, 1e-31, 1.0, 1e37])
def test_the_length_of_a_tiny_vector_counts_its_small_components(size: float) -> None:
    """Their products with the unit vector underflow, while the length has room for them."""
    x, y, z = (np.float32(size * part) for part in (-0.0097, 0.996, -0.085))
    _, length = unit(Vector(jnp.float32(x), jnp.float32(y), jnp.float32(z)))
    exact = np.sqrt(sum(np.longdouble(part) ** 2 for part in (x, y, z)))
    assert abs(float(length) - exact) <= 3 * np.spacing(np.float32(exact))


# --- the factors by themselves ----------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def fifty_digits() -> Iterator[None]:
    with mp.workdps(50):
        yield


def beside(*points: float) -> np.ndarray:
    """The points and their float32 neighbours 1, 2 and 16 ulp to both sides."""
    found = []
    for point in points:
        for steps in (-16, -2, -1, 0, 1, 2, 16):
            x = np.float32(point)
            for _ in range(abs(steps)):
                x = np.nextafter(x, np.float32(np.inf if steps > 0 else -np.inf))
            found.append(x)
    return np.array(found)


def ulp_apart(got: jax.Array, wanted: Sequence[mpf]) -> float:
    """The largest difference in ulp of float32; below the smallest normal number in ulp of that."""
    errors = []
    for x, exact in zip(np.asarray(got, dtype=np.float64).ravel(), wanted, strict=True):
        spacing = max(float(np.spacing(np.float32(abs(exact)))), float(np.finfo(np.float32).tiny))
        errors.append(abs(float((mpf(float(x)) - exact) / mpf(spacing))))
    return max(errors)


@pytest.mark.parametrize("size", [1e-45, 1e-38, 1.2e-38, 1e-37, 1e-19, 1.0, 1e19, 1e37])
def test_unit_vectors_of_any_length(size: float) -> None:
    x, y, z = (np.float32(size * part) for part in (2.0, -3.0, 6.0))
    got, length = unit(Vector(jnp.float32(x), jnp.float32(y), jnp.float32(z)))
    if size < np.finfo(np.float32).tiny / 2:  # processors may flush subnormal numbers: then the vector is zero
        assert 0 <= length < np.finfo(np.float32).tiny
        return
    exact = mp.sqrt(sum(mpf(float(part)) ** 2 for part in (x, y, z)))
    assert ulp_apart(length, [exact]) <= (3 if size > 1e-37 else 64)
    if size > 1e-36:
        assert ulp_apart(jnp.stack(got), [mpf(float(part)) / exact for part in (x, y, z)]) <= 2


def test_second_derivatives_at_tiny_numbers_are_finite() -> None:
    tiny = jnp.full(3, 1e-30, jnp.float32)
    assert np.all(np.isfinite(jax.grad(lambda v: inverse_length(Vector(*v)))(tiny)))
    assert np.all(np.isfinite(jax.hessian(lambda v: unit(Vector(*v))[0].x)(tiny)))
    assert np.isfinite(jax.grad(elementary.steep_reciprocal)(tiny[0]))


@pytest.mark.parametrize("form", [highlight.FULL, highlight.FAST], ids=["full", "fast"])
def test_the_slope_of_a_power_below_one_is_held(form: highlight.Highlight) -> None:
    slope = jax.grad(form.power)(jnp.float32(2.0**-55), jnp.float32(0.5))
    assert 2.0**20 < slope <= 2.0**24


def test_the_zero_vector() -> None:
    zero = jnp.zeros(())
    (got, length), slope = jax.jvp(lambda x: unit(Vector(x, zero, zero)), (zero,), (jnp.ones(()),))
    assert [*map(float, got), float(length)] == [0, 0, 0, 0]
    assert [*map(float, slope[0]), float(slope[1])] == [0, 0, 0, 0]


def test_powers_near_the_peak_keep_their_digits() -> None:
    """The error of (N . H)^128 is not 128 times that of N . H."""
    for versine in (0.0, 1e-12, 1e-7, 1e-4, 1e-2, 0.1):
        nearby = -np.abs(beside(versine))
        got = highlight.FULL.power(jnp.asarray(nearby), jnp.float32(128.0))
        wanted = [(1 + mpf(float(x))) ** 128 for x in nearby]
        condition = 1 + 128 * abs(versine)
        assert ulp_apart(got, wanted) <= 4 * condition


@pytest.mark.parametrize(("exponent", "value"), [(0.0, 1.0), (1e-30, 0.0), (1.0, 0.0), (128.0, 0.0)])
def test_powers_of_what_faces_away(exponent: float, value: float) -> None:
    away, exponent_of = jnp.float32(highlight.AWAY), jnp.float32(exponent)
    assert highlight.FULL.power(away, exponent_of) == value
    slopes = jax.grad(highlight.FULL.power, argnums=(0, 1))(away, exponent_of)
    assert [*map(float, slopes)] == [0, 0]


@pytest.mark.parametrize("angle", [0.0, 1e-30, 1e-7, 1e-3, 0.5, np.pi / 4, np.pi / 2, 3.0, np.pi])
def test_angles_from_zero_to_pi(angle: float) -> None:
    """Where an arc cosine has no digits left, too."""
    nearby = np.abs(beside(angle))
    y = np.sin(nearby.astype(np.float64)).astype(np.float32)
    x = np.cos(nearby.astype(np.float64)).astype(np.float32)
    got = elementary.arctangent(jnp.abs(jnp.asarray(y)), jnp.asarray(x))
    wanted = [mp.atan2(abs(mpf(float(b))), mpf(float(a))) for a, b in zip(x, y, strict=True)]
    assert ulp_apart(got, wanted) <= 2


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_axis_of_a_spot_is_a_tip_in_every_direction(precision: str, sign: float) -> None:
    """The angle to a vector itself has derivative 0, although compiled products of its components are contracted."""
    with jax.enable_x64(precision == "float64"):
        drawn = np.random.default_rng(1).normal(size=(3, 4096)).astype(precision)
        axes, _ = unit(Vector(*map(jnp.asarray, drawn)))
        toward = axes.scaled(jnp.asarray(sign, precision))
        total = jax.jit(lambda a, b: jnp.sum(factors.angle_between(a, b)))
        angle = jax.jit(factors.angle_between)(axes, toward)
        slopes = jax.grad(total, argnums=(0, 1))(axes, toward)
        if sign > 0:
            assert np.max(angle) <= 1.01 * np.sqrt(np.finfo(precision).tiny)
        else:
            np.testing.assert_array_equal(angle, np.asarray(np.pi, precision))
        np.testing.assert_array_equal(jnp.stack([plane for slope in slopes for plane in slope]), 0.0)


def test_the_spots_ramp_at_its_ends() -> None:
    beam, cut_off = np.float32(0.25), np.float32(0.75)
    angles = beside(0.25, 0.75)
    got = factors.spot(jnp.asarray(angles), jnp.asarray(beam), jnp.asarray(cut_off))
    wanted = [min(mpf(1), max(mpf(0), (mpf(0.75) - mpf(float(a))) / mpf(0.5))) for a in angles]
    assert ulp_apart(got, wanted) <= 1
    for angle in angles:
        slopes = jax.grad(factors.spot, argnums=(0, 1, 2))(*map(jnp.float32, (angle, beam, cut_off)))
        assert -2.01 <= slopes[0] <= 0 and 0 <= slopes[1] <= 2.01 and 0 <= slopes[2] <= 2.01


@pytest.mark.parametrize("width", [0.25, 1.5])
def test_a_spot_without_a_ramp_jumps(width: float) -> None:
    angles = beside(width)
    got = factors.spot(jnp.asarray(angles), jnp.float32(width), jnp.float32(width))
    np.testing.assert_array_equal(got, np.where(angles < np.float32(width), 1.0, 0.0))
    slopes = jax.grad(factors.spot, argnums=(0, 1, 2))(*map(jnp.float32, (width, width, width)))
    assert [*map(float, slopes)] == [0, 0, 0]


def test_attenuation_at_a_sum_of_one() -> None:
    for c1 in beside(0.25):
        got = factors.attenuation(jnp.float32(c1), jnp.float32(0.25), jnp.float32(0), jnp.float32(3))
        assert ulp_apart(got, [1 / max(mpf(1), mpf(float(c1)) + mpf(0.75))]) <= 1
        slope = jax.grad(factors.attenuation)(*map(jnp.float32, (c1, 0.25, 0.0, 3.0)))
        assert -1.0001 <= slope <= 0
    # A light may be made fainter from there.
    assert jax.grad(factors.attenuation)(*map(jnp.float32, (0.25, 0.25, 0.0, 3.0))) == -1


def test_slopes_of_an_attenuation_that_overflows_are_finite() -> None:
    numbers = map(jnp.float32, (0.0, 0.0, 1e38, 10.0))
    assert np.all(np.isfinite(jax.grad(factors.attenuation, argnums=(0, 1, 2, 3))(*numbers)))


@pytest.mark.parametrize("distance", [1e18, 9e18, 1e25, 1e37])
def test_a_faint_light_is_attenuated_over_any_distance(distance: float) -> None:
    """The squared distance overflows or nearly does, its product with the little light that arrives does not."""
    d, weight = np.float32(distance), np.float32(1e-9)
    of_c3 = jax.grad(lambda c3: weight * factors.attenuation(jnp.float32(1), jnp.float32(0), c3, jnp.float32(d)))
    slope = float(of_c3(jnp.float32(0)))
    exact = -mpf(float(weight)) * mpf(float(d)) ** 2
    assert np.isfinite(slope)
    assert ulp_apart(np.float32(slope), [exact]) <= 2 if abs(exact) < 2.0**100 else slope < -(2.0**95)


@pytest.mark.parametrize("moved", ["c1", "c2", "c3", "d"])
def test_a_far_light_fades_as_its_distance_and_coefficients_grow(moved: str) -> None:
    """The square of the factor underflows, its product with a step as large as the distance does not."""
    numbers = {"c1": 1e20, "c2": 0.25, "c3": 1e-20, "d": 1e20}
    start = {name: jnp.float32(value) for name, value in numbers.items()}
    step = {name: value if name == moved else jnp.zeros_like(value) for name, value in start.items()}
    change = jax.jvp(lambda at: factors.attenuation(**at), (start,), (step,))[1]
    c1, c2, c3, d = (mpf(float(value)) for value in start.values())
    by = {"c1": c1, "c2": c2 * d, "c3": c3 * d * d, "d": c2 * d + 2 * c3 * d * d}[moved]
    assert ulp_apart(change, [-by / (c1 + c2 * d + c3 * d * d) ** 2]) <= 4


def test_the_direction_of_a_faint_light_in_a_large_frame() -> None:
    """A direction has no length: its derivative is that without a frame, times the frame's size."""
    size = 2.0**40
    faint = Light(kind="directional", direction=(-0.5, -0.25, -2.0), intensity=2.0**-90)
    frame = ((size, 0.0, 0.0, 0.0), (0.0, size, 0.0, 0.0), (0.0, 0.0, size, 0.0))
    framed = dataclasses.replace(faint, direction=tuple(x / size for x in faint.direction), frame=frame)
    slopes = []
    for light in (faint, framed):
        any_light = one_light((0.0,) * 3, (1.0, 2.0, 3.0), (0.0,) * 3, (0.25, 0.5, 1.0), 0.1)
        case = dataclasses.replace(any_light, lights=(light,))
        (derivatives,) = answers.derivatives([case], np.float32, chunk=1)
        slopes.append(derivatives[[path[2:3] == ("direction",) for path in float_paths(case)]])
    assert np.all(slopes[0][:, :3] != 0)
    np.testing.assert_allclose(slopes[1], size * slopes[0], rtol=1e-6)


@pytest.mark.parametrize("visibility", [-1.0, 0.0, 1e-37, 1e-20, 3.0, 1e20, 1e37])
@pytest.mark.parametrize("fog", [factors.linear_fog, factors.exponential_fog])
def test_fog_at_before_and_beyond_the_visibility(fog, visibility: float) -> None:
    near = beside(visibility) if visibility > 0 else np.float32([1.0])
    distances = np.abs(np.concatenate([near, np.float32([0.0, 1.0])]))
    for d in distances:
        clear, hidden = fog(jnp.float32(d), jnp.float32(visibility))
        v, d_exact = mpf(float(np.float32(visibility))), mpf(float(d))
        if v <= 0:
            f0 = mpf(1)
        elif d_exact >= v:
            f0 = mpf(0)
        else:
            f0 = (v - d_exact) / v if fog is factors.linear_fog else mp.exp(-d_exact / (v - d_exact))
        flushed = 0 < v - d_exact < np.finfo(np.float32).tiny
        assert flushed or ulp_apart(jnp.stack([clear, hidden]), [f0, 1 - f0]) <= (
            2 if fog is factors.linear_fog else 2 + 2 * abs(float(mp.log(f0 or 1)))
        )
        slopes = jax.grad(lambda d, v: fog(d, v)[0], argnums=(0, 1))(jnp.float32(d), jnp.float32(visibility))
        assert np.isfinite(slopes).all()
        assert slopes[0] <= 0 <= slopes[1]


@pytest.mark.parametrize("kind", ["LINEAR", "EXPONENTIAL"])
def test_fog_that_is_endlessly_far_away_hides_nothing(kind: str) -> None:
    ball = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()), geometry=nodes.Sphere())
    sun, sample = nodes.DirectionalLight(ambient_intensity=1), SampleBuffer.create([[0, 0, 1]], [[0, 0, 1]], [0, 0, 5])
    fogged = Scene.from_nodes([ball, sun, nodes.Fog(visibility_range=1, fog_type=kind, color=(1, 0, 0))])
    endless = eqx.tree_at(lambda scene: scene.fog.visibility_range, fogged, jnp.float32(np.inf))
    np.testing.assert_array_equal(shade(endless, sample), shade(Scene.from_nodes([ball, sun]), sample))
    if kind == "LINEAR":  # whose quotients are by the range itself
        slopes = jax.grad(lambda scene: jnp.sum(shade(scene, sample)))(endless)
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slopes))
