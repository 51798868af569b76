"""The lighting equation over a `Tape`: VRML97 4.14 and X3D 17.2.2, written separately from `equation`.

The numbers in brackets are those of the project's table of readings.
"""

from __future__ import annotations

from mpmath import mp, mpf

from .case import Fog, Light, Material
from .dual import Dual, Vector, dot, minus, plus, times
from .paths import is_live
from .tape import Kind, Tape, angle_between, exp, exp_minus_one, length_slopes, log, sum_slopes


def shade(tape: Tape) -> tuple[Dual, Dual, Dual, Dual]:
    """Red, green, blue, alpha."""
    case, material = tape.case, tape.case.material
    if case.line_or_point and material is not None:  # [24]
        own = case.sample.color is not None
        color = tape.vector("sample", "color") if own else tape.vector("material", "emissive_color")
        alpha = opacity(tape, material)
    else:
        color, alpha = base_color(tape, material)
        if material is not None:
            color = lit(tape, color)
    is_lit = material is not None and not case.line_or_point
    if case.fog is not None and (is_lit or case.options.fog_unlit):  # [4]
        color = fogged(tape, color, case.fog)
    return (*color, alpha)


# --- colour tables ----------------------------------------------------------------------------------------------------


def opacity(tape: Tape, material: Material | None) -> Dual:
    """Per-vertex alpha [25], or 1 - T_M, or 1."""
    color = tape.case.sample.color
    if color is not None and len(color) == 4:
        return tape.number("sample", "color", 3)
    return tape.constant(1) if material is None else 1 - tape.number("material", "transparency")


def base_color(tape: Tape, material: Material | None) -> tuple[Vector, Dual]:
    """Tables 17.2 (no material: the colour itself) and 17.3 (the diffuse factor) [1, 2, 3]."""
    sample, modulate = tape.case.sample, tape.case.options.texture_mode == "modulate"
    white = (tape.constant(1), tape.constant(1), tape.constant(1))
    texel = [tape.number("sample", "texel", i) for i in range(len(sample.texel or ()))]
    alpha = opacity(tape, material)
    if len(texel) in (2, 4):
        alpha = texel[-1] * alpha if modulate else texel[-1]
    if len(texel) in (3, 4) and not modulate:
        return (texel[0], texel[1], texel[2]), alpha
    if sample.color is not None:
        surface = tape.vector("sample", "color")
    else:
        surface = white if material is None else tape.vector("material", "diffuse_color")
    match len(texel):
        case 0:
            return surface, alpha
        case 1 | 2:
            return times(surface, texel[0]), alpha
    return (texel[0] * surface[0], texel[1] * surface[1], texel[2] * surface[2]), alpha


# --- the equation (17.2.2.4) ------------------------------------------------------------------------------------------


def lit(tape: Tape, o_d: Vector) -> Vector:
    """O_E + SUM(on x attenuation x spot x I_L x (ambient + diffuse + specular))."""
    total = tape.vector("material", "emissive_color")
    for i, light in enumerate(tape.case.lights):
        contribution = light_contribution(tape, i, light, o_d) if is_live(light, tape.case.options) else None
        total = total if contribution is None else plus(total, contribution)
    return total


def light_contribution(tape: Tape, i: int, light: Light, o_d: Vector) -> Vector | None:
    """One light's part of the sum; None beyond its radius."""
    owner = ("lights", i)
    factor = tape.constant(1)
    if light.kind == "directional":
        toward = times(tape.to_world(owner, light, tape.vector(*owner, "direction")), -1)
    else:
        reach = attenuation(tape, i, light)
        if reach is None:
            return None
        factor = reach
        position = tape.world_offset(owner, light, tape.vector("sample", "position"))
        toward = minus(tape.to_world(owner, light, tape.vector(*owner, "location")), position)
    if light.kind == "spot":
        axis = tape.to_world(owner, light, tape.vector(*owner, "direction"))
        factor = factor * spot(tape, i, times(toward, -1), axis)
    n_l, power = dots(tape, i, toward)
    ambient = tape.number(*owner, "ambient_intensity") * tape.number("material", "ambient_intensity")
    intensity = tape.number(*owner, "intensity")
    on_diffuse = factor * (ambient + intensity * n_l)  # the ambient term without intensity [29]
    on_specular = factor * (intensity * power)
    o_s = tape.vector("material", "specular_color")
    color = tape.vector(*owner, "color")
    r, g, b = (color[c] * (on_diffuse * o_d[c] + on_specular * o_s[c]) for c in range(3))
    return r, g, b


def attenuation(tape: Tape, i: int, light: Light) -> Dual | None:
    """1 / max(c1 + c2 d + c3 d^2, 1) [20], d_L in the light's coordinate system [10]; None beyond radius [9, 28]."""
    owner = ("lights", i)
    position = tape.world_offset(owner, light, tape.vector("sample", "position"))
    offset = minus(tape.to_local(owner, light, position), tape.vector(*owner, "location"))
    d = tape.distance(f"lights[{i}].distance", offset)
    radius = tape.number(*owner, "radius")
    slopes = sum_slopes(length_slopes(offset), radius.gradient)
    if not tape.decide(f"lights[{i}].radius", "jump", radius.value - d.value, slopes, at_tie=True):
        return None
    c = tape.vector(*owner, "attenuation")
    total = c[0] + c[1] * d
    if tape.case.options.support_level == 3:  # level 2: linear [22]
        total = total + c[2] * (d * d)
    return total.reciprocal() if tape.compare(f"lights[{i}].attenuation", "kink", total - 1) else tape.constant(1)


def spot(tape: Tape, i: int, from_light: Vector, axis: Vector) -> Dual:
    """Table 17.4 on the true angle [12, 13]; acos(0) where a vector is zero [19]."""
    owner = ("lights", i)
    a = tape.length(f"lights[{i}].to_light", "jump", from_light)
    b = tape.length(f"lights[{i}].axis", "jump", axis)
    cut_off, beam = tape.number(*owner, "cut_off_angle"), tape.number(*owner, "beam_width")
    angle, slopes = tape.constant(mp.pi / 2), {}
    if a is not None and b is not None:
        angle = angle_between(from_light, axis)
        slopes = sum_slopes(length_slopes(from_light, 1 / a.value), length_slopes(axis, 1 / b.value))
    ramp = beam.value < cut_off.value
    kind: Kind = "kink" if ramp else "jump"
    margin = cut_off.value - angle.value
    if not tape.decide(f"lights[{i}].cut_off", kind, margin, sum_slopes(slopes, cut_off.gradient)):
        return tape.constant(0)
    margin = angle.value - beam.value
    if ramp and tape.decide(f"lights[{i}].beam", "kink", margin, sum_slopes(slopes, beam.gradient)):
        return (angle - cut_off) / (beam - cut_off)
    return tape.constant(1)


def dots(tape: Tape, i: int, toward: Vector) -> tuple[Dual, Dual]:
    """N.L and (N.H)^(128 shininess), both with the modified dot product; an undefined unit vector is 0 [19]."""
    n = tape.vector("sample", "normal")
    to_eye = minus(tape.vector("sample", "eye"), tape.vector("sample", "position"))
    size_n = tape.length("normal", "jump", n)
    units = []
    for name, vector in ((f"lights[{i}].to_light", toward), ("to_eye", to_eye)):
        size = tape.length(name, "jump", vector)
        units.append(None if size is None else (vector, size.reciprocal()))
    none = tape.constant(0)
    half: Vector = (none, none, none)
    for unit in units:
        half = half if unit is None else plus(half, times(*unit))
    if max(abs(side.value) for side in half) < mpf(10) ** (10 - mp.dps):
        half = times(half, 0)  # the exact sum is zero: what is left is rounding
    size_h = tape.length(f"lights[{i}].half", "jump", half, rounding=True)
    tape.needs_more_digits |= size_h is not None and size_h.value < mpf(10) ** -20
    n_l, n_h = none, none
    if size_n is not None and units[0] is not None:
        n_l = dot(n, toward) * units[0][1] / size_n
    if size_n is not None and size_h is not None:
        # Added up by vectors, so that a sum that is exactly zero comes out as zero.
        along = [dot(n, vector) * inverse for vector, inverse in (unit for unit in units if unit is not None)]
        n_h = sum(along[1:], along[0]) / (size_n * size_h)
    gate = tape.case.options.specular_gate  # [16]
    positive = tape.compare(f"lights[{i}].n_l", "jump" if gate else "kink", n_l)
    power = none if gate and not positive else modified_power(tape, i, n_h)
    return (n_l if positive else none), power


def modified_power(tape: Tape, i: int, base: Dual) -> Dual:
    """max(base, 0)^(128 shininess); 0^0 = 1 [17]."""
    exponent = tape.number("material", "shininess") * 128
    n, x = exponent.value, base.value
    # Below exponent 1 the power meets zero with an infinite slope. Above it derivatives at zero have no condition: they
    # are 0, with n x^(n-1) and x^n log x just beside.
    tape.decide(f"lights[{i}].power at 0", "cone", x, base.gradient, exponent=n)
    positive = tape.compare(f"lights[{i}].n_h", "kink", base) if n == 1 else x > 0
    if positive and x > 0:
        power = exp(exponent * log(base))
        kept = tape.decide(f"lights[{i}].power", "underflow", power.value, {})
        return power if kept else tape.constant(0)
    if positive and n == 1:
        return base
    if n < 1 and (positive or x == 0):
        tape.singular.update({**base.gradient, **exponent.gradient})  # infinite slopes from inside
    return tape.constant(1 if n == 0 else 0)


def fogged(tape: Tape, color: Vector, fog: Fog) -> Vector:
    """I_F (1 - f0) + f0 color, table 17.5, d_V in the fog's coordinate system [5, 7]."""
    visibility = tape.number("fog", "visibility_range")
    if not tape.compare("fog.visibility", "jump", visibility):
        return color
    to_eye = minus(tape.vector("sample", "eye"), tape.vector("sample", "position"))
    offset = tape.to_local(("fog",), fog, to_eye)
    d = tape.distance("fog.distance", offset)
    margin = visibility.value - d.value
    within = margin > 0
    if fog.fog_type == "LINEAR":
        slopes = sum_slopes(length_slopes(offset), visibility.gradient)
        within = tape.decide("fog.range", "kink", margin, slopes)
    haze = tape.vector("fog", "color")
    if not within:
        return haze
    if fog.fog_type == "LINEAR":
        f0, lost = (visibility - d) / visibility, d / visibility
    else:
        exponent = -(d / (visibility - d))
        f0, lost = exp(exponent), -exp_minus_one(exponent)
    return plus(times(haze, lost), times(color, f0))  # 1 - f0 in its own right: it may be far below f0's last digit
