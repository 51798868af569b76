"""Lights as the equation wants them: world space, per kind, the few numbers that do not depend on the sample.

Everything here is small (one row a light) and differentiable, so that derivatives reach the fields as the user wrote
them. Lights that are off never get here: the plan leaves them out, and their fields may hold anything.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..scene import DirectionalLights, Fog, PointLights, SpotLights
from .elementary import power_of_two_above, reciprocal_of_power_of_two
from .plan import FogPlan, LightPlan
from .vectors import Matrix, Vector, matrix_of, transform, unit


class WorldLights(eqx.Module):
    """Lights of one kind in world space; planes [lights, 1, lanes], to broadcast against samples [rows, lanes].

    Every lane holds the same numbers (`culling` gives each its own lights). Derivatives then add up lane by lane,
    which the processor does at once, and the lanes are summed once at the end instead of in every tile.
    """

    color: Float[Array, "3 lights 1 lanes"]
    intensity: Float[Array, "lights 1 lanes"]
    ambient: Float[Array, "lights 1 lanes"] | None
    """The ambient intensity; None: skipped."""
    towards: Vector | None
    """Directional lights: unit L."""
    place: Vector | None
    """Point and spot lights: location."""
    to_local: Matrix | None
    """World vectors to the light's frame, where distances are measured; None: `unit_length` tells it."""
    local_place: Vector | None
    """With `to_local`: the location in the light's frame, seen from the world's origin."""
    unit_length: Float[Array, "lights 1 lanes"] | None
    """World length of one unit of the light's frame; None: 1."""
    attenuation: tuple[Array, Array, Array] | None
    radius: Float[Array, "lights 1 lanes"] | None
    axis: Vector | None
    """Spot lights: unit direction."""
    beam_width: Float[Array, "lights 1 lanes"] | None
    cut_off_angle: Float[Array, "lights 1 lanes"] | None

    @property
    def count(self) -> int:
        """How many lights."""
        return self.color.shape[1]

    @property
    def cone(self) -> tuple[Array, Array] | None:
        """Beam width and cut-off angle of spot lights; None: no cone."""
        return None if self.beam_width is None or self.cut_off_angle is None else (self.beam_width, self.cut_off_angle)

    @property
    def asks_distance(self) -> bool:
        """Whether d_L matters, and not only the direction."""
        return self.attenuation is not None or self.radius is not None

    def with_planes(self, function: Callable[[Array], Array], colors: Callable[[Array], Array]) -> WorldLights:
        """These lights with every plane, and the colours [3, lights, 1, lanes], replaced by a function of it."""
        planes = jax.tree.map(function, dataclasses.replace(self, color=None))
        return dataclasses.replace(planes, color=colors(self.color))


class WorldFog(eqx.Module):
    """The bound fog, on all lanes; `to_local` None: its frame measures distances as the world does."""

    color: Float[Array, "3 1 lanes"]
    visibility_range: Float[Array, "1 lanes"]
    to_local: Matrix | None


def lights_in_world(
    lights: DirectionalLights | PointLights | SpotLights,
    plan: LightPlan,
    dtype: jnp.dtype,
    camera_to_world: Float[Array, "3 3"] | None,
) -> WorldLights:
    """The lights that the plan keeps, in world space, in the given float type, on one lane."""
    keep = jnp.asarray(plan.rows, dtype=jnp.int32) if plan.rows is not None else slice(None)

    def field(values: Array) -> Array:
        return values[keep].astype(dtype)

    def planes(values: Array) -> Vector:
        rows = field(values)
        return Vector(*(as_plane(rows[:, i]) for i in range(3)))

    to_world = lights.to_world[keep].astype(dtype)
    linear = matrix_of(to_world[:, None, None, :, :3])
    turning = matrix_of(_scaled_to_one(to_world[:, None, None, :, :3]))
    color = as_plane(field(lights.color).T)
    intensity = as_plane(field(lights.intensity))
    ambient = as_plane(field(lights.ambient_intensity)) if plan.ambient else None

    def world_direction(values: Array) -> Vector:
        # Normalised in its own frame first: it may be of any length, and its derivative along itself is exactly 0.
        own = unit(planes(values))[0]
        return own if plan.frame == "identity" else unit(transform(turning, own))[0]

    if isinstance(lights, DirectionalLights):
        towards = -world_direction(lights.direction)
        if plan.headlight and camera_to_world is not None:
            own = unit(Vector(*(a[-1] for a in planes(lights.direction))))[0]
            # A rotation of few bits is none any more.
            aimed = -unit(transform(matrix_of(camera_to_world.astype(dtype)), own))[0]
            towards = Vector(*(a.at[-1].set(b) for a, b in zip(towards, aimed, strict=True)))
        return WorldLights(color, intensity, ambient, towards, *(None,) * 9)

    location = place = planes(lights.location)
    to_local = local_place = None
    if plan.frame != "identity":
        origin = Vector(*(to_world[:, None, None, i, 3] for i in range(3)))
        place = transform(linear, location) + origin
        if plan.frame == "general":
            to_local = matrix_of(field(lights.to_local)[:, None, None])
            local_place = location + transform(to_local, origin)
    spot = isinstance(lights, SpotLights)
    coefficients = None
    if plan.attenuation:
        c1, c2, c3 = planes(lights.attenuation)
        coefficients = (c1, c2, c3 if plan.attenuation == "quadratic" else jnp.zeros_like(c3))
    scale = None
    if plan.frame == "similarity":
        scale = unit(Vector(*(as_plane(to_world[:, i, 0]) for i in range(3))))[1]
    return WorldLights(
        color=color,
        intensity=intensity,
        ambient=ambient,
        towards=None,
        place=place,
        to_local=to_local,
        local_place=local_place,
        unit_length=scale,
        attenuation=coefficients,
        # Distances are rounded: a sample at the radius is lit all the same.
        radius=lax.stop_gradient(as_plane(field(lights.radius))) * (1 + 4 * jnp.finfo(dtype).eps)
        if plan.radius
        else None,
        axis=world_direction(lights.direction) if spot else None,
        beam_width=as_plane(field(lights.beam_width)) if spot else None,
        cut_off_angle=as_plane(field(lights.cut_off_angle)) if spot else None,
    )


def _scaled_to_one(matrices: Float[Array, "... 3 3"]) -> Float[Array, "... 3 3"]:
    """Matrices times powers of two: they make no vector much longer, by whose length derivatives would be divided."""
    largest = jnp.max(jnp.abs(lax.stop_gradient(matrices)), axis=(-2, -1), keepdims=True)
    return matrices * reciprocal_of_power_of_two(power_of_two_above(largest))


def fog_in_world(fog: Fog, plan: FogPlan, dtype: jnp.dtype) -> WorldFog:
    """The fog in the given float type, on one lane."""
    return WorldFog(
        as_plane(fog.color.astype(dtype)),
        # Without end, as far as there are numbers: quotients by infinity would be NaN.
        jnp.minimum(as_plane(fog.visibility_range.astype(dtype)), jnp.finfo(dtype).max),
        None if plan.identity_frame else matrix_of(fog.to_local.astype(dtype)[None, None]),
    )


def as_plane(value: Float[Array, "..."]) -> Float[Array, "... 1 1"]:
    """A number or colour as a plane (see WorldLights)."""
    return value[..., None, None]


def in_chunks(lights: WorldLights, chunk: int) -> WorldLights:
    """The lights in groups of `chunk`, everything with a leading axis; the last group is filled up with black."""
    missing = -lights.count % chunk

    def rows(plane: Array) -> Array:
        filled = (
            jnp.concatenate([plane, jnp.broadcast_to(plane[-1:], (missing, *plane.shape[1:]))]) if missing else plane
        )
        return filled.reshape(-1, chunk, *plane.shape[1:])

    def colors(table: Array) -> Array:
        filled = jnp.pad(table, ((0, 0), (0, missing), (0, 0), (0, 0)))
        return jnp.moveaxis(filled.reshape(3, -1, chunk, *table.shape[2:]), 1, 0)

    return lights.with_planes(rows, colors)


def one_by_one(lights: WorldLights) -> WorldLights:
    """Every light, or its change, by itself: everything with a leading axis; None where nothing is given."""
    planes = jax.tree.map(lambda plane: plane[:, None], dataclasses.replace(lights, color=None))
    color = None if lights.color is None else jnp.moveaxis(lights.color, 1, 0)[:, :, None]
    return dataclasses.replace(planes, color=color)
