"""Random cases from a seed: ordinary scenes, in which nothing is degenerate but everything occurs.

All numbers are float32 numbers, so that float32 and float64 see the same case. Cases come in few shapes (kinds of
lights, textures, options), because what has one shape can be computed together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .case import Case, Fog, Frame, Light, Material, Options, Sample, Vec
from .fast_exact import values

CASES_PER_SHAPE = 256
KINDS = ("directional", "point", "spot")


def random_cases(seed: int, count: int) -> list[Case]:
    """`count` cases; almost all well-conditioned, none chosen by its answer."""
    rng = np.random.default_rng([seed, 1])
    shapes = max(12, count // CASES_PER_SHAPE)
    cases: list[Case] = []
    for i in range(shapes):
        shape = _random_shape(rng, i)
        own = count // shapes + (i < count % shapes)
        cases += [fill(rng, shape, f"random(seed={seed})[{len(cases) + k}]") for k in range(own)]
    return cases


def random_block(seed: int, block: int, count: int, shapes: int = 12) -> list[Case]:
    """As `random_cases`, in numbered blocks that all have the same few shapes, so that few programs are compiled."""
    rng = np.random.default_rng([seed, 1])
    drawn = [_random_shape(rng, i) for i in range(shapes)]
    rng = np.random.default_rng([seed, 3, block])
    return [fill(rng, drawn[i % shapes], f"random:{block}:{i}") for i in range(count)]


def well_conditioned_cases(seed: int, count: int, precision: int = 32) -> list[Case]:
    """`count` random cases that are well-conditioned in this precision (see `condition`)."""
    found: list[Case] = []
    while len(found) < count:
        drawn = random_cases(seed, count)
        found += [case for case, good in zip(drawn, values(drawn, precision).well_conditioned, strict=True) if good]
        seed += 1_000_003
    return found[:count]


def single(*numbers: float | np.floating) -> Vec:
    """The numbers as float32 numbers."""
    return tuple(float(np.float32(x)) for x in numbers)


def _random_shape(rng: np.random.Generator, i: int) -> Case:
    """A template: what there is, with placeholders for numbers. The first twelve shapes are lit, kinds in turn."""
    if i >= 12 and rng.random() < 0.1:
        material, lights = None, ()
    else:
        kinds = [KINDS[i % 3], *rng.choice(KINDS, int(rng.integers(0, 3)))]
        material, lights = Material(), tuple(_light_shape(rng, str(kind)) for kind in kinds)
    kind = ("LINEAR", "EXPONENTIAL")[int(rng.integers(2))]
    return Case(
        sample=Sample(color=_numbers(rng, (0, 3, 4), 0.3), texel=_numbers(rng, (1, 2, 3, 4), 0.4)),
        material=material,
        lights=lights,
        fog=Fog(fog_type=kind, frame=_frame_shape(rng)) if rng.random() < 0.3 else None,
        options=Options(
            texture_mode="modulate" if rng.random() < 0.3 else "replace",
            fog_unlit=bool(rng.random() < 0.8),
            specular_gate=bool(rng.random() < 0.15),
            support_level=int(rng.choice([1, 2, 3], p=[0.05, 0.1, 0.85])),
        ),
        line_or_point=bool(rng.random() < 0.05),
    )


def _light_shape(rng: np.random.Generator, kind: str) -> Light:
    on, in_scope = rng.random(2) < 0.95
    return Light(kind=kind, on=bool(on), in_scope=bool(in_scope), frame=_frame_shape(rng))


def _frame_shape(rng: np.random.Generator) -> Frame | None:
    row = (0.0, 0.0, 0.0, 0.0)
    return (row, row, row) if rng.random() < 0.25 else None


def _numbers(rng: np.random.Generator, counts: tuple[int, ...], share: float) -> Vec | None:
    count = int(rng.choice(counts)) if rng.random() < share else 0
    return (0.0,) * count or None


def fill(rng: np.random.Generator, shape: Case, label: str) -> Case:
    """The template with random numbers."""
    position = rng.uniform(-3, 3, 3)
    lights = tuple(_fill_light(rng, light, position) for light in shape.lights)
    normal = unit_vector(rng)
    eye = position + unit_vector(rng) * rng.uniform(1, 10)
    if rng.random() < 0.8 and np.dot(normal, eye - position) < 0:
        normal = -normal
    if rng.random() < 0.5:
        normal = normal * 10 ** rng.uniform(-2, 2)
    sample, fog = shape.sample, shape.fog
    return Case(
        sample=Sample(
            position=single(*position),
            normal=single(*normal),
            eye=single(*eye),
            color=None if sample.color is None else _unit_interval(rng, len(sample.color)),
            texel=None if sample.texel is None else _unit_interval(rng, len(sample.texel)),
        ),
        material=None if shape.material is None else random_material(rng),
        lights=lights,
        fog=None
        if fog is None
        else Fog(
            color=_unit_interval(rng, 3),
            fog_type=fog.fog_type,
            visibility_range=single(rng.uniform(2, 40))[0],
            frame=None if fog.frame is None else random_frame(rng),
        ),
        options=shape.options,
        line_or_point=shape.line_or_point,
        label=label,
    )


def random_material(rng: np.random.Generator) -> Material:
    """A Material, its fields in [0, 1], now and then at an end."""
    return Material(
        ambient_intensity=_unit_interval(rng, 1)[0],
        diffuse_color=_unit_interval(rng, 3),
        emissive_color=_unit_interval(rng, 3) if rng.random() < 0.4 else (0.0, 0.0, 0.0),
        shininess=_unit_interval(rng, 1)[0],
        specular_color=_unit_interval(rng, 3),
        transparency=single(rng.uniform(0, 0.99))[0],
    )


def random_light(rng: np.random.Generator, kind: str, position: Sequence[float] | np.ndarray) -> Light:
    """A light that usually reaches the position, in world coordinates."""
    return _fill_light(rng, Light(kind=kind), position)


def _fill_light(rng: np.random.Generator, shape: Light, position: Sequence[float] | np.ndarray) -> Light:
    location = np.asarray(position) + unit_vector(rng) * rng.uniform(0.5, 8)
    aim = np.asarray(position) - location + rng.normal(0, 1.0, 3)
    direction = aim if rng.random() < 0.5 else aim / np.linalg.norm(aim)
    frame = None if shape.frame is None else random_frame(rng)
    if frame is not None:
        local = np.linalg.inv(np.array(frame)[:, :3])
        location, direction = local @ (location - np.array(frame)[:, 3]), local @ direction
    attenuation = [(1.0, 0.0, 0.0), (0.0, 0.0, 0.0), tuple(rng.uniform(0, 1, 3)), (1.0, rng.uniform(0, 1), 0.0)]
    beam, cut_off = rng.uniform(0.05, 1.5, 2)
    return Light(
        kind=shape.kind,
        ambient_intensity=_unit_interval(rng, 1)[0],
        attenuation=single(*attenuation[int(rng.choice(4, p=[0.3, 0.05, 0.45, 0.2]))]),
        beam_width=single(min(beam, cut_off) if rng.random() < 0.8 else beam)[0],
        color=_unit_interval(rng, 3),
        cut_off_angle=single(max(beam, cut_off))[0],
        direction=single(*direction),
        intensity=_unit_interval(rng, 1)[0],
        location=single(*location),
        radius=single(rng.choice([100.0, 1e30, rng.uniform(2, 20)]))[0],
        on=shape.on,
        in_scope=shape.in_scope,
        frame=frame,
    )


def random_frame(rng: np.random.Generator) -> Frame:
    """An affine map with rotation, moderate non-uniform scale and translation."""
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    other, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    linear = rotation @ np.diag(2.0 ** rng.uniform(-1.5, 1.5, 3)) @ other
    x, y, z = (single(*row) for row in np.hstack([linear, rng.uniform(-3, 3, (3, 1))]))
    return x, y, z


def unit_vector(rng: np.random.Generator) -> np.ndarray:
    """A random direction."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def _unit_interval(rng: np.random.Generator, count: int) -> Vec:
    """Numbers in [0, 1]; one in eight is an end."""
    numbers = rng.uniform(0, 1, count)
    ends = rng.random(count)
    return single(*np.where(ends < 0.06, 0.0, np.where(ends < 0.125, 1.0, numbers)))
