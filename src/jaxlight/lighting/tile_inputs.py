"""What the colours of a tile follow from, read where it lies: samples, material, lights, fog.

Where lights are culled, samples are read cluster by cluster (see `culling`), those first that few lights may reach.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import operator
from functools import partial
from typing import Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..raster.samples import SampleBuffer
from ..scene import Surface
from .culled_lights import CulledLights
from .culling import Bounds, Extent, Found, by_length, find_near
from .geometry import Unread
from .ordinary import for_all_mapped
from .plan import Plan
from .prepared import Prepared, compute_dtype, is_only, material_row, viewer_of
from .stages import Stage
from .surface import MaterialRow, sampled_texture
from .unstored import Inlined
from .vectors import Vector
from .world import WorldFog, WorldLights


class Run(NamedTuple):
    """Consecutive tiles whose surfaces are coloured by the same code."""

    surface: Surface
    """Stands for all surfaces of the run: they differ in material and scope only."""
    single: int | None
    """The row of the run's only surface; None: several."""
    start: int
    stop: int


class TileKind(NamedTuple):
    """What is static of a tile."""

    run: Run
    plan: Plan
    count: int
    """Neighbouring tiles that are one here."""
    forward: bool = False
    """If derivatives are taken, then in forward mode."""
    with_alpha: bool = False
    """Whether colours have a fourth component, alpha."""

    @property
    def clustered(self) -> bool:
        """Whether samples are read cluster by cluster, each of which has lights of its own."""
        return self.plan.culled and self.run.surface.material >= 0 and self.run.surface.lighting == "lit"


class TileInputs(NamedTuple):
    """What the colour of a tile's samples follows from; planes [..., rows or 1, lanes or 1]."""

    position: Unread
    normal: Unread
    eye: Float[Array, "3 1 1"]
    vertex_color: Unread | None
    texel: Array | None
    material: MaterialRow | None
    lights: tuple[WorldLights | CulledLights | None, ...]
    """Directional, point and spot lights; those out of scope are black, if they are not culled."""
    fog: WorldFog | None


class Near(NamedTuple):
    """Of lights that are evaluated for those clusters only that they may reach."""

    extent: Extent
    found: tuple[Found | None, ...]
    """Of the three kinds; None: not culled."""
    order: Int[Array, " clusters"] | None
    """In which the tile's clusters are read; None: as they lie."""


def read_tile(
    stage: Stage,
    how: TileKind,
    prepared: Prepared,
    samples: SampleBuffer,
    texel: Array | None,
    first: Array | int,
    lanes: int,
) -> tuple[Stage, Near | None, TileInputs]:
    """The stage as it is for `how.count` tiles from tile `first` on, and what their colours follow from.

    `Near`: if they are read cluster by cluster.
    """
    surface, plan, count = how.run.surface, how.plan, how.count
    dtype, tile, blocks = compute_dtype(samples), samples.tile * count, max(1, count // samples.group)
    rows = tile // lanes

    row: Any = how.run.single
    if row is None:
        row = samples.tile_surface[first]
        if blocks > 1:
            row = lax.dynamic_slice_in_dim(samples.tile_surface, first, count)[:: samples.group]
    material = material_row(prepared, surface, row, how.run.single)
    if prepared.materials is not None and not is_only(prepared.materials):
        material = stage.on_lanes(material, prepared.lanes)
    lit = material is not None and surface.lighting == "lit"
    in_scope = tuple(None if scope is None else scope[row] for scope in prepared.scopes)
    all_lights = prepared.lights if lit else (None,) * 3
    near = _near(stage, how, samples, first, all_lights, in_scope) if how.clustered else None

    # Known before the loops that read there: divided in each of them, LLVM would not see that it is always the same.
    place = stage(lambda: (first // samples.group, first % samples.group * samples.tile), name="place")

    def part(planes: Array, components: tuple[int, ...], lowest: int = 0) -> Array:
        """The tiles' part of planes [blocks, components, block], of so many components or one, left where it lies."""
        block, within = place
        start = (block, jnp.full_like(block, lowest), within)
        return cast(Array, Inlined(partial(_part, blocks, (*components, rows, lanes), dtype), (planes, start)))

    def arranged(planes: Array) -> Array:
        """[components, slots] -> [components, rows, lanes]"""
        if near is None:
            return planes.reshape(planes.shape[0], -1, lanes)
        return stage.clusters.arranged(planes.reshape(planes.shape[0], -1, samples.cluster), near.order)

    def unread(planes: Array, components: int = 3) -> Unread:
        if near is not None:
            # First as they lie: memory is read the quicker.
            whole = stage(lambda own: own, part(planes, (components,)), name="read")
            own = stage(lambda own: arranged(own.reshape(components, -1)), whole, name="read")
            return Unread(tuple(cast(Array, Inlined(operator.itemgetter(k), (own,))) for k in range(components)), own)
        each = tuple(part(planes, (), component) for component in range(components))
        return Unread(each, part(planes, (components,)) if stage.stacks else None)

    def cut(planes: Array, kind: jnp.dtype = dtype) -> Array:
        """The tiles' part of planes [components, slots], [components, rows, lanes]."""
        own = partial(lax.dynamic_slice_in_dim, planes, first * samples.tile, tile, axis=-1)
        return stage(lambda: arranged(own().astype(kind)), name="read")

    vertex_color = None
    if surface.color_components and samples.color_planes is not None:
        # Others in the buffer may have an alpha that these have not.
        vertex_color = unread(samples.color_planes, surface.color_components)
    index_planes, weight_planes = samples.texel_index, samples.texel_weight
    if texel is not None:
        texel = arranged(texel)
    elif surface.textured and index_planes is not None and weight_planes is not None:
        texel = _texel(how.run, prepared, samples, row, cut(index_planes, jnp.dtype(jnp.int32)), cut(weight_planes))
    inputs = TileInputs(
        position=unread(samples.position_planes),
        normal=unread(samples.normal_planes),
        eye=samples.eye.astype(dtype)[:, None, None],
        vertex_color=vertex_color,
        texel=texel,
        material=material,
        lights=tuple(map(_in_reach, all_lights, in_scope)),
        fog=prepared.fog if lit or plan.options.fog_unlit else None,
    )
    ordinary = for_all_mapped(jnp.all(lax.dynamic_slice_in_dim(prepared.ordinary, first, count)))
    return dataclasses.replace(stage, ordinary=ordinary), near, inputs


def textures_of_run(run: Run, surfaces: tuple[Surface, ...], samples: SampleBuffer) -> list[tuple[int, int, int]]:
    """(texture, first tile, tile after the last) of neighbouring tiles of one texture, for a run that has textures."""
    own = [part for part in samples.runs if run.start <= part[1] < run.stop]
    found = []
    for texture, alike in itertools.groupby(own, lambda part: surfaces[part[0]].texture):
        (_, start, stop), *more = alike
        found.append((texture, start, more[-1][2] if more else stop))
    return found


def _texel(
    run: Run, prepared: Prepared, samples: SampleBuffer, row: Any, index: Array, weight: Array
) -> Float[Array, "components ..."]:
    """The texture of surface `row`; of several surfaces by the one of these that their tile has."""
    of_run = sorted({texture for texture, _, _ in textures_of_run(run, prepared.surfaces, samples)})
    branches = [partial(sampled_texture, prepared.textures[texture]) for texture in of_run]
    if len(branches) == 1:
        return branches[0](index, weight)
    numbers = np.array(
        [of_run.index(own.texture) if own.texture in of_run else 0 for own in prepared.surfaces], np.int32
    )
    return lax.switch(jnp.asarray(numbers)[row], branches, index, weight)


def tile_of(plane: Array, index: Array, tile: int) -> Array:
    """Columns of tile `index` of an array [..., slots]."""
    return lax.dynamic_slice_in_dim(plane, index * tile, tile, axis=-1)


def _near(
    stage: Stage,
    how: TileKind,
    samples: SampleBuffer,
    first: Array | int,
    lights: tuple[WorldLights | CulledLights | None, ...],
    in_scope: tuple[Bool[Array, " lights"] | None, ...],
) -> Near:
    dtype = compute_dtype(samples)

    def bounds(planes: Array, each: int) -> Float[Array, "3 groups"]:
        """Of the tiles' groups of samples, so many in each tile."""
        return lax.dynamic_slice_in_dim(planes, first * each, how.count * each, axis=1).astype(dtype)

    low, high = jnp.min(bounds(samples.tile_low, 1), axis=1), jnp.max(bounds(samples.tile_high, 1), axis=1)
    largest = jnp.maximum(jnp.max(jnp.abs(low)), jnp.max(jnp.abs(high)))
    each = samples.tile // samples.cluster
    clusters = Bounds(Vector(*bounds(samples.cluster_low, each)), Vector(*bounds(samples.cluster_high, each)), largest)
    extent = Extent(low, high, clusters, viewer_of(samples, how.plan))
    found = tuple(
        find_near(stage, own, scope, extent) if isinstance(own, CulledLights) else None
        for own, scope in zip(lights, in_scope, strict=True)
    )
    if how.count * each <= stage.clusters.at_once():
        return Near(extent, found, None)
    order = by_length([own.lists for own in found if own is not None])
    found = tuple(None if own is None else own.of(order) for own in found)
    return Near(extent._replace(clusters=clusters.of(order)), found, order)


def _part(blocks: int, shape: tuple[int, ...], dtype: jnp.dtype, array: Array, start: tuple[Array, ...]) -> Array:
    slots = shape[-2] * shape[-1]
    size = (blocks, math.prod(shape) // slots, slots // blocks)
    part = lax.dynamic_slice(array, start, size, allow_negative_indices=False)
    return part.reshape(shape).astype(dtype)


def _in_reach(
    lights: WorldLights | CulledLights | None, in_scope: Bool[Array, "*rows lights"] | None
) -> WorldLights | CulledLights | None:
    """The lights with those out of scope made black; what is culled takes care of its scope itself."""
    if lights is None or isinstance(lights, CulledLights) or in_scope is None:
        return lights
    reaches = jnp.atleast_2d(in_scope).T[..., None]
    return dataclasses.replace(lights, color=jnp.where(reaches, lights.color, 0.0))
