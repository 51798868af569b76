"""Spheres for the tests of fitting: scenes, samples, and their pictures by a plain NumPy rendering of the equation."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from jaxlight import SampleBuffer, Scene, nodes

MATERIAL = {
    "diffuse_color": (0.6, 0.3, 0.2),
    "specular_color": (0.5, 0.4, 0.3),
    "shininess": 0.3,
    "ambient_intensity": 0.2,
    "name": "body",
}
KEY = {"location": (1.5, 2.0, 3.0), "color": (1.0, 0.9, 0.8), "intensity": 0.9, "name": "key"}
EYE = (0.0, 0.0, 4.0)

PRECISIONS = ("float32", "float32 with x64", "float64")


@contextlib.contextmanager
def precision(name: str) -> Iterator[Any]:
    """Run in this precision; gives the float type of scenes and samples."""
    with jax.enable_x64(name != "float32"):
        yield np.float64 if name == "float64" else np.float32


def material(**changes: Any) -> nodes.Material:
    """The material `body`."""
    return nodes.Material(**{**MATERIAL, **changes})


def key_light(**changes: Any) -> nodes.PointLight:
    """The point light `key`."""
    return nodes.PointLight(**{**KEY, **changes})


def sphere_scene(*lights: nodes.Node, body: nodes.Material | None = None, dtype: Any = None) -> Scene:
    """A sphere of material `body` under the lights (default: `key`)."""
    shape = nodes.Shape(appearance=nodes.Appearance(material=body or material()), geometry=nodes.Sphere())
    return Scene.from_nodes([shape, *(lights or (key_light(),))], dtype=dtype)


def sphere_points(size: int) -> tuple[np.ndarray, np.ndarray]:
    """(points [N, 3] of the unit sphere as seen along -z, pixel [N]) of a picture of size x size."""
    centres = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(centres, -centres)
    seen = x**2 + y**2 < 0.998
    points = np.stack([x[seen], y[seen], np.sqrt(1 - x[seen] ** 2 - y[seen] ** 2)], axis=1)
    return points, np.flatnonzero(seen)


def sphere_samples(size: int, *, dtype: Any = None, eye: Any = EYE, **more: Any) -> SampleBuffer:
    """Samples of the unit sphere, one a pixel."""
    points, pixel = sphere_points(size)
    return SampleBuffer.create(
        position=points, normal=points, eye=eye, pixel=pixel, width=size, height=size, dtype=dtype, **more
    )


def sphere_picture(
    size: int, *lights: nodes.Node, body: nodes.Material | None = None, noise: float = 0.0, seed: int = 0
) -> np.ndarray:
    """[size, size, 3]: the sphere by the lighting equation (X3D 17.2.2.4) in NumPy float64; 0 where it is not seen.

    Point and directional lights that are global; no fog, no texture.
    """
    points, pixel = sphere_points(size)
    body = body or material()
    diffuse, specular = np.array(body.diffuse_color), np.array(body.specular_color)
    to_eye = _unit(np.array(EYE) - points)
    color = np.repeat(np.array(body.emissive_color)[None], len(points), axis=0)
    for light in lights or (key_light(),):
        fade = np.ones(len(points))
        if isinstance(light, nodes.PointLight):
            away = np.array(light.location) - points
            distance = np.linalg.norm(away, axis=1)
            to_light = away / distance[:, None]
            c1, c2, c3 = light.attenuation
            fade = (distance <= light.radius) / np.maximum(c1 + c2 * distance + c3 * distance**2, 1)
        else:
            to_light = np.repeat(_unit(-np.array(light.direction))[None], len(points), axis=0)
        n_dot_l = np.maximum(np.sum(points * to_light, axis=1), 0)
        n_dot_h = np.maximum(np.sum(points * _unit(to_light + to_eye), axis=1), 0)
        shine = n_dot_h ** (body.shininess * 128)
        ambient = light.ambient_intensity * diffuse * body.ambient_intensity
        direct = light.intensity * (n_dot_l[:, None] * diffuse + shine[:, None] * specular)
        color += fade[:, None] * np.array(light.color) * (ambient + direct)
    color += noise * np.random.default_rng(seed).normal(size=color.shape)
    picture = np.zeros((size * size, 3))
    picture[pixel] = color
    return picture.reshape(size, size, 3)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
