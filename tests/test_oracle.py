"""The NumPy oracle against values worked out by hand: every table row, every field, every reading."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from oracle import Case, Fog, Light, Material, Options, Sample
from oracle.equation import attenuation, brightest, shade, spot_factor

# The sample looks up the z axis; the viewer and, by default, the light stand on it.
UP = Sample(position=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 2.0), eye=(0.0, 0.0, 10.0))
ABOVE = Light(location=(0.0, 0.0, 4.0))
RGB, RGBA = (0.5, 0.25, 1.0), (0.5, 0.25, 1.0, 0.75)
# I_T = 0.5 or I_Trgb = (0.2, 0.4, 0.6), A_T = 0.8, by the number of components.
TEXELS: dict[int, Any] = {0: None, 1: (0.5,), 2: (0.5, 0.8), 3: (0.2, 0.4, 0.6), 4: (0.2, 0.4, 0.6, 0.8)}


def sample(color: Any = None, texel: Any = None, **fields: Any) -> Sample:
    return Sample(**{**UP.__dict__, "color": color, "texel": texel, **fields})


def check(case: Case, rgb: Any, alpha: float = 1.0) -> None:
    got, got_alpha = shade(case)
    # The 128th power multiplies float64's rounding by 128.
    np.testing.assert_allclose(got, np.broadcast_to(rgb, 3), rtol=128 * 2.3e-16, atol=1e-300)
    assert got_alpha == pytest.approx(alpha, rel=1e-15)


# --- tables 17.2 and 17.3 ---------------------------------------------------------------------------------------------

IMAGE = (0.2, 0.4, 0.6)
UNLIT = [
    # components, mode, colour without and with a Color node, alpha
    (0, "replace", (1, 1, 1), RGB, 1.0),
    (1, "replace", (0.5, 0.5, 0.5), (0.25, 0.125, 0.5), 1.0),
    (2, "replace", (0.5, 0.5, 0.5), (0.25, 0.125, 0.5), 0.8),
    (3, "replace", IMAGE, IMAGE, 1.0),
    (4, "replace", IMAGE, IMAGE, 0.8),
    (0, "modulate", (1, 1, 1), RGB, 1.0),
    (1, "modulate", (0.5, 0.5, 0.5), (0.25, 0.125, 0.5), 1.0),
    (2, "modulate", (0.5, 0.5, 0.5), (0.25, 0.125, 0.5), 0.8),
    (3, "modulate", IMAGE, (0.1, 0.1, 0.6), 1.0),
    (4, "modulate", IMAGE, (0.1, 0.1, 0.6), 0.8),
]


@pytest.mark.parametrize(("components", "mode", "without", "colored", "alpha"), UNLIT)
def test_unlit_table(components: int, mode: Any, without: Any, colored: Any, alpha: float) -> None:
    options, texel = Options(texture_mode=mode), TEXELS[components]
    lights = (ABOVE,)  # light makes no difference
    check(Case(sample(None, texel), None, lights, options=options), without, alpha)
    check(Case(sample(RGB, texel), None, lights, options=options), colored, alpha)


# diffuseColor (0.4, 0.8, 1), transparency 0.25; one head-on light, no ambient: the result is O_D itself.
LIT = [
    (0, "replace", (0.4, 0.8, 1.0), RGB, 0.75),
    (1, "replace", (0.2, 0.4, 0.5), (0.25, 0.125, 0.5), 0.75),
    (2, "replace", (0.2, 0.4, 0.5), (0.25, 0.125, 0.5), 0.8),
    (3, "replace", IMAGE, IMAGE, 0.75),
    (4, "replace", IMAGE, IMAGE, 0.8),
    (0, "modulate", (0.4, 0.8, 1.0), RGB, 0.75),
    (1, "modulate", (0.2, 0.4, 0.5), (0.25, 0.125, 0.5), 0.75),
    (2, "modulate", (0.2, 0.4, 0.5), (0.25, 0.125, 0.5), 0.6),
    (3, "modulate", (0.08, 0.32, 0.6), (0.1, 0.1, 0.6), 0.75),
    (4, "modulate", (0.08, 0.32, 0.6), (0.1, 0.1, 0.6), 0.6),
]


@pytest.mark.parametrize(("components", "mode", "without", "colored", "alpha"), LIT)
def test_lit_table(components: int, mode: Any, without: Any, colored: Any, alpha: float) -> None:
    material = Material(diffuse_color=(0.4, 0.8, 1.0), transparency=0.25)
    options, texel = Options(texture_mode=mode), TEXELS[components]
    check(Case(sample(None, texel), material, (ABOVE,), options=options), without, alpha)
    check(Case(sample(RGB, texel), material, (ABOVE,), options=options), colored, alpha)


@pytest.mark.parametrize(
    ("components", "mode", "alpha"),
    [(0, "replace", 0.75), (1, "replace", 0.75), (2, "replace", 0.8), (4, "replace", 0.8), (4, "modulate", 0.6)],
)
def test_alpha_of_a_vertex_colour_stands_in_for_opacity(components: int, mode: Any, alpha: float) -> None:
    for material in (None, Material(transparency=0.5)):
        case = Case(sample(RGBA, TEXELS[components]), material, options=Options(texture_mode=mode))
        assert shade(case)[1] == pytest.approx(alpha)


def test_lines_and_points_are_unlit_and_take_emissive_color() -> None:
    material = Material(emissive_color=(0.1, 0.2, 0.3), transparency=0.25)
    check(Case(UP, material, (ABOVE,), line_or_point=True), (0.1, 0.2, 0.3), 0.75)
    check(Case(sample(RGB), material, (ABOVE,), line_or_point=True), RGB, 0.75)
    check(Case(UP, None, (ABOVE,), line_or_point=True), 1.0)


# --- the terms --------------------------------------------------------------------------------------------------------

TILTED = Light(location=(4.0, 0.0, 3.0))  # N.L = 0.6
PLAIN = Material(diffuse_color=(0.5, 0.5, 0.5))


def lit(light: Light, material: Material = PLAIN, **fields: Any) -> Case:
    return Case(UP, material, (light,), **fields)


def test_ambient_is_not_multiplied_by_intensity() -> None:
    material = Material(ambient_intensity=0.2, diffuse_color=(0.5, 1.0, 0.25))
    light = Light(location=(0.0, 0.0, -4.0), ambient_intensity=0.5, intensity=0.0, color=(1.0, 0.5, 1.0))
    check(lit(light, material), (0.05, 0.05, 0.025))


def test_emissive_diffuse_and_light_fields() -> None:
    material = Material(diffuse_color=(0.5, 1.0, 0.25), emissive_color=(0.25, 0.0, 0.5))
    light = Light(location=(4.0, 0.0, 3.0), intensity=0.5, color=(1.0, 0.5, 0.0))
    check(lit(light, material), (0.25 + 0.15, 0.15, 0.5))


@pytest.mark.parametrize(("shininess", "power"), [(0.0, 1.0), (1 / 128, 0.8), (0.03125, 0.8**4), (1.0, 0.8**128)])
def test_specular(shininess: float, power: float) -> None:
    # L = (24, 0, 7) / 25 and V = (0, 0, 1): H = (0.6, 0, 0.8).
    light = Light(location=(24.0, 0.0, 7.0), intensity=0.5)
    material = Material(diffuse_color=(0.0,) * 3, specular_color=(1.0, 0.5, 0.0), shininess=shininess)
    check(lit(light, material), (0.5 * power, 0.25 * power, 0.0))


def test_specular_behind_the_surface_and_its_gate() -> None:
    # L = (24, 0, -7) / 25, V = (0, 0, 1): L + V = (24, 0, 18) / 25, N.H = 0.6.
    light = Light(location=(24.0, 0.0, -7.0))
    material = Material(specular_color=(1.0, 1.0, 1.0), shininess=1 / 128)
    check(lit(light, material), 0.6)
    check(lit(light, material, options=Options(specular_gate=True)), 0.0)


@pytest.mark.parametrize(("shininess", "power"), [(0.0, 1.0), (1e-6, 0.0), (1.0, 0.0)])
def test_shininess_zero_gives_one_also_where_n_h_is_zero(shininess: float, power: float) -> None:
    material = Material(diffuse_color=(0.0,) * 3, specular_color=(1.0, 1.0, 1.0), shininess=shininess)
    case = Case(sample(eye=(5.0, 0.0, 0.0)), material, (Light(location=(0.0, 3.0, 0.0)),))
    check(case, power)


@pytest.mark.parametrize(
    ("coefficients", "level", "factor"),
    [
        ((1.0, 0.0, 0.0), 3, 1.0),
        ((0.0, 0.0, 0.0), 3, 1.0),
        ((0.25, 0.25, 0.0), 3, 0.8),
        ((0.0, 0.0, 0.5), 3, 0.125),
        ((0.5, 0.25, 0.5), 3, 1 / 9.5),
        ((0.5, 0.25, 0.5), 2, 1 / 1.5),
        ((0.5, 0.1, 0.0), 3, 1.0),
    ],
)
def test_attenuation_scales_everything_at_distance_4(coefficients: Any, level: Any, factor: float) -> None:
    light = Light(location=(0.0, 0.0, 4.0), attenuation=coefficients, ambient_intensity=0.5)
    check(lit(light, options=Options(support_level=level)), 0.55 * factor)
    assert attenuation(light, 4.0, Options(support_level=level)) == pytest.approx(factor)


def test_directional_light_has_length_no_attenuation_and_no_radius() -> None:
    light = Light(kind="directional", direction=(-4.0, 0.0, -3.0), attenuation=(9.0, 9.0, 9.0), radius=0.0)
    check(lit(light), 0.3)


@pytest.mark.parametrize(
    ("radius", "on"), [(4.0, True), (np.nextafter(4.0, 0.0), False), (0.0, False), (math.inf, True)]
)
def test_radius(radius: float, on: bool) -> None:
    check(lit(Light(location=(0.0, 0.0, 4.0), radius=radius)), 0.5 if on else 0.0)


def test_off_and_out_of_scope_lights_are_not_read() -> None:
    nothing = Light(location=(math.nan,) * 3, intensity=math.inf, color=(math.nan,) * 3, radius=math.nan)
    for switches in ({"on": False}, {"in_scope": False}):
        check(Case(UP, PLAIN, (Light(**{**nothing.__dict__, **switches}), ABOVE)), 0.5)


def test_support_levels() -> None:
    overhead = Light(kind="directional", in_scope=False)
    spot = Light(kind="spot", location=(0.0, 0.0, 4.0))
    levels: tuple[tuple[Any, float], ...] = ((1, 0.5), (2, 1.5), (3, 1.0))
    for level, rgb in levels:
        check(Case(UP, PLAIN, (overhead, ABOVE, spot), options=Options(support_level=level)), rgb)


@pytest.mark.parametrize(
    ("angle", "beam", "cut_off", "factor"),
    [
        (0.0, 0.2, 0.6, 1.0),
        (0.2, 0.2, 0.6, 1.0),
        (0.3, 0.2, 0.6, 0.75),
        (0.6, 0.2, 0.6, 0.0),
        (2.0, 0.2, 0.6, 0.0),
        (0.5, 0.6, 0.6, 1.0),
        (0.6, 0.6, 0.6, 0.0),
        (0.5, 1.5, 0.6, 1.0),
        (0.7, 1.5, 0.6, 0.0),
    ],
)
def test_spot_factor(angle: float, beam: float, cut_off: float, factor: float) -> None:
    light = Light(kind="spot", beam_width=beam, cut_off_angle=cut_off)
    assert spot_factor(light, angle) == pytest.approx(factor, abs=1e-15)


def test_spot_light_uses_the_true_angle_and_any_length_of_direction() -> None:
    def aimed(direction: Any, **fields: Any) -> Case:
        return lit(Light(kind="spot", location=(0.0, 0.0, 4.0), direction=direction, ambient_intensity=1.0, **fields))

    # 45 degrees off the axis, half-way down a ramp from 0 to 90 degrees; diffuse 0.5, ambient 0.1.
    check(aimed((3.0, 0.0, -3.0), beam_width=1e-300, cut_off_angle=math.pi / 2), 0.3)
    # Behind the light, with a cutOffAngle that float32 rounds above pi / 2.
    check(aimed((0.0, 0.0, 7.0), beam_width=0.5, cut_off_angle=float(np.float32(math.pi / 2))), 0.0)


def test_degenerate_vectors_count_as_zero() -> None:
    shiny = Material(diffuse_color=(0.5,) * 3, specular_color=(1.0,) * 3, shininess=1 / 128)
    at_sample = Light(location=(0.0, 0.0, 0.0))
    check(lit(at_sample, shiny), 1.0)  # L = 0: no diffuse term, H = V
    check(Case(sample(eye=(0.0, 0.0, 0.0)), shiny, (TILTED,)), 0.5 * 0.6 + 0.6)  # V = 0: H = L
    check(Case(sample(normal=(0.0, 0.0, 0.0)), shiny, (ABOVE,)), 0.0)
    check(Case(sample(eye=(0.0, 0.0, -9.0)), shiny, (ABOVE,)), 0.5)  # L + V = 0
    check(lit(Light(kind="spot", location=(0.0, 0.0, 4.0), direction=(0.0, 0.0, 0.0))), 0.0)
    check(lit(Light(kind="directional", direction=(0.0, 0.0, 0.0)), shiny), 1.0)


# --- frames -----------------------------------------------------------------------------------------------------------

# x' = 2 x + 1, y' = y, z' = 4 z: non-uniform.
STRETCH = ((2.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 4.0, 0.0))


def test_light_frame_moves_the_light_and_measures_distance_in_it() -> None:
    # In the world at (4, 0, 3): N.L = 0.6. In its own frame the sample is at (-0.5, 0, 0), the light at (1.5, 0, 0.75).
    light = Light(location=(1.5, 0.0, 0.75), frame=STRETCH, attenuation=(0.0, 1.0, 0.0))
    d = math.hypot(2.0, 0.75)
    check(lit(light), 0.5 * 0.6 / d)
    for radius, on in ((d, True), (math.nextafter(d, 0.0), False)):
        inside = Light(**{**light.__dict__, "radius": radius})
        check(lit(inside), 0.3 / d if on else 0.0)


def test_directions_turn_with_the_frame() -> None:
    # (-2, 0, -0.375) becomes (-4, 0, -1.5); a translation does not touch it.
    light = Light(kind="directional", direction=(-2.0, 0.0, -0.375), frame=STRETCH)
    check(lit(light), 0.5 * 1.5 / math.hypot(4.0, 1.5))


@pytest.mark.parametrize(
    ("fog_type", "visibility", "frame", "f0"),
    [
        ("LINEAR", 20.0, None, 0.5),
        ("LINEAR", 10.0, None, 0.0),
        ("LINEAR", 5.0, None, 0.0),
        ("LINEAR", 0.0, None, 1.0),
        ("LINEAR", -3.0, None, 1.0),
        ("EXPONENTIAL", 20.0, None, math.exp(-1.0)),
        ("EXPONENTIAL", 12.5, None, math.exp(-4.0)),
        ("EXPONENTIAL", 10.0, None, 0.0),
        ("EXPONENTIAL", 0.0, None, 1.0),
        ("LINEAR", 20.0, STRETCH, 0.875),  # 10 along z are 2.5 in the fog's system
        ("EXPONENTIAL", 5.0, STRETCH, math.exp(-1.0)),
    ],
)
def test_fog(fog_type: Any, visibility: float, frame: Any, f0: float) -> None:
    fog = Fog(color=(1.0, 0.5, 0.0), fog_type=fog_type, visibility_range=visibility, frame=frame)
    rgb = np.array(fog.color) * (1 - f0) + f0 * 0.5
    check(Case(UP, Material(diffuse_color=(0.5,) * 3, transparency=0.5), (ABOVE,), fog), rgb, 0.5)
    half = sample((0.5, 0.5, 0.5))
    check(Case(half, None, (), fog), rgb)
    check(Case(half, None, (), fog, Options(fog_unlit=False)), 0.5)


def test_lights_add_up_and_nothing_clamps() -> None:
    check(Case(UP, Material(diffuse_color=(1.0,) * 3), (ABOVE, ABOVE, TILTED)), 2.6)


def test_brightest_bounds_the_answer() -> None:
    case = Case(UP, Material(diffuse_color=(1.0,) * 3), (ABOVE, ABOVE, TILTED))
    np.testing.assert_allclose(brightest(case), 3.0)


def test_wrong_texel_is_refused() -> None:
    with pytest.raises(ValueError, match="1 to 4 numbers, got 5"):
        shade(Case(sample(None, (0.0,) * 5), None))
