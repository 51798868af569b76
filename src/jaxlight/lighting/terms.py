"""The lighting equation (VRML97 4.14.4, X3D 17.2.2.4) on planes of samples: the one place where it is written.

I = I_F (1 - f0) + f0 (O_E + sum_i on_i attenuation_i spot_i I_L,i (ambient_i + diffuse_i + specular_i))

Letters: p position, n unit normal, v unit vector to the viewer, l unit vector to the light, d_l and d_v distances.
Planes of samples are [rows, lanes], planes of lights and samples [lights, rows, lanes].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from . import factors
from .elementary import ratio
from .stages import Stage
from .surface import MaterialRow
from .vectors import Vector, dot, half_vector, inverse_length, inverse_length_in_range, normalised, transform, unit
from .world import WorldFog, WorldLights


class Geometry(NamedTuple):
    """What a tile of samples knows of itself and the viewer; planes [rows, lanes]."""

    position: Vector
    low: Array
    """Lowest coordinates of the tile, [3]."""
    high: Array
    normal: Vector
    """Unit normal."""
    to_viewer: Vector
    """Unit vector to the viewer."""
    offset: Vector
    """Vector to the viewer."""
    distance: Array
    """Distance to the viewer."""


def geometry(stage: Stage, position: Vector, normal: Vector, eye: Float[Array, 3], low: Array, high: Array) -> Geometry:
    """The tile's geometry, normalised."""
    offset = Vector(*eye) - position
    to_viewer, distance = stage(lambda: unit(offset))
    return Geometry(position, low, high, stage(lambda: unit(normal)[0]), to_viewer, offset, distance)


class Received(NamedTuple):
    """Light that a tile receives, [3, rows, lanes]: sums over lights of colour times weight."""

    diffuse: Array
    """What multiplies O_D: the ambient and diffuse terms."""
    specular: Array | None
    """What multiplies O_S; None: skipped."""

    def __add__(self, other: Received) -> Received:  # type: ignore[override]  # a sum of light, not a tuple's
        specular = None if self.specular is None or other.specular is None else self.specular + other.specular
        return Received(self.diffuse + other.diffuse, specular)


def received(
    stage: Stage, lights: WorldLights, tile: Geometry, material: MaterialRow, *, specular: bool, specular_gate: bool
) -> Received:
    """attenuation * spot * I_L * (ambient + diffuse + specular), summed over lights, without O_D and O_S.

    Vectors per light are functions, evaluated anew in each stage: three planes cost more to keep than to compute.
    """
    l, reaching = _light_vector(stage, lights, tile)

    def facing() -> Array:
        return _times(reaching, factors.positive_part(dot(tile.normal, l())))

    from_diffuse = _sum_of_colors(lights.direct, stage(facing))
    if lights.ambient is not None:
        if reaching is None:
            ambient = jnp.sum(lights.ambient, axis=1)[:, None, None]
        else:
            ambient = _sum_of_colors(lights.ambient, reaching)
        from_diffuse = from_diffuse + ambient * material.ambient_intensity
    if not specular:
        return Received(from_diffuse, None)
    exponent = 128.0 * material.shininess
    inverse = stage(lambda: inverse_length_in_range(l() + tile.to_viewer))
    alignment = stage(lambda: factors.alignment(tile.normal, half_vector(l(), tile.to_viewer), inverse))

    def highlight() -> Array:
        power = factors.highlight(alignment, exponent)
        return _times(reaching, jnp.where(dot(tile.normal, l()) > 0, power, 0.0) if specular_gate else power)

    return Received(from_diffuse, _sum_of_colors(lights.direct, stage(highlight)))


def _light_vector(stage: Stage, lights: WorldLights, tile: Geometry) -> tuple[Callable[[], Vector], Array | None]:
    """L as a function, and attenuation * spot * (within radius); None: 1."""
    towards = lights.towards
    if lights.place is None:
        assert towards is not None
        return lambda: towards, None

    place, to_local, local_place = lights.place, lights.to_local, lights.local_place
    # Kept, so that the derivatives by the places are summed over samples once, not in every stage.
    offset = Vector(
        stage(lambda: place.x - tile.position.x),
        stage(lambda: place.y - tile.position.y),
        stage(lambda: place.z - tile.position.z),
    )
    inverse = lax.cond(
        _squares_in_range(place, tile), lambda: inverse_length_in_range(offset), lambda: inverse_length(offset)
    )

    def l() -> Vector:
        return normalised(offset, inverse)[0]

    spot = _spot(stage, lights, l)
    distance = None
    if to_local is not None and local_place is not None:
        distance = stage(lambda: unit(local_place - transform(to_local, tile.position))[1])
    if lights.attenuation is None and lights.radius is None:
        return l, spot

    def reaching() -> Array:
        d = normalised(offset, inverse)[1] if distance is None else distance
        if lights.unit_length is not None:
            d = ratio(d, lights.unit_length)
        factor = jnp.ones_like(d) if lights.attenuation is None else factors.attenuation(*lights.attenuation, d)
        factor = _times(spot, factor)
        # A sample is lit at d == radius.
        return factor if lights.radius is None else jnp.where(d <= lights.radius, factor, 0.0)

    return l, stage(reaching)


def _spot(stage: Stage, lights: WorldLights, l: Callable[[], Vector]) -> Array | None:
    """The spotlight factor; None for lights without a cone."""
    axis, beam_width, cut_off_angle = lights.axis, lights.beam_width, lights.cut_off_angle
    if axis is None or beam_width is None or cut_off_angle is None:
        return None
    angle = stage(lambda: factors.angle_between(-l(), axis))
    return stage(lambda: factors.spot(angle, beam_width, cut_off_angle))


def _squares_in_range(place: Vector, tile: Geometry) -> Array:
    """True if the squared distance of every light to every sample of the tile is a normal number, by its bounds."""
    places = jnp.stack([component[..., 0, 0] for component in place], axis=-1)
    below, above = tile.low - places, places - tile.high
    nearest = jnp.max(jnp.maximum(below, above), axis=-1)
    farthest = jnp.max(jnp.maximum(jnp.abs(places - tile.low), jnp.abs(places - tile.high)), axis=-1)
    safe = jnp.finfo(tile.low.dtype).max ** 0.4
    return jnp.all((nearest > 1 / safe) & (farthest < safe))


def _times(factor: Array | None, value: Array) -> Array:
    return value if factor is None else factor * value


def _sum_of_colors(colors: Float[Array, "3 lights"], weights: Float[Array, "lights rows lanes"]) -> Array:
    """Sum over lights of color * weight, [3, rows, lanes], in full precision on every backend."""
    lights, rows, lanes = weights.shape
    if lights == 1:
        return jnp.broadcast_to(colors[:, :, None], (3, 1, lanes)) * weights
    flat = jnp.dot(colors, weights.reshape(lights, -1), precision=lax.Precision.HIGHEST)
    return flat.reshape(3, rows, lanes)


def lit(
    material: MaterialRow, diffuse_color: Float[Array, "3 #rows #lanes"], light: Received | None, *, emissive: bool
) -> Float[Array, "3 #rows #lanes"]:
    """O_E + O_D * (ambient and diffuse light) + O_S * (specular light); the material's colours on all lanes."""
    color = material.emissive_color if emissive else jnp.zeros_like(material.emissive_color)
    if light is None:
        return color
    color = color + diffuse_color * light.diffuse
    return color if light.specular is None else color + material.specular_color * light.specular


def fogged(
    color: Float[Array, "3 #rows #lanes"], fog: WorldFog, fog_type: str, tile: Geometry
) -> Float[Array, "3 rows lanes"]:
    """I_F (1 - f0) + f0 color, with d_V measured in the fog's coordinate system."""
    distance = tile.distance if fog.to_local is None else unit(transform(fog.to_local, tile.offset))[1]
    interpolant = factors.linear_fog if fog_type == "LINEAR" else factors.exponential_fog
    clear, hidden = interpolant(distance, fog.visibility_range)
    return fog.color * hidden + clear * color
