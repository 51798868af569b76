"""The lighting equation (VRML97 4.14.4, X3D 17.2.2.4) on planes of samples: the one place where it is written.

I = I_F (1 - f0) + f0 (O_E + sum_i on_i attenuation_i spot_i I_L,i (ambient_i + diffuse_i + specular_i))

Letters: p position, n unit normal, v unit vector to the viewer, l unit vector to the light, d_l and d_v distances.
Samples lie along the last axis; lights along the one before.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from . import factors
from .surface import MaterialRow
from .vectors import Vector, dot, transform, unit
from .world import WorldFog, WorldLights


class View(NamedTuple):
    """What a sample sees of the viewer: unit normal, unit vector to the viewer, and the vector and distance to it."""

    normal: Vector
    to_viewer: Vector
    offset: Vector
    distance: Array


class LightWeights(NamedTuple):
    """Per light and sample [lights, samples]: what multiplies the light's colour in each term; None: skipped."""

    reaching: Array | None
    """on * attenuation * spot, the weight of the ambient term."""
    diffuse: Array
    specular: Array | None


def view_of(position: Vector, normal: Vector, eye: Float[Array, "3"]) -> View:
    """Normalised geometry of the samples."""
    offset = Vector(eye[0], eye[1], eye[2]) - position
    to_viewer, distance = unit(offset)
    return View(unit(normal)[0], to_viewer, offset, distance)


def light_weights(
    lights: WorldLights, position: Vector, view: View, exponent: Array | None, *, ambient: bool, specular_gate: bool
) -> LightWeights:
    """The weights of all lights of one kind. `exponent` = 128 shininess; None: no specular term."""
    if lights.place is None:
        l, reaching = lights.towards, None
    else:
        l, reaching = _reaching(lights, position)
    n_dot_l = dot(view.normal, l)
    diffuse = jnp.where(n_dot_l > 0, n_dot_l, 0.0)
    specular = None
    if exponent is not None:
        specular = factors.highlight(view.normal, l, view.to_viewer, exponent)
        if specular_gate:
            specular = jnp.where(n_dot_l > 0, specular, 0.0)
    if reaching is not None:
        diffuse = diffuse * reaching
        specular = None if specular is None else specular * reaching
    elif ambient:
        reaching = jnp.ones_like(diffuse)
    return LightWeights(reaching if ambient else None, diffuse, specular)


def _reaching(lights: WorldLights, position: Vector) -> tuple[Vector, Array | None]:
    """L, and attenuation * spot * (within radius) of point and spot lights; None: 1."""
    offset = lights.place - position
    l, d = unit(offset)
    if lights.to_local is not None:
        d = unit(transform(lights.to_local, offset))[1]
    elif lights.unit_length is not None:
        d = d / lights.unit_length
    reaching = None
    if lights.attenuation is not None:
        reaching = factors.attenuation(*lights.attenuation, d)
    if lights.axis is not None:
        spot = factors.spot(l, lights.axis, lights.beam_width, lights.cut_off_angle)
        reaching = spot if reaching is None else reaching * spot
    if lights.radius is not None:
        # A sample is lit at d == radius, and never by a light of radius 0 unless it lies on it.
        reaching = jnp.where(d <= lights.radius, 1.0 if reaching is None else reaching, 0.0)
    return l, reaching


def lit_color(
    material: MaterialRow,
    diffuse_color: Float[Array, "3 #samples"],
    kinds: list[tuple[WorldLights, LightWeights, Array | None]],
    *,
    emissive: bool,
) -> Float[Array, "3 #samples"]:
    """O_E + sum over the lights; `kinds`: lights of each kind, their weights, and which of them are in scope."""
    color = material.emissive_color[:, None] if emissive else jnp.zeros_like(material.emissive_color)[:, None]
    for lights, weights, in_scope in kinds:
        direct, ambient = lights.direct, lights.ambient
        if in_scope is not None:
            direct = jnp.where(in_scope, direct, 0.0)
        received = _weighted_colors(direct, weights.diffuse)
        if weights.reaching is not None and ambient is not None:
            ambient = ambient * material.ambient_intensity
            if in_scope is not None:
                ambient = jnp.where(in_scope, ambient, 0.0)
            received = received + _weighted_colors(ambient, weights.reaching)
        color = color + diffuse_color * received
        if weights.specular is not None:
            color = color + material.specular_color[:, None] * _weighted_colors(direct, weights.specular)
    return color


def _weighted_colors(colors: Float[Array, "3 lights"], weights: Array) -> Float[Array, "3 samples"]:
    """Sum over lights of color * weight, in full precision on every backend."""
    if colors.shape[1] == 1:
        return colors * weights
    return jnp.dot(colors, weights, precision=lax.Precision.HIGHEST)


def fogged(color: Float[Array, "3 #samples"], fog: WorldFog, fog_type: str, view: View) -> Float[Array, "3 samples"]:
    """I_F (1 - f0) + f0 color, with d_V measured in the fog's coordinate system."""
    distance = view.distance if fog.to_local is None else unit(transform(fog.to_local, view.offset))[1]
    interpolant = factors.linear_fog if fog_type == "LINEAR" else factors.exponential_fog
    clear, hidden = interpolant(distance, fog.visibility_range)
    return fog.color[:, None] * hidden + clear * color
