"""What is asked of XLA's CPU backend."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight import SampleBuffer, Scene, compiler_options, nodes
from jaxlight.lighting import compiling, one_tile, shade_tiles
from jaxlight.lighting.prepared import LANES
from jaxlight.lighting.stages import LOOPS_ARE_HOISTED, Stage


@pytest.fixture
def asked_anew() -> Iterator[None]:
    compiling.cpu_options.cache_clear()
    yield
    compiling.cpu_options.cache_clear()


def test_options_that_xla_does_not_know_are_not_asked_for(asked_anew: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "WANTED", {"xla_cpu_no_such_option": 1, "xla_cpu_prefer_vector_width": 512})
    options = compiler_options()
    assert options.pop("xla_disable_hlo_passes")
    assert options == {"xla_cpu_prefer_vector_width": 512}


def scene_and_samples(lights: int, count: int = 2**13) -> tuple[Scene, SampleBuffer]:
    lamps = [nodes.PointLight(location=(x, 0, 4), ambient_intensity=0.1) for x in np.linspace(-1, 1, lights)]
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()), geometry=nodes.Sphere())
    points = np.random.default_rng(3).normal(size=(count, 3))
    return Scene.from_nodes([shape, *lamps]), SampleBuffer.create(points, points, [0, 0, 6])


def gradient_by_scene(lights: int, count: int) -> tuple[Callable[[Scene], Scene], Scene]:
    """The gradient of a loss, and where to take it."""
    scene, samples = scene_and_samples(lights, count)
    free, fixed = eqx.partition(scene, eqx.is_inexact_array)

    def loss(free: Scene) -> jax.Array:
        tile = shade_tiles(eqx.combine(free, fixed), samples)[0, :3, :16]
        return jnp.sum(tile**2)  # so few that XLA never gives them to a library

    return jax.grad(loss), free


def test_sums_of_a_gradient_are_loops_of_xla() -> None:
    gradient, free = gradient_by_scene(2, 2**13)
    program = jax.jit(gradient, compiler_options=compiler_options()).lower(free).compile().as_text() or ""
    assert "reduce" in program
    assert "ynn" not in program


PLAIN_SUM = re.compile(r"reduce\(.*applies stablehlo.add .*: \(tensor<([\dx]+)xf(?:32|64)>")
"""With the shape of what is added up."""


def large_sums(text: str) -> list[int]:
    """Of how many numbers are sums of so many that a library of XLA's would be given them."""
    counts = [math.prod(map(int, shape.split("x"))) for shape in PLAIN_SUM.findall(text)]
    return [count for count in counts if count >= 4096]


@pytest.mark.parametrize("lights", [1, 8, 40])
def test_sums_of_a_gradient_are_none_that_a_library_knows(lights: int) -> None:
    """Whatever options the program is compiled with; but one for the alpha of a whole picture."""
    gradient, free = gradient_by_scene(lights, 2**13)
    assert large_sums(jax.jit(gradient).lower(free).as_text()) == [2**13]
    assert large_sums(jax.jit(lambda planes: jnp.sum(planes, axis=1)).lower(jnp.ones((8, 16, 128))).as_text())


PARTS_OF_LOOPS = """
import sys
import jax
sys.path.insert(0, sys.argv[1])
from jaxlight import compiler_options
from test_compiling import gradient_by_scene

gradient, free = gradient_by_scene(8, 2**15)
for options in (compiler_options(all_cores=True), compiler_options()):
    program = jax.jit(gradient, compiler_options=options).lower(free).compile().as_text()
    print(program.count('outer_dimension_partitions":["'))
"""


def test_loops_of_a_gradient_are_not_shared_out_among_cores() -> None:
    """They are too small for that; but who asks for it gets it."""
    command = [sys.executable, "-c", PARTS_OF_LOOPS, str(Path(__file__).parent)]
    four_cores = {**os.environ, "NPROC": "4"}
    done = subprocess.run(command, env=four_cores, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    on_all_cores, on_one = map(int, done.stdout.split())
    assert on_all_cores > 0 and on_one == 0


def test_a_loop_and_the_loops_in_it_are_not_one_function() -> None:
    def product(numbers: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, 8, lambda number, total: jnp.sin(total) * numbers[number], numbers)

    program = jax.jit(product, compiler_options=compiler_options()).lower(jnp.ones(8)).compile().as_text() or ""
    assert "while" in program
    assert "small_call" not in program


@pytest.mark.parametrize("lights", [8, 12])
def test_loops_over_samples_are_not_part_of_a_larger_function(lights: int) -> None:
    """In one function with the loop over tiles, or over chunks of lights, they would be slower."""
    scene, samples = scene_and_samples(lights, 2**15)
    text = jax.jit(partial(shade_tiles, scene)).lower(samples).compile().as_text() or ""
    assert "while" in text
    assert "small_call" not in text


def test_loops_of_a_gradient_are_not_part_of_a_larger_function() -> None:
    """With no more to compile than that takes: each stage would have a sort that XLA compiles by itself."""
    gradient, free = gradient_by_scene(2, 2**15)
    lowered = jax.jit(gradient).lower(free)
    text = lowered.compile().as_text() or ""
    assert "while" in text
    assert "small_call" not in text
    assert ("stablehlo.sort" in lowered.as_text()) == LOOPS_ARE_HOISTED


@pytest.mark.parametrize("scale", [(2, 2, 2), (1, 2, 0.5)])
def test_xla_finds_an_end_in_simplifying_lights_of_a_scaled_frame(
    scale: tuple[float, float, float], capfd: pytest.CaptureFixture[str]
) -> None:
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(specular_color=(0.5,) * 3)))
    lamp = nodes.SpotLight(location=(0, 0, 1), ambient_intensity=0.1, attenuation=(1, 0.1, 0.2))
    scene = Scene.from_nodes([shape, nodes.Transform(scale=scale, translation=(0, 0.1, 0), children=[lamp])])
    points = np.random.default_rng(3).normal(size=(3000, 3))
    jax.jit(partial(shade_tiles, scene)).lower(SampleBuffer.create(points, points, [0, 0, 6])).compile()
    assert "circular simplification" not in capfd.readouterr().err


def test_the_equation_is_traced_once_for_a_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the form that is differentiated, and in no other: most of the time until a program runs is JAX's."""
    traced: list[type] = []
    color = one_tile._color

    def counted(stage: Any, *rest: Any) -> Any:
        traced.append(type(stage))
        return color(stage, *rest)

    monkeypatch.setattr(one_tile, "_color", counted)
    gradient, free = gradient_by_scene(1, 700)
    jax.clear_caches()
    jax.make_jaxpr(gradient)(free)
    assert traced == [Stage]


def test_the_compiler_is_given_no_sum_of_constants(tmp_path: Path) -> None:
    """XLA adds constants up as it compiles, a microsecond a number: seconds for the pixels of a large picture."""
    scene, samples = scene_and_samples(1)
    free, fixed = eqx.partition(scene, eqx.is_inexact_array)

    def loss(free: Scene) -> jax.Array:  # of colours, and not of alpha
        return jnp.sum(shade_tiles(eqx.combine(free, fixed), samples)[:, :3] ** 2)

    dump = {"xla_dump_to": str(tmp_path), "xla_dump_hlo_pass_re": "constant_folding"}
    jax.jit(jax.grad(loss), compiler_options=compiler_options() | dump).lower(free).compile()
    programs = [path.read_text() for path in tmp_path.glob("*.before_constant_folding.txt")]
    assert programs
    assert [sum_ for program in programs for sum_ in sums_of_constants(program)] == []
    assert sums_of_constants("%a = f32[9] broadcast(%c), dimensions={}\n%b = f32[] reduce(%a, %z)") == ["%b"]


def sums_of_constants(program: str) -> list[str]:
    """The sums of a program in HLO whose terms are all the same constant."""
    constants = set(re.findall(r"(%\S+) = \S+ broadcast\(%c\S*\), dimensions=\{\}", program))
    sums = re.findall(r"(%\S+) = \S+ reduce(?:-window)?\((%[^,]+),", program)
    return [name for name, terms in sums if terms in constants]


def test_what_derivatives_add_up_over_samples_is_a_short_expression() -> None:
    """XLA vectorises no sum of a long one."""
    lamps = [
        nodes.PointLight(location=(1, 2, 4), attenuation=(1, 0.1, 0.2), ambient_intensity=0.1),
        nodes.SpotLight(location=(-1, 2, 4), direction=(0.3, -0.6, -1), attenuation=(1, 0.1, 0), cut_off_angle=0.9),
        nodes.DirectionalLight(direction=(0.2, -1, -1)),
        nodes.Fog(visibility_range=30, fog_type="EXPONENTIAL"),
    ]
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(specular_color=(0.4, 0.5, 0.6))))
    scene = Scene.from_nodes([shape, nodes.Transform(scale=(1, 1.5, 2), children=lamps)])
    points = np.random.default_rng(3).normal(size=(2**13, 3))
    samples = SampleBuffer.create(points, points, [0, 0, 6])
    free, fixed = eqx.partition(scene, eqx.is_inexact_array)

    def loss(free: Scene) -> jax.Array:
        return jnp.sum(shade_tiles(eqx.combine(free, fixed), samples) ** 2)

    program = jax.jit(jax.grad(loss), compiler_options=compiler_options()).lower(free).compile().as_text() or ""
    lengths = lengths_of_sums(program)
    assert lengths and max(lengths.values()) <= 16, lengths


def lengths_of_sums(program: str) -> dict[str, int]:
    """How many operations there are in each loop of a compiled program that adds up samples lane by lane."""
    loops = re.findall(r"^%(\S+) \(.*\{\n((?:  .*\n)+)\}", program, re.MULTILINE)
    arithmetic = r" = [fs]\d+\S* (?:add|multiply|subtract|divide|select|minimum|maximum|sqrt|convert)\("
    lengths = {}
    for name, loop in loops:
        lanes = re.findall(r" = f\d+\[(?:\d+,)*(\d+)\]\S* reduce\(", loop)
        if lanes and max(map(int, lanes)) >= LANES:
            lengths[name] = len(re.findall(arithmetic, loop))
    return lengths
