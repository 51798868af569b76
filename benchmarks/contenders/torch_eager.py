"""PyTorch, eager: whole-array operations, lights x samples by broadcasting, autograd for the gradient."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import torch

from ..workload import Arrays, Workload
from .base import Contender, Operation, Run, ValueAndGradient, split


def shade(parameters: Any, scene: Any) -> torch.Tensor:
    """[3, N]. Planes x, y, z are kept apart: arrays are [L, N], without a short last axis."""
    material, lights = split(parameters)
    diffuse = scene["sample_color"] if "sample_color" in scene else material["diffuse_color"][:, None]
    normal = scene["normal"]
    to_eye = scene["eye"][:, None] - scene["position"]
    eye_distance = torch.sqrt((to_eye**2).sum(0))
    view = to_eye / eye_distance

    to_light = [lights["location"][:, i, None] - scene["position"][i] for i in range(3)]
    squared = to_light[0] ** 2 + to_light[1] ** 2 + to_light[2] ** 2
    distance = torch.sqrt(squared)
    l = [x / distance for x in to_light]
    half = [l[i] + view[i] for i in range(3)]
    n_l = normal[0] * l[0] + normal[1] * l[1] + normal[2] * l[2]
    n_half = normal[0] * half[0] + normal[1] * half[1] + normal[2] * half[2]
    n_h = n_half / torch.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    peak = torch.clamp(n_h, min=1e-20) ** (128 * material["shininess"])

    c1, c2, c3 = (lights["attenuation"][:, i, None] for i in range(3))
    attenuation = 1 / torch.clamp(c1 + c2 * distance + c3 * squared, min=1)
    weight = torch.where(distance <= scene["radius"][:, None], attenuation, 0)
    ambient = lights["ambient_intensity"][:, None] * material["ambient_intensity"]
    intensity = lights["intensity"][:, None]
    diffuse_weight = weight * (ambient + intensity * torch.clamp(n_l, min=0))
    specular_weight = weight * intensity * peak

    color = lights["color"].T
    lit = (color @ diffuse_weight) * diffuse + (color @ specular_weight) * material["specular_color"][:, None]
    visible = torch.exp(-eye_distance / (scene["fog_visibility"] - eye_distance))
    return scene["fog_color"][:, None] * (1 - visible) + visible * (material["emissive_color"][:, None] + lit)


def loss(shader: Callable[..., torch.Tensor], parameters: Any, scene: Any) -> torch.Tensor:
    """Sum of squared residuals."""
    return ((shader(parameters, scene) - scene["target"]) ** 2).sum()


class TorchEager(Contender):
    """The functions above, with one thread a core."""

    shader: ClassVar[Callable[..., torch.Tensor]] = staticmethod(shade)

    def __init__(self, work: Workload, arrays: Arrays) -> None:
        self._parameters = {k: torch.from_numpy(v.copy()) for k, v in arrays.parameters.items()}
        planes = {"position": arrays.position, "normal": arrays.normal, "target": arrays.target, "eye": arrays.eye}
        planes |= {"fog_color": arrays.fog_color, "radius": arrays.lights["radius"]}
        if arrays.sample_color is not None:
            planes["sample_color"] = arrays.sample_color
        self._scene = {k: torch.from_numpy(np.array(v)) for k, v in planes.items()}
        self._scene["fog_visibility"] = torch.tensor(arrays.fog_visibility)

    def forward_function(self) -> Callable[..., torch.Tensor]:
        return self.shader

    def loss_function(self) -> Callable[..., torch.Tensor]:
        return lambda parameters, scene: loss(self.shader, parameters, scene)

    def prepare(self, operation: Operation) -> Run:
        if operation == "forward":
            function = self.forward_function()

            def run_forward() -> torch.Tensor:
                with torch.no_grad():
                    return function(self._parameters, self._scene)

            return run_forward
        function = self.loss_function()

        def run_gradient() -> Any:
            free = {k: v.detach().requires_grad_() for k, v in self._parameters.items()}
            value = function(free, self._scene)
            return value.detach(), torch.autograd.grad(value, list(free.values()))

        return run_gradient

    def colors(self, result: Any) -> np.ndarray:
        return result.numpy()

    def value_and_gradient(self, result: Any) -> ValueAndGradient:
        gradient = dict(zip(self._parameters, (g.numpy() for g in result[1]), strict=True))
        return ValueAndGradient(float(result[0]), gradient)
