"""Derivatives by what is as large as an image: positions, normals and colours of samples, weights and texels."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxprs_in_params

from fit_scenes import precision
from jaxlight import Scene, nodes
from jaxlight.lighting import Plan, make_plan, shade
from jaxlight.raster import SampleBuffer

SIDE = 40
LIGHTS = 5
FIELDS = ("position_planes", "normal_planes", "color_planes", "texel_weight")


def scene_of_kinds(lights: int) -> Scene:
    """Shapes with a texture, with colours of their own, and with both but unlit; the last has another texture."""
    random = np.random.default_rng(1)
    texture, other = (nodes.PixelTexture(image=random.uniform(0.1, 0.9, (SIDE, SIDE, 3))) for _ in range(2))
    glossy = nodes.Material(specular_color=(0.4, 0.3, 0.2), shininess=0.1)
    color = nodes.Color(color=np.ones((1, 3)))
    shapes = [
        nodes.Shape(appearance=nodes.Appearance(material=glossy, texture=texture)),
        nodes.Shape(appearance=nodes.Appearance(material=glossy), geometry=nodes.IndexedFaceSet(color=color)),
        nodes.Shape(appearance=nodes.Appearance(texture=other), geometry=nodes.IndexedFaceSet(color=color)),
    ]
    places = np.array([0, 0, 3]) + random.normal(size=(lights, 3))
    points = [nodes.PointLight(location=place, attenuation=(0.5, 0, 0.1)) for place in places]
    return Scene.from_nodes([*shapes, *points, nodes.DirectionalLight(direction=(0.3, 0.2, -1))])


def samples_of_kinds(count: int) -> SampleBuffer:
    """Random samples of all shapes."""
    random = np.random.default_rng(2)
    return SampleBuffer.create(
        random.uniform(-1, 1, (count, 3)),
        np.array([0, 0, 3]) + random.normal(size=(count, 3)),
        [0.3, 0.2, 6],
        surface=random.integers(0, 3, count),
        color=random.uniform(0.1, 1, (count, 3)),
        texel_index=random.integers(0, SIDE**2, (count, 4)),
        texel_weight=random.dirichlet(np.ones(4), count),
    )


def inputs_of(scene: Scene, samples: SampleBuffer) -> dict[str, Any]:
    """What is differentiated by."""
    images = {f"image{number}": texture.image for number, texture in enumerate(scene.textures)}
    return {name: getattr(samples, name) for name in (*FIELDS, "eye")} | images


def loss(inputs: Mapping[str, Any], scene: Scene, samples: SampleBuffer, plan: Plan) -> jax.Array:
    """Of all colours, each weighted differently."""
    images = [inputs[f"image{number}"] for number in range(len(scene.textures))]
    textures = tuple(dataclasses.replace(t, image=image) for t, image in zip(scene.textures, images, strict=True))
    own = dataclasses.replace(samples, **{name: inputs[name] for name in (*FIELDS, "eye")})
    colors = shade(dataclasses.replace(scene, textures=textures), own, plan=plan)
    return jnp.sum(jnp.sin(jnp.arange(colors.size).reshape(colors.shape)) * colors**2)


def test_derivatives_by_samples_and_textures_are_those_of_the_loss() -> None:
    with precision("float64"):
        scene, samples = scene_of_kinds(20), samples_of_kinds(1500)
        assert len(scene.textures) == 2 and len(samples.runs) == 3 and samples.slots > 2 * samples.group * samples.tile
        plan, inputs = make_plan(scene, samples, free=True), inputs_of(scene, samples)
        of_inputs = jax.jit(lambda inputs: loss(inputs, scene, samples, plan))
        gradient = jax.jit(jax.grad(of_inputs))(inputs)
        along = jax.jit(lambda direction: jax.jvp(of_inputs, (inputs,), (direction,))[1])
        random = np.random.default_rng(3)
        for name, value in inputs.items():
            direction = jax.tree.map(jnp.zeros_like, inputs) | {name: jnp.asarray(random.normal(size=value.shape))}
            step = 1e-6
            above, below = (
                of_inputs({key: own + sign * step * direction[key] for key, own in inputs.items()}) for sign in (1, -1)
            )
            slope = float(jnp.vdot(gradient[name], direction[name]))
            assert abs(slope) > 1e-3
            np.testing.assert_allclose(slope, (above - below) / (2 * step), rtol=1e-6)
            np.testing.assert_allclose(along(direction), slope, rtol=1e-11)


def test_no_loop_over_tiles_carries_what_is_as_large_as_an_image() -> None:
    """Added to with every tile, it would make the derivative of n samples cost n^2."""
    samples = samples_of_kinds(6000)
    carried = [
        math.prod(given.aval.shape)
        for loop in equations_of(gradient_of(samples), "scan")
        for given, inside in zip(loop.outvars, loop.params["jaxpr"].jaxpr.outvars, strict=True)
        if given.aval.shape == inside.aval.shape  # what is stacked has one axis more outside
    ]
    assert samples.eye.size in carried
    assert max(carried) < min(3 * SIDE**2, samples.slots) / 2


def test_no_stage_of_a_derivative_is_computed_anew_for_the_parts_of_an_array() -> None:
    """As it would be where derivatives by planes are put into their places in the array that the planes lie in."""
    stages = list(equations_of(gradient_of(samples_of_kinds(6000)), "linear_stage"))
    of_lights = [stage for stage in stages if any(operand.aval.shape[:1] == (LIGHTS,) for operand in stage.invars)]
    assert of_lights
    for stage in of_lights:
        for inside in jaxprs_in_params(stage.params):
            assert not [*equations_of(inside, "pad"), *equations_of(inside, "dynamic_update_slice")]


def gradient_of(samples: SampleBuffer) -> Any:
    """The program of the gradient by all inputs."""
    scene = scene_of_kinds(LIGHTS)
    plan, inputs = make_plan(scene, samples, free=True), inputs_of(scene, samples)
    return jax.make_jaxpr(jax.grad(lambda inputs: loss(inputs, scene, samples, plan)))(inputs).jaxpr


def equations_of(program: Any, primitive: str) -> Iterator[Any]:
    """All equations with this primitive, those inside others included."""
    for equation in program.eqns:
        if equation.primitive.name == primitive:
            yield equation
        for inside in jaxprs_in_params(equation.params):
            yield from equations_of(inside, primitive)
