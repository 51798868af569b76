"""A problem with a whole texture free: a bumpy sheet under two point lights, seen from four places."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxlight.fit import View
from jaxlight.lighting import shade
from jaxlight.raster import SampleBuffer
from jaxlight.scene import Scene, nodes

TEXELS = 256
EYES = ((1.5, 0.0, 4.0), (-1.5, 0.5, 4.0), (0.0, 1.5, 4.0), (0.3, -1.5, 4.0))
LIGHTS = ({"location": (1.5, 2.0, 3.0), "intensity": 0.9}, {"location": (-2.0, 1.0, 3.0), "intensity": 0.5})
START = ({"location": (1.0, 1.5, 3.5), "intensity": 0.9}, {"location": (-1.5, 0.5, 3.5), "intensity": 0.7})
"""Strength against albedo is a gauge: the first light's strength is known."""


class TextureProblem(NamedTuple):
    """Start, pictures and truth."""

    scene: Scene
    views: list[View]
    free: list[Any]
    image: np.ndarray
    truth: np.ndarray
    """Of the free numbers that are no texels."""
    seen: np.ndarray
    """[height, width]: texels that a sample meets."""


def texture_problem(size: int, pixels: int) -> TextureProblem:
    """A texture of size x size x 3, pictures of pixels x pixels, in the precision that is switched on."""
    row, column = np.mgrid[0:size, 0:size] / size
    waves = [0.5 + 0.3 * np.sin(7 * column + 3 * row), 0.5 + 0.3 * np.cos(9 * row), 0.3 + 0.4 * (column < 0.5)]
    image = np.clip(np.stack(waves, axis=2) + 0.05 * np.random.default_rng(0).normal(size=(size, size, 3)), 0.05, 0.95)
    truth = _scene(image, LIGHTS)
    views, seen = [], np.zeros(size * size, bool)
    for number, eye in enumerate(EYES):
        samples, met = _sheet(size, pixels, eye, 0.25 * number)
        seen[met] = True
        picture = np.asarray(shade(truth, samples))[:, :3].reshape(pixels, pixels, 3)
        views.append(View(samples, picture, name=f"view{number}"))
    free = ["Texture[0].image", "PointLight[*].location", "PointLight[1].intensity"]
    values = np.array([*LIGHTS[0]["location"], *LIGHTS[1]["location"], LIGHTS[1]["intensity"]])
    return TextureProblem(
        _scene(np.full((size, size, 3), 0.5), START), views, free, image, values, seen.reshape(size, size)
    )


def _scene(image: np.ndarray, lights: Any) -> Scene:
    dtype = np.float64 if jax.config.jax_enable_x64 else np.float32
    body = nodes.Material(diffuse_color=(1, 1, 1), specular_color=(0.3, 0.3, 0.3), shininess=0.2, ambient_intensity=0)
    shape = nodes.Shape(appearance=nodes.Appearance(material=body, texture=nodes.PixelTexture(image=image)))
    return Scene.from_nodes([shape, *(nodes.PointLight(**light) for light in lights)], dtype=dtype)


def _sheet(size: int, pixels: int, eye: tuple[float, float, float], shift: float) -> tuple[SampleBuffer, np.ndarray]:
    """Samples of the sheet with four texels each (bilinear), and the texels that they meet."""
    across = (np.arange(pixels) + 0.5) / pixels
    u, v = np.meshgrid(across, across)
    x, y = 2 * u - 1, 2 * v - 1
    z = 0.3 * np.sin(3 * x) * np.cos(2 * y)
    normal = np.stack([-0.9 * np.cos(3 * x) * np.cos(2 * y), 0.6 * np.sin(3 * x) * np.sin(2 * y), np.ones_like(x)], -1)
    s, t = ((w.ravel() * (size - 1) + shift).clip(0, size - 1.001) for w in (u, v))
    i, j = np.floor(t).astype(int), np.floor(s).astype(int)
    f, g = t - i, s - j
    index = np.stack([i * size + j, i * size + j + 1, (i + 1) * size + j, (i + 1) * size + j + 1], 1)
    weight = np.stack([(1 - f) * (1 - g), (1 - f) * g, f * (1 - g), f * g], 1)
    samples = SampleBuffer.create(
        np.stack([x, y, z], -1).reshape(-1, 3), normal.reshape(-1, 3), eye, texel_index=index, texel_weight=weight,
        pixel=np.arange(pixels**2), width=pixels, height=pixels,
        dtype=np.float64 if jax.config.jax_enable_x64 else np.float32,
    )  # fmt: skip
    return samples, index[weight > 0]
