"""One tile: all lights are evaluated for some hundred samples of one surface before the next are read.

Colours alone are computed in loops over samples that keep everything in registers (`sample_loops`), derivatives in
stages whose planes stay in the cache (`stages`): the same functions either way.
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
from jaxtyping import Array, Bool, Float

from ..raster.samples import SampleBuffer
from ..scene import Surface
from .changes import with_change
from .culling import Extent, received_from_near
from .geometry import Geometry, Unread, directions
from .highlight import highlight_of
from .mapped import mapped_axis_first
from .ordinary import for_all_mapped
from .plan import LightPlan, Plan
from .prepared import Prepared, compute_dtype, lanes_of, material_row, on_one_lane, viewer_of
from .sample_loops import UNROLLED, SampleLoops, SideBySide
from .stages import Stage
from .surface import MaterialRow, alpha, base_color, sampled_texture
from .terms import Haze, Received, fogged, haze, lit, received
from .unstored import Inlined, stored
from .vectors import Vector
from .world import WorldFog, WorldLights, in_chunks


class Color(NamedTuple):
    """What a tile gives."""

    rgb: Float[Array, "3 samples"]
    opacity: Float[Array, " #samples"]
    """Alpha; one number if it is the same of all samples."""

    @property
    def alpha(self) -> Float[Array, " samples"]:
        """Of every sample."""
        return jnp.broadcast_to(self.opacity, self.rgb.shape[-1:])


class Run(NamedTuple):
    """Consecutive tiles whose surfaces are coloured by the same code."""

    surface: Surface
    """Stands for all surfaces of the run: they differ in material and scope only."""
    single: int | None
    """The row of the run's only surface; None: several."""
    start: int
    stop: int


class How(NamedTuple):
    """What is static of a tile."""

    run: Run
    plan: Plan
    count: int
    """Neighbouring tiles that are one here."""
    forward: bool = False
    """If derivatives are taken, then in forward mode."""
    with_alpha: bool = False
    """Whether colours have a fourth component, alpha."""


class TileInputs(NamedTuple):
    """What the colour of a tile's samples follows from; planes [..., rows or 1, lanes or 1]."""

    position: Unread
    normal: Unread
    eye: Float[Array, "3 1 1"]
    vertex_color: Unread | None
    texel: Array | None
    material: MaterialRow | None
    lights: tuple[WorldLights | None, WorldLights | None, WorldLights | None]
    """Directional, point and spot lights; those out of scope are black, if they are not culled."""
    fog: WorldFog | None


class Near(NamedTuple):
    """What is asked to find the lights that reach a tile."""

    extent: Extent
    in_scope: tuple[Bool[Array, " lights"] | None, ...]
    """Of the three kinds; None: all."""


def tile_color(
    run: Run,
    prepared: Prepared,
    samples: SampleBuffer,
    plan: Plan,
    index: Array,
    count: int = 1,
    *,
    single: Prepared | None = None,
    texel: Float[Array, "components samples"] | None = None,
    forward: bool = False,
) -> Color:
    """The equation on one tile, or on `count` tiles of one surface from tile `index` * `count` on.

    `single`, `texel`: what `on_one_lane` and `sampled_texture` give, if that is known before all tiles; `forward`: if
    derivatives are taken, then in forward mode.
    """
    single = on_one_lane(prepared) if single is None else single
    return _tile_color(How(run, plan, count, forward), prepared, single, samples, texel, index)


def rows_of_tiles(
    run: Run, single: Prepared, samples: SampleBuffer, plan: Plan, first: Array | int, count: int
) -> Float[Array, "samples 4"]:
    """Red, green, blue and alpha, side by side, of `count` tiles from tile `first` on; not to be differentiated.

    Either they are of one block, or whole blocks, under at most UNROLLED lights.

    Args:
        single: what `on_one_lane` gives.
    """
    how = How(run, plan, count, with_alpha=True)
    lanes = lanes_of(samples) if plan.culled else samples.tile * min(count, samples.group)
    stage, near, inputs = _read(
        SampleLoops(_always(how, samples, first), lanes=lanes), how, single, samples, None, first, lanes
    )
    rows = _evaluated(how, near, stage, inputs).numbers
    return rows.astype(compute_dtype(samples)).reshape(-1, rows.shape[-1])


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _tile_color(
    how: How, prepared: Prepared, single: Prepared, samples: SampleBuffer, texel: Array | None, index: Array
) -> Color:
    always = _always(how, samples, index)
    lanes = lanes_of(samples) if how.plan.culled else samples.tile * how.count
    return mapped_axis_first(_color(SampleLoops(always, lanes=lanes), how, single, samples, texel, index, lanes))


def _tile_color_jvp(how: How, primals: Any, tangents: Any) -> tuple[Color, Color]:
    def in_stages(prepared: Prepared, samples: SampleBuffer, texel: Array | None, index: Array) -> Color:
        stage = Stage(_always(how, samples, index), forward=how.forward)
        return mapped_axis_first(_color(stage, how, prepared, samples, texel, index, prepared.lanes))

    (prepared, _, *others), (change, _, *other_changes) = primals, tangents
    return with_change(in_stages, (prepared, *others), (change, *other_changes))


_tile_color.defjvp(_tile_color_jvp, symbolic_zeros=True)


def _always(how: How, samples: SampleBuffer, number: Array | int) -> Bool[Array, ""]:
    """True, but only the running program knows; `number` is at least 0."""
    alone = how.run.stop - how.run.start <= how.count
    return samples.tile_surface[0] >= 0 if alone else jnp.asarray(number) >= 0


def _color(
    stage: Stage,
    how: How,
    prepared: Prepared,
    samples: SampleBuffer,
    texel: Array | None,
    index: Array,
    lanes: int,
) -> Color:
    stage, near, inputs = _read(stage, how, prepared, samples, texel, index * how.count, lanes)
    rgb = stored(_evaluated(how, near, stage, inputs))
    own = None if inputs.vertex_color is None else stored(inputs.vertex_color).stacked()
    dtype = compute_dtype(samples)
    opacity = alpha(how.plan.options, inputs.material, own, inputs.texel)
    opacity = jnp.ones(1, dtype) if opacity is None else opacity.astype(dtype).reshape(-1)
    return Color(rgb.astype(dtype).reshape(3, -1), opacity)


def _read(
    stage: Stage,
    how: How,
    prepared: Prepared,
    samples: SampleBuffer,
    texel: Array | None,
    first: Array | int,
    lanes: int,
) -> tuple[Stage, Near | None, TileInputs]:
    """What colours from tile `first` on follow from, left where it lies; `Near` if lights are evaluated in parts."""
    surface, plan, count = how.run.surface, how.plan, how.count
    dtype, tile, blocks = compute_dtype(samples), samples.tile * count, max(1, count // samples.group)
    rows = tile // lanes

    # Known before the loops that read there: divided in each of them, LLVM would not see that it is always the same.
    place = stage(lambda: (first // samples.group, first % samples.group * samples.tile), name="place")

    def part(planes: Array, components: tuple[int, ...], lowest: int = 0) -> Array:
        """The tiles' part of planes [blocks, components, block], of so many components or one, left where it lies."""
        block, within = place
        start = (block, jnp.full_like(block, lowest), within)
        return cast(Array, Inlined(partial(_part, blocks, (*components, rows, lanes), dtype), (planes, start)))

    def unread(planes: Array, components: int = 3) -> Unread:
        each = tuple(part(planes, (), component) for component in range(components))
        return Unread(each, part(planes, (components,)) if stage.stacks else None)

    def cut(planes: Array, kind: jnp.dtype = dtype) -> Array:
        """The tiles' part of planes [components, slots], [components, rows, lanes]."""
        own = partial(lax.dynamic_slice_in_dim, planes, first * samples.tile, tile, axis=-1)
        return stage(lambda: own().astype(kind).reshape(planes.shape[0], -1, lanes), name="read")

    def bounds(planes: Array, reduce: Callable[..., Array]) -> Array:
        return reduce(lax.dynamic_slice_in_dim(planes, first, count, axis=1), axis=1).astype(dtype)

    row: Any = how.run.single
    if row is None:
        row = samples.tile_surface[first]
        if blocks > 1:
            row = lax.dynamic_slice_in_dim(samples.tile_surface, first, count)[:: samples.group]
    material = material_row(prepared, surface, row, how.run.single)
    vertex_color = None
    if surface.color_components and samples.color_planes is not None:
        # Others in the buffer may have an alpha that these have not.
        vertex_color = unread(samples.color_planes, surface.color_components)
    index_planes, weight_planes = samples.texel_index, samples.texel_weight
    if texel is not None:
        texel = texel.reshape(-1, rows, lanes)
    elif surface.textured and index_planes is not None and weight_planes is not None:
        weight = cut(weight_planes)
        texel = sampled_texture(prepared.textures[surface.texture], cut(index_planes, jnp.dtype(jnp.int32)), weight)
    lit_material = material is not None and surface.lighting == "lit"
    in_scope = tuple(None if scope is None else scope[row] for scope in prepared.scopes)
    all_lights = (prepared.directional, prepared.point, prepared.spot)
    inputs = TileInputs(
        position=unread(samples.position_planes),
        normal=unread(samples.normal_planes),
        eye=samples.eye.astype(dtype)[:, None, None],
        vertex_color=vertex_color,
        texel=texel,
        material=material,
        lights=tuple(map(_in_reach, all_lights, how.plan.lights, in_scope)) if lit_material else (None,) * 3,  # type: ignore[arg-type]  # three kinds
        fog=prepared.fog if lit_material or plan.options.fog_unlit else None,
    )
    ordinary = for_all_mapped(jnp.all(lax.dynamic_slice_in_dim(prepared.ordinary, first, count)))
    near = None
    if sum(lights.count for lights in inputs.lights if lights is not None) > UNROLLED or plan.culled:
        extent = Extent(bounds(samples.tile_low, jnp.min), bounds(samples.tile_high, jnp.max), viewer_of(samples, plan))
        near = Near(extent, in_scope)
    return dataclasses.replace(stage, ordinary=ordinary), near, inputs


def _evaluated(how: How, near: Near | None, stage: Stage, inputs: TileInputs) -> Any:
    """The equation; all of it in one of what a stage puts together, unless lights are evaluated in parts."""
    if near is None:
        return stage.together(partial(_colors, how, None), inputs)
    return _colors(how, near, stage, inputs)


def tile_of(plane: Array, index: Array, tile: int) -> Array:
    """Columns of tile `index` of an array [..., slots]."""
    return lax.dynamic_slice_in_dim(plane, index * tile, tile, axis=-1)


def _part(blocks: int, shape: tuple[int, ...], dtype: jnp.dtype, array: Array, start: tuple[Array, ...]) -> Array:
    slots = shape[-2] * shape[-1]
    size = (blocks, math.prod(shape) // slots, slots // blocks)
    part = lax.dynamic_slice(array, start, size, allow_negative_indices=False)
    return part.reshape(shape).astype(dtype)


def _in_reach(
    lights: WorldLights | None, plan: LightPlan | None, in_scope: Bool[Array, "*rows lights"] | None
) -> WorldLights | None:
    """The lights with those out of scope made black; what is culled takes care of its scope itself."""
    if lights is None or plan is None or plan.culled or in_scope is None:
        return lights
    reaches = jnp.atleast_2d(in_scope).T[..., None]
    return dataclasses.replace(lights, color=jnp.where(reaches, lights.color, 0.0))


def _colors(how: How, near: Near | None, stage: Stage, inputs: TileInputs) -> Float[Array, "components rows lanes"]:
    """The equation; `near` is asked for if lights are culled."""
    position, eye = inputs.position.vector, Vector(*inputs.eye)
    own = stage.together(directions, inputs.position, inputs.normal, inputs.eye)
    tile = Geometry(position, eye, *(own.stored() if isinstance(own, SideBySide) else own))
    light = _light(how, near, stage, inputs, tile)
    return stage.together(partial(_mixed, how), inputs._replace(lights=(None,) * 3), light, tile)


def _light(how: How, near: Near | None, stage: Stage, inputs: TileInputs, tile: Geometry) -> Received | None:
    """What the lights of all kinds send to a tile; None: there are none."""
    total = None
    for kind, (lights, plan) in enumerate(zip(inputs.lights, how.plan.lights, strict=True)):
        if lights is None or plan is None:
            continue

        def with_light(stage: Stage, total: Received | None, some: WorldLights) -> Received:
            return stage.together(partial(_received, how), some, tile, inputs.material, total)

        most = stage.lights_at_once(lights.count, math.prod(tile.position.x.shape))
        if plan.culled:
            assert near is not None
            position, in_scope = stored(tile.position), near.in_scope[kind]
            total = received_from_near(stage, with_light, total, lights, in_scope, position, near.extent)
        elif lights.count > most:
            parts = -(-lights.count // most)
            # All about as long: what is missing is filled up with black.
            chunks = in_chunks(lights, -(-lights.count // parts))
            total = stage.sum_over(with_light, total, chunks)
        else:
            total = with_light(stage, total, lights)
    return total


def _received(
    how: How,
    stage: Stage,
    lights: WorldLights,
    tile: Geometry,
    material: MaterialRow,
    total: Received | None,
) -> Received:
    """`total` and what these lights send."""
    options = how.plan.options
    highlight = highlight_of(options.accuracy) if how.plan.specular else None
    own = received(stage, lights, tile, material, highlight=highlight, specular_gate=options.specular_gate)
    return own if total is None else total + own


def _mixed(
    how: How, stage: Stage, inputs: TileInputs, light: Received | None, tile: Geometry
) -> Float[Array, "components rows lanes"]:
    fog = None
    if inputs.fog is not None and how.plan.fog is not None:
        fog = (inputs.fog.color, haze(stage, inputs.fog, how.plan.fog.fog_type, tile))
    shape = tile.position.x.shape
    own = None if inputs.vertex_color is None else inputs.vertex_color.stacked()
    return stage.each(partial(_colored, how, shape), inputs.material, own, inputs.texel, light, fog)


def _colored(
    how: How,
    shape: tuple[int, ...],
    material: MaterialRow | None,
    vertex_color: Array | None,
    texel: Array | None,
    light: Received | None,
    fog: tuple[Array, Haze] | None,
) -> Float[Array, "components rows lanes"]:
    surface, plan = how.run.surface, how.plan
    color = base_color(surface, plan.options, material, vertex_color, texel)
    if surface.lighting == "lit" and material is not None:
        color = lit(material, color, light, emissive=plan.emissive)
    rgb = jnp.broadcast_to(color if fog is None else fogged(color, *fog), (3, *shape))
    if not how.with_alpha:
        return rgb
    opacity = alpha(plan.options, material, vertex_color, texel)
    return jnp.concatenate([rgb, jnp.broadcast_to(1.0 if opacity is None else opacity, shape)[None].astype(rgb.dtype)])
