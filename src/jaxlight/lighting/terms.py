"""The lighting equation (VRML97 4.14.4, X3D 17.2.2.4) on planes of samples: the one place where it is written.

I = I_F (1 - f0) + f0 (O_E + sum_i on_i attenuation_i spot_i I_L,i (ambient_i + diffuse_i + specular_i))

Letters: p position, n unit normal, v unit vector to the viewer, l unit vector to the light, d_l and d_v distances.
Planes of samples are [rows, lanes], planes of lights and samples [lights, rows, lanes].
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import factors
from .color_sums import sums_of_colors
from .elementary import ratio
from .geometry import Geometry, inverse_distance
from .highlight import Highlight
from .stages import Stage
from .surface import MaterialRow
from .unstored import stored
from .vectors import Matrix, Vector, dot, normalised, transform, unit
from .world import WorldFog, WorldLights


class Received(NamedTuple):
    """Light that a tile receives, [3, rows, lanes]: sums over lights of colour times weight."""

    diffuse: Array
    """What multiplies O_D: the ambient and diffuse terms."""
    specular: Array | None
    """What multiplies O_S; None: skipped."""

    def __add__(self, other: Received) -> Received:  # a sum of light, not a tuple's
        return jax.tree.map(jnp.add, stored(self), stored(other))


def received(
    stage: Stage,
    lights: WorldLights,
    tile: Geometry,
    material: MaterialRow,
    *,
    highlight: Highlight | None,
    specular_gate: bool,
) -> Received:
    """attenuation * spot * I_L * (ambient + diffuse + specular), summed over lights, without O_D and O_S.

    `highlight` None: no specular term.
    """
    asked = Asked(highlight, specular_gate, lights.asks_distance and lights.to_local is None, stage.forward)
    to_viewer = None if highlight is None else tile.to_viewer
    sight = Sight(lights.towards, lights.place, tile.position, tile.normal, to_viewer, lights.axis)
    limits = Limits(lights.unit_length, lights.attenuation, lights.radius, lights.cone)
    framed = None
    if lights.asks_distance and lights.to_local is not None:
        framed = stage.each(_distance_in_frame, lights.to_local, lights.local_place, tile.position, wide=(0, 1))
    ambient = None if lights.ambient is None else stage.each(_ambient, lights.ambient, material.ambient_intensity)
    # A plane for every light: derivatives are then added up light by light, and only those sums over lights.
    exponent = None if highlight is None else stage.each(partial(_exponents, lights.count), material.shininess)
    strength = Strength(lights.intensity, ambient, exponent)
    sums = sums_of_colors(
        stage,
        lights.color,
        partial(_weights, asked),
        sight,
        limits,
        framed,
        strength,
        derive=partial(_factors, asked),
        wide=(0, 1, 3),
        shared=partial(_slopes_of_weights, asked),
        has_forms=True,
    )
    return Received(*sums)


class Asked(NamedTuple):
    """What is static of the light of some lights."""

    highlight: Highlight | None
    specular_gate: bool
    distance: bool
    """Whether the distance in the world matters."""
    forward: bool
    """Whether derivatives are only taken in forward mode."""


class Sight(NamedTuple):
    """What decides how samples see lights."""

    towards: Vector | None
    place: Vector | None
    position: Vector
    normal: Vector
    to_viewer: Vector | None
    """None: no highlights."""
    axis: Vector | None


class Limits(NamedTuple):
    """What decides how far and where lights reach."""

    unit_length: Array | None
    attenuation: tuple[Array, Array, Array] | None
    radius: Array | None
    cone: tuple[Array, Array] | None
    """Beam width and cut-off angle."""


class Strength(NamedTuple):
    """What of lights and materials weights are made of; planes [lights, 1, lanes]."""

    intensity: Array
    ambient: Array | None
    exponent: Array | None


class Aspect(NamedTuple):
    """How samples see lights; planes [lights, rows, lanes]."""

    facing: Array
    """N . L"""
    alignment: Array | None
    """N . H, as `Highlight.alignment` gives it; None: no highlights."""
    distance: Array | None
    """d_L in the world's units; None: not asked for."""
    angle: Array | None
    """Between -L and the axis of a spotlight; None: no cone."""


class Factors(NamedTuple):
    """What weights are the product of; planes [lights, rows, lanes]."""

    inverse: Array | None
    """1 / d_L; None: no place."""
    aspect: Aspect
    reach: Array | None
    """attenuation * spot * (within the radius); None: 1."""
    power: Array | None
    """The highlight, (N . H)^exponent."""


def _ambient(
    light: Float[Array, "lights 1 lanes"], material: Float[Array, "1 lanes"]
) -> Float[Array, "lights 1 lanes"]:
    return light * material


def _exponents(lights: int, shininess: Float[Array, "1 lanes"]) -> Float[Array, "lights 1 lanes"]:
    return jnp.broadcast_to(128.0 * shininess, (lights, *shininess.shape))


def _factors(
    asked: Asked, stage: Stage, sight: Sight, limits: Limits, framed: Array | None, strength: Strength
) -> tuple[Factors]:
    """The factors, in stages. The vectors to the lights are never stored: three planes cost more to keep than to
    compute anew from 1 / d_L."""
    inverse = reach = power = None
    if sight.place is not None:
        inverse = stage.each(inverse_distance, sight.place, sight.position, has_forms=True)
    aspect = stage.each(
        partial(_seen, asked), sight, derived=(inverse,), wide=(0,), shared=partial(_known, asked), has_forms=True
    )
    distance = aspect.distance if framed is None else framed
    if distance is not None or limits.cone is not None:
        reach = stage.each(_reach, distance, aspect.angle, limits, wide=(2,))
    if asked.highlight is not None:
        power = stage.each(asked.highlight.power, aspect.alignment, strength.exponent)
    return (Factors(inverse, aspect, reach, power),)


def _weights(
    asked: Asked,
    sight: Sight,
    limits: Limits,
    framed: Array | None,
    strength: Strength,
    known: Factors,
    slopes: Any = None,
    *,
    ordinary: bool,
) -> tuple[Array, Array | None]:
    """attenuation * spot * (ambient + diffuse) and attenuation * spot * specular, without colours.

    The factors are known. For derivatives, that is with `slopes`, they are functions of what they follow from: those of
    a light come from one loop.
    """
    aspect, reach = known.aspect, known.reach
    if slopes is not None:
        aspect = _seen(
            asked, sight, known.inverse, KnownAspect(aspect.alignment, aspect.angle, slopes), ordinary=ordinary
        )
        if asked.forward:  # more is read then, for all directions, and less computed for each
            aspect = jax.tree.map(_as_known, known.aspect, aspect)
        if reach is not None:
            reach = _reach(aspect.distance if framed is None else framed, aspect.angle, limits, reach)
    diffuse = strength.intensity * factors.positive_part(aspect.facing)
    diffuse = _times(reach, diffuse if strength.ambient is None else diffuse + strength.ambient)
    if asked.highlight is None or known.power is None:
        return diffuse, None
    power = asked.highlight.known_power(known.power, aspect.alignment, strength.exponent)  # type: ignore[arg-type]  # there are highlights
    specular = _times(reach, strength.intensity * power)
    return diffuse, jnp.where(aspect.facing > 0, specular, 0.0) if asked.specular_gate else specular


def _slopes_of_weights(
    asked: Asked,
    weights: Any,
    sight: Sight,
    limits: Limits,
    framed: Array | None,
    strength: Strength,
    known: Factors,
    *,
    ordinary: bool,
) -> Any:
    return _slopes(asked, known.aspect, sight, known.inverse, ordinary)


@jax.custom_jvp
def _as_known(value: Array, same: Array) -> Array:
    """The value, which is known, with the derivatives of what gives the same."""
    return value


@_as_known.defjvp
def _as_known_jvp(primals, tangents):
    return primals[0], tangents[1]


class KnownAspect(NamedTuple):
    """What is known of an aspect when derivatives are taken."""

    alignment: Array | None
    angle: Array | None
    slopes: Any
    """`Highlight.slopes`; (): no highlights."""


def _known(asked: Asked, aspect: Aspect, sight: Sight, inverse: Array | None, *, ordinary: bool) -> KnownAspect:
    return KnownAspect(aspect.alignment, aspect.angle, _slopes(asked, aspect, sight, inverse, ordinary))


def _slopes(asked: Asked, aspect: Aspect, sight: Sight, inverse: Array | None, ordinary: bool) -> Any:
    if asked.highlight is None or aspect.alignment is None or sight.to_viewer is None:
        return ()
    l, _ = _light_vector(sight, inverse, ordinary)
    return asked.highlight.slopes(aspect.alignment, sight.normal, l, sight.to_viewer, ordinary)


def _light_vector(sight: Sight, inverse: Array | None, ordinary: bool) -> tuple[Vector, Array | None]:
    """L, and d_L for lights that have a place."""
    if sight.place is None or inverse is None:
        assert sight.towards is not None
        return sight.towards, None
    return normalised(sight.place - sight.position, inverse, ordinary)


def _seen(
    asked: Asked, sight: Sight, inverse: Array | None, known: KnownAspect | None = None, *, ordinary: bool
) -> Aspect:
    """`inverse`: 1 / d_L; `known`: for derivatives."""
    l, distance = _light_vector(sight, inverse, ordinary)
    alignment = angle = None
    if asked.highlight is not None and sight.to_viewer is not None:
        seen = (sight.normal, l, sight.to_viewer)
        if known is None or known.alignment is None:
            alignment = asked.highlight.alignment(*seen, ordinary)
        else:
            alignment = asked.highlight.known_alignment(ordinary, known.alignment, known.slopes, *seen)
    if sight.axis is not None:
        if known is None or known.angle is None:
            angle = factors.angle_between(-l, sight.axis)
        else:
            angle = factors.known_angle(known.angle, -l, sight.axis)
    return Aspect(dot(sight.normal, l), alignment, distance if asked.distance else None, angle)


def _distance_in_frame(to_local: Matrix, local_place: Vector, position: Vector) -> Array:
    return unit(local_place - transform(to_local, position))[1]


def _reach(distance: Array | None, angle: Array | None, limits: Limits, known: Array | None = None) -> Array:
    """attenuation * spot * (within the radius).

    Args:
        known: what this gives, for derivatives. Without a cone that is the attenuation, or 0 beyond the radius, where
            derivatives are 0 too.
    """
    spot = None if limits.cone is None or angle is None else factors.spot(angle, *limits.cone)
    if distance is None:
        assert spot is not None
        return spot
    if limits.unit_length is not None:
        distance = ratio(distance, limits.unit_length)
    if limits.attenuation is None:
        factor = jnp.ones_like(distance)
    elif known is None or spot is not None:
        factor = factors.attenuation(*limits.attenuation, distance)
    else:
        factor = factors.known_attenuation(known, *limits.attenuation, distance)
    factor = _times(spot, factor)
    # A sample is lit at d == radius.
    return factor if limits.radius is None else jnp.where(distance <= limits.radius, factor, 0.0)


def _times(factor: Array | None, value: Array) -> Array:
    return value if factor is None else factor * value


def lit(
    material: MaterialRow, diffuse_color: Float[Array, "3 #rows #lanes"], light: Received | None, *, emissive: bool
) -> Float[Array, "3 #rows #lanes"]:
    """O_E + O_D * (ambient and diffuse light) + O_S * (specular light); the material's colours on all lanes."""
    color = material.emissive_color if emissive else jnp.zeros_like(material.emissive_color)
    if light is None:
        return color
    color = color + diffuse_color * light.diffuse
    return color if light.specular is None else color + material.specular_color * light.specular


class Haze(NamedTuple):
    """The fog between samples and viewer; planes [rows, lanes]."""

    clear: Array
    """f0"""
    hidden: Array
    """1 - f0"""


def haze(stage: Stage, fog: WorldFog, fog_type: str, tile: Geometry) -> Haze:
    """The fog interpolant, with d_V measured in the fog's coordinate system."""
    distance = tile.distance
    if fog.to_local is not None:
        distance = stage.each(_distance_in_fog, fog.to_local, tile.eye, tile.position, wide=(0,))
    interpolant = factors.linear_fog if fog_type == "LINEAR" else factors.exponential_fog
    return Haze(*stage.each(interpolant, distance, fog.visibility_range, wide=(1,)))


def _distance_in_fog(to_local: Matrix, eye: Vector, position: Vector) -> Array:
    return unit(transform(to_local, eye - position))[1]


def fogged(
    color: Float[Array, "3 #rows #lanes"], fog_color: Float[Array, "3 1 lanes"], haze: Haze
) -> Float[Array, "3 rows lanes"]:
    """I_F (1 - f0) + f0 color."""
    return fog_color * haze.hidden + haze.clear * color
