"""One tile: what fits the cache. All lights are evaluated for some hundred samples of one surface at once.

Derivatives are taken tile by tile too (a tile is computed anew in reverse mode), so memory does not grow with lights.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..raster.samples import SampleBuffer
from ..scene import Surface
from .culling import received_from_near
from .plan import Plan
from .prepared import Prepared, compute_dtype, lanes_of, material_row
from .stages import Stage
from .surface import MaterialRow, alpha, base_color, sampled_texture
from .terms import Geometry, Received, fogged, geometry, lit, received
from .vectors import Vector
from .world import WorldLights, in_chunks

PLANE = 8192
"""Lights times samples that are evaluated at once: what a tile's planes may hold to stay in the cache."""


class Color(NamedTuple):
    """What a tile gives: planes [3, samples] and [samples]."""

    rgb: Array
    alpha: Array


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


def colors_of_run(run: Run, prepared: Prepared, samples: SampleBuffer, plan: Plan) -> Float[Array, "tiles 4 tile"]:
    """Red, green, blue and alpha of the tiles of a run."""

    @jax.checkpoint
    def body(index: Array, prepared: Prepared, samples: SampleBuffer) -> Array:
        color = tile_color(run, prepared, samples, plan, index)
        return jnp.concatenate([color.rgb, color.alpha[None]])

    def step(_: None, index: Array) -> tuple[None, Array]:
        return None, body(index, prepared, samples)

    return lax.scan(step, None, jnp.arange(run.start, run.stop))[1]


def tile_of(plane: Array, index: Array, tile: int) -> Array:
    """Columns of tile `index` of an array [..., slots]."""
    return lax.dynamic_slice_in_dim(plane, index * tile, tile, axis=-1)


def tile_color(run: Run, prepared: Prepared, samples: SampleBuffer, plan: Plan, index: Array) -> Color:
    """The equation on one tile."""
    dtype, tile, lanes = compute_dtype(samples), samples.tile, lanes_of(samples)
    stage = Stage(index >= 0 if run.stop - run.start > 1 else samples.tile_surface[0] >= 0)

    def of_tile(planes: Array) -> Array:
        """The tile's planes [components, rows, lanes]."""
        return stage(lambda: planes[index].astype(dtype).reshape(planes.shape[1], -1, lanes))

    def cut(planes: Array, kind: jnp.dtype = dtype) -> Array:
        """The tile's part of planes [components, slots], [components, rows, lanes]."""
        return stage(lambda: tile_of(planes, index, tile).astype(kind).reshape(planes.shape[0], -1, lanes))

    position = Vector(*of_tile(samples.position_planes))
    normal = Vector(*of_tile(samples.normal_planes))
    surface = run.surface
    row = samples.tile_surface[index] if run.single is None else run.single
    material = material_row(prepared, surface, row, run.single, lanes)
    vertex_color = texel = None
    if surface.color_components and samples.color_planes is not None:
        vertex_color = of_tile(samples.color_planes)
    index_planes, weight_planes = samples.texel_index, samples.texel_weight
    if (
        surface.texture >= 0
        and surface.lighting != "emissive"
        and index_planes is not None
        and weight_planes is not None
    ):
        weight = cut(weight_planes)
        texel = sampled_texture(prepared.textures[surface.texture], cut(index_planes, jnp.dtype(jnp.int32)), weight)
    low, high = samples.tile_low[:, index].astype(dtype), samples.tile_high[:, index].astype(dtype)
    ground = geometry(stage, position, normal, samples.eye.astype(dtype), low, high)
    lit_material = material if surface.lighting == "lit" else None
    light = None if lit_material is None else _light(stage, prepared, plan, ground, lit_material, row)
    fog = prepared.fog if lit_material is not None or plan.options.fog_unlit else None

    def rgb() -> Array:
        color = base_color(surface, plan.options, material, vertex_color, texel)
        if lit_material is not None:
            color = lit(lit_material, color, light, emissive=plan.emissive)
        if fog is not None and plan.fog is not None:
            color = fogged(color, fog, plan.fog.fog_type, ground)
        return jnp.broadcast_to(color, (3, tile // lanes, lanes)).astype(dtype)

    opacity = alpha(plan.options, material, vertex_color, texel)
    opacity = jnp.broadcast_to(1.0 if opacity is None else opacity, (tile // lanes, lanes)).astype(dtype)
    return Color(stage(rgb).reshape(3, tile), opacity.reshape(tile))


def _light(
    stage: Stage, prepared: Prepared, plan: Plan, tile: Geometry, material: MaterialRow, row: Any
) -> Received | None:
    """What the lights of all kinds send to a tile; None: there are none."""
    total = None
    kinds = zip(
        (prepared.directional, prepared.point, prepared.spot),
        (plan.directional, plan.point, plan.spot),
        prepared.scopes,
        strict=True,
    )
    for lights, light_plan, scope in kinds:
        if lights is None or light_plan is None:
            continue
        if scope is not None:
            lights = _scoped(lights, scope[row])

        def of(some: WorldLights) -> Received:
            return received(
                stage, some, tile, material, specular=plan.specular, specular_gate=plan.options.specular_gate
            )

        light = received_from_near(of, lights, tile) if light_plan.culled else _received_from_all(of, lights, tile)
        total = light if total is None else total + light
    return total


def _scoped(lights: WorldLights, in_scope: Array) -> WorldLights:
    """The lights with those out of scope made black."""
    ambient = None if lights.ambient is None else jnp.where(in_scope, lights.ambient, 0.0)
    return dataclasses.replace(lights, direct=jnp.where(in_scope, lights.direct, 0.0), ambient=ambient)


def _received_from_all(of: Callable[[WorldLights], Received], lights: WorldLights, tile: Geometry) -> Received:
    """What all lights send, over so many of them at once that their planes stay in the cache."""
    chunk = max(1, PLANE // tile.position.x.size)
    if lights.count <= chunk:
        return of(lights)
    chunks = in_chunks(lights, chunk)
    first = jax.eval_shape(of, jax.tree.map(lambda leaf: leaf[0], chunks))
    dark = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), first)
    total, _ = lax.scan(lambda total, some: (total + of(some), None), dark, chunks)
    return total
