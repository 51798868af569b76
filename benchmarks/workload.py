"""The common scene that every contender shades: a bumpy sheet under many lights, as plain float32 NumPy arrays."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

Kind = Literal["point", "directional", "spot"]
Fields = dict[str, np.ndarray]

_LIGHTS = Path(__file__).parent / "data" / "lights.csv"
SHEET = 4.0
"""Side of the sheet: x and y run from -2 to 2."""


@dataclasses.dataclass(frozen=True)
class Workload:
    """Which scene to shade; hashable, and plain enough to travel to another process as JSON.

    `cover` is used with many small lights: the number of lights that reach a sample on average. The radius follows
    from it. `cover=0` keeps `radius`.
    """

    samples: int = 2**20
    lights: int = 8
    kind: Kind = "point"
    sample_color: bool = True
    attenuation: bool = True
    radius: float = 3.0
    specular: bool = True
    ambient: bool = True
    emissive: bool = True
    fog: Literal["NONE", "LINEAR", "EXPONENTIAL"] = "EXPONENTIAL"
    cover: float = 0.0
    dark: Literal["none", "off", "black", "far"] = "none"
    """Half of the lights: switched off, without colour, or out of reach."""
    shape: Literal["sheet", "sphere"] = "sheet"
    """The sheet, or the half of a unit sphere that faces the viewer."""

    @property
    def light_samples(self) -> int:
        """Samples times lights: what a cost is divided by."""
        return self.samples * self.lights


class Arrays(NamedTuple):
    """The scene in numbers. Planes are [3, N]; colours are RGB without encoding; world space."""

    position: np.ndarray
    normal: np.ndarray
    """Unit vectors."""
    sample_color: np.ndarray | None
    """Diffuse colour of each sample; it replaces the material's, as an X3D Color node does. None: the material's."""
    target: np.ndarray
    """What the residuals are taken against."""
    eye: np.ndarray
    fog_color: np.ndarray
    fog_visibility: float
    """Infinite without fog."""
    material: Fields
    """X3D Material fields: scalars [] and colours [3]."""
    lights: Fields
    """X3D light fields, one row a light."""
    on: np.ndarray
    """Which lights are on. Peers know no switch: they are given workloads whose lights are all on."""

    @property
    def input_bytes(self) -> int:
        """Bytes of the per-sample inputs of the forward pass."""
        planes = [self.position, self.normal] + ([] if self.sample_color is None else [self.sample_color])
        return sum(plane.nbytes for plane in planes)

    @property
    def parameters(self) -> dict[str, np.ndarray]:
        """The free fields by name: all of the material and of the lights that have a derivative somewhere.

        The radius is a jump, and its derivative is 0 by convention; a diffuse colour that the samples replace has none.
        """
        material = {k: v for k, v in self.material.items() if k != "diffuse_color" or self.sample_color is None}
        lights = {k: v for k, v in self.lights.items() if k != "radius"}
        return {f"material.{k}": v for k, v in material.items()} | {f"lights.{k}": v for k, v in lights.items()}


def make_arrays(work: Workload) -> Arrays:
    """The arrays of a workload; the same numbers every time."""
    position, normal = _sheet(work.samples) if work.shape == "sheet" else _sphere(work.samples)
    material = _material(work)
    sample_color = None
    if work.sample_color:
        tint = np.random.default_rng(1).uniform(0.2, 1.0, (3, work.samples)).astype(np.float32)
        sample_color = np.asarray(material["diffuse_color"])[:, None] * tint
    wave = np.sin(3.0 * position[0] + np.array([[0.0], [1.0], [2.0]], np.float32)) * np.cos(2.0 * position[1])
    return Arrays(
        position=position,
        normal=normal,
        sample_color=sample_color,
        target=(0.5 + 0.25 * wave).astype(np.float32),
        eye=np.array([0.3, 0.2, 6.0], np.float32),
        fog_color=np.array([0.5, 0.6, 0.7], np.float32),
        fog_visibility=math.inf if work.fog == "NONE" else 30.0,
        material=material,
        lights=_lights(work),
        on=np.arange(work.lights) % 2 == 0 if work.dark == "off" else np.ones(work.lights, bool),
    )


def _sheet(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions on z = 0.3 sin 3x cos 2y over [-2, 2]^2, and unit normals."""
    side = math.isqrt(max(samples - 1, 0)) + 1
    row, column = np.divmod(np.arange(samples), side)
    x = (column / side * SHEET - SHEET / 2).astype(np.float32).astype(np.float64)
    y = (row / side * SHEET - SHEET / 2).astype(np.float32).astype(np.float64)
    z = 0.3 * np.sin(3 * x) * np.cos(2 * y)
    slope_x, slope_y = 0.9 * np.cos(3 * x) * np.cos(2 * y), -0.6 * np.sin(3 * x) * np.sin(2 * y)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(x)]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    return np.stack([x, y, z]).astype(np.float32), normal.astype(np.float32)


def _sphere(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and normals of a unit sphere, evenly over the disc that one sees (a Fibonacci spiral)."""
    index = np.arange(samples) + 0.5
    radius, angle = np.sqrt(index / samples), index * math.pi * (3 - math.sqrt(5))
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    normal = np.stack([x, y, np.sqrt(1 - radius**2)]).astype(np.float32)
    return normal.copy(), normal


def _material(work: Workload) -> Fields:
    fields = {
        "ambient_intensity": 0.2 if work.ambient else 0.0,
        "diffuse_color": (0.8, 0.7, 0.6),
        "emissive_color": (0.02, 0.03, 0.01) if work.emissive else (0.0, 0.0, 0.0),
        "shininess": 0.2,
        "specular_color": (0.5, 0.5, 0.4) if work.specular else (0.0, 0.0, 0.0),
    }
    return {name: np.array(value, np.float32) for name, value in fields.items()}


def _lights(work: Workload) -> Fields:
    """Lights over the sheet, aimed down; with `cover`, low and small enough that so many reach a sample on average."""
    count = work.lights
    known = np.loadtxt(_LIGHTS, delimiter=",")
    more = np.random.default_rng(2).uniform(size=(max(count - len(known), 0), 6))
    u = np.concatenate([known, more])[:count]
    radius = work.radius
    height = 1 + 2 * u[:, 2]
    if work.cover:
        # Lights close to the sheet reach a disc of it; a quarter is lost beyond the edges and on slopes.
        radius = math.sqrt(1.25 * work.cover / count * SHEET**2 / math.pi)
        height = 0.3 * np.sin(3 * (4 * u[:, 0] - 2)) * np.cos(2 * (4 * u[:, 1] - 2)) + 0.1 * radius
    axis = np.stack([u[:, 3] - 0.5, u[:, 4] - 0.5, np.full(count, -1.0)], axis=1)
    fields = {
        "ambient_intensity": np.full(count, 0.1 if work.ambient else 0.0),
        "color": 0.3 + 0.7 * u[:, [5, 0, 1]],
        "intensity": np.full(count, 0.8),
    }
    if work.kind != "directional":
        fields |= {
            "attenuation": np.tile([1.0, 0.1, 0.05] if work.attenuation else [1.0, 0.0, 0.0], (count, 1)),
            "location": np.stack([4 * u[:, 0] - 2, 4 * u[:, 1] - 2, height], axis=1),
            "radius": np.full(count, radius),
        }
    if work.kind != "point":
        fields["direction"] = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    if work.kind == "spot":
        fields |= {"beam_width": np.full(count, 0.4), "cut_off_angle": np.full(count, 0.8)}
    if work.dark == "black":
        fields["color"][1::2] = 0
    if work.dark == "far":
        fields["location"][1::2] += [1000, 0, 0]
    return {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in fields.items()}
