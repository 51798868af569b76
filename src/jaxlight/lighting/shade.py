"""`shade`: the colour of every sample, tile by tile.

The tile is what fits the cache: inside it all lights are evaluated for some hundred samples at once. Derivatives are
taken tile by tile too (the tile is rematerialised in reverse mode), so memory does not grow with lights.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..raster.samples import SampleBuffer
from ..scene import Materials, Scene, Surface
from .options import LightingOptions
from .plan import Plan, make_plan
from .stages import Stage
from .surface import MaterialRow, alpha, base_color, sampled_texture
from .terms import Geometry, Received, fogged, geometry, lit, received
from .vectors import Vector
from .world import WorldFog, WorldLights, fog_in_world, in_chunks, lights_in_world, on_lanes

PLANE = 8192
"""Lights times samples that are evaluated at once: what a tile's planes may hold to stay in the cache."""

LANES = 64


def shade(
    scene: Scene, samples: SampleBuffer, options: LightingOptions | None = None, *, plan: Plan | None = None
) -> Float[Array, "samples 4"]:
    """The colour and alpha of every sample by the lighting equation (VRML97 4.14, X3D 17.2.2).

    Args:
        scene: materials, lights, fog and textures.
        samples: N visible surface points.
        options: readings of the specification.
        plan: what to compute, from `make_plan`; default: decided here from the numbers that are known.

    Returns:
        [N, 4]: red, green, blue as the equation gives them (not clamped, no transfer function), and alpha.

    Raises:
        ValueError: samples that name a surface the scene lacks, or lack a colour or texels that it asks for.
    """
    return samples.in_sample_order(shade_planes(scene, samples, options, plan=plan)).T


def shade_planes(
    scene: Scene, samples: SampleBuffer, options: LightingOptions | None = None, *, plan: Plan | None = None
) -> Float[Array, "4 slots"]:
    """`shade` in storage order: planes red, green, blue, alpha, one column a slot of the buffer, padding included."""
    check_samples(scene, samples)
    if plan is None:
        plan = make_plan(scene, samples, options)
    return _shade_planes(_without_document(scene), samples, plan)


@partial(jax.jit, static_argnames="plan")
def _shade_planes(scene: Scene, samples: SampleBuffer, plan: Plan) -> Array:
    prepared = prepare(scene, samples, plan)
    parts = [
        map_tiles(run, prepared, samples, plan, lambda color: jnp.concatenate([color.rgb, color.alpha[None]]))
        for run in surface_runs(scene.surfaces, samples)
    ]
    return jnp.concatenate(parts, axis=1) if len(parts) != 1 else parts[0]


class Color(NamedTuple):
    """What a tile gives: planes [3, samples] and [samples]."""

    rgb: Array
    alpha: Array


class Prepared(eqx.Module):
    """What does not depend on the sample: materials and lights in world space, in the samples' float type."""

    materials: Materials | None
    directional: WorldLights | None
    point: WorldLights | None
    spot: WorldLights | None
    scopes: tuple[Array | None, Array | None, Array | None]
    """[surfaces, lights] of the kinds above; None: every light reaches every surface."""
    fog: WorldFog | None
    textures: tuple[Array, ...]
    surfaces: tuple[Surface, ...] = eqx.field(static=True)


class Run(NamedTuple):
    """Consecutive tiles whose surfaces are coloured by the same code."""

    surface: Surface
    """Stands for all surfaces of the run: they differ in material and scope only."""
    single: int | None
    """The row of the run's only surface; None: several."""
    start: int
    stop: int


def surface_runs(surfaces: tuple[Surface, ...], samples: SampleBuffer) -> list[Run]:
    """The buffer's tiles, split where the code that colours them changes."""
    runs: list[Run] = []
    for row, start, stop in samples.runs:
        surface = surfaces[row]
        last = runs[-1] if runs else None
        if last is not None and _alike(last.surface, surface):
            runs[-1] = Run(last.surface, None, last.start, stop)
        else:
            runs.append(Run(surface, row, start, stop))
    return runs


def _alike(a: Surface, b: Surface) -> bool:
    return a._replace(material=min(a.material, 0)) == b._replace(material=min(b.material, 0))


def prepare(scene: Scene, samples: SampleBuffer, plan: Plan) -> Prepared:
    """The part of the equation that is done once, not once a sample."""
    dtype = compute_dtype(samples)
    kinds = [(scene.directional, plan.directional), (scene.point, plan.point), (scene.spot, plan.spot)]
    world: list[WorldLights | None] = []
    scopes: list[Array | None] = []
    for lights, light_plan in kinds:
        if lights is None or light_plan is None:
            world.append(None)
            scopes.append(None)
            continue
        world.append(lights_in_world(lights, light_plan, dtype, samples.camera_to_world, lanes_of(samples)))
        rows = slice(None) if light_plan.rows is None else np.asarray(light_plan.rows)
        scopes.append(jnp.asarray(lights.in_scope.array[:, rows]) if light_plan.scoped else None)
    return Prepared(
        materials=None if scene.materials is None else jax.tree.map(lambda a: a.astype(dtype), scene.materials),
        directional=world[0],
        point=world[1],
        spot=world[2],
        scopes=tuple(scopes),  # type: ignore[arg-type]  # three of them
        fog=None
        if plan.fog is None or scene.fog is None
        else fog_in_world(scene.fog, plan.fog, dtype, lanes_of(samples)),
        textures=tuple(texture.image for texture in scene.textures),
        surfaces=scene.surfaces,
    )


def compute_dtype(samples: SampleBuffer) -> jnp.dtype:
    """float64 for float64 samples, float32 for all others: half precision is widened at the door."""
    return jnp.promote_types(samples.position_planes.dtype, jnp.float32)


def map_tiles(
    run: Run,
    prepared: Prepared,
    samples: SampleBuffer,
    plan: Plan,
    function: Callable[..., Any],
    *planes: Array,
) -> Any:
    """function(color, *tiles of planes) for every tile of a run, the results side by side: [..., slots of the run].

    `planes`: further arrays [..., slots], whose tiles go to `function`.
    """
    tile = samples.tile

    @jax.checkpoint
    def body(index: Array, prepared: Prepared, samples: SampleBuffer, planes: tuple[Array, ...]) -> Any:
        color = tile_color(run, prepared, samples, plan, index)
        return function(color, *(tile_of(plane, index, tile) for plane in planes))

    def step(_: None, index: Array) -> tuple[None, Any]:
        return None, body(index, prepared, samples, planes)

    _, results = lax.scan(step, None, jnp.arange(run.start, run.stop))
    return jax.tree.map(lambda a: jnp.moveaxis(a, 0, -2).reshape(*a.shape[1:-1], -1), results)


def lanes_of(samples: SampleBuffer) -> int:
    """Lanes on which a tile's samples, and copies of every number, are spread (see WorldLights)."""
    return min(LANES, samples.tile)


def tile_of(plane: Array, index: Array, tile: int) -> Array:
    """Columns of tile `index` of an array [..., slots]."""
    return lax.dynamic_slice_in_dim(plane, index * tile, tile, axis=-1)


def tile_color(run: Run, prepared: Prepared, samples: SampleBuffer, plan: Plan, index: Array) -> Color:
    """The equation on one tile."""
    dtype, tile, lanes = compute_dtype(samples), samples.tile, lanes_of(samples)
    stage = Stage(index >= 0 if run.stop - run.start > 1 else samples.tile_surface[0] >= 0)

    def cut(plane: Array, kind: jnp.dtype = dtype) -> Array:
        """The tile's part of a plane, [..., rows, lanes]."""
        return stage(lambda: tile_of(plane, index, tile).astype(kind).reshape(*plane.shape[:-1], -1, lanes))

    position = Vector(*cut(samples.position_planes))
    normal = Vector(*cut(samples.normal_planes))
    surface = run.surface
    row = samples.tile_surface[index] if run.single is None else run.single
    material = _material_row(prepared, surface, row, run.single, lanes)
    vertex_color = texel = None
    if surface.color_components:
        vertex_color = cut(samples.color_planes)
    if surface.texture >= 0 and surface.lighting != "emissive":
        weight = cut(samples.texel_weight)
        texel = sampled_texture(
            prepared.textures[surface.texture], cut(samples.texel_index, jnp.dtype(jnp.int32)), weight
        )
    low, high = samples.tile_low[:, index].astype(dtype), samples.tile_high[:, index].astype(dtype)
    ground = geometry(stage, position, normal, samples.eye.astype(dtype), low, high)
    is_lit = surface.lighting == "lit"
    light = _light(stage, prepared, plan, ground, material, row) if is_lit else None

    def rgb() -> Array:
        color = base_color(surface, plan.options, material, vertex_color, texel)
        if is_lit:
            color = lit(material, color, light, emissive=plan.emissive)
        if plan.fog is not None and (is_lit or plan.options.fog_unlit):
            color = fogged(color, prepared.fog, plan.fog.fog_type, ground)
        return jnp.broadcast_to(color, (3, tile // lanes, lanes)).astype(dtype)

    opacity = alpha(plan.options, material, vertex_color, texel)
    opacity = jnp.broadcast_to(1.0 if opacity is None else opacity, (tile // lanes, lanes)).astype(dtype)
    return Color(stage(rgb).reshape(3, tile), opacity.reshape(tile))


def _material_row(prepared: Prepared, surface: Surface, row: Any, single: int | None, lanes: int) -> MaterialRow | None:
    """The material of a surface row; a known row needs no lookup."""
    if surface.material < 0 or prepared.materials is None:
        return None
    rows = np.array([other.material for other in prepared.surfaces])
    material = rows[single] if single is not None else jnp.asarray(rows)[row]
    return MaterialRow(*(on_lanes(getattr(prepared.materials, name)[material], lanes) for name in MaterialRow._fields))


def _light(
    stage: Stage, prepared: Prepared, plan: Plan, tile: Geometry, material: MaterialRow, row: Any
) -> Received | None:
    """What the lights of all kinds send to a tile; None: there are none."""
    total = None
    for lights, scope in zip((prepared.directional, prepared.point, prepared.spot), prepared.scopes, strict=True):
        if lights is None:
            continue
        if scope is not None:
            lights = _scoped(lights, scope[row])
        light = _light_of_kind(stage, lights, tile, material, plan)
        total = light if total is None else total + light
    return total


def _scoped(lights: WorldLights, in_scope: Array) -> WorldLights:
    """The lights with those out of scope made black."""
    ambient = None if lights.ambient is None else jnp.where(in_scope, lights.ambient, 0.0)
    return dataclasses.replace(lights, direct=jnp.where(in_scope, lights.direct, 0.0), ambient=ambient)


def _light_of_kind(stage: Stage, lights: WorldLights, tile: Geometry, material: MaterialRow, plan: Plan) -> Received:
    """`received`, over so many lights at once that their planes stay in the cache."""
    options = {"specular": plan.specular, "specular_gate": plan.options.specular_gate}
    chunk = max(1, PLANE // tile.position.x.size)
    if lights.count <= chunk:
        return received(stage, lights, tile, material, **options)
    chunks = in_chunks(lights, chunk)

    def add(total: Received, some: WorldLights) -> tuple[Received, None]:
        return total + received(stage, some, tile, material, **options), None

    dark = jnp.zeros((3, *tile.position.x.shape), tile.position.x.dtype)
    total, _ = lax.scan(add, Received(dark, dark if plan.specular else None), chunks)
    return total


def _without_document(scene: Scene) -> Scene:
    """The scene without what shading does not read, so that scenes that differ only there share compiled code."""
    return dataclasses.replace(scene, document=None)


def check_samples(scene: Scene, samples: SampleBuffer) -> None:
    """Raise ValueError if the samples do not fit the scene."""
    for row, _, _ in samples.runs:
        if row >= len(scene.surfaces):
            raise ValueError(f"samples: surface {row} asked for, but the scene has {len(scene.surfaces)} surfaces")
        surface = scene.surfaces[row]
        components = 0 if samples.color_planes is None else samples.color_planes.shape[0]
        if surface.color_components > components:
            raise ValueError(
                f"samples: surface {row} has {surface.color_components}-component vertex colours, "
                f"the buffer holds {components}"
            )
        if surface.texture >= 0 and samples.texel_index is None:
            raise ValueError(
                f"samples: surface {row} has a texture, but the buffer has no texel_index and texel_weight"
            )
