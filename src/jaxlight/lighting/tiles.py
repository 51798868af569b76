"""One tile: what fits the cache. All lights are evaluated for some hundred samples of one surface at once.

Derivatives are taken tile by tile too (a tile is computed anew in reverse mode), so memory does not grow with lights.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..raster.samples import SampleBuffer
from ..scene import Scene, Surface
from .culling import received_from_near
from .highlight import highlight_of
from .plan import Plan
from .prepared import Prepared, compute_dtype, lanes_of, material_row
from .stages import Inlined, Stage, stored
from .surface import MaterialRow, alpha, base_color, sampled_texture
from .terms import Geometry, Haze, Received, Unread, fogged, geometry, haze, lit, received
from .vectors import Vector
from .world import WorldLights, in_chunks

PLANE = 8192
"""Lights times samples that are evaluated at once: what a tile's planes may hold to stay in the cache."""

SMALLEST_TILE = 256
"""Samples of a tile that is split because there are many lights."""


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


def tiles_at_once(scene: Scene, samples: SampleBuffer, plan: Plan) -> int:
    """How many neighbouring tiles are evaluated together: several where few lights would leave the planes short."""
    lights, count = _most_lights(scene, plan), samples.group
    if lights is None:
        return 1
    while count > 1 and count * samples.tile * lights > PLANE:
        count //= 2
    return count


def in_fitting_tiles(scene: Scene, samples: SampleBuffer, plan: Plan) -> SampleBuffer:
    """The samples in tiles so small that planes of all lights of a kind stay in the cache, if that is small enough.

    Under still more lights they stay as they are, and lights are evaluated in chunks: what is done once a sample has
    its price in small tiles, as it has in derivatives to evaluate chunks twice.
    """
    lights, parts = _most_lights(scene, plan), 1
    if lights is None:
        return samples
    while samples.tile // parts * lights > PLANE:
        parts *= 2
    return samples.with_split_tiles(parts) if samples.tile // parts >= SMALLEST_TILE else samples


def _most_lights(scene: Scene, plan: Plan) -> int | None:
    """Of the kind with most lights their number, at least 1; None if only those near a tile are evaluated."""
    most = 1
    for group, light_plan in (
        (scene.directional, plan.directional),
        (scene.point, plan.point),
        (scene.spot, plan.spot),
    ):
        if group is None or light_plan is None:
            continue
        if light_plan.culled:
            return None
        most = max(most, len(group.names) if light_plan.rows is None else len(light_plan.rows))
    return most


class Share(NamedTuple):
    """One of the equal shares into which the tiles of every run are divided; the last ones may overlap others."""

    number: Int[Array, ""]
    shares: int

    def of(self, steps: int) -> Int[Array, " share"]:
        """The share of 0, 1, ... `steps` - 1."""
        length = -(-steps // self.shares)
        return jnp.minimum(self.number * length, steps - length) + jnp.arange(length)


def joined_shares(colors: list[Array], tiles: int) -> Float[Array, "tiles 4 tile"]:
    """The colours of all tiles of a run from those of its shares, without what they have twice."""
    length = colors[0].shape[0]
    twice = [max(0, number * length - (tiles - length)) for number in range(len(colors))]
    return jnp.concatenate([share[skipped:] for share, skipped in zip(colors, twice, strict=True)])


def colors_of_run(
    run: Run, prepared: Prepared, samples: SampleBuffer, plan: Plan, count: int, share: Share | None = None
) -> Float[Array, "tiles 4 tile"]:
    """Red, green, blue and alpha of the tiles of a run or of a share of them, `count` tiles at once."""

    @jax.checkpoint
    def body(index: Array, prepared: Prepared, samples: SampleBuffer) -> Array:
        color = tile_color(run, prepared, samples, plan, index, count)
        planes = jnp.concatenate([color.rgb, color.alpha[None]])
        return jnp.swapaxes(planes.reshape(4, count, samples.tile), 0, 1)

    def step(_: None, index: Array) -> tuple[None, Array]:
        return None, body(index, prepared, samples)

    steps = (run.stop - run.start) // count
    indices = run.start // count + (jnp.arange(steps) if share is None else share.of(steps))
    colors = lax.scan(step, None, indices)[1]
    return colors.reshape(-1, 4, samples.tile)


def tile_of(plane: Array, index: Array, tile: int) -> Array:
    """Columns of tile `index` of an array [..., slots]."""
    return lax.dynamic_slice_in_dim(plane, index * tile, tile, axis=-1)


def _part(shape: tuple[int, ...], dtype: jnp.dtype, array: Array, start: tuple[Array, ...]) -> Array:
    slots = shape[-2] * shape[-1]
    return lax.dynamic_slice(array, start, (1, math.prod(shape) // slots, slots)).reshape(shape).astype(dtype)


def tile_color(
    run: Run,
    prepared: Prepared,
    samples: SampleBuffer,
    plan: Plan,
    index: Array,
    count: int = 1,
    *,
    forward: bool = False,
) -> Color:
    """The equation on one tile, or on `count` tiles of one surface from tile `index` * `count` on.

    `forward`: if derivatives are taken, then in forward mode.
    """
    dtype, tile, lanes = compute_dtype(samples), samples.tile * count, lanes_of(samples)
    stage = Stage(index >= 0 if run.stop - run.start > count else samples.tile_surface[0] >= 0, forward)
    first = index * count

    def part(planes: Array, component: int | None = None) -> Array:
        """The tiles' part of planes [blocks, components, block], of all components or one, left where it lies."""
        block, within = first // samples.group, first % samples.group * samples.tile
        components = planes.shape[1:2] if component is None else ()
        start = (block, jnp.full_like(block, component or 0), within)
        return cast(Array, Inlined(partial(_part, (*components, tile // lanes, lanes), dtype), (planes, start)))

    def unread(planes: Array) -> Unread:
        return Unread(Vector(*(part(planes, i) for i in range(3))), part(planes))

    def cut(planes: Array, kind: jnp.dtype = dtype) -> Array:
        """The tiles' part of planes [components, slots], [components, rows, lanes]."""
        return stage(lambda: tile_of(planes, index, tile).astype(kind).reshape(planes.shape[0], -1, lanes), name="read")

    def bounds(planes: Array, reduce: Callable[..., Array]) -> Array:
        return reduce(lax.dynamic_slice_in_dim(planes, first, count, axis=1), axis=1).astype(dtype)

    surface = run.surface
    row = samples.tile_surface[first] if run.single is None else run.single
    material = material_row(prepared, surface, row, run.single)
    vertex_color = texel = None
    if surface.color_components and samples.color_planes is not None:
        vertex_color = part(samples.color_planes)
    index_planes, weight_planes = samples.texel_index, samples.texel_weight
    if (
        surface.texture >= 0
        and surface.lighting != "emissive"
        and index_planes is not None
        and weight_planes is not None
    ):
        weight = cut(weight_planes)
        texel = sampled_texture(prepared.textures[surface.texture], cut(index_planes, jnp.dtype(jnp.int32)), weight)
    low, high = bounds(samples.tile_low, jnp.min), bounds(samples.tile_high, jnp.max)
    position, normal = unread(samples.position_planes), unread(samples.normal_planes)
    in_range = jnp.all(lax.dynamic_slice_in_dim(prepared.in_range, first, count))
    ground = geometry(stage, position, normal, samples.eye.astype(dtype), low, high, in_range)
    lit_material = material if surface.lighting == "lit" else None
    light = None if lit_material is None else _light(stage, prepared, plan, ground, lit_material, row)
    fog = None
    if prepared.fog is not None and plan.fog is not None and (lit_material is not None or plan.options.fog_unlit):
        fog = (prepared.fog.color, haze(stage, prepared.fog, plan.fog.fog_type, ground))
    rgb = stage.each(
        partial(_rgb, surface, plan, (3, tile // lanes, lanes)), material, vertex_color, texel, light, fog
    ).astype(dtype)
    opacity = alpha(plan.options, material, stored(vertex_color), texel)
    opacity = jnp.broadcast_to(1.0 if opacity is None else opacity, (tile // lanes, lanes)).astype(dtype)
    return Color(rgb.reshape(3, tile), opacity.reshape(tile))


def _rgb(
    surface: Surface,
    plan: Plan,
    shape: tuple[int, ...],
    material: MaterialRow | None,
    vertex_color: Array | None,
    texel: Array | None,
    light: Received | None,
    fog: tuple[Array, Haze] | None,
) -> Float[Array, "3 rows lanes"]:
    color = base_color(surface, plan.options, material, vertex_color, texel)
    if surface.lighting == "lit" and material is not None:
        color = lit(material, color, light, emissive=plan.emissive)
    return jnp.broadcast_to(color if fog is None else fogged(color, *fog), shape)


def _light(
    stage: Stage, prepared: Prepared, plan: Plan, tile: Geometry, material: MaterialRow, row: Any
) -> Received | None:
    """What the lights of all kinds send to a tile; None: there are none."""
    total = None
    if any(light_plan is not None and light_plan.culled for light_plan in (plan.directional, plan.point, plan.spot)):
        tile = tile._replace(position=stored(tile.position))
    highlight = highlight_of(plan.options.accuracy) if plan.specular else None
    kinds = zip(
        (prepared.directional, prepared.point, prepared.spot),
        (plan.directional, plan.point, plan.spot),
        prepared.scopes,
        strict=True,
    )
    for lights, light_plan, scope in kinds:
        if lights is None or light_plan is None:
            continue
        in_scope = None if scope is None else scope[row]

        def of(some: WorldLights, tile: Geometry) -> Received:
            return received(stage, some, tile, material, highlight=highlight, specular_gate=plan.options.specular_gate)

        if light_plan.culled:
            light = received_from_near(stage, of, lights, in_scope, tile)
        else:
            light = _received_from_all(of, lights if in_scope is None else _scoped(lights, in_scope), tile)
        total = light if total is None else total + light
    return total


def _scoped(lights: WorldLights, in_scope: Array) -> WorldLights:
    """The lights with those out of scope made black."""
    return dataclasses.replace(lights, color=jnp.where(in_scope[:, None, None], lights.color, 0.0))


def _received_from_all(
    of: Callable[[WorldLights, Geometry], Received], lights: WorldLights, tile: Geometry
) -> Received:
    """What all lights send, over so many of them at once that their planes stay in the cache."""
    chunk = max(1, PLANE // math.prod(tile.position.x.shape))
    if lights.count <= chunk:
        return of(lights, tile)
    count = -(-lights.count // chunk)
    chunks = in_chunks(lights, -(-lights.count // count))  # all about as long: what is missing is filled up with black
    first = jax.eval_shape(of, jax.tree.map(lambda leaf: leaf[0], chunks), tile)
    dark = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), first)
    # Checkpoint: what derivatives need of a chunk is computed anew, and never stored for all chunks.
    total, _ = lax.scan(lambda total, some: (total + jax.checkpoint(of)(some, tile), None), dark, chunks)
    return total
