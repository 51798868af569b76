"""The part of the equation that is done once, not once a sample."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool

from ..processor import for_cpu
from ..raster.samples import LANES, SampleBuffer
from ..scene import Materials, Scene, Surface
from .culled_lights import CulledLights, LightTable, culled_lights
from .highlight import highlight_of
from .ordinary import ordinary_lights, squares_in_range
from .plan import Plan
from .surface import MaterialRow
from .vectors import Vector
from .world import WorldFog, WorldLights, fog_in_world, lights_in_world, on_lanes


class Prepared(eqx.Module):
    """What does not depend on the sample: materials and lights in world space, in the samples' float type."""

    materials: Materials | None
    """Every number on all lanes: [materials, 1, lanes], colours [materials, 3, 1, lanes]."""
    lights: tuple[WorldLights | CulledLights | None, ...]
    """Directional, point and spot lights."""
    scopes: tuple[Array | None, Array | None, Array | None]
    """[surfaces, lights] of these kinds; None: every light reaches every surface."""
    fog: WorldFog | None
    textures: tuple[Array, ...]
    ordinary: Bool[Array, " tiles"]
    """Which tiles are ordinary (see `ordinary`) as far as lights go that are not culled."""
    surfaces: tuple[Surface, ...] = eqx.field(static=True)
    lanes: int = eqx.field(static=True)
    """On which numbers are, but those of lights that are culled."""


def prepare(scene: Scene, samples: SampleBuffer, plan: Plan, together: int = 1) -> Prepared:
    """Materials, lights and fog as the tiles of these samples read them, `together` of them at once."""
    dtype = compute_dtype(samples)
    # On the CPU as many rows however many tiles: sums of more are slower. Clusters have a lane each.
    lanes = min(together * LANES, samples.tile) if for_cpu() else 1
    if plan.culled:
        lanes = together * samples.tile // samples.cluster
    kinds = [(scene.directional, plan.directional), (scene.point, plan.point), (scene.spot, plan.spot)]
    world: list[WorldLights | CulledLights | None] = []
    shading_all: list[WorldLights] = []
    scopes: list[Array | None] = []
    for lights, light_plan in kinds:
        if lights is None or light_plan is None:
            world.append(None)
            scopes.append(None)
            continue
        own = lights_in_world(lights, light_plan, dtype, samples.camera_to_world, 1 if light_plan.culled else lanes)
        world.append(culled_lights(own) if light_plan.culled else own)
        if not light_plan.culled:
            shading_all.append(own)
        rows = slice(None) if light_plan.rows is None else np.asarray(light_plan.rows)
        scopes.append(jnp.asarray(lights.in_scope.array[:, rows]) if light_plan.scoped else None)
    return Prepared(
        materials=None
        if scene.materials is None
        else jax.tree.map(lambda a: on_lanes(a.astype(dtype), lanes), scene.materials),
        lights=tuple(world),
        scopes=tuple(scopes),  # type: ignore[arg-type]  # three of them
        fog=None if plan.fog is None or scene.fog is None else fog_in_world(scene.fog, plan.fog, dtype, lanes),
        textures=tuple(texture.image for texture in scene.textures),
        ordinary=_ordinary(samples, dtype, shading_all, viewer_of(samples, plan)),
        surfaces=scene.surfaces,
        lanes=lanes,
    )


def on_one_lane(prepared: Prepared) -> Prepared:
    """The same numbers on one lane, to broadcast; without derivatives."""
    return lax.stop_gradient(_with_planes(prepared, lambda plane: plane[..., :1]))


FEWER_LANES = 16
"""Of whole vectors: to add up derivatives of many lights tile by tile on all lanes is to go through more memory."""


def on_fewer_lanes(slope: Prepared) -> Prepared:
    """Of derivatives by the numbers on all lanes sums over some of the lanes each."""

    def folded(plane: Array) -> Array:
        lanes = plane.shape[-1]
        if lanes % FEWER_LANES or lanes == FEWER_LANES:
            return plane
        return reduce(jnp.add, [plane[..., first : first + FEWER_LANES] for first in range(0, lanes, FEWER_LANES)])

    return _with_planes(slope, folded)


def on_all_lanes(slope: Prepared, prepared: Prepared) -> Prepared:
    """Derivatives on as many lanes as `prepared` has, whose sums over lanes are those of `slope`."""

    def filled(plane: Array, like: Array) -> Array:
        return jnp.pad(plane, [(0, 0)] * (plane.ndim - 1) + [(0, like.shape[-1] - plane.shape[-1])])

    return _with_planes(slope, filled, prepared)


_ON_LANES = ("materials", "lights", "fog")


def _with_planes(prepared: Prepared, of: Callable[..., Array], *others: Prepared) -> Prepared:
    """With others for the planes of numbers: of these planes, and those of `others`. Tables are left as they are."""

    def is_table(part: Any) -> bool:
        return isinstance(part, LightTable)

    def own(plane: Any, *others: Any) -> Any:
        return plane if is_table(plane) else of(plane, *others)

    def part(name: str) -> Any:
        return jax.tree.map(own, *(getattr(one, name) for one in (prepared, *others)), is_leaf=is_table)

    return dataclasses.replace(prepared, **{name: part(name) for name in _ON_LANES})


def _ordinary(
    samples: SampleBuffer, dtype: jnp.dtype, groups: list[WorldLights], viewer: Vector | None
) -> Bool[Array, " tiles"]:
    low, high = (Vector(*bounds.astype(dtype)) for bounds in (samples.tile_low, samples.tile_high))
    found = squares_in_range(Vector(*samples.eye.astype(dtype)), low, high)
    for lights in groups:
        found &= jnp.all(ordinary_lights(lights, viewer, low, high), axis=0)
    return found


def viewer_of(samples: SampleBuffer, plan: Plan) -> Vector | None:
    """Where the viewer is, if it matters where lights are seen from: accurate highlights ask for it."""
    asked = plan.specular and highlight_of(plan.options.accuracy).asks_apart
    return Vector(*samples.eye.astype(compute_dtype(samples))) if asked else None


def compute_dtype(samples: SampleBuffer) -> jnp.dtype:
    """float64 for float64 samples, float32 for all others: half precision is widened at the door."""
    return jnp.promote_types(samples.position_planes.dtype, jnp.float32)


def material_row(prepared: Prepared, surface: Surface, row: Any, single: int | None) -> MaterialRow | None:
    """The material of a surface row, or of several, which are rows of planes then; a known row needs no lookup."""
    if surface.material < 0 or prepared.materials is None:
        return None
    numbers = np.array([other.material for other in prepared.surfaces])
    material = numbers[single] if single is not None else jnp.asarray(numbers)[row]

    def field(name: str) -> Array:
        own = getattr(prepared.materials, name)[material]
        return own if np.ndim(material) == 0 else jnp.moveaxis(own[..., 0, :], 0, -2)

    return MaterialRow(*map(field, MaterialRow._fields))
