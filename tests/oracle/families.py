"""The singular points of the lighting equation, one function a family: each call draws a case at such a point.

A function returns the case and the path of the number that the neighbouring cases move (None: it has none).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .case import Fog, Light, Material, Options, Vec
from .cases import KINDS, single, unit_vector
from .setting import (
    DIRECTION,
    EYE,
    FAMILIES,
    HALF_PI,
    LOCATION,
    NORMAL,
    POSITION,
    SIZES,
    TINY,
    Point,
    Rng,
    Setting,
    family,
    leaning,
    moving,
    shiny,
    sized,
)

__all__ = ["FAMILIES"]

# --- vectors ----------------------------------------------------------------------------------------------------------


@family
def vector_size(rng: Rng) -> Point:
    """One vector tiny or huge."""
    size = float(rng.choice(SIZES))
    which, kind = [("normal", "point"), ("direction", "directional"), ("direction", "spot")][int(rng.integers(3))]
    setting = Setting(rng)
    if which == "normal":
        return moving(rng, setting.case(kind=kind, normal=sized(rng, size)), NORMAL)
    direction = (np.array([-1.0, -2.0, -2.0]) + rng.uniform(-1, 1, 3)) / 3 * size
    return moving(rng, setting.case(kind=kind, direction=direction), DIRECTION)


@family
def distance_size(rng: Rng) -> Point:
    """The light or the viewer very near or very far."""
    vector = np.array(sized(rng, float(rng.choice(SIZES))))
    setting = Setting(rng, placed=False)
    kind = str(rng.choice(["point", "spot"]))
    if rng.random() < 0.6:
        vector[2] = abs(vector[2])
        return moving(rng, setting.case(kind=kind, to_light=vector), LOCATION)
    return moving(rng, setting.case(kind=kind, to_eye=vector), EYE)


@family
def zero_vector(rng: Rng) -> Point:
    """Normal, direction, light offset or viewer offset exactly zero."""
    setting, zero = Setting(rng), (0.0, 0.0, 0.0)
    kind = str(rng.choice(["point", "spot"]))
    match int(rng.integers(5)):
        case 0:
            return setting.case(kind=kind, normal=zero), None
        case 1:
            return setting.case(kind=str(rng.choice(["directional", "spot"])), direction=zero), None
        case 2:
            return moving(rng, setting.case(kind=kind, to_light=zero, direction=(0.0, 0.0, -1.0)), LOCATION)
        case 3:
            return moving(rng, setting.case(kind=kind, to_eye=zero), EYE)
    return setting.case(kind=kind, to_light=zero, to_eye=zero, direction=(0.0, 0.0, -1.0)), None


@family
def opposite_light_and_viewer(rng: Rng) -> Point:
    """L = -V: there is no half vector."""
    toward = rng.integers(1, 8, 3) / 4.0
    normal = unit_vector(rng) if rng.random() < 0.5 else np.array([toward[1], -toward[0], 0.0])
    material = shiny(rng, float(rng.choice([0.0, 0.01, 0.2, 1.0])))
    case = Setting(rng).case(
        to_light=toward, to_eye=-toward * 2.0 ** rng.integers(-1, 3), normal=normal, material=material
    )
    return moving(rng, case, EYE)


@family
def far_from_the_origin(rng: Rng) -> Point:
    """Positions of 10^6."""
    setting = Setting(rng, origin=np.array(single(*rng.uniform(-1e6, 1e6, 3))))
    vectors = [
        np.array(single(*(setting.origin + unit_vector(rng) * rng.uniform(2, 20)))) - setting.origin for _ in range(2)
    ]
    kind = str(rng.choice(["point", "spot"]))
    case = setting.case(kind=kind, normal=unit_vector(rng))
    light = replace(case.lights[0], location=single(*(setting.origin + vectors[0])), direction=single(*-vectors[0]))
    sample = replace(case.sample, eye=single(*(setting.origin + vectors[1])))
    return moving(rng, replace(case, sample=sample, lights=(light,)), POSITION)


@family
def any_length(rng: Rng) -> Point:
    """Normals and directions that are not normalised."""
    case = Setting(rng).case(
        kind=str(rng.choice(["directional", "spot"])),
        normal=(unit_vector(rng) + np.array([0, 0, 1])) * 10 ** rng.uniform(-6, 6),
        direction=(unit_vector(rng) - np.array([1, 2, 2])) * 10 ** rng.uniform(-6, 6),
    )
    return moving(rng, case, NORMAL if rng.random() < 0.5 else DIRECTION)


# --- surface ----------------------------------------------------------------------------------------------------------


@family
def grazing_light(rng: Rng) -> Point:
    """N.L = 0, with and without the gate of the specular term."""
    gate = bool(rng.random() < 0.3)
    kind = "point" if gate else str(rng.choice(KINDS))
    case = Setting(rng).case(kind=kind, normal=(0.0, 1.0, 1.0), to_light=(1.0, 1.0, -1.0))
    case = replace(case, options=Options(specular_gate=gate))
    return moving(rng, case, NORMAL)


@family
def grazing_half_vector(rng: Rng) -> Point:
    """N.H = 0 with shininess 0, tiny, at exponent 1 and above."""
    shininess = float(rng.choice([0.0, 0.0, 1e-30, 1e-6, 1e-3, 0.5 / 128, 1 / 128, 1.5 / 128, 0.02, 1.0]))
    case = Setting(rng).case(
        kind=str(rng.choice(KINDS)),
        normal=(0.0, 1.0, 1.0),
        to_light=(1.0, 1.0, -1.0),
        to_eye=(2.0, -1.0, 1.0),
        material=shiny(rng, shininess),
    )
    return moving(rng, case, NORMAL)


@family
def highlight_peak(rng: Rng) -> Point:
    """Large exponents with H at, and a small angle from, N."""
    setting, normal, aside = Setting(rng, placed=False), unit_vector(rng), unit_vector(rng)
    tilt = rng.uniform(0, 1)
    off = float(rng.choice([0.0, 1e-7, 1e-5, 1e-4, 1e-3, 1e-2, 0.1]))
    to_light = leaning(normal, aside, tilt + off) * rng.uniform(1, 4)
    to_eye = leaning(normal, aside, off - tilt) * rng.uniform(1, 4)
    case = setting.case(
        kind=str(rng.choice(KINDS)),
        normal=normal,
        to_light=to_light,
        to_eye=to_eye,
        material=shiny(rng, float(rng.choice([1.0, 1.0, 0.9, 0.5]))),
    )
    return moving(rng, case, NORMAL)


@family
def field_ends(rng: Rng) -> Point:
    """Fields at the ends of their ranges."""

    def end(count: int) -> Vec:
        return tuple(float(x) for x in rng.integers(0, 2, count))

    case = Setting(rng).case(kind=str(rng.choice(KINDS)))
    material = Material(*(end(1)[0], end(3), end(3), float(rng.choice([0.0, 1.0])), end(3), end(1)[0]))
    light = replace(case.lights[0], intensity=end(1)[0], ambient_intensity=end(1)[0], color=end(3))
    return replace(case, material=material, lights=(light,)), None


# --- lights -----------------------------------------------------------------------------------------------------------


@family
def spot_axis(rng: Rng) -> Point:
    """A spot angle at or near 0, in wide and in very narrow cones."""
    setting = Setting(rng, placed=False)
    beam = float(rng.choice([1e-6, 1e-3, 0.1, 1.0]))
    toward = unit_vector(rng)
    angle = float(rng.choice([0.0, 0.3, 0.9, 1.5, 1.999])) * beam
    aim = -leaning(toward, unit_vector(rng), angle)
    beams = single(beam, min(2 * beam, HALF_PI))
    case = setting.case(
        kind="spot",
        to_light=toward * 2.0 ** rng.integers(-3, 4),
        direction=aim,
        beam_width=beams[0],
        cut_off_angle=beams[1],
    )
    return moving(rng, case, DIRECTION)


@family
def spot_edge(rng: Rng) -> Point:
    """The spot angle at beamWidth, at cutOffAngle, and at cutOffAngle without a ramp."""
    angle = rng.uniform(0.05, 1.5)
    toward = unit_vector(rng)
    case = Setting(rng, placed=False).case(
        kind="spot", to_light=toward, direction=-leaning(toward, unit_vector(rng), angle)
    )
    light = case.lights[0]
    place, axis = -np.array(light.location), np.array(light.direction)
    angle = math.atan2(float(np.linalg.norm(np.cross(place, axis))), float(np.dot(place, axis)))
    at = single(angle)[0]
    beam, cut_off, moved = [
        (at, single(min(angle + 0.3, HALF_PI))[0], "beam_width"),
        (single(angle / 2)[0], at, "cut_off_angle"),
        (HALF_PI, at, "cut_off_angle"),
    ][int(rng.integers(3))]
    return replace(case, lights=(replace(light, beam_width=beam, cut_off_angle=cut_off),)), ("lights", 0, moved)


@family
def spot_right_angle(rng: Rng) -> Point:
    """cutOffAngle pi/2 (in float32 a little more) with the sample beside and behind the light."""
    behind = rng.random() < 0.3
    case = Setting(rng).case(
        kind="spot",
        to_light=(1.0, 1.0, -1.0) if rng.random() < 0.5 else (2.0, 1.0, -1.0),
        direction=(1.0, 1.0, -1.0) if behind else (0.0, 1.0, 1.0),
        normal=unit_vector(rng),
        cut_off_angle=HALF_PI,
        beam_width=float(rng.choice([0.5, single(math.pi / 4)[0], 1.5, HALF_PI])),
    )
    return moving(rng, case, DIRECTION)


@family
def spot_without_ramp(rng: Rng) -> Point:
    """beamWidth = cutOffAngle, with the sample inside, outside and near the edge."""
    width = single(rng.uniform(0.1, 1.5))[0]
    angle = width * float(rng.choice([0.0, 0.5, 1 - 1e-6, 1.0, 1 + 1e-6, 1.5]))
    toward = unit_vector(rng)
    case = Setting(rng, placed=False).case(
        kind="spot",
        to_light=toward,
        direction=-leaning(toward, unit_vector(rng), angle),
        beam_width=width,
        cut_off_angle=width,
    )
    return case, ("lights", 0, "beam_width")


@family
def attenuation_one(rng: Rng) -> Point:
    """c1 + c2 d + c3 d^2 exactly 1; (1, 0, 0) and (0, 0, 0)."""
    coefficients, to_light = [
        ((1.0, 0.0, 0.0), (1.0, 2.0, 2.0)),
        ((0.0, 0.0, 0.0), (1.0, 2.0, 2.0)),
        ((0.25, 0.25, 0.0), (1.0, 2.0, 2.0)),
        ((0.5, 0.25, 0.0), (0.0, 0.0, 2.0)),
        ((0.0, 0.0, 0.25), (0.0, 2.0, 0.0)),
        ((0.375, 0.125, 0.0), (3.0, 0.0, 4.0)),
        ((0.21875, 0.0, 0.03125), (3.0, 0.0, 4.0)),
    ][int(rng.integers(7))]
    case = Setting(rng).case(kind=str(rng.choice(["point", "spot"])), to_light=to_light, attenuation=coefficients)
    return moving(rng, case, ("lights", 0, "attenuation") if rng.random() < 0.5 else LOCATION)


@family
def radius_edge(rng: Rng) -> Point:
    """The sample exactly at the radius, and radius 0."""
    to_light, radius = [
        ((1.0, 2.0, 2.0), 3.0),
        ((3.0, 0.0, 4.0), 5.0),
        ((2.0, 3.0, 6.0), 7.0),
        ((1.0, 2.0, 2.0), 0.0),
        ((0.0, 0.0, 0.0), 0.0),
    ][int(rng.integers(5))]
    case = Setting(rng).case(
        kind=str(rng.choice(["point", "spot"])), to_light=to_light, radius=radius, direction=(-1.0, -2.0, -2.0)
    )
    return case, ("lights", 0, "radius") if radius else None


@family
def dead_light(rng: Rng) -> Point:
    """A light that is off and holds NaN and Inf beside one of its kind that is on."""
    bad = float(rng.choice([math.nan, math.inf, -math.inf, 3e38]))
    three = (bad, bad, bad)
    kind = str(rng.choice(KINDS))
    dead = Light(
        kind=kind,
        ambient_intensity=bad,
        attenuation=three,
        beam_width=bad,
        color=three,
        cut_off_angle=bad,
        direction=three,
        intensity=bad,
        location=three,
        radius=bad,
        on=False,
    )
    case = Setting(rng).case(kind=kind)
    return replace(case, lights=(dead, *case.lights)), None


@family
def subnormal_numbers(rng: Rng) -> Point:
    """Fields and vectors that a processor may flush to zero."""
    case = Setting(rng, placed=False).case(kind=str(rng.choice(KINDS)))
    light, sample, material = case.lights[0], case.sample, case.material
    assert material is not None
    x = single(TINY)[0]
    match int(rng.integers(6)):
        case 0:
            light = replace(light, intensity=x, ambient_intensity=x)
        case 1:
            light = replace(light, color=(x, 1.0, x))
        case 2:
            light = replace(light, attenuation=(x, x, x))
        case 3:
            sample = replace(sample, normal=(x, 1.0, x))
        case 4:
            sample = replace(sample, normal=(x, 2 * x, x))
        case 5:
            material = replace(material, shininess=x, diffuse_color=(x, x, x))
    return replace(case, lights=(light,), sample=sample, material=material), None


# --- fog --------------------------------------------------------------------------------------------------------------


@family
def fog_edge(rng: Rng) -> Point:
    """The viewer at, just before and beyond the visibility."""
    to_eye, distance = [((1.0, 2.0, 2.0), 3.0), ((3.0, 0.0, 4.0), 5.0), ((2.0, 3.0, 6.0), 7.0)][int(rng.integers(3))]
    factor = float(rng.choice([1.0, 1.0, 1.0 + 2.0**-10, 1.0 + 2.0**-16, 0.5, 2.0]))
    return _fogged(rng, to_eye, distance * factor)


@family
def fog_range(rng: Rng) -> Point:
    """Visibility 0, negative, tiny, huge; the viewer at the sample."""
    visibility = float(rng.choice([0.0, -1.0, TINY, 1e-37, 1e-20, 1e20, 1e37]))
    to_eye = (0.0, 0.0, 0.0) if rng.random() < 0.2 else (1.0, 2.0, 2.0)
    case, _ = _fogged(rng, to_eye, visibility)
    return case, None


def _fogged(rng: Rng, to_eye: Vec, visibility: float) -> Point:
    kind = "LINEAR" if rng.random() < 0.5 else "EXPONENTIAL"
    color = single(*rng.uniform(0, 1, 3))
    case = Setting(rng).case(to_eye=to_eye)
    case = replace(case, fog=Fog(color, kind, single(visibility)[0]))
    if rng.random() < 0.2:
        case = replace(case, material=None, lights=())
    return case, ("fog", "visibility_range")
