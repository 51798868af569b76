"""The oracles against each other: exact against NumPy, derivatives against differences, 80-bit floats against exact."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpmath import mp, mpf

import oracle
from oracle import Case, Fog, Light, Material, Sample
from oracle.adversarial import FAMILIES, adversarial_cases, step
from oracle.cases import random_cases, well_conditioned_cases
from oracle.condition import condition, gradient_condition, moved_gradient_condition, near_ties
from oracle.equation import brightest, shade
from oracle.exact import evaluate, gradient_bounds
from oracle.fast_exact import gradients, second_derivatives, values
from oracle.paths import float_paths, get, put, show
from oracle.ulp import error_in_ulp, input_ulp, neighbours, output_ulp

SEED = 20
RANDOM = random_cases(SEED, 300)
ADVERSARIAL = adversarial_cases(SEED, 600)


def wide(number: Any) -> np.longdouble:
    """An mpmath number as an 80-bit float."""
    high = float(number)
    return np.longdouble(high) + np.longdouble(float(number - mpf(high)))


# --- exact ------------------------------------------------------------------------------------------------------------


def test_equation_agrees_with_exact() -> None:
    # Cases by their conditioning, not by their error: 8 ulp of float64 times the condition, at the very worst 100; near
    # the highlight's peak the plain formula multiplies the error of the dot product by the exponent, up to 128.
    cases = RANDOM + ADVERSARIAL
    known = values(cases, 64)
    errors = []
    for i, case in enumerate(cases):
        rgb, alpha = shade(case)
        exact = np.array([wide(x) for x in evaluate(case).rgba])
        errors.append(error_in_ulp([*rgb, alpha], exact, 64) / known.condition[i])
        assert np.all(np.isfinite(rgb)) and np.all(rgb <= brightest(case) * (1 + 1e-12)), case
    worst = np.where(known.well_conditioned[:, None], np.array(errors), 0).max(axis=1)
    assert known.well_conditioned.mean() > 0.8
    at_peak = np.array([case.label.startswith("highlight_peak") for case in cases])
    assert np.quantile(worst[~at_peak], 0.99) < 8, cases[int(worst.argmax())]
    assert worst.max() < 128, cases[int(worst.argmax())]


def with_numbers(case: Case) -> Case:
    """The case with mpmath numbers, so that steps far below a float's last digit are possible."""
    for path in float_paths(case):
        case = put(case, path, mpf(get(case, path)))
    return case


def difference(case: Case, path: Any, order: int) -> list:
    """Central difference of the values (order 0) or gradients (order 1), at 80 digits."""
    with mp.workdps(80):
        x = get(case, path)
        h = mpf(10) ** -25 * (abs(x) + mpf(10) ** -3)
        up, down = (evaluate(put(case, path, x + sign * h), order, digits=80) for sign in (1, -1))
        if order == 0:
            return [(a - b) / (2 * h) for a, b in zip(up.rgba, down.rgba, strict=True)]
        return [
            {p: (up.gradient[p][c] - down.gradient[p][c]) / (2 * h) for p in up.gradient} for c in range(len(up.rgba))
        ]


def away_from_kinks(cases: list[Case], count: int) -> list[Case]:
    """The first cases of every shape whose decisions are all far off."""
    known = values(cases)
    far = np.min([known.distances[kind] for kind in ("jump", "kink", "cone")], axis=0) > 1000
    return [case for case, good in zip(cases, far, strict=True) if good][:: max(1, int(far.sum()) // count)][:count]


@pytest.mark.parametrize("case", away_from_kinks(RANDOM, 12), ids=lambda case: case.label)
def test_gradient_agrees_with_differences(case: Case) -> None:
    numbers = with_numbers(case)
    exact = evaluate(numbers, 1)
    for path in exact.inputs:
        expected = difference(numbers, path, 0)
        for got, want in zip(exact.gradient[path], expected, strict=True):
            assert abs(got - want) <= mpf(10) ** -20 * (abs(want) + mpf(10) ** -15), show(path)


@pytest.mark.parametrize("case", away_from_kinks(RANDOM, 3), ids=lambda case: case.label)
def test_hessian_agrees_with_differences_of_the_gradient(case: Case) -> None:
    numbers = with_numbers(case)
    exact = evaluate(numbers, 2)
    none = (mpf(0),) * 4
    for q in exact.inputs:
        slopes = difference(numbers, q, 1)
        for p in exact.inputs:
            got = exact.hessian.get((p, q)) or exact.hessian.get((q, p)) or none
            for c in range(4):
                want = slopes[c][p]
                assert abs(got[c] - want) <= mpf(10) ** -18 * (abs(want) + mpf(10) ** -12), (show(p), show(q))


UP = Sample(position=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), eye=(0.0, 0.0, 10.0))


def bounds(case: Case, *path: Any) -> tuple[float, float]:
    low, high = gradient_bounds(case)[path][0]
    return float(low), float(high)


def test_bounds_at_kinks_hold_both_sides() -> None:
    light = Light(location=(0.0, 0.0, 4.0))
    half = Material(diffuse_color=(0.5,) * 3)
    # Attenuation (1, 0, 0) is a sum of exactly 1: -0.5 x d^k on one side, 0 on the other.
    for k in range(3):
        assert bounds(Case(UP, half, (light,)), "lights", 0, "attenuation", k) == (-0.5 * 4.0**k, 0.0)
    # N.L = 0 with the light along x: 0.5 dz / 2 on one side.
    grazing = Light(location=(2.0, 0.0, 0.0), attenuation=(0.0, 0.0, 0.0))
    assert bounds(Case(UP, half, (grazing,)), "lights", 0, "location", 2) == (0.0, 0.25)
    # At the visibility the fog's colour (0) is all there is; nearer, 0.5 (v - d) / v.
    fog = Fog(color=(0.0,) * 3, visibility_range=10.0)
    unattenuated = replace(light, attenuation=(0.0, 0.0, 0.0))
    assert bounds(Case(UP, half, (unattenuated,), fog), "fog", "visibility_range") == (0.0, 0.05)
    # Nothing is defined at the light itself.
    assert bounds(Case(UP, half, (Light(),)), "lights", 0, "location", 0) == (-math.inf, math.inf)


def test_opposite_directions_are_told_from_almost_opposite_ones() -> None:
    # The light above, the viewer below: L + V = 0. Aside by 1e-30, L + V points that way, along N.
    shiny = Material(diffuse_color=(0.0,) * 3, specular_color=(1.0,) * 3, shininess=1 / 128)
    for aside, expected in ((0.0, 0.0), (1e-30, 1.0)):
        sample = Sample(position=(0.0, 0.0, 0.0), normal=(1.0, 0.0, 0.0), eye=(aside, 0.0, -1.0))
        case = Case(sample, shiny, (Light(location=(0.0, 0.0, 2.0)),))
        assert float(evaluate(case).rgba[0]) == pytest.approx(expected)
    # No component is zero, and no unit vector is exact.
    light = Light(location=(0.3, 0.7, 1.1), attenuation=(0.0, 0.0, 0.0))
    case = Case(replace(UP, eye=tuple(-2 * x for x in light.location), normal=(1.0, 0.2, 0.3)), shiny, (light,))
    assert evaluate(case).rgba[0] == 0


def test_a_power_may_underflow() -> None:
    # N.H = 0.5 to the 128th is 2^-128, below float32's smallest normal number; its slope is above it.
    shiny = Material(diffuse_color=(0.0,) * 3, specular_color=(1.0,) * 3, shininess=1.0)
    sideways = Light(location=(math.sqrt(0.75) * 4, 0.0, 2.0), attenuation=(0.0, 0.0, 0.0))
    case = Case(replace(UP, eye=sideways.location), shiny, (sideways,))
    slope = 128 * 2.0**-128 * math.log(0.5)
    for precision, expected in ((32, (2 * slope, 0.0)), (64, (slope, slope))):
        low, high = gradient_bounds(case, near_ties(case, precision))["material", "shininess"][0]
        assert (float(low), float(high)) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(("precision", "underflows"), [(32, True), (64, False)])
def test_fog_may_underflow(precision: int, underflows: bool) -> None:
    """At distance 1, e^-100 is below float32's smallest normal number, and its slopes are 1e4 times it."""
    fog = Fog(fog_type="EXPONENTIAL", visibility_range=1.01)
    sample = replace(UP, position=(0.0, 0.0, 0.0), eye=(0.0, 0.0, 1.0))
    clear = replace(fog, visibility_range=2.0)
    for own, expected in ((fog, underflows), (clear, False)):
        (found,) = second_derivatives([Case(sample, None, fog=own)], lambda path: 1.0, precision)
        assert found.may_underflow.tolist() == [expected]


# --- condition --------------------------------------------------------------------------------------------------------


def test_ulp() -> None:
    assert output_ulp(1.0, 32) == 2.0**-23 and output_ulp(0.75, 64) == 2.0**-53
    assert output_ulp(0.0, 32) == 2.0**-126 and np.isinf(output_ulp(1e39, 32))
    assert [float(x) for x in neighbours(1.0, 32)] == [1 + 2.0**-23, 1 - 2.0**-24]
    assert input_ulp(0.0, 32) == 0 and input_ulp(math.inf, 32) == 0
    assert input_ulp(float(np.float32(1e-40)), 32) == np.float32(1e-40)  # it may be flushed
    assert error_in_ulp(1.0 + 2.0**-22, 1.0, 32) == 2 and np.isinf(error_in_ulp(math.nan, 1.0, 32))
    assert step(1.0, -2) == 1 - 2.0**-23 and step(0.0, 0) == 0.0


def test_condition_of_a_product_and_of_a_difference() -> None:
    # 0.5 x 0.75 (emissive 0): each factor's ulp counts; colours 1 and intensity 1 move by an ulp of 1.
    light = Light(kind="directional", direction=(0.0, 0.0, -1.0), intensity=0.75, color=(0.75, 0.0, 0.0))
    case = Case(UP, Material(ambient_intensity=0.0, diffuse_color=(0.75, 0.0, 0.0), shininess=0.0), (light,))
    known = condition(case)
    # f = 27/64, ulp(f) = 2^-25; each factor 0.75 moves by 2^-24 and the result by 9/16 of it: 9/8 ulp each. Directions,
    # along the axis, change nothing.
    assert known.condition == (3 * 9 / 8, 1.0, 1.0, 1.0)
    assert known.well_conditioned
    # Alpha 1 - T near T = 1 is all cancellation: an ulp of T is 2^22 ulp of 2^-22.
    clear = condition(Case(UP, Material(transparency=1 - 2.0**-22)))
    assert clear.condition[3] == 2.0**-24 / 2.0**-45


def test_jumps_make_a_case_ill_conditioned() -> None:
    at_radius = Case(UP, Material(), (Light(location=(0.0, 0.0, 4.0), radius=4.0),))
    assert not condition(at_radius).well_conditioned
    assert condition(at_radius).decisions["lights[0].radius"] == ("jump", 0.0)
    zero_normal = Case(replace(UP, normal=(0.0, 0.0, 0.0)), Material(), (Light(location=(0.0, 0.0, 4.0)),))
    assert condition(zero_normal).well_conditioned and not condition(zero_normal).differentiable


# --- 80-bit floats ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cases", [RANDOM, ADVERSARIAL], ids=["random", "adversarial"])
def test_fast_values_agree_with_exact(cases: list[Case]) -> None:
    known = values(cases, 64)
    exact = np.array([[wide(x) for x in evaluate(case).rgba] for case in cases])
    error = np.abs(known.rgba - exact) / output_ulp(exact, 64) / known.condition
    worst = np.where(known.well_conditioned, error.max(axis=1), 0)
    assert worst.max() < 0.1, cases[int(worst.argmax())]
    in_float32 = np.abs(known.rgba - exact) / output_ulp(exact, 32) / values(cases, 32).condition
    assert in_float32.max() < 1e-6, cases[int(in_float32.max(axis=1).argmax())]


@pytest.mark.parametrize("cases", [RANDOM[::30], ADVERSARIAL[::40]], ids=["random", "adversarial"])
@pytest.mark.parametrize("precision", [32, 64])
def test_fast_conditions_agree_with_exact(cases: list[Case], precision: int) -> None:
    known = values(cases, precision)
    for i, case in enumerate(cases):
        exact = condition(case, precision)
        np.testing.assert_allclose(known.condition[i], exact.condition, rtol=0.05, err_msg=repr(case))
        for kind in known.distances:
            assert known.distances[kind][i] == pytest.approx(exact.nearest(kind), rel=1e-6), (kind, case)
        assert known.well_conditioned[i] == exact.well_conditioned


@pytest.mark.parametrize("cases", [RANDOM[::5], ADVERSARIAL[::8]], ids=["random", "adversarial"])
def test_fast_gradients_agree_with_exact(cases: list[Case]) -> None:
    judged = 0
    for group in gradients(cases, 32):
        assert group.condition is not None and np.all(np.isfinite(group.low[group.differentiable]))
        for row, place in enumerate(group.index):
            if not group.differentiable[row]:
                continue
            exact = evaluate(cases[place], 1)
            expected = np.array(
                [[wide(x) for x in exact.gradient.get(path, (mpf(0),) * 4)] for path in group.paths],
                dtype=np.longdouble,
            )
            room = group.rounding[row]
            below = (group.low[row] - room - expected) / output_ulp(expected, 32)
            above = (expected - room - group.high[row]) / output_ulp(expected, 32)
            outside = np.maximum(below, above) / group.condition[row]
            # A thousandth of an ulp: far below what derivatives are asked for.
            assert outside.max() < 1e-3, (show(group.paths[int(outside.max(axis=1).argmax())]), cases[place])
            judged += 1
    assert judged > 0.4 * len(cases)


def test_fast_bounds_at_kinks_agree_with_exact() -> None:
    cases = adversarial_cases(SEED, 300, ("grazing_light", "spot_edge", "attenuation_one", "fog_edge"))
    intervals = 0
    for group in gradients(cases, 32):
        assert group.condition is not None
        for row in np.flatnonzero(group.differentiable):
            case = cases[group.index[row]]
            exact = gradient_bounds(case, near_ties(case))
            for i, path in enumerate(group.paths):
                for c, (low, high) in enumerate(exact.get(path, ((mpf(0), mpf(0)),) * 4)):
                    ends = np.array([group.low[row, i, c], group.high[row, i, c]])
                    allowed = output_ulp(ends, 32).max() * group.condition[row, i, c]
                    allowed = 1e-3 * allowed
                    assert abs(group.low[row, i, c] - wide(low)) <= allowed, (show(path), case)
                    assert abs(group.high[row, i, c] - wide(high)) <= allowed, (show(path), case)
                    intervals += low != high
    assert intervals > 1000


def test_fast_gradient_conditions_agree_with_exact() -> None:
    cases = away_from_kinks(RANDOM, 4)
    for group in gradients(cases, 32):
        assert group.condition is not None
        for row, place in enumerate(group.index):
            exact = gradient_condition(cases[place])
            for i, path in enumerate(group.paths):
                expected = exact.get(path, (1.0,) * 4)
                np.testing.assert_allclose(group.condition[row, i], expected, rtol=1e-6, err_msg=show(path))


def test_moved_inputs_tell_the_condition_of_derivatives_that_first_order_tells() -> None:
    for case in away_from_kinks(RANDOM, 4):
        moved = moved_gradient_condition(case)
        for path, expected in gradient_condition(case).items():
            np.testing.assert_allclose(moved[path], expected, rtol=1e-3, err_msg=show(path))


def test_moved_inputs_tell_what_vanishes_to_first_order() -> None:
    """L and V opposite, N in their plane: H turns with an input's square."""
    numbers: dict[str, Any] = {"position": (-3.0, -1.0, 1.0), "normal": (0.0, -1.0, 1.0), "eye": (-4.0, 0.0, 0.0)}
    light = Light(kind="point", location=(-2.0 - 2.0**-12, -2.0, 2.0))
    material = Material(shininess=1 / 128, specular_color=(1.0, 1.0, 1.0))
    case = Case(sample=Sample(**numbers), material=material, lights=(light,))
    path = ("sample", "position", 0)
    assert moved_gradient_condition(case, 32)[path][0] > 100 * gradient_condition(case, 32)[path][0]


# --- cases ------------------------------------------------------------------------------------------------------------


def test_cases_follow_from_the_seed_and_are_float32_numbers() -> None:
    for make in (random_cases, adversarial_cases):
        cases = make(5, 200)
        assert repr(cases) == repr(make(5, 200)) != repr(make(6, 200))
        for case in cases:
            numbers = np.array([get(case, path) for path in float_paths(case)])
            np.testing.assert_array_equal(numbers, numbers.astype(np.float32))


def test_a_printed_case_is_the_case() -> None:
    case = random_cases(5, 1)[0]
    assert eval(repr(case), dict(vars(oracle))) == case


def test_random_cases_are_well_conditioned() -> None:
    assert values(RANDOM).well_conditioned.mean() > 0.95
    assert values(well_conditioned_cases(SEED, 50)).well_conditioned.all()


def test_every_family_comes_at_its_point_and_on_both_sides() -> None:
    cases = adversarial_cases(SEED, 1500)
    labels = {case.label for case in cases}
    assert {label.split("[")[0] for label in labels} == set(FAMILIES)
    for steps in ("+0", "+1", "-1", "+2", "-2", "+16", "-16"):
        assert any(label == f"spot_edge[0]{steps}" for label in labels)
    with pytest.raises(ValueError, match="unknown"):
        adversarial_cases(SEED, 1, ("no_such_family",))
