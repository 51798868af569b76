"""Loops over samples: the numbers of the functions and stages they stand for, in one loop of the compiled code."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import precision
from jaxlight import Scene, nodes
from jaxlight.lighting import LightingOptions, make_plan, one_loop, shade, shade_tiles
from jaxlight.lighting.one_loop import in_one_loop
from jaxlight.lighting.unrolled import unrolled
from jaxlight.raster import SampleBuffer

ARRAYS = tuple(np.random.default_rng(1).uniform(0.5, 1.5, shape) for shape in [(2, 3), (3,), ()])

FUNCTIONS: dict[str, Callable[[jax.Array, jax.Array, jax.Array], Any]] = {
    "arithmetic": lambda a, b, c: a * b - c / a,
    "axes": lambda a, b, c: (a.T[:, None] + b[:, None, None], jnp.moveaxis(a, 0, 1).reshape(2, 3)),
    "parts": lambda a, b, c: (a[1, ::2], a[-1], b[None, 1:], jnp.squeeze(a[:1])),
    "taken apart": lambda a, b, c: (*a, *jnp.unstack(a, axis=1), *jnp.unstack(b)),
    "joined": lambda a, b, c: (jnp.stack([b, a[0]], axis=1), jnp.concatenate([a, b[None]])),
    "sums": lambda a, b, c: (jnp.sum(a), jnp.sum(a, axis=0), jnp.sum(a * b, axis=-1)),
    "choices": lambda a, b, c: jnp.where((a > 1) & (b < c), jnp.sqrt(a), jnp.maximum(a, b)),
    "types": lambda a, b, c: (a > 1).astype(jnp.float32) + jax.lax.bitcast_convert_type(a, jnp.int32) % 7,
    "constants": lambda a, b, c: a + np.arange(3.0, dtype=np.float32),
    "places": lambda a, b, c: (
        jax.lax.with_sharding_constraint(a, jax.sharding.SingleDeviceSharding(jax.devices()[0])),
        *jax.lax.optimization_barrier((b, c)),
    ),
    "calls": lambda a, b, c: (jax.jit(jnp.tanh)(a), jax.checkpoint(jnp.sin)(b), jax.nn.relu(c - 1)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_of_arrays_are_unrolled(name: str) -> None:
    arrays = [jnp.asarray(array, jnp.float32) for array in ARRAYS]
    numbers = [number for array in arrays for number in array.reshape(-1)]
    expected = jax.tree.leaves(FUNCTIONS[name](*arrays))
    got = unrolled(jax.make_jaxpr(FUNCTIONS[name])(*arrays))(*numbers)
    assert all(np.ndim(number) == 0 for number in got)
    np.testing.assert_allclose(np.array(got), np.concatenate([np.ravel(result) for result in expected]), rtol=1e-6)


@pytest.mark.parametrize(
    "function", [jnp.sort, lambda a: a @ a.T, jnp.cumsum, lambda a: jax.lax.cond(True, abs, abs, a)]
)
def test_what_cannot_be_unrolled_is_refused(function: Callable[[jax.Array], jax.Array]) -> None:
    array = jnp.asarray(ARRAYS[0])
    with pytest.raises(NotImplementedError, match="cannot be unrolled"):
        unrolled(jax.make_jaxpr(function)(array))(*array.reshape(-1))


def several(a: jax.Array, b: jax.Array, c: jax.Array) -> list[jax.Array]:
    """Three results of three numbers."""
    shared = jnp.exp(a * b)
    return [shared + c, shared * c, shared - a]


PLANES = [np.random.default_rng(2).uniform(0.5, 1.5, shape) for shape in [(4, 64), (4, 1), (1, 1)]]


def looped(*planes: jax.Array) -> jax.Array:
    """`several`, element by element."""
    jaxpr = jax.make_jaxpr(several)(*(plane[0, 0] for plane in planes))
    return in_one_loop(jaxpr, planes, (4, 64))


@pytest.mark.parametrize("bits", ["float32", "float64"])
@pytest.mark.parametrize("compiled", [True, False])
def test_results_stand_side_by_side(bits: str, compiled: bool) -> None:
    with precision(bits) as dtype:
        planes = [jnp.asarray(plane, dtype) for plane in PLANES]
        got = (jax.jit(looped) if compiled else looped)(*planes)
        expected = np.stack(np.broadcast_arrays(*several(*planes)), axis=-1)
        assert got.dtype == dtype and got.shape == (4, 64, 3)
        np.testing.assert_allclose(got, expected, rtol=4 * np.finfo(dtype).eps)


@pytest.mark.parametrize("compiled", [True, False])
def test_results_may_be_constants_or_what_is_given(compiled: bool) -> None:
    planes = [jnp.asarray(plane, jnp.float32) for plane in PLANES]

    def found(*planes: jax.Array) -> jax.Array:
        jaxpr = jax.make_jaxpr(lambda a, b, c: [a * b, c, np.float32(2)])(*(plane[0, 0] for plane in planes))
        return in_one_loop(jaxpr, planes, (4, 64))

    got = (jax.jit(found) if compiled else found)(*planes)
    np.testing.assert_allclose(got[..., 0], planes[0] * planes[1], rtol=1e-6)
    assert np.all(got[..., 1] == planes[2]) and np.all(got[..., 2] == 2)


def test_loops_are_mapped_over_any_axis() -> None:
    first, second, third = (jnp.asarray(plane, jnp.float32) for plane in PLANES)
    many = jnp.stack([first, 2 * first], axis=1)
    got = jax.jit(jax.vmap(looped, in_axes=(1, None, None)))(many, second, third)
    expected = jnp.stack([looped(first, second, third), looped(2 * first, second, third)])
    np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_other_platforms_evaluate_the_function_on_planes() -> None:
    traced = jax.jit(looped).trace(*(jnp.asarray(plane, jnp.float32) for plane in PLANES))
    exponentials = re.compile(r"stablehlo\.exponential .*tensor<([0-9x]+)xf32>")
    assert exponentials.findall(traced.lower(lowering_platforms=("cpu",)).as_text()) == ["4x64x3"]
    assert exponentials.findall(traced.lower(lowering_platforms=("cuda",)).as_text()) == ["4x64"]


# --- the equation -----------------------------------------------------------------------------------------------------

COUNT = 3000


def lights_of(kind: str, count: int) -> list[Any]:
    random = np.random.default_rng(5)
    place = random.uniform([-2, -2, 0.5], [2, 2, 2], (count, 3))
    common = [{"color": random.uniform(0, 1, 3), "ambient_intensity": 0.1} for _ in range(count)]
    if kind == "directional":
        return [nodes.DirectionalLight(direction=-p, **own) for p, own in zip(place, common, strict=True)]
    near = [
        {"location": p, "attenuation": (1, 0.1, 0.2), "radius": 3.0, **c} for p, c in zip(place, common, strict=True)
    ]
    if kind == "point":
        return [nodes.PointLight(**own) for own in near]
    return [nodes.SpotLight(direction=(0.1, 0, -1), beam_width=0.4, cut_off_angle=1.0, **own) for own in near]


def scene_under(lights: list[Any], fog: str | None = "LINEAR", dtype: Any = None) -> Scene:
    material = nodes.Material(ambient_intensity=0.3, emissive_color=(0.1, 0, 0.05), specular_color=(0.5, 0.6, 0.4))
    shape = nodes.Shape(appearance=nodes.Appearance(material=material))
    hidden = [nodes.Fog(color=(0.5, 0.6, 0.7), visibility_range=20, fog_type=fog)] if fog else []
    framed = [nodes.Transform(scale=(1, 2, 0.5), children=lights[:1]), *lights[1:]]
    return Scene.from_nodes([shape, *framed, *hidden], dtype=dtype)


@pytest.fixture
def samples() -> SampleBuffer:
    return samples_of(np.float32)


def samples_of(dtype: Any) -> SampleBuffer:
    random = np.random.default_rng(6)
    return SampleBuffer.create(
        random.uniform([-2, -2, -0.2], [2, 2, 0.2], (COUNT, 3)),
        np.array([0, 0, 2]) + random.normal(size=(COUNT, 3)),
        [0.5, 0.2, 4],
        color=random.uniform(0, 1, (COUNT, 4)),
        by_place=True,
        dtype=dtype,
    )


LIGHTS = {
    "none": [],
    "few of all kinds": [*lights_of("directional", 1), *lights_of("point", 2), *lights_of("spot", 1)],
    "all kinds in one loop": [*lights_of("directional", 2), *lights_of("point", 3), *lights_of("spot", 3)],
    "more than one loop holds": [*lights_of("point", 11), *lights_of("directional", 5)],
    "lists of spots": lights_of("spot", 40),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_loops_and_stages_give_the_same_colours(name: str, samples: SampleBuffer) -> None:
    """Only colours that are not differentiated come from loops."""
    scene = scene_under(LIGHTS[name])
    plan = make_plan(scene, samples, free=True)

    def of_color(color: jax.Array) -> jax.Array:
        materials = scene.materials
        assert materials is not None
        moved = jax.tree.map(lambda leaf: color if leaf is materials.emissive_color else leaf, scene)
        return shade(moved, samples, plan=plan)

    assert scene.materials is not None
    color = scene.materials.emissive_color
    in_stages, change = jax.jit(lambda color: jax.jvp(of_color, (color,), (jnp.ones_like(color),)))(color)
    in_loops = jax.jit(of_color)(color)
    np.testing.assert_allclose(in_loops, in_stages, rtol=3e-6, atol=1e-6)
    assert np.all(np.asarray(change)[:, :3] > 0) and np.std(np.asarray(in_loops)[:, :3]) > 0.02


def functions_called(program: str) -> set[str]:
    """What of planes (of 64 numbers or more) is computed by a call in some precision: LLVM repeats calls."""
    found = re.findall(r"= f\d+\[([\d,]+)\]\S* ([a-z][a-z0-9\-]*)\(", program)
    names = {name for shape, name in found if math.prod(map(int, shape.split(","))) >= 64}
    assert {"multiply", "sqrt"} <= names
    functions = ("exponential", "log", "power", "tan", "sine", "cosine", "atan2", "cbrt", "erf")
    return {name for name in names if name.startswith(functions)}


def stored_in_loops(program: str) -> dict[str, int]:
    """How many planes (of 64 numbers or more) each form of each loop over samples stores; by loop and branch."""
    # What the computations of fusions hold is not stored.
    outside = "\n".join(part for part in program.split("\n\n") if "fused_computation" not in part.split("(")[0])
    found = re.findall(r"= [a-z]+\d*\[([\d,]+)\].*op_name=\"[^\"]*/loop\.(\w+)/cond/branch_([12])_fun", outside)
    planes = [f"{loop} {branch}" for shape, loop, branch in found if math.prod(map(int, shape.split(","))) >= 64]
    return dict(Counter(planes))


@pytest.mark.parametrize(
    ("name", "fog", "bits", "accuracy"),
    [
        ("few of all kinds", "EXPONENTIAL", "float32", "full"),
        ("few of all kinds", "EXPONENTIAL", "float64", "fast"),
        ("all kinds in one loop", "LINEAR", "float64", "full"),
    ],
)
def test_a_tile_under_few_lights_is_one_loop(name: str, fog: Any, bits: str, accuracy: Any) -> None:
    """One for tiles whose squared distances are surely in range, one for the others, and no boundary of a stage.

    Nothing is taken out of them and stored, however costly and by how much it is asked for; nothing in them is a call.
    """
    with precision(bits) as dtype:
        scene, samples = scene_under(LIGHTS[name], fog, dtype), samples_of(dtype)
        plan = make_plan(scene, samples, LightingOptions(accuracy=accuracy))
        program = jax.jit(lambda scene, samples: shade_tiles(scene, samples, plan=plan)).lower(scene, samples).compile()
        text = program.as_text() or ""
        assert stored_in_loops(text) == {"colors 1": 1, "colors 2": 1}
        assert "stage.seen" not in text and "stage.weights" not in text
        assert functions_called(text) == set()


def test_more_lights_are_a_loop_for_each_few(samples: SampleBuffer) -> None:
    """Of points, in parts of one size, and of directional lights."""
    scene = scene_under(LIGHTS["more than one loop holds"])
    program = jax.jit(shade_tiles).lower(scene, samples).compile().as_text()
    loops = {"directions": 1, "received": 2, "mixed": 1}
    assert stored_in_loops(program or "") == {f"{loop} {form}": n for loop, n in loops.items() for form in (1, 2)}


@pytest.mark.parametrize(("bits", "by_place"), [("float32", True), ("float64", False)])
def test_all_blocks_of_all_surfaces_under_few_lights_are_one_loop(bits: str, by_place: bool) -> None:
    """Each block in the material of its surface, under the lights that have this in their scope."""
    random = np.random.default_rng(9)
    groups = []
    for sun in lights_of("directional", 3):
        material = nodes.Material(diffuse_color=random.uniform(0.3, 1, 3), transparency=random.uniform(0, 1))
        groups.append(nodes.Group(children=[nodes.Shape(appearance=nodes.Appearance(material=material)), sun]))
    place, normal = random.uniform([-2, -2, -0.2], [2, 2, 0.2], (COUNT, 3)), random.normal(size=(COUNT, 3))
    surface = random.integers(0, 3, COUNT)
    with precision(bits):
        scene = Scene.from_nodes([*groups, *lights_of("point", 1)])
        samples = SampleBuffer.create(place, normal, [0.5, 0.2, 4], surface=surface, tile=32, by_place=by_place)
        assert samples.group > 1 and samples.slots > 3 * samples.group * samples.tile
        program = jax.jit(shade).lower(scene, samples).compile().as_text()
        assert program is not None and " while(" not in program
        together = np.asarray(shade(scene, samples))
        for row in range(3):
            of_row = surface == row
            alone = SampleBuffer.create(place[of_row], normal[of_row], [0.5, 0.2, 4], surface=row)
            np.testing.assert_allclose(together[of_row], shade(scene, alone), rtol=1e-6, atol=1e-7)
            assert np.std(together[of_row], axis=0)[:3].min() > 0.01


def test_gradients_by_places_of_lights_are_one_loop(samples: SampleBuffer) -> None:
    """Of four results: the derivatives of what a light gives by the three components of its place and by its distance,
    which is measured in another frame.

    One such loop for ordinary tiles, and one for the others.
    """
    scene = scene_under(lights_of("point", 3)[1:])

    def total(location: jax.Array) -> jax.Array:
        assert scene.point is not None
        moved = jax.tree.map(lambda leaf: location if leaf is scene.point.location else leaf, scene)
        return jnp.sum(shade_tiles(moved, samples) ** 2)

    assert scene.point is not None
    gradient = jax.jit(jax.grad(total))
    program = gradient.lower(scene.point.location).compile().as_text()
    assert program is not None
    loops = re.findall(r"\((f32\[2,.*)\) reduce\(.*stage\.weights\.change", program)
    assert [loop.count("f32[2,") for loop in loops] == [4, 4], loops


@pytest.mark.parametrize(("radius", "culled"), [(0.5, True), (3.5, False)])
def test_lights_that_reach_most_tiles_are_not_looked_for(radius: float, culled: bool, samples: SampleBuffer) -> None:
    random = np.random.default_rng(8)
    places = random.uniform([-2, -2, 0.2], [2, 2, 0.4], (40, 3))
    lamps = [nodes.PointLight(location=place, radius=radius) for place in places]
    scene = scene_under([nodes.DirectionalLight(), *lamps])
    plan = make_plan(scene, samples)
    assert plan.point is not None and plan.point.radius and plan.point.culled == culled
    # Free lights stay in the plan as they are, and are looked for as long as that seems quicker.
    free = make_plan(scene, samples, free=True).point
    assert free is not None and free.culled == culled
    other = plan._replace(point=plan.point._replace(culled=not culled))
    np.testing.assert_allclose(
        shade(scene, samples, plan=plan), shade(scene, samples, plan=other), rtol=2e-6, atol=1e-6
    )


def test_gradients_unroll_no_loop(samples: SampleBuffer, monkeypatch: pytest.MonkeyPatch) -> None:
    """JAX traces a function also where its derivative rule takes its place, and to unroll takes long."""
    scene = scene_under(lights_of("point", 5))

    def brightness(places: jax.Array) -> jax.Array:
        moved = eqx.tree_at(lambda scene: scene.point.location, scene, places)
        return jnp.sum(shade_tiles(moved, samples))

    def fail(*_: Any) -> Any:
        raise AssertionError("unrolled")

    monkeypatch.setattr(one_loop, "unrolled", fail)
    places = scene.point.location
    jax.jit(jax.grad(brightness)).lower(places)
    with pytest.raises(AssertionError, match="unrolled"):
        jax.jit(brightness).lower(places)
