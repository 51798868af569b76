"""The part of the equation that is done once, not once a sample."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ..processor import for_cpu
from ..raster.samples import SampleBuffer
from ..scene import Materials, Scene, Surface
from .culled_lights import CulledLights, culled_lights
from .highlight import highlight_of
from .ordinary import ordinary_lights, squares_in_range
from .plan import Plan
from .surface import MaterialRow
from .vectors import Vector
from .world import WorldFog, WorldLights, as_plane, fog_in_world, lights_in_world

LANES = 64
"""Over which numbers are spread on the CPU for each tile that is evaluated at once."""


class Prepared(eqx.Module):
    """What does not depend on the sample: materials and lights in world space, in the samples' float type.

    Planes are on one lane, or on all lanes (`lanes.on_all_lanes`) where derivatives are taken in reverse mode.
    """

    materials: Materials | None
    """Planes [materials, 1, lanes], colours [materials, 3, 1, lanes]; of the only one without the first axis."""
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
    """Of a row of samples where derivatives are taken."""


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
        own = lights_in_world(lights, light_plan, dtype, samples.camera_to_world)
        world.append(culled_lights(own) if light_plan.culled else own)
        if not light_plan.culled:
            shading_all.append(own)
        rows = slice(None) if light_plan.rows is None else np.asarray(light_plan.rows)
        scopes.append(jnp.asarray(lights.in_scope.array[:, rows]) if light_plan.scoped else None)
    return Prepared(
        materials=None if scene.materials is None else _planes_of(scene.materials, dtype),
        lights=tuple(world),
        scopes=tuple(scopes),  # type: ignore[arg-type]  # three of them
        fog=None if plan.fog is None or scene.fog is None else fog_in_world(scene.fog, plan.fog, dtype),
        textures=tuple(texture.image for texture in scene.textures),
        ordinary=_ordinary(samples, dtype, shading_all, viewer_of(samples, plan)),
        surfaces=scene.surfaces,
        lanes=lanes,
    )


def _planes_of(materials: Materials, dtype: jnp.dtype) -> Materials:
    planes = jax.tree.map(lambda a: as_plane(a.astype(dtype)), materials)
    return jax.tree.map(lambda plane: plane[0], planes) if is_only(materials) else planes


def is_only(materials: Materials) -> bool:
    """Whether there is one material, whose planes have no axis of materials then."""
    return len(materials.names) == 1


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
    materials = prepared.materials
    if surface.material < 0 or materials is None:
        return None
    if is_only(materials):
        return MaterialRow(*(getattr(materials, name) for name in MaterialRow._fields))
    material = material_number(prepared.surfaces, row, single)

    def field(name: str) -> Array:
        own = getattr(materials, name)[material]
        return own if np.ndim(material) == 0 else jnp.moveaxis(own[..., 0, :], 0, -2)

    return MaterialRow(*map(field, MaterialRow._fields))


def material_number(surfaces: tuple[Surface, ...], row: Any, single: int | None) -> Any:
    """Which material a surface row has, or several rows have (-1: none); of a known row known too."""
    numbers = np.array([surface.material for surface in surfaces], np.int32)
    return numbers[single] if single is not None else jnp.asarray(numbers)[row]
