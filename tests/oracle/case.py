"""What one evaluation of the lighting equation needs: a sample, its material, the lights, the fog, the options.

Plain frozen data shared by all oracles (`equation`, `exact`, `fast_exact`); fields and defaults are the
specification's, in snake_case. Vectors are tuples of floats in the units and frame that the node's author uses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

Vec = tuple[float, ...]
Frame = tuple[Vec, Vec, Vec]
"""Three rows of four: the affine map from a node's own coordinate system to the world."""


@dataclass(frozen=True)
class Material:
    """X3D Material: colours and factors in [0, 1]."""

    ambient_intensity: float = 0.2
    diffuse_color: Vec = (0.8, 0.8, 0.8)
    emissive_color: Vec = (0.0, 0.0, 0.0)
    shininess: float = 0.2
    specular_color: Vec = (0.0, 0.0, 0.0)
    transparency: float = 0.0


@dataclass(frozen=True)
class Light:
    """X3D DirectionalLight, PointLight or SpotLight; a field that the kind lacks is not read.

    `frame` maps the light's coordinate system to the world (None: they are the same, exactly). `in_scope` says
    whether the sample's shape lies in the light's scope (`global`, or below the light's parent group).
    """

    kind: Literal["directional", "point", "spot"] = "point"
    ambient_intensity: float = 0.0
    attenuation: Vec = (1.0, 0.0, 0.0)
    beam_width: float = math.pi / 2
    color: Vec = (1.0, 1.0, 1.0)
    cut_off_angle: float = math.pi / 4
    direction: Vec = (0.0, 0.0, -1.0)
    intensity: float = 1.0
    location: Vec = (0.0, 0.0, 0.0)
    radius: float = 100.0
    on: bool = True
    in_scope: bool = True
    frame: Frame | None = None


@dataclass(frozen=True)
class Fog:
    """X3D Fog; `frame` maps the fog's coordinate system to the world (None: they are the same, exactly)."""

    color: Vec = (1.0, 1.0, 1.0)
    fog_type: Literal["LINEAR", "EXPONENTIAL"] = "LINEAR"
    visibility_range: float = 0.0
    frame: Frame | None = None


@dataclass(frozen=True)
class Sample:
    """One point of a surface in world space.

    `eye` is the viewer's position; `color` the interpolated Color (3) or ColorRGBA (4) value; `texel` the filtered
    texture value: 1 (intensity), 2 (intensity, alpha), 3 (RGB) or 4 (RGBA) numbers.
    """

    position: Vec = (0.0, 0.0, 0.0)
    normal: Vec = (0.0, 0.0, 1.0)
    eye: Vec = (0.0, 0.0, 10.0)
    color: Vec | None = None
    texel: Vec | None = None


@dataclass(frozen=True)
class Options:
    """The documented alternatives to the default readings."""

    texture_mode: Literal["replace", "modulate"] = "replace"
    fog_unlit: bool = True
    specular_gate: bool = False
    support_level: Literal[1, 2, 3] = 3


@dataclass(frozen=True)
class Case:
    """One evaluation. No material: the shape is unlit (X3D 17.2.2.2). `line_or_point`: its geometry knows no light."""

    sample: Sample = field(default_factory=Sample)
    material: Material | None = field(default_factory=Material)
    lights: tuple[Light, ...] = ()
    fog: Fog | None = None
    options: Options = field(default_factory=Options)
    line_or_point: bool = False
    label: str = ""
