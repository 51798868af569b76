"""The lighting equation (VRML97 4.14.4, X3D 17.2.2.4) on planes of samples: the one place where it is written.

I = I_F (1 - f0) + f0 (O_E + sum_i on_i attenuation_i spot_i I_L,i (ambient_i + diffuse_i + specular_i))

Letters: p position, n unit normal, v unit vector to the viewer, l unit vector to the light, d_l and d_v distances.
Planes of samples are [rows, lanes], planes of lights and samples [lights, rows, lanes].
"""

from __future__ import annotations

import operator
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from . import factors
from .elementary import ratio
from .highlight import Highlight
from .stages import Stage
from .surface import MaterialRow
from .unstored import Inlined, stored
from .vectors import (
    Matrix,
    Vector,
    dot,
    inverse_length,
    inverse_length_in_range,
    normalised,
    transform,
    unit,
    unit_planes,
)
from .world import WorldFog, WorldLights


class Geometry(NamedTuple):
    """What a tile of samples knows of itself and the viewer; planes [rows, lanes]."""

    position: Vector
    eye: Vector
    """The viewer's position, [1, 1] each."""
    normal: Vector
    """Unit normal."""
    to_viewer: Vector
    """Unit vector to the viewer."""
    distance: Array
    """Distance to the viewer."""


class Unread(NamedTuple):
    """Vectors or colours of samples where they lie in memory, in the two forms that XLA reads at full speed."""

    components: tuple[Array, ...]
    """For loops over samples."""
    planes: Float[Array, "components rows lanes"] | None
    """For loops over samples and components; None: not read in such loops."""

    @property
    def vector(self) -> Vector:
        """Three components."""
        return Vector(*self.components)

    def stacked(self) -> Float[Array, "components rows lanes"]:
        """All components in one."""
        return jnp.stack(self.components) if self.planes is None else self.planes


def directions(
    stage: Stage, position: Unread, normal: Unread, eye: Float[Array, "3 1 1"]
) -> tuple[Vector, Vector, Array]:
    """The unit normal, the unit vector to the viewer, and the distance to it."""
    viewer = _components(eye)
    inverse = stage.each(_inverse_distance, viewer, position.vector, has_forms=True)
    to_viewer = stage.each(_directions, eye, position.stacked(), derived=(inverse,))
    distance = stage.each(_distance, viewer, position.vector, derived=(inverse,), has_forms=True)
    unit_normal = stage.each(unit_planes, normal.stacked(), derived=(stage.each(inverse_length, normal.vector),))
    return _components(unit_normal), _components(to_viewer), distance


def _inverse_distance(end: Vector, start: Vector, *, ordinary: bool) -> Array:
    return (inverse_length_in_range if ordinary else inverse_length)(end - start)


def _components(planes: Float[Array, "3 ..."]) -> Vector:
    return Vector(*(cast(Array, Inlined(operator.itemgetter(i), (planes,))) for i in range(3)))


def _directions(end: Array, start: Array, inverse: Array) -> Array:
    return unit_planes(end - start, inverse)


def _distance(end: Vector, start: Vector, inverse: Array, *, ordinary: bool) -> Array:
    return normalised(end - start, inverse, ordinary)[1]


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
    aspect = _aspect(stage, lights, tile, highlight)
    reaching = _reaching(stage, lights, tile, aspect)
    ambient = None if lights.ambient is None else stage.each(_ambient, lights.ambient, material.ambient_intensity)
    exponent = power = None
    if highlight is not None and aspect.alignment is not None:
        # A plane for every light: derivatives are then added up light by light, and only those sums over lights.
        exponent = stage.each(partial(_exponents, lights.count), material.shininess)
        power = stage.each(highlight.power, aspect.alignment, exponent)
    for_diffuse, for_specular = stage.each(
        partial(_weights, highlight, specular_gate),
        reaching,
        (aspect.facing, aspect.alignment),
        lights.intensity,
        ambient,
        exponent,
        derived=(power,),
        wide=(2, 3, 4),
    )
    weights = [for_diffuse] if for_specular is None else [for_diffuse, for_specular]
    diffuse, *specular = _sums_of_colors(stage, lights.color, weights)
    return Received(diffuse, specular[0] if specular else None)


def _ambient(
    light: Float[Array, "lights 1 lanes"], material: Float[Array, "1 lanes"]
) -> Float[Array, "lights 1 lanes"]:
    return light * material


def _exponents(lights: int, shininess: Float[Array, "1 lanes"]) -> Float[Array, "lights 1 lanes"]:
    return jnp.broadcast_to(128.0 * shininess, (lights, *shininess.shape))


def _weights(
    highlight: Highlight | None,
    specular_gate: bool,
    reaching: Array | None,
    seen: tuple[Array, Array | None],
    intensity: Array,
    ambient: Array | None,
    exponent: Array | None,
    power: Array | None,
) -> tuple[Array, Array | None]:
    """attenuation * spot * (ambient + diffuse) and attenuation * spot * specular, without colours.

    `power`: the highlight, (N . H)^exponent.
    """
    facing, alignment = seen
    diffuse = intensity * factors.positive_part(facing)
    diffuse = _times(reaching, diffuse if ambient is None else diffuse + ambient)
    if highlight is None or power is None or exponent is None or alignment is None:
        return diffuse, None
    specular = _times(reaching, intensity * highlight.known_power(power, alignment, exponent))
    return diffuse, jnp.where(facing > 0, specular, 0.0) if specular_gate else specular


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


def _aspect(stage: Stage, lights: WorldLights, tile: Geometry, highlight: Highlight | None) -> Aspect:
    """How a tile sees lights.

    The vectors to the lights are never stored: three planes cost more to keep than to compute anew from 1 / d_L.
    """
    place, position, inverse = lights.place, tile.position, None
    if place is not None:
        inverse = stage.each(_inverse_distance, place, position, has_forms=True)
    return stage.each(
        partial(_seen, highlight, lights.asks_distance and lights.to_local is None),
        lights.towards,
        place,
        position,
        tile.normal,
        None if highlight is None else tile.to_viewer,
        lights.axis,
        derived=(inverse,),
        wide=(0, 1, 2, 3, 4, 5),
        shared=None if highlight is None else partial(_slopes, highlight),
        has_forms=True,
    )


def _light_vector(
    towards: Vector | None, place: Vector | None, position: Vector, inverse: Array | None, ordinary: bool
) -> tuple[Vector, Array | None]:
    """L, and d_L for lights that have a place."""
    if place is None:
        assert towards is not None
        return towards, None
    assert inverse is not None
    return normalised(place - position, inverse, ordinary)


def _seen(
    highlight: Highlight | None,
    asks_distance: bool,
    towards: Vector | None,
    place: Vector | None,
    position: Vector,
    normal: Vector,
    to_viewer: Vector | None,
    axis: Vector | None,
    inverse: Array | None,
    slopes: Any = None,
    *,
    ordinary: bool,
) -> Aspect:
    """`inverse`: 1 / d_L; `slopes`: what `_slopes` gives, for derivatives."""
    l, distance = _light_vector(towards, place, position, inverse, ordinary)
    alignment = None
    if highlight is not None and to_viewer is not None:
        seen = (normal, l, to_viewer)
        if slopes is None:
            alignment = highlight.alignment(*seen, ordinary)
        else:
            alignment = highlight.known_alignment(ordinary, slopes, *seen)
    return Aspect(
        facing=dot(normal, l),
        alignment=alignment,
        distance=distance if asks_distance else None,
        angle=None if axis is None else factors.angle_between(-l, axis),
    )


def _slopes(
    highlight: Highlight,
    aspect: Aspect,
    towards: Vector | None,
    place: Vector | None,
    position: Vector,
    normal: Vector,
    to_viewer: Vector | None,
    axis: Vector | None,
    inverse: Array | None,
    *,
    ordinary: bool,
) -> Any:
    """`Highlight.slopes` of what `_seen` gives."""
    l, _ = _light_vector(towards, place, position, inverse, ordinary)
    assert to_viewer is not None and aspect.alignment is not None
    return highlight.slopes(aspect.alignment, normal, l, to_viewer, ordinary)


def _reaching(stage: Stage, lights: WorldLights, tile: Geometry, aspect: Aspect) -> Array | None:
    """attenuation * spot * (within the radius); None: 1."""
    distance = aspect.distance
    if lights.asks_distance and lights.to_local is not None:
        distance = stage.each(_distance_in_frame, lights.to_local, lights.local_place, tile.position)
    cone = None if aspect.angle is None else (aspect.angle, lights.beam_width, lights.cut_off_angle)
    if distance is None and cone is None:
        return None
    known = _known_attenuation if cone is None and lights.attenuation is not None else None
    operands = (distance, lights.unit_length, lights.attenuation, lights.radius, cone)
    return stage.each(_reach, *operands, wide=(2,), shared=known)


def _distance_in_frame(to_local: Matrix, local_place: Vector, position: Vector) -> Array:
    return unit(local_place - transform(to_local, position))[1]


def _known_attenuation(reach: Array, *_: Any) -> Array:
    """The attenuation from what `_reach` gives without a cone. Beyond the radius that is 0, and so are derivatives."""
    return reach


def _reach(
    distance: Array | None,
    unit_length: Array | None,
    coefficients: tuple[Array, Array, Array] | None,
    radius: Array | None,
    cone: tuple[Array, Array, Array] | None,
    known: Array | None = None,
) -> Array:
    """`known`: the attenuation, for derivatives."""
    spot = None if cone is None else factors.spot(*cone)
    if distance is None:
        assert spot is not None
        return spot
    if unit_length is not None:
        distance = ratio(distance, unit_length)
    if coefficients is None:
        factor = jnp.ones_like(distance)
    elif known is None:
        factor = factors.attenuation(*coefficients, distance)
    else:
        factor = factors.known_attenuation(known, *coefficients, distance)
    factor = _times(spot, factor)
    # A sample is lit at d == radius.
    return factor if radius is None else jnp.where(distance <= radius, factor, 0.0)


def _times(factor: Array | None, value: Array) -> Array:
    return value if factor is None else factor * value


SUMMED = 8
"""Lights whose colours one loop adds up, if there are more than twice as many: longer sums XLA does not vectorise."""


def _sums_of_colors(
    stage: Stage, colors: Float[Array, "3 lights 1 lanes"], weights: list[Float[Array, "lights rows lanes"]]
) -> list[Any]:
    """Of each of the weights the sum over lights of color * weight; planes [3, rows, lanes]."""
    lights = colors.shape[1]
    if lights == 1:
        return [Inlined(jnp.multiply, (colors[:, 0], own)) for own in weights]
    if lights <= 2 * SUMMED:
        return _sums(colors, weights)
    return _sums_in_parts(colors, weights) if stage.forward else _sums_for_reverse(colors, weights)


def _sums(colors: Array, weights: list[Array]) -> list[Array]:
    return [jnp.sum(colors * own, axis=1) for own in weights]


def _sums_in_parts(colors: Array, weights: list[Array]) -> list[Array]:
    full, rest = divmod(colors.shape[1], SUMMED)

    def part(first: Array | int, count: int) -> list[Array]:
        own = [lax.dynamic_slice_in_dim(plane, first, count) for plane in weights]
        return _sums(lax.dynamic_slice_in_dim(colors, first, count, axis=1), own)

    def with_part(number: Array, totals: list[Array]) -> list[Array]:
        return list(map(jnp.add, totals, part(number * SUMMED, SUMMED)))

    return lax.fori_loop(0, full, with_part, part(full * SUMMED, rest))


_sums_for_reverse = jax.custom_jvp(_sums_in_parts)
"""`_sums_in_parts` whose changes are no sums in parts: cotangents would be put together from parts."""


@_sums_for_reverse.defjvp
def _sums_jvp(primals, tangents):
    return _sums_for_reverse(*primals), jax.jvp(_sums, primals, tangents)[1]


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
        distance = stage.each(_distance_in_fog, fog.to_local, tile.eye, tile.position)
    interpolant = factors.linear_fog if fog_type == "LINEAR" else factors.exponential_fog
    return Haze(*stage.each(interpolant, distance, fog.visibility_range))


def _distance_in_fog(to_local: Matrix, eye: Vector, position: Vector) -> Array:
    return unit(transform(to_local, eye - position))[1]


def fogged(
    color: Float[Array, "3 #rows #lanes"], fog_color: Float[Array, "3 1 lanes"], haze: Haze
) -> Float[Array, "3 rows lanes"]:
    """I_F (1 - f0) + f0 color."""
    return fog_color * haze.hidden + haze.clear * color
