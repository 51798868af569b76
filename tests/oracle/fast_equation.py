"""The lighting equation over columns of cases (`FastTape`), without branches: both sides, then a selection.

The third writing of VRML97 4.14 / X3D 17.2.2 among the oracles; the numbers in brackets are those of the readings.
"""

from __future__ import annotations

import numpy as np

from .case import Fog, Light
from .dual import Dual, Vector, cross, dot, minus, plus, times
from .fast_tape import WIDE, FastTape, arc_tangent, exp, exp_minus_one, log, safe_reciprocal, select, sum_slopes
from .paths import is_live
from .ulp import underflowing_base

OPPOSITE = 1e-17
"""L + V of this length is rounding: the directions are opposite."""


def shade(tape: FastTape) -> tuple[Dual, Dual, Dual, Dual]:
    """Red, green, blue, alpha of every case."""
    case = tape.case
    surface_lit = case.material is not None and not case.line_or_point
    emissive_line = case.material is not None and case.line_or_point
    alpha = tape.constant(1) if case.material is None else 1 - tape.number("material", "transparency")
    if case.sample.color is not None and len(case.sample.color) == 4:
        alpha = tape.number("sample", "color", 3)  # [25]
    if emissive_line:  # [24]
        color = tape.vector("material", "emissive_color")
        if case.sample.color is not None:
            color = tape.vector("sample", "color")
    else:
        color, alpha = textured(tape, alpha)
    if surface_lit:
        total = tape.vector("material", "emissive_color")
        for i, light in enumerate(case.lights):
            if is_live(light, case.options):
                total = plus(total, contribution(tape, i, light, color))
        color = total
    if case.fog is not None and (surface_lit or case.options.fog_unlit):  # [4]
        color = fogged(tape, case.fog, color)
    return (*color, alpha)


def textured(tape: FastTape, alpha: Dual) -> tuple[Vector, Dual]:
    """Tables 17.2 and 17.3 [1, 2, 3]."""
    sample, modulate = tape.case.sample, tape.case.options.texture_mode == "modulate"
    white = tape.constant(1)
    color: Vector = (white, white, white)
    if tape.case.material is not None:
        color = tape.vector("material", "diffuse_color")
    if sample.color is not None:
        color = tape.vector("sample", "color")
    components = len(sample.texel or ())
    if components in (1, 2):
        color = times(color, tape.number("sample", "texel", 0))
    if components in (3, 4):
        image = tape.vector("sample", "texel")
        color = (image[0] * color[0], image[1] * color[1], image[2] * color[2]) if modulate else image
    if components in (2, 4):
        opaque = tape.number("sample", "texel", components - 1)
        alpha = opaque * alpha if modulate else opaque
    return color, alpha


def contribution(tape: FastTape, i: int, light: Light, o_d: Vector) -> Vector:
    """One light's part of the sum (17.2.2.4)."""
    owner = ("lights", i)
    weight = tape.constant(1)
    if light.kind == "directional":
        toward = times(tape.to_world(owner, light, tape.vector(*owner, "direction")), -1)
    else:
        weight = attenuation(tape, i, light)
        place = tape.to_world(owner, light, tape.vector(*owner, "location"))
        toward = minus(place, tape.world_offset(owner, light, tape.vector("sample", "position")))
    if light.kind == "spot":
        weight = weight * spot(tape, i, light, toward)
    n_l, power = dots(tape, i, toward)
    intensity = tape.number(*owner, "intensity")
    scattered = tape.number(*owner, "ambient_intensity") * tape.number("material", "ambient_intensity")  # [29]
    diffuse, specular = weight * (scattered + intensity * n_l), weight * intensity * power
    tape.active = np.True_
    color, o_s = tape.vector(*owner, "color"), tape.vector("material", "specular_color")
    r, g, b = (color[c] * (diffuse * o_d[c] + specular * o_s[c]) for c in range(3))
    return r, g, b


def attenuation(tape: FastTape, i: int, light: Light) -> Dual:
    """0 beyond the radius [9, 28], else 1 / max(c1 + c2 d + c3 d^2, 1) [20], d in the light's system [10]."""
    owner = ("lights", i)
    position = tape.world_offset(owner, light, tape.vector("sample", "position"))
    offset = minus(tape.to_local(owner, light, position), tape.vector(*owner, "location"))
    radius = tape.number(*owner, "radius")
    d = tape.length("cone", offset)
    margin = radius.value - d.value
    tape.decide("jump", margin, sum_slopes(tape.length_slopes(offset), radius.gradient))
    tape.active = margin >= 0
    c = tape.vector(*owner, "attenuation")
    total = c[0] + d * c[1]
    if tape.case.options.support_level == 3:  # level 2: linear [22]
        total = total + d * d * c[2]
    above = tape.decide("kink", total.value - 1, total.gradient, name=f"lights[{i}].attenuation")
    damped = total.map_value(np.where(above, total.value, WIDE(1))).reciprocal()
    return select(tape.active, select(above, damped, tape.constant(1)), tape.constant(0))


def spot(tape: FastTape, i: int, light: Light, toward: Vector) -> Dual:
    """Table 17.4 on the true angle [12, 13]; pi / 2 where a vector is zero [19]."""
    owner = ("lights", i)
    axis = tape.to_world(owner, light, tape.vector(*owner, "direction"))
    beam, cut_off = tape.number(*owner, "beam_width"), tape.number(*owner, "cut_off_angle")
    size, size_axis = tape.length("jump", toward), tape.length("jump", axis)
    undefined = (size.value == 0) | (size_axis.value == 0)
    normal = cross(toward, axis)
    square = dot(normal, normal)
    aligned = square.value == 0
    root = np.sqrt(np.where(aligned, WIDE(1), square.value))
    sine = square.chain(root, 1 / (2 * root), -1 / (4 * root**3))
    cosine = -dot(toward, axis)
    safe_cosine = cosine.map_value(np.where(aligned, WIDE(1), cosine.value))
    straight = np.where(cosine.value < 0, np.arctan2(WIDE(0), WIDE(-1)), 0)
    angle = select(aligned, Dual(straight), arc_tangent(sine, safe_cosine))
    angle = select(undefined, Dual(np.arctan2(WIDE(1), WIDE(0))), angle)
    safe, safe_axis = (np.where(undefined, WIDE(1), x.value) for x in (size, size_axis))
    slopes = sum_slopes(tape.length_slopes(toward, 1 / safe), tape.length_slopes(axis, 1 / safe_axis))
    ramp = beam.value < cut_off.value
    outer = cut_off.value - angle.value
    outer_slopes = sum_slopes(slopes, cut_off.gradient)
    tape.decide("jump", outer, outer_slopes, where=~ramp)
    lit = tape.decide("kink", outer, outer_slopes, name=f"lights[{i}].cut_off", where=ramp)
    inner_slopes = sum_slopes(slopes, beam.gradient)
    fading = tape.decide("kink", angle.value - beam.value, inner_slopes, name=f"lights[{i}].beam", where=ramp & lit)
    width = beam - cut_off
    slope = (angle - cut_off) * width.map_value(np.where(ramp, width.value, WIDE(-1))).reciprocal()
    return select(lit, select(ramp & fading, slope, tape.constant(1)), tape.constant(0))


def dots(tape: FastTape, i: int, toward: Vector) -> tuple[Dual, Dual]:
    """N.L and (N.H)^(128 shininess), both with the modified dot product; an undefined unit vector is 0 [19]."""
    n = tape.vector("sample", "normal")
    to_eye = minus(tape.vector("sample", "eye"), tape.vector("sample", "position"))
    inverse_n, inverse_l, inverse_v = (safe_reciprocal(tape.length("jump", w)) for w in (n, toward, to_eye))
    half = plus(times(toward, inverse_l), times(to_eye, inverse_v))
    inverse_h = safe_reciprocal(tape.length("jump", half, tiny=OPPOSITE, rounding=True))
    n_l = dot(n, toward) * inverse_l * inverse_n
    n_h = (dot(n, toward) * inverse_l + dot(n, to_eye) * inverse_v) * inverse_h * inverse_n
    none = tape.constant(0)
    gate = tape.case.options.specular_gate  # [16]
    positive = tape.decide("jump" if gate else "kink", n_l.value, n_l.gradient, name=f"lights[{i}].n_l")
    if gate:
        tape.active = tape.active & positive
    apart = minus(times(n, inverse_n), times(half, inverse_h))
    power = modified_power(tape, i, n_h, sum(side.value**2 for side in apart) / 2)
    return select(positive, n_l, none), select(positive, power, none) if gate else power


def modified_power(tape: FastTape, i: int, base: Dual, versine: np.ndarray) -> Dual:
    """max(base, 0)^(128 shininess); 0^0 = 1 [17]. `versine`: 1 - base with all its digits."""
    exponent = tape.number("material", "shininess") * 128
    n, x = exponent.value, base.value
    positive = x > 0
    logarithm = log(base.map_value(np.where(positive, x, WIDE(1))))
    near = positive & (versine < 0.25)
    logarithm = logarithm.map_value(np.where(near, np.log1p(-np.where(near, versine, 0)), logarithm.value))
    power = exp(exponent * logarithm)
    power = tape.underflow(f"lights[{i}].power", power)
    tape.decide("cone", x, base.gradient, room=underflowing_base(n, tape.precision))
    straight = tape.decide("kink", x, base.gradient, name=f"lights[{i}].n_h", where=n == 1)
    beyond = select(n == 1, base, Dual(np.where(n == 0, WIDE(1), WIDE(0))))
    power = select(positive, power, beyond)
    return select((n == 1) & ~straight, tape.constant(0), power)


def fogged(tape: FastTape, fog: Fog, color: Vector) -> Vector:
    """I_F (1 - f0) + f0 color, table 17.5, d_V in the fog's coordinate system [5, 7]."""
    visibility = tape.number("fog", "visibility_range")
    offset = tape.to_local(("fog",), fog, minus(tape.vector("sample", "eye"), tape.vector("sample", "position")))
    present = tape.decide("jump", visibility.value, visibility.gradient)
    d = tape.length("cone", offset, where=present)
    margin = visibility - d
    within = margin.value > 0
    if fog.fog_type == "LINEAR":
        slopes = sum_slopes(tape.length_slopes(offset), visibility.gradient)
        within = tape.decide("kink", margin.value, slopes, name="fog.range", where=present)
        inverse = visibility.map_value(np.where(present, visibility.value, WIDE(1))).reciprocal()
        lost = d * inverse
        f0 = (1 - lost).map_value(margin.value * inverse.value)  # each with all its digits
    else:
        exponent = -(d * margin.map_value(np.where(within, margin.value, WIDE(1))).reciprocal())
        f0, lost = exp(exponent), -exp_minus_one(exponent)
        tape.flushed(f0, present & within)
    none, one = tape.constant(0), tape.constant(1)
    f0 = select(present, select(within, f0, none), one)
    lost = select(present, select(within, lost, one), none)  # 1 - f0: it may be far below f0's last digit
    haze = tape.vector("fog", "color")
    r, g, b = (haze[c] * lost + f0 * color[c] for c in range(3))
    return r, g, b
