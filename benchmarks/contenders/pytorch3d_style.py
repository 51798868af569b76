"""PyTorch3D's lighting functions (`pytorch3d/renderer/lighting.py`) rewritten as a user would for this equation.

Kept from there: [N, 3] tensors, `diffuse` and `specular` as separate functions that each normalise what they are given
with `F.normalize`, one call per light. Changed: the half vector instead of the reflected one, no mask where N.L <= 0.
Added: attenuation, radius, ambient term and fog, which PyTorch3D lacks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from ..workload import Arrays, Workload
from .base import split
from .torch_eager import TorchEager


def diffuse(normals: torch.Tensor, color: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """[N, 3]: the light's colour times max(N.L, 0)."""
    normals = F.normalize(normals, p=2, dim=-1, eps=1e-6)
    direction = F.normalize(direction, p=2, dim=-1, eps=1e-6)
    angle = F.relu(torch.sum(normals * direction, dim=-1))
    return color * angle[..., None]


def specular(
    points: torch.Tensor,
    normals: torch.Tensor,
    direction: torch.Tensor,
    color: torch.Tensor,
    camera_position: torch.Tensor,
    shininess: torch.Tensor,
) -> torch.Tensor:
    """[N, 3]: the light's colour times max(N.H, 0)^shininess."""
    normals = F.normalize(normals, p=2, dim=-1, eps=1e-6)
    direction = F.normalize(direction, p=2, dim=-1, eps=1e-6)
    view_direction = F.normalize(camera_position - points, p=2, dim=-1, eps=1e-6)
    half_direction = F.normalize(direction + view_direction, p=2, dim=-1, eps=1e-6)
    alpha = F.relu(torch.sum(normals * half_direction, dim=-1))
    return color * torch.pow(alpha, shininess)[..., None]


def shade(parameters: Any, scene: Any) -> torch.Tensor:
    """[N, 3]."""
    material, lights = split(parameters)
    points, normals = scene["position"], scene["normal"]
    texels = scene["sample_color"] if "sample_color" in scene else material["diffuse_color"]
    exponent = 128 * material["shininess"]
    colors = material["emissive_color"].expand(points.shape)
    for i in range(len(lights["location"])):
        direction = lights["location"][i] - points
        distance = torch.linalg.vector_norm(direction, dim=-1)
        c1, c2, c3 = lights["attenuation"][i]
        falloff = 1 / torch.clamp(c1 + c2 * distance + c3 * distance**2, min=1)
        falloff = torch.where(distance <= scene["radius"][i], falloff, 0)[..., None]
        color, intensity = lights["color"][i], lights["intensity"][i]
        ambient = color * lights["ambient_intensity"][i] * material["ambient_intensity"]
        diffuse_color = diffuse(normals, color * intensity, direction)
        specular_color = specular(points, normals, direction, color * intensity, scene["eye"], exponent)
        colors = colors + falloff * ((ambient + diffuse_color) * texels + specular_color * material["specular_color"])
    distance = torch.linalg.vector_norm(scene["eye"] - points, dim=-1, keepdim=True)
    visible = torch.exp(-distance / (scene["fog_visibility"] - distance))
    return scene["fog_color"] * (1 - visible) + visible * colors


class PyTorch3DStyle(TorchEager):
    """The functions above, eager, with autograd."""

    shader = staticmethod(shade)

    def __init__(self, work: Workload, arrays: Arrays) -> None:
        super().__init__(work, arrays)
        for name in ("position", "normal", "target", "sample_color"):
            if name in self._scene:
                self._scene[name] = self._scene[name].T.contiguous()

    def colors(self, result: Any) -> np.ndarray:
        return result.numpy().T
