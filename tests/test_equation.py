"""The lighting equation against the float64 oracle: every row of the colour tables, field, fog case and reading."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cases_to_scenes import options_of, scene_and_sample, scenes_and_samples, structure
from fit_scenes import precision
from jaxlight import Scene, nodes, shade
from jaxlight.raster import SampleBuffer
from oracle import equation
from oracle.case import Case, Fog, Light, Material, Options, Sample
from oracle.cases import random_cases
from oracle.fast_exact import values

TOLERANCE = {"float64": 1e-12, "float32": 2e-5}
TOGETHER = 16
"""Cases that are evaluated together."""

SAMPLE = Sample(position=(0.25, -0.5, 0.125), normal=(0.25, 0.5, 1.5), eye=(0.5, 1.0, 6.0))
BODY = Material(
    ambient_intensity=0.25,
    diffuse_color=(0.75, 0.5, 0.25),
    emissive_color=(0.0625, 0.03125, 0.125),
    shininess=0.125,
    specular_color=(0.5, 0.625, 0.375),
    transparency=0.25,
)
LAMP = Light(
    kind="point",
    ambient_intensity=0.5,
    attenuation=(0.5, 0.25, 0.0625),
    color=(1.0, 0.75, 0.5),
    intensity=0.75,
    location=(1.5, 1.0, 3.0),
)
SUN = Light(kind="directional", ambient_intensity=0.25, color=(0.5, 1.0, 0.75), direction=(-1.0, 0.5, -2.0))
# The sample is seen 0.22 rad off the axis: on the ramp.
SPOT = dataclasses.replace(LAMP, kind="spot", direction=(-0.75, -0.75, -1.0), beam_width=0.125, cut_off_angle=0.75)
# 2 x scale, turned about x, moved; and one that scales unevenly and mirrors.
SIMILAR = ((2.0, 0.0, 0.0, 0.5), (0.0, 0.0, -2.0, 0.25), (0.0, 2.0, 0.0, -0.5))
UNEVEN = ((1.5, 0.25, 0.0, 0.5), (0.0, -0.75, 0.5, 0.25), (0.25, 0.0, 2.0, -0.5))
HAZE = Fog(color=(0.5, 0.625, 0.75), fog_type="LINEAR", visibility_range=12.0)
COLORS = {"none": None, "rgb": (0.25, 0.75, 0.5), "rgba": (0.25, 0.75, 0.5, 0.625)}
TEXELS = {0: None, 1: (0.5,), 2: (0.5, 0.75), 3: (0.25, 0.5, 0.75), 4: (0.25, 0.5, 0.75, 0.375)}


def case(*lights: Light, sample: Sample = SAMPLE, material: Material | None = BODY, **rest: Any) -> Case:
    return Case(sample=sample, material=material, lights=lights, **rest)


def tables() -> Iterator[tuple[str, Case]]:
    """Tables 17.2 and 17.3 with both texture modes, and what lines and points show."""
    kinds = itertools.product(("lit", "unlit", "line"), TEXELS, COLORS, ("replace", "modulate"))
    for kind, components, color, mode in kinds:
        if (mode == "modulate" and components < 2) or (kind == "line" and components not in (0, 3)):
            continue  # the mode is read for alpha and RGB textures only, and lines show no texture
        yield (
            f"{kind}-{components}-{color}-{mode}",
            case(
                LAMP,
                sample=dataclasses.replace(SAMPLE, texel=TEXELS[components], color=COLORS[color]),
                material=None if kind == "unlit" else BODY,
                options=Options(texture_mode=mode),
                line_or_point=kind == "line",
            ),
        )
    yield "line without material", case(LAMP, material=None, line_or_point=True)


def fields() -> Iterator[tuple[str, Case]]:
    """Every field of every light, material and fog; readings 4 to 30 where they concern the equation."""
    changes: dict[str, Any] = {
        "ambient_intensity": 0.875,
        "attenuation": (1.0, 0.5, 0.25),
        "color": (0.125, 0.25, 1.0),
        "intensity": 0.25,
        "location": (-1.0, 2.0, 2.5),
        "direction": (-0.5, -1.0, -1.25),
        "beam_width": 0.1875,
        "cut_off_angle": 0.625,
        "radius": 3.75,
        "on": False,
        "in_scope": False,
    }
    for light in (SUN, LAMP, SPOT):
        yield light.kind, case(light)
        for name, value in changes.items():
            yield f"{light.kind}.{name}", case(dataclasses.replace(light, **{name: value}), SUN)
        for name, frame in {"similarity": SIMILAR, "uneven": UNEVEN}.items():
            yield f"{light.kind} in a {name} frame", case(dataclasses.replace(light, frame=frame))
        for level in (1, 2, 3):
            options = Options(support_level=level)
            yield (
                f"{light.kind} at level {level}",
                case(light, dataclasses.replace(SUN, in_scope=False), options=options),
            )
    for name in ("ambient_intensity", "diffuse_color", "emissive_color", "shininess", "specular_color", "transparency"):
        value = getattr(BODY, name)
        less = tuple(x / 2 for x in value) if isinstance(value, tuple) else value / 2
        yield f"material.{name}", case(LAMP, SUN, material=dataclasses.replace(BODY, **{name: less}))
    behind = dataclasses.replace(LAMP, location=(4.0, 3.0, -1.5))
    for gate in (False, True):
        yield f"specular_gate={gate}", case(behind, options=Options(specular_gate=gate))
    yield "shininess 0", case(LAMP, material=dataclasses.replace(BODY, shininess=0.0))
    yield (
        "shininess 0, highlight behind",
        case(dataclasses.replace(SUN, direction=(0.0, 0.0, 5.0)), material=dataclasses.replace(BODY, shininess=0.0)),
    )
    yield "attenuation (0, 0, 0)", case(dataclasses.replace(LAMP, attenuation=(0.0, 0.0, 0.0)))
    yield "attenuation below 1", case(dataclasses.replace(LAMP, attenuation=(0.25, 0.0, 0.0)))
    yield "radius 0", case(dataclasses.replace(LAMP, radius=0.0))
    yield "intensity 0 keeps the ambient term", case(dataclasses.replace(LAMP, intensity=0.0))
    yield "beam wider than cone", case(dataclasses.replace(SPOT, beam_width=math.pi / 2, cut_off_angle=math.pi / 4))
    yield "beam equal to cone, outside", case(dataclasses.replace(SPOT, beam_width=0.125, cut_off_angle=0.125))
    yield "normal of zero", case(LAMP, sample=dataclasses.replace(SAMPLE, normal=(0.0, 0.0, 0.0)))
    yield "viewer at the sample", case(LAMP, sample=dataclasses.replace(SAMPLE, eye=SAMPLE.position))
    yield "light at the sample", case(dataclasses.replace(LAMP, location=SAMPLE.position))
    yield "above 1", case(LAMP, SUN, SPOT, material=dataclasses.replace(BODY, emissive_color=(1.0, 1.0, 1.0)))
    yield "no light", case()


def fogs() -> Iterator[tuple[str, Case]]:
    """Table 17.5, frames, and fog on unlit shapes."""
    for kind, visibility, frame in itertools.product(("LINEAR", "EXPONENTIAL"), (12.0, 4.0, 0.0, -1.0), (None, UNEVEN)):
        fog = dataclasses.replace(HAZE, fog_type=kind, visibility_range=visibility, frame=frame)
        yield f"{kind} {visibility} {'uneven' if frame else 'world'}", case(LAMP, fog=fog)
    for unlit in (True, False):
        yield f"fog_unlit={unlit}", case(material=None, fog=HAZE, options=Options(fog_unlit=unlit))


CASES = dict(itertools.chain(tables(), fields(), fogs()))
IN_BOTH_PRECISIONS = list(dict(itertools.chain(fields(), fogs())))
"""The tables choose among colours, whatever these are made of."""


def answers(cases: Sequence[Case], dtype: Any) -> np.ndarray:
    """Colour and alpha [cases, 4] of cases of one structure, evaluated operation by operation.

    Compiling so many different programs would take minutes; so would operations on arrays of many sizes.
    """
    filled = [*cases, *[cases[-1]] * (-len(cases) % TOGETHER)]
    scenes, samples = scenes_and_samples(filled, dtype)
    with jax.disable_jit():
        colors = jax.vmap(lambda s, b: shade(s, b, options_of(cases[0]))[0])(scenes, samples)
    return np.asarray(colors, np.float64)[: len(cases)]


@functools.cache
def answers_of_structure(shape: tuple, bits: str) -> dict[str, np.ndarray]:
    """The answers to all of CASES that have this structure, by name."""
    names = [name for name, one in CASES.items() if structure(one) == shape]
    with precision(bits) as dtype:
        return dict(zip(names, answers([CASES[name] for name in names], dtype), strict=True))


@pytest.mark.parametrize(
    ("name", "bits"), [*((name, "float64") for name in CASES), *((name, "float32") for name in IN_BOTH_PRECISIONS)]
)
def test_the_equation_is_the_specifications(name: str, bits: str) -> None:
    one = CASES[name]
    rgb, alpha = equation.shade(one)
    got = answers_of_structure(structure(one), bits)[name]
    np.testing.assert_allclose(got, [*rgb, alpha], rtol=TOLERANCE[bits], atol=TOLERANCE[bits] * 1e-3)


@pytest.mark.parametrize("bits", ["float32", pytest.param("float64", marks=pytest.mark.thorough)])
def test_random_scenes_compiled(bits: str) -> None:
    """Random well-conditioned cases, compiled, and compared with the operations one by one."""
    cases = random_cases(20, 60)
    good = values(cases, 64 if bits == "float64" else 32).well_conditioned
    assert good.sum() > 50
    by_shape = {str(options_of(one)) + str(len(one.lights)): one for one, fine in zip(cases, good, strict=True) if fine}
    with precision(bits) as dtype:
        for one in list(by_shape.values())[:4]:
            scene, samples = scene_and_sample(one, dtype)
            compiled = np.asarray(shade(scene, samples, options_of(one))[0], dtype=np.float64)
            rgb, alpha = equation.shade(one)
            np.testing.assert_allclose(compiled, [*rgb, alpha], rtol=50 * TOLERANCE[bits], atol=TOLERANCE[bits])
            np.testing.assert_allclose(compiled, answers([one], dtype)[0], rtol=TOLERANCE[bits], atol=TOLERANCE[bits])


def test_scene_of_nodes() -> None:
    """The public way: nodes, transforms, scopes and two surfaces in one buffer, by the same oracle."""
    body = nodes.Material(**{f.name: getattr(BODY, f.name) for f in dataclasses.fields(BODY)})
    shape = nodes.Shape(appearance=nodes.Appearance(material=body))
    own = nodes.PointLight(
        location=LAMP.location, attenuation=LAMP.attenuation, color=LAMP.color, intensity=0.75, global_=False
    )
    room = nodes.Transform(translation=(0.5, 0.25, -0.5), scale=(2.0, 2.0, 2.0), children=[shape, own])
    sun = nodes.DirectionalLight(direction=SUN.direction, color=SUN.color, ambient_intensity=0.25, global_=True)
    outside = nodes.Shape(appearance=nodes.Appearance(material=body))
    frame = ((2.0, 0.0, 0.0, 0.5), (0.0, 2.0, 0.0, 0.25), (0.0, 0.0, 2.0, -0.5))
    lamp = dataclasses.replace(LAMP, ambient_intensity=0.0, frame=frame)
    with precision("float64"):
        scene = Scene.from_nodes([room, outside, sun])
        samples = SampleBuffer.create([SAMPLE.position] * 2, [SAMPLE.normal] * 2, SAMPLE.eye, surface=np.array([1, 0]))
        got = np.asarray(shade(scene, samples))
    for row, lights in zip(got, [(dataclasses.replace(lamp, in_scope=False), SUN), (lamp, SUN)], strict=True):
        rgb, alpha = equation.shade(case(*lights))
        np.testing.assert_allclose(row, [*rgb, alpha], rtol=1e-12)


@pytest.mark.parametrize("name", [name for name, one in CASES.items() if one.sample.color == COLORS["rgb"]])
def test_colors_without_alpha_in_a_buffer_with_alpha(name: str) -> None:
    """A shape with RGB colours beside one with RGBA: the fourth number of its samples is not read."""
    one = CASES[name]
    with precision("float64") as dtype:
        scene, samples = scene_and_sample(one, dtype)
        assert samples.color_planes is not None
        wider = jnp.concatenate([samples.color_planes, jnp.full_like(samples.color_planes[:, :1], 0.6)], axis=1)
        with jax.disable_jit():
            got = np.asarray(shade(scene, dataclasses.replace(samples, color_planes=wider), options_of(one))[0])
    rgb, alpha = equation.shade(one)
    np.testing.assert_allclose(got, [*rgb, alpha], rtol=1e-12)


def test_a_small_scale_is_no_singular_transform() -> None:
    """A light of 1e11 times the place and radius in a frame of 1e-11 is the same light."""
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()))
    with precision("float64"):
        samples = SampleBuffer.create([SAMPLE.position], [SAMPLE.normal], SAMPLE.eye)
        plain, scaled = (
            nodes.PointLight(location=tuple(size * np.array(LAMP.location)), radius=50.0 * size) for size in (1.0, 1e11)
        )
        small = nodes.Transform(scale=(1e-11,) * 3, children=[scaled])
        expected, got = (shade(Scene.from_nodes([shape, light]), samples) for light in (plain, small))
    np.testing.assert_allclose(got, expected, rtol=1e-12)


BOXES = [
    (sides, math.isqrt(square))
    for sides in itertools.combinations_with_replacement(range(1, 31), 3)
    if math.isqrt(square := sum(side * side for side in sides)) ** 2 == square
]
"""Boxes whose sides and diagonal are whole numbers."""


@pytest.mark.parametrize("boxes", [BOXES[:20], BOXES], ids=["few", "many"])
@pytest.mark.parametrize(("bits", "scale"), [("float32", 1.0), ("float64", 3.0)])
def test_samples_at_the_radius_are_lit(bits: str, boxes: list[Any], scale: float) -> None:
    """Each under a light of its own; those a ten thousandth farther away are dark (reading 9)."""
    corners = np.array([sides for sides, _ in boxes], float)
    places = np.arange(len(boxes))[:, None] * np.array([256.0, 0, 0])
    lamps = [
        nodes.PointLight(location=tuple(place), radius=float(diagonal))
        for place, (_, diagonal) in zip(places, boxes, strict=True)
    ]
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()))
    with precision(bits) as dtype:
        scene = Scene.from_nodes([nodes.Transform(scale=(scale,) * 3, children=[shape, *lamps])], dtype=dtype)
        for factor, is_lit in ((1, True), (1.0001, False)):
            position = scale * (places + factor * corners)
            samples = SampleBuffer.create(position, -corners, (0.0, 0.0, 9.0), dtype=dtype)
            got = np.asarray(shade(scene, samples))[:, 0]
            assert np.all(got > 0) if is_lit else np.all(got == 0)


@pytest.mark.parametrize("size", [1e-165, 1e155, 1e160])
@pytest.mark.parametrize("radius", [0.5, 2.0, 1e100])
def test_what_is_out_of_reach_does_not_depend_on_the_size_of_the_scene(size: float, radius: float) -> None:
    """Whose squares are no numbers of double precision: some samples are lit and others not, or all, or none."""
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()))
    position = np.array([(0, 0, 0), (0.9, 0, 0), (0, 0, 0.6)])

    def colors(size: float) -> np.ndarray:
        lamp = nodes.PointLight(location=(0, 0, size), radius=radius * size)
        scene = Scene.from_nodes([shape, lamp])
        return np.asarray(shade(scene, SampleBuffer.create(size * position, [(0, 0, 1)] * 3, (0, 0, 3 * size))))

    with precision("float64"):
        np.testing.assert_allclose(colors(size), colors(1.0), rtol=1e-12)


@pytest.mark.parametrize("count", [3, 1000, 40_000])
def test_batch_size_changes_nothing(count: int) -> None:
    """200 x 200 flat pixels and fewer: some releases of JAX compute thousands of wrong rows at this size."""
    random = np.random.default_rng(count)
    body = nodes.Material(specular_color=(0.5, 0.5, 0.5), shininess=0.3)
    scene = Scene.from_nodes(
        [nodes.Shape(appearance=nodes.Appearance(material=body)), nodes.PointLight(location=(1.0, 2.0, 3.0))]
    )
    position, normal = random.normal(size=(count, 3)), random.normal(size=(count, 3))
    got = np.asarray(shade(scene, SampleBuffer.create(position, normal, (0.0, 0.0, 9.0))))
    for i in random.integers(0, count, 20):
        one = Case(
            sample=Sample(position=tuple(position[i]), normal=tuple(normal[i]), eye=(0.0, 0.0, 9.0)),
            material=Material(specular_color=(0.5, 0.5, 0.5), shininess=0.3),
            lights=(Light(kind="point", location=(1.0, 2.0, 3.0)),),
        )
        np.testing.assert_allclose(got[i, :3], equation.shade(one)[0], rtol=2e-4, atol=2e-6)
    alone = np.asarray(shade(scene, SampleBuffer.create(position[:3], normal[:3], (0.0, 0.0, 9.0))))
    np.testing.assert_allclose(got[:3], alone, rtol=1e-6)
