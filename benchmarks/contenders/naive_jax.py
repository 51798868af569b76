"""JAX as one writes it first: the equation for one sample and one light, `vmap` over lights and samples, `jit`."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..workload import Arrays, Workload
from .base import Contender, Operation, Run, ValueAndGradient, split


def light_contribution(light: Any, material: Any, diffuse: Any, position: Any, normal: Any, view: Any) -> Any:
    """[3]: what one point light adds to one sample before fog."""
    to_light = light["location"] - position
    distance = jnp.linalg.norm(to_light)
    l = to_light / distance
    half = (l + view) / jnp.linalg.norm(l + view)
    c1, c2, c3 = light["attenuation"]
    attenuation = 1 / jnp.maximum(c1 + c2 * distance + c3 * distance**2, 1)
    reach = jnp.where(distance <= light["radius"], attenuation, 0)
    ambient = light["ambient_intensity"] * material["ambient_intensity"]
    lit = light["intensity"] * jnp.maximum(normal @ l, 0)
    # The floor keeps the power's derivative from being NaN at 0.
    peak = light["intensity"] * jnp.maximum(normal @ half, 1e-20) ** (128 * material["shininess"])
    return light["color"] * reach * ((ambient + lit) * diffuse + peak * material["specular_color"])


def shade_sample(lights: Any, material: Any, scene: Any, diffuse: Any, position: Any, normal: Any) -> Any:
    """[3]: the colour of one sample under all lights, with exponential fog."""
    to_eye = scene["eye"] - position
    distance = jnp.linalg.norm(to_eye)
    each = jax.vmap(light_contribution, in_axes=(0, None, None, None, None, None))
    added = each(lights, material, diffuse, position, normal, to_eye / distance)
    color = material["emissive_color"] + jnp.sum(added, axis=0)
    visible = jnp.exp(-distance / (scene["fog_visibility"] - distance))
    return scene["fog_color"] * (1 - visible) + visible * color


def shade(parameters: Any, scene: Any) -> Any:
    """[N, 3]."""
    material, lights = split(parameters)
    lights["radius"] = scene["radius"]
    diffuse = scene.get("sample_color", material.get("diffuse_color"))
    axis = 0 if "sample_color" in scene else None
    each = jax.vmap(shade_sample, in_axes=(None, None, None, axis, 0, 0))
    return each(lights, material, scene, diffuse, scene["position"], scene["normal"])


def loss(parameters: Any, scene: Any) -> Any:
    """Sum of squared residuals."""
    return jnp.sum((shade(parameters, scene) - scene["target"]) ** 2)


def scene_arrays(arrays: Arrays) -> dict[str, np.ndarray]:
    """What is not differentiated, with samples as rows."""
    scene = {
        "position": arrays.position.T,
        "normal": arrays.normal.T,
        "target": arrays.target.T,
        "eye": arrays.eye,
        "fog_color": arrays.fog_color,
        "fog_visibility": np.float32(arrays.fog_visibility),
        "radius": arrays.lights["radius"],
    }
    if arrays.sample_color is not None:
        scene["sample_color"] = arrays.sample_color.T
    return {name: np.ascontiguousarray(value) for name, value in scene.items()}


class NaiveJax(Contender):
    """`jax.jit` and `jax.value_and_grad` of the functions above; arrays are [N, 3], intermediates [N, L, 3]."""

    def __init__(self, work: Workload, arrays: Arrays) -> None:
        self._arguments = jax.device_put((arrays.parameters, scene_arrays(arrays)))

    def prepare(self, operation: Operation) -> Run:
        function = shade if operation == "forward" else jax.value_and_grad(loss)
        compiled = jax.jit(function).lower(*self._arguments).compile()
        return lambda: jax.block_until_ready(compiled(*self._arguments))

    def colors(self, result: Any) -> np.ndarray:
        return np.asarray(result).T

    def value_and_gradient(self, result: Any) -> ValueAndGradient:
        return ValueAndGradient(float(result[0]), {name: np.asarray(g) for name, g in result[1].items()})
