"""The VRML97 / X3D lighting equation in plain NumPy float64, one sample at a time, straight from the specification.

Sources: VRML97 4.14 and X3D 17.2.2 (tables 17.2 to 17.5), X3D FCD 17.3 to 17.5 (nodes, scoping, support levels).
Where the texts leave a choice, the numbers in brackets are those of the project's table of readings.
"""

from __future__ import annotations

import math

import numpy as np

from .case import Case, Fog, Light, Material, Options, Sample
from .paths import is_live

__all__ = [
    "attenuation",
    "brightest",
    "diffuse_factor",
    "fog_interpolant",
    "lit_color",
    "shade",
    "spot_factor",
    "unlit_color",
]


def shade(case: Case) -> tuple[np.ndarray, float]:
    """Colour [3] and alpha of the case's sample."""
    sample, material, options = case.sample, case.material, case.options
    if case.line_or_point and material is not None:
        rgb, alpha = line_color(sample, material)
        lit = False
    elif case.line_or_point or material is None:
        rgb, alpha = unlit_color(sample, options)
        lit = False
    else:
        rgb, alpha = lit_color(sample, material, case.lights, options)
        lit = True
    if case.fog is not None and (lit or options.fog_unlit):  # [4]
        f0 = fog_interpolant(case.fog, sample)
        rgb = np.array(case.fog.color) * (1.0 - f0) + f0 * rgb
    return rgb, alpha


# --- colour tables ----------------------------------------------------------------------------------------------------


def unlit_color(sample: Sample, options: Options) -> tuple[np.ndarray, float]:
    """Table 17.2: colour and alpha of an unlit shape; without a Color node, white."""
    color = np.ones(3) if sample.color is None else np.array(sample.color[:3])
    return textured(color, vertex_opacity(sample, 1.0), sample.texel, options)


def diffuse_factor(sample: Sample, material: Material, options: Options) -> tuple[np.ndarray, float]:
    """Table 17.3: the diffuse factor O_D [3] and alpha of a lit shape; without a Color node, diffuseColor."""
    color = np.array(material.diffuse_color if sample.color is None else sample.color[:3])
    return textured(color, vertex_opacity(sample, 1.0 - material.transparency), sample.texel, options)


def textured(
    color: np.ndarray, opacity: float, texel: tuple[float, ...] | None, options: Options
) -> tuple[np.ndarray, float]:
    """The rows of tables 17.2 and 17.3: what a texture makes of the colour and opacity without it [1, 2, 3]."""
    match texel:
        case None:
            return color, opacity
        case (i_t,):
            return i_t * color, opacity
        case (i_t, a_t):
            return i_t * color, texture_alpha(a_t, opacity, options)
        case (_, _, _):
            return texture_color(texel, color, options), opacity
        case (_, _, _, a_t):
            return texture_color(texel, color, options), texture_alpha(a_t, opacity, options)
    raise ValueError(f"texel: expected 1 to 4 numbers, got {len(texel)}")


def line_color(sample: Sample, material: Material) -> tuple[np.ndarray, float]:
    """Lines and points with a Material: its emissiveColor [24], unless they have colours of their own."""
    color = material.emissive_color if sample.color is None else sample.color[:3]
    return np.array(color), vertex_opacity(sample, 1.0 - material.transparency)


def vertex_opacity(sample: Sample, otherwise: float) -> float:
    """The alpha of a per-vertex RGBA colour stands in for the material's opacity [25]."""
    return sample.color[3] if sample.color is not None and len(sample.color) == 4 else otherwise


def texture_color(texel: tuple[float, ...], color: np.ndarray, options: Options) -> np.ndarray:
    """RGB textures replace the colour (tables) or are modulated by it (prose) [1]."""
    return np.array(texel[:3]) * (color if options.texture_mode == "modulate" else 1.0)


def texture_alpha(alpha: float, opacity: float, options: Options) -> float:
    """Alpha textures replace the opacity (tables) or are modulated by it (prose) [2]."""
    return alpha * opacity if options.texture_mode == "modulate" else alpha


# --- lighting 'on' (17.2.2.4) -----------------------------------------------------------------------------------------


def lit_color(
    sample: Sample, material: Material, lights: tuple[Light, ...], options: Options
) -> tuple[np.ndarray, float]:
    """O_E + SUM(on x attenuation x spot x I_L x (ambient + diffuse + specular)), before fog; and alpha."""
    o_d, alpha = diffuse_factor(sample, material, options)
    rgb = np.array(material.emissive_color, dtype=np.float64)
    for light in lights:
        rgb = rgb + light_contribution(light, sample, material, o_d, options)
    return rgb, alpha


def light_contribution(
    light: Light, sample: Sample, material: Material, o_d: np.ndarray, options: Options
) -> np.ndarray:
    """One light's part of the sum, [3]."""
    if not affects(light, sample, options):
        return np.zeros(3)
    point = np.array(sample.position)
    to_light = light_vector(light, point)
    n = unit(np.array(sample.normal))
    l = unit(to_light)
    v = unit(np.array(sample.eye) - point)
    h = unit(l + v)

    ambient = light.ambient_intensity * o_d * material.ambient_intensity  # without intensity [29]
    diffuse = light.intensity * o_d * modified_dot(n, l)
    # 0 ** 0 is 1 [17]; a light behind the surface may give a highlight [16].
    specular = light.intensity * np.array(material.specular_color) * modified_dot(n, h) ** (material.shininess * 128.0)
    if options.specular_gate and not np.dot(n, l) > 0.0:
        specular = np.zeros(3)
    factor = 1.0
    if light.kind != "directional":
        factor = attenuation(light, light_distance(light, point), options)
    if light.kind == "spot":
        axis = linear(light.frame) @ np.array(light.direction)
        factor = factor * spot_factor(light, spot_angle(-l, axis))
    return factor * np.array(light.color) * (ambient + diffuse + specular)


def brightest(case: Case) -> np.ndarray:
    """What the colour [3] cannot exceed: every live light, unattenuated and head-on; or the fog's colour."""
    if case.material is None or case.line_or_point:
        return np.ones(3)
    o_d, _ = diffuse_factor(case.sample, case.material, case.options)
    rgb = np.array(case.material.emissive_color)
    for light in case.lights:
        if is_live(light, case.options):
            ambient = light.ambient_intensity * case.material.ambient_intensity * o_d
            direct = light.intensity * (o_d + np.array(case.material.specular_color))
            rgb = rgb + np.array(light.color) * (ambient + direct)
    return rgb if case.fog is None else np.maximum(rgb, case.fog.color)


def affects(light: Light, sample: Sample, options: Options) -> bool:
    """on_i: the `on` field, the scope [8], the radius [9, 28] and the support level [22]."""
    if not light.on:
        return False
    if light.kind == "directional":
        return light.in_scope or options.support_level < 3  # levels 1 and 2 know no scope of DirectionalLight
    if options.support_level == 1 or not light.in_scope:
        return False
    return light_distance(light, np.array(sample.position)) <= light.radius


def attenuation(light: Light, distance: float, options: Options) -> float:
    """1 / max(c1 + c2 d + c3 d^2, 1) [20]; support level 2: linear."""
    c1, c2, c3 = light.attenuation
    quadratic = 0.0 if options.support_level == 2 else c3 * distance * distance
    return 1.0 / max(c1 + c2 * distance + quadratic, 1.0)


def light_vector(light: Light, point: np.ndarray) -> np.ndarray:
    """From the point towards the light, in the world, of any length."""
    if light.kind == "directional":
        return -(linear(light.frame) @ np.array(light.direction))
    return linear(light.frame) @ np.array(light.location) + offset(light.frame) - point


def light_distance(light: Light, point: np.ndarray) -> float:
    """d_L: from the light to the point in the light's coordinate system [9, 10]."""
    local = np.linalg.solve(linear(light.frame), point - offset(light.frame))
    return length(local - np.array(light.location))


def spot_angle(from_light: np.ndarray, axis: np.ndarray) -> float:
    """The angle between two vectors, 0 to pi; a zero vector has dot product 0 and so angle pi / 2 [12, 19]."""
    if length(from_light) == 0.0 or length(axis) == 0.0:
        return math.pi / 2
    a, b = unit(from_light), unit(axis)
    return math.atan2(length(np.cross(a, b)), float(np.dot(a, b)))


def spot_factor(light: Light, angle: float) -> float:
    """Table 17.4, conditions in order; without a ramp when beamWidth >= cutOffAngle [13]."""
    if angle >= light.cut_off_angle:
        return 0.0
    if angle <= light.beam_width:
        return 1.0
    return (angle - light.cut_off_angle) / (light.beam_width - light.cut_off_angle)


def fog_interpolant(fog: Fog, sample: Sample) -> float:
    """Table 17.5: f0 from d_V in the fog's coordinate system [5, 7]."""
    visibility = fog.visibility_range
    if visibility <= 0.0:
        return 1.0
    d_v = length(np.linalg.solve(linear(fog.frame), np.array(sample.eye) - np.array(sample.position)))
    if d_v >= visibility:
        return 0.0
    if fog.fog_type == "LINEAR":
        return (visibility - d_v) / visibility
    return math.exp(-d_v / (visibility - d_v))


# --- vectors ----------------------------------------------------------------------------------------------------------


def linear(frame: tuple | None) -> np.ndarray:
    """The linear part [3, 3] of a frame."""
    return np.eye(3) if frame is None else np.array(frame, dtype=np.float64)[:, :3]


def offset(frame: tuple | None) -> np.ndarray:
    """The origin [3] of a frame in the world."""
    return np.zeros(3) if frame is None else np.array(frame, dtype=np.float64)[:, 3]


def length(vector: np.ndarray) -> float:
    """Euclidean length without overflow of squares."""
    return math.hypot(*vector)


def unit(vector: np.ndarray) -> np.ndarray:
    """The vector divided by its length; the zero vector stays zero [19]."""
    size = length(vector)
    return vector / size if size > 0.0 else np.zeros(3)


def modified_dot(a: np.ndarray, b: np.ndarray) -> float:
    """The dot product, 0 where it is negative."""
    return max(float(np.dot(a, b)), 0.0)
