"""Singular points met together: whole scenes with several numbers at an extreme, odd frames, scales and dead lights."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .case import Case, Fog, Frame, Light, Material, Options, Sample
from .cases import KINDS, fill, random_frame, random_light, random_material, single, unit_vector
from .families import FAMILIES
from .paths import float_paths, get, put
from .setting import HALF_PI, TINY, Point, Rng, Setting, family, moving

__all__ = ["FAMILIES"]

PLACED: Frame = ((0.0,) * 4,) * 3
"""Stands for a frame that is drawn later."""
SCENES = (
    Case(
        sample=Sample(color=(0.0,) * 4, texel=(0.0, 0.0)),
        lights=(Light("spot", frame=PLACED), Light("directional"), Light("point", frame=PLACED)),
        fog=Fog(fog_type="EXPONENTIAL", frame=PLACED),
    ),
    Case(
        sample=Sample(texel=(0.0,) * 4),
        lights=(Light("spot"), Light("point")),
        fog=Fog(fog_type="LINEAR"),
        options=Options(texture_mode="modulate", specular_gate=True),
    ),
    Case(lights=(Light("directional", frame=PLACED), Light("spot", frame=PLACED)), fog=Fog(frame=PLACED)),
)
"""Few shapes, so that few programs are compiled."""

SMALL = (0.0, TINY, 1.2e-38, 1e-30, 1e-20, 1e-7)
LARGE = (1e7, 1e20, 1e30, 1e37)
EXTREMES = {
    "location": (*SMALL, *LARGE),
    "eye": (*SMALL, *LARGE),
    "position": (*SMALL, 1e7, 1e20),
    "normal": (*SMALL, *LARGE),
    "direction": (*SMALL, *LARGE),
    "attenuation": (*SMALL, *LARGE),
    "intensity": (*SMALL, 1e7),
    "radius": (*SMALL, *LARGE, math.inf),
    "visibility_range": (*SMALL, *LARGE, -1.0),
    "beam_width": (0.0, TINY, 1e-20, 1e-7, HALF_PI),
    "cut_off_angle": (1e-20, 1e-7, 1e-3, HALF_PI),
    "shininess": (0.0, TINY, 1e-20, 1e-4, 1 / 128, 1.0, 8.0),
}
"""By field; the others are colours and shares."""


@family
def crowded(rng: Rng) -> Point:
    """A whole scene, one to four of its numbers at an extreme."""
    case = fill(rng, SCENES[int(rng.integers(len(SCENES)))], "")
    paths = [path for path in float_paths(case) if "frame" not in path]
    for _ in range(int(rng.integers(1, 5))):
        path = paths[int(rng.integers(len(paths)))]
        name = next(step for step in reversed(path) if isinstance(step, str))
        value = float(rng.choice(EXTREMES.get(name, (0.0, TINY, 1e-30, 1.0))))
        if name in ("location", "eye", "position", "normal", "direction"):
            value = math.copysign(value, get(case, path))
        case = put(case, path, single(value)[0])
    return case, paths[int(rng.integers(len(paths)))]


@family
def scaled_scene(rng: Rng) -> Point:
    """A whole scene in very small or very large units."""
    case = fill(rng, SCENES[1], "")
    size = 10.0 ** rng.uniform(-36, 36)
    assert case.fog is not None

    def times(vector: tuple[float, ...]) -> tuple[float, ...]:
        return single(*(min(size * x, 3e38) for x in vector))

    lights = tuple(
        replace(
            light,
            location=times(light.location),
            radius=times((light.radius,))[0],
            attenuation=single(light.attenuation[0], light.attenuation[1] / size, 0.0),
        )
        for light in case.lights
    )
    sample = replace(case.sample, position=times(case.sample.position), eye=times(case.sample.eye))
    fog = replace(case.fog, visibility_range=times((case.fog.visibility_range,))[0])
    return moving(rng, replace(case, lights=lights, sample=sample, fog=fog), ("lights", 0, "location"))


@family
def odd_frame(rng: Rng) -> Point:
    """Lights and fog in frames that mirror, stretch a thousandfold, or measure in very small or large units."""
    linear = np.array(random_frame(rng))[:, :3]
    linear = linear @ np.diag(10.0 ** rng.uniform(-1.5, 1.5, 3)) if rng.random() < 0.5 else linear
    linear = linear * 10.0 ** float(rng.choice([-12, -6, -3, 0, 3, 6, 12]))
    linear = linear * rng.choice([-1.0, 1.0])
    position, case = rng.uniform(-3, 3, 3), fill(rng, SCENES[2], "")
    frame = tuple(single(*row) for row in np.hstack([linear, rng.uniform(-3, 3, (3, 1))]))
    exact = np.array(frame)
    inverse = np.linalg.inv(exact[:, :3])
    place = position + unit_vector(rng) * rng.uniform(0.5, 8)
    aim = inverse @ (position - place + rng.normal(0, 0.5, 3))
    spot = replace(case.lights[1], location=single(*(inverse @ (place - exact[:, 3]))), direction=single(*aim))
    spot = replace(spot, frame=frame, radius=single(3e38)[0], attenuation=single(1.0, 0.1 / np.linalg.norm(aim), 0.0))
    sun = replace(case.lights[0], direction=single(*aim), frame=frame)
    eye = position + unit_vector(rng) * rng.uniform(1, 10)
    assert case.fog is not None
    far = np.linalg.norm(inverse @ (eye - position))
    fog = replace(case.fog, frame=frame, visibility_range=single(far * rng.uniform(0.5, 3))[0])
    sample = replace(case.sample, position=single(*position), eye=single(*eye))
    case = replace(case, lights=(sun, spot), fog=fog, sample=sample)
    return moving(rng, case, ("lights", 1, "location"))


@family
def corners(rng: Rng) -> Point:
    """N.L = 0, the edge of the cone and the end of the fog in one sample, in any combination."""
    kind = str(rng.choice(["point", "spot"]))
    setting = Setting(rng)
    normal = (0.0, 1.0, 1.0) if rng.random() < 0.5 else (1.0, 1.0, 0.0)
    to_eye = ((1.0, 2.0, 2.0), (-1.0, -1.0, 1.0), (2.0, -1.0, 1.0))[int(rng.integers(3))]
    case = setting.case(
        kind=kind,
        normal=normal,
        to_light=(1.0, 1.0, -1.0),
        to_eye=to_eye,
        direction=((0.0, 1.0, 1.0), (-1.0, -1.0, 1.0), (-1.0, -1.0, 0.5))[int(rng.integers(3))],
        cut_off_angle=HALF_PI,
        beam_width=float(rng.choice([0.0, 0.5, HALF_PI])),
        attenuation=((1.0, 0.0, 0.0), (0.25, 0.25, 0.0), (0.0, 0.0, 0.0))[int(rng.integers(3))],
        material=replace(random_material(rng), shininess=float(rng.choice([0.0, 1 / 128, 0.25, 1.0]))),
    )
    length = float(np.linalg.norm(to_eye))
    fog_type = "LINEAR" if rng.random() < 0.5 else "EXPONENTIAL"
    fog = Fog(single(*rng.uniform(0, 1, 3)), fog_type, single(length * rng.choice([1.0, 1.001, 2.0]))[0])
    paths = [("sample", "normal"), ("sample", "eye"), ("lights", 0, "location"), ("sample", "position")]
    return moving(rng, replace(case, fog=fog), paths[int(rng.integers(4))])


@family
def dead_lights_everywhere(rng: Rng) -> Point:
    """Lights of every kind, frames included, that are off or out of scope and hold no numbers."""
    bad = float(rng.choice([math.nan, math.inf]))
    three = (bad, bad, bad)
    row = (bad, bad, bad, bad)
    dead = [
        Light(kind, bad, three, bad, three, bad, three, bad, three, bad, on=on, in_scope=False, frame=(row, row, row))
        for kind, on in (("directional", False), ("point", True), ("spot", False), ("spot", True))
    ]
    position = rng.uniform(-2, 2, 3)
    alive = [random_light(rng, kind, position) for kind in KINDS]
    case = Setting(rng, origin=np.array(single(*position))).case()
    return replace(case, lights=(*dead[:2], *alive, *dead[2:])), None


@family
def strong_light(rng: Rng) -> Point:
    """Intensities far beyond 1, on highlights of every width."""
    case = Setting(rng).case(kind=str(rng.choice(KINDS)))
    light = replace(case.lights[0], intensity=single(10.0 ** rng.uniform(0, 6))[0], ambient_intensity=1.0)
    material = replace(case.material or Material(), shininess=single(10.0 ** rng.uniform(-3, 0))[0])
    return moving(rng, replace(case, lights=(light,), material=material), ("sample", "normal"))
