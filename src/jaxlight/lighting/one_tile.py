"""One tile: all lights are evaluated for some hundred samples of one surface before the next are read.

Colours alone are computed in loops over samples that keep everything in registers (`sample_loops`), derivatives in
stages whose planes stay in the cache (`stages`): the same functions either way.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ..raster.samples import SampleBuffer
from .changes import with_change
from .clusters import inverse
from .culled_lights import CulledLights
from .culling import received_from_near
from .geometry import Geometry, directions
from .highlight import highlight_of
from .mapped import mapped_axis_first
from .plan import Plan
from .prepared import Prepared, compute_dtype
from .sample_loops import UNROLLED, SampleLoops, SideBySide
from .stages import Stage
from .surface import MaterialRow, alpha, base_color
from .terms import Haze, Received, fogged, haze, lit, received
from .tile_inputs import Near, Run, TileInputs, TileKind, read_tile
from .unstored import stored
from .vectors import Vector
from .world import WorldLights, in_chunks


class Color(NamedTuple):
    """What a tile gives."""

    rgb: Float[Array, "3 samples"]
    opacity: Float[Array, " #samples"]
    """Alpha; one number if it is the same of all samples."""

    @property
    def alpha(self) -> Float[Array, " samples"]:
        """Of every sample."""
        return jnp.broadcast_to(self.opacity, self.rgb.shape[-1:])


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

    `single`: the numbers of `prepared` on one lane; default: these. `texel`: what `sampled_texture` gives, if that is
    known before all tiles; `forward`: if derivatives are taken, then in forward mode.
    """
    single = lax.stop_gradient(prepared if single is None else single)
    return _tile_color(TileKind(run, plan, count, forward), prepared, single, samples, texel, index)


def rows_of_tiles(
    run: Run, prepared: Prepared, samples: SampleBuffer, plan: Plan, first: Array | int, count: int
) -> Float[Array, "samples 4"]:
    """Red, green, blue and alpha, side by side, of `count` tiles from tile `first` on; not to be differentiated.

    Either they are of one block, or whole blocks, under at most UNROLLED lights.
    """
    how = TileKind(run, plan, count, with_alpha=True)
    lanes = _lanes_of_loops(how, samples)
    stage, near, inputs = read_tile(
        SampleLoops(_always(how, samples, first), lanes=lanes), how, prepared, samples, None, first, lanes
    )
    color = _evaluated(how, near, stage, inputs)
    rows = color.numbers if isinstance(color, SideBySide) else jnp.moveaxis(color, 0, -1)
    if near is not None and near.order is not None:
        rows = rows[inverse(near.order)]
    return rows.astype(compute_dtype(samples)).reshape(-1, rows.shape[-1])


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _tile_color(
    how: TileKind, prepared: Prepared, single: Prepared, samples: SampleBuffer, texel: Array | None, index: Array
) -> Color:
    always = _always(how, samples, index)
    lanes = _lanes_of_loops(how, samples)
    return mapped_axis_first(_color(SampleLoops(always, lanes=lanes), how, single, samples, texel, index, lanes))


def _tile_color_jvp(how: TileKind, primals: Any, tangents: Any) -> tuple[Color, Color]:
    def in_stages(prepared: Prepared, samples: SampleBuffer, texel: Array | None, index: Array) -> Color:
        stage = Stage(_always(how, samples, index), forward=how.forward)
        return mapped_axis_first(_color(stage, how, prepared, samples, texel, index, prepared.lanes))

    (prepared, _, *others), (change, _, *other_changes) = primals, tangents
    return with_change(in_stages, (prepared, *others), (change, *other_changes))


_tile_color.defjvp(_tile_color_jvp, symbolic_zeros=True)


def _lanes_of_loops(how: TileKind, samples: SampleBuffer) -> int:
    """All samples of a block in one row; or a row for each cluster."""
    return samples.cluster if how.plan.culled else samples.tile * min(how.count, samples.group)


def _always(how: TileKind, samples: SampleBuffer, number: Array | int) -> Bool[Array, ""]:
    """True, but only the running program knows; `number` is at least 0.

    By the number in any case: where JAX divides a loop into what is known before and what is not, stages of a known
    one would be taken apart, and lose the derivatives that their functions have of their own.
    """
    always = jnp.asarray(number) >= 0
    alone = how.run.stop - how.run.start <= how.count
    return always & (samples.tile_surface[0] >= 0) if alone else always


def _color(
    stage: Stage,
    how: TileKind,
    prepared: Prepared,
    samples: SampleBuffer,
    texel: Array | None,
    index: Array,
    lanes: int,
) -> Color:
    stage, near, inputs = read_tile(stage, how, prepared, samples, texel, index * how.count, lanes)
    rgb = stored(_evaluated(how, near, stage, inputs))
    own = None if inputs.vertex_color is None else stored(inputs.vertex_color).stacked()
    dtype = compute_dtype(samples)
    opacity = alpha(how.plan.options, inputs.material, own, inputs.texel)
    opacity = jnp.ones((1, 1), dtype) if opacity is None else opacity.astype(dtype)
    if near is not None:
        rgb, opacity = (stage.clusters.as_stored(planes, near.order) for planes in (rgb, opacity))
    return Color(rgb.astype(dtype).reshape(3, -1), opacity.reshape(-1))


def _evaluated(how: TileKind, near: Near | None, stage: Stage, inputs: TileInputs) -> Any:
    """The equation; all of it in one of what a stage puts together, unless lights are evaluated in parts."""
    if near is None and sum(lights.count for lights in inputs.lights if lights is not None) <= UNROLLED:
        return stage.together(partial(_colors, how, None), inputs)
    return _colors(how, near, stage, inputs)


def _colors(
    how: TileKind, near: Near | None, stage: Stage, inputs: TileInputs
) -> Float[Array, "components rows lanes"]:
    """The equation; `near` is asked for if lights are culled."""
    position, eye = inputs.position.vector, Vector(*inputs.eye)
    # Lists of lights read them many times: planes, not numbers side by side.
    own = (stage if near is None else stage.in_planes).together(directions, inputs.position, inputs.normal, inputs.eye)
    tile = Geometry(position, eye, *(own.stored() if isinstance(own, SideBySide) else own))
    light = _light(how, near, stage, inputs, tile)
    return stage.together(partial(_mixed, how), inputs._replace(lights=(None,) * 3), light, tile)


def _light(how: TileKind, near: Near | None, stage: Stage, inputs: TileInputs, tile: Geometry) -> Received | None:
    """What the lights of all kinds send to a tile; None: there are none."""
    total = None
    for kind, (lights, plan) in enumerate(zip(inputs.lights, how.plan.lights, strict=True)):
        if lights is None or plan is None:
            continue

        def with_light(stage: Stage, total: Received | None, some: WorldLights, first: Array | None = None) -> Received:
            own = (tile, inputs.material) if first is None else _of_some(stage, tile, inputs.material, first)
            return stage.together(partial(_received, how), some, *own, total)

        most = stage.lights_at_once(lights.count, math.prod(tile.position.x.shape))
        found = None if near is None else near.found[kind]
        if isinstance(lights, CulledLights):
            assert near is not None and found is not None
            total = received_from_near(stage, with_light, total, stage.clusters.form_of(lights), found, near.extent)
        elif lights.count > most:
            parts = -(-lights.count // most)
            # All about as long: what is missing is filled up with black.
            chunks = in_chunks(lights, -(-lights.count // parts))
            total = stage.sum_over(with_light, total, chunks)
        else:
            total = with_light(stage, total, lights)
    return total


def _of_some(stage: Stage, tile: Geometry, material: Any, first: Array) -> tuple[Geometry, Any]:
    """Of as many clusters as work through their lists at once, from the first on."""
    numbers = tile._replace(eye=())
    some = stage.clusters.some(numbers, first)
    return some._replace(eye=tile.eye), stage.clusters.numbers_of_some(material)


def _received(
    how: TileKind,
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
    how: TileKind, stage: Stage, inputs: TileInputs, light: Received | None, tile: Geometry
) -> Float[Array, "components rows lanes"]:
    fog = None
    if inputs.fog is not None and how.plan.fog is not None:
        fog = (inputs.fog.color, haze(stage, inputs.fog, how.plan.fog.fog_type, tile))
    shape = tile.position.x.shape
    own = None if inputs.vertex_color is None else inputs.vertex_color.stacked()
    return stage.each(partial(_colored, how, shape), inputs.material, own, inputs.texel, light, fog)


def _colored(
    how: TileKind,
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
