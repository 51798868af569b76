"""All tiles of a buffer, one after the other: their sizes, their runs, and the loop over them.

Derivatives are taken tile by tile too (a tile is computed anew in reverse mode), so memory does not grow with lights.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..processor import for_cpu, sizes
from ..raster.samples import SampleBuffer
from ..scene import Scene, Surface, Texture
from .changes import with_change, without_zeros
from .lanes import Packed, on_all_lanes, packed, spread, unpacked
from .one_tile import Color, rows_of_tiles, tile_color
from .plan import Plan
from .prepared import Prepared, compute_dtype
from .surface import sampled_texture
from .tile_inputs import Run, textures_of_run

VERY_FEW = 4
"""Lights under which the samples of a run are evaluated in one loop: tile by tile, what a step of the loop over tiles
costs, and to put its colours where they belong, is as much as half of the loop over samples."""


def surface_runs(
    surfaces: tuple[Surface, ...], samples: SampleBuffer, textures: tuple[Texture, ...] | None = None
) -> list[Run]:
    """The buffer's tiles, split where the code that colours them changes.

    `textures`: those of the scene; all that have as many components are read by the same code. None: split by textures.
    """
    shared = textures if for_cpu() else None
    runs: list[Run] = []
    for _, alike in itertools.groupby(samples.runs, lambda run: surfaces[run[0]].code(shared)):
        (row, start, stop), *more = alike
        runs.append(Run(surfaces[row], None, start, more[-1][2]) if more else Run(surfaces[row], row, start, stop))
    return runs


def tiles_at_once(scene: Scene, samples: SampleBuffer, plan: Plan) -> int:
    """How many neighbouring tiles are evaluated together: several where few lights would leave the planes short."""
    if plan.culled:
        return samples.group
    lights, count = min(max(1, *_lights_by_kind(scene, plan)), sizes().lights), samples.group
    # Planes of samples count as much as those of one light more.
    while count > 1 and count * samples.tile * (lights + 1) > sizes().planes:
        count //= 2
    return count


def _lights_by_kind(scene: Scene, plan: Plan) -> list[int]:
    """How many lights of each kind the plan keeps."""
    return [
        0 if group is None or kept is None else len(group.names if kept.rows is None else kept.rows)
        for group, kept in zip((scene.directional, scene.point, scene.spot), plan.lights, strict=True)
    ]


class Share(NamedTuple):
    """One of the equal shares into which the tiles of every run are divided; the last ones may overlap others."""

    number: Int[Array, ""]
    shares: int

    def of(self, steps: int) -> Int[Array, " share"]:
        """The share of 0, 1, ... `steps` - 1."""
        length = -(-steps // self.shares)
        return jnp.minimum(self.number * length, steps - length) + jnp.arange(length)


def joined_shares(rows: list[Array], tiles: int) -> Float[Array, "tiles tile 4"]:
    """The colours of all tiles of a run from those of its shares, without what they have twice."""
    length = rows[0].shape[0]
    twice = [max(0, number * length - (tiles - length)) for number in range(len(rows))]
    return jnp.concatenate([share[skipped:] for share, skipped in zip(rows, twice, strict=True)])


def is_one_loop(run: Run, scene: Scene, plan: Plan) -> bool:
    """Whether all samples of a run are evaluated in one loop, of which XLA gives each core a part.

    Texels are gathered tile by tile.
    """
    if plan.culled or run.surface.textured:
        return False
    return run.surface.lighting != "lit" or sum(_lights_by_kind(scene, plan)) <= VERY_FEW


def rows_of_run(
    run: Run, prepared: Prepared, samples: SampleBuffer, plan: Plan, share: Share | None, *, one_loop: bool
) -> Float[Array, "tiles tile 4"]:
    """Red, green, blue and alpha of the tiles of a run or of a share of them; not to be differentiated."""
    count = samples.group
    steps = (run.stop - run.start) // count
    numbers = jnp.arange(steps) if share is None else share.of(steps)
    if one_loop:
        first = run.start if share is None else run.start + numbers[0] * count
        rows = rows_of_tiles(run, prepared, samples, plan, first, numbers.shape[0] * count)
    else:

        def step(_: None, first: Array) -> tuple[None, Array]:
            return None, rows_of_tiles(run, prepared, samples, plan, first, count)

        rows = lax.scan(step, None, run.start + numbers * count)[1]
    return rows.reshape(-1, samples.tile, 4)


def color_and_alpha_of_run(
    run: Run, prepared: Prepared, samples: SampleBuffer, plan: Plan, count: int, *, by_images: bool
) -> tuple[Float[Array, "tiles 3 tile"], Float[Array, "tiles 1 tile"]]:
    """Colours of the tiles of a run, `count` at once, and alpha apart, as small as it may be, and what is kept for its
    derivatives with it.

    `by_images`: derivatives by samples or textures are asked for.
    """

    def planes_of(color: Color) -> Color:
        # Row by row, as they are computed, or XLA would divide to find the place of every number.
        own = color.rgb.reshape(3, count, -1, min(prepared.lanes, samples.tile))
        # What has an axis of length 1 would be copied in reverse mode.
        return color._replace(rgb=jnp.swapaxes(own, 0, 1) if count > 1 else own[:, 0])

    of_run = _of_parts_of_run if by_images else _of_run
    colors = of_run(planes_of, run, prepared, samples, plan, count)
    # A sum that XLA knows in reverse mode: of a loss of colours alone it adds up zeros, which it would otherwise add up
    # number by number as it compiles.
    alpha = jnp.broadcast_to(colors.opacity, (colors.opacity.shape[0], count * samples.tile))
    return colors.rgb.reshape(-1, 3, samples.tile), alpha.reshape(-1, 1, samples.tile)


_PlanesOf = Callable[[Color], Any]


def _of_run(
    planes_of: _PlanesOf,
    run: Run,
    prepared: Prepared,
    samples: SampleBuffer,
    plan: Plan,
    count: int,
) -> Any:
    def step(index: Array, prepared: Prepared, single: Prepared, samples: SampleBuffer) -> Any:
        return planes_of(tile_color(run, prepared, samples, plan, index, count, single=single))

    steps = jnp.arange(run.start // count, run.stop // count)
    return _mapped(step, steps, prepared, samples)


def _of_parts_of_run(
    planes_of: _PlanesOf, run: Run, prepared: Prepared, samples: SampleBuffer, plan: Plan, count: int
) -> Any:
    """`_of_run` for derivatives by what is as large as an image: those of a step are as small as its own part of it."""

    def step(
        part: tuple[dict[str, Array], Array, Array | None], prepared: Prepared, single: Prepared, samples: SampleBuffer
    ) -> Any:
        planes, ordinary, texel = part
        own = samples.of_part(planes)
        first = jnp.minimum(own.tile_surface[0], 0)  # 0, but only the running program knows
        here, alone = (dataclasses.replace(prepared, ordinary=ordinary) for prepared in (prepared, single))
        return planes_of(tile_color(run, here, own, plan, first, count, single=alone, texel=texel))

    parts = (samples.parts(count), prepared.ordinary.reshape(-1, count))
    planes, ordinary = jax.tree.map(lambda part: part[run.start // count : run.stop // count], parts)
    texel = None
    if run.surface.textured and "texel_index" in planes:
        index, weight = (jnp.swapaxes(planes[name], 0, 1) for name in ("texel_index", "texel_weight"))
        weight = weight.astype(compute_dtype(samples))
        first, texels = run.start // count, []
        for number, start, stop in textures_of_run(run, prepared.surfaces, samples):
            own = slice(start // count - first, stop // count - first)
            texels.append(sampled_texture(prepared.textures[number], index[:, own], weight[:, own]))
        texel = jnp.swapaxes(jnp.concatenate(texels, axis=1), 0, 1)
    return _mapped(step, (planes, ordinary, texel), dataclasses.replace(prepared, textures=()), samples)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _mapped(function: Callable[..., Any], parts: Any, prepared: Prepared, samples: SampleBuffer) -> Any:
    """function(part, prepared, single, samples) for every part along the leading axis of `parts`; derivatives compute
    it anew. `prepared` and `single` are the same numbers; where derivatives are taken, by `prepared` on all lanes.

    `function` closes over no traced value.
    """
    return lax.map(lambda part: function(part, prepared, prepared, samples), parts)


def _mapped_jvp(function: Callable[..., Any], primals: Any, tangents: Any) -> Any:
    (parts, single, samples), (changes_of_parts, change, change_of_samples) = primals, without_zeros(tangents)
    moving, fixed = eqx.partition(single, jax.tree.map(lambda _, own: own is not None, single, change))
    prepared, packed_change = eqx.combine(on_all_lanes(moving), fixed), spread(packed(change), single.lanes)

    # The function and its change in one: of a loop over the function alone JAX would take derivatives operation by
    # operation.
    @jax.checkpoint
    def of_part(operands: tuple[Any, Prepared, Prepared, SampleBuffer], changes: tuple[Any, Packed, Any]) -> Any:
        own, prepared, single, samples = operands
        change_of_part, of_prepared, of_samples = changes

        def at(part: Any, prepared: Prepared, samples: SampleBuffer) -> Any:
            return function(part, prepared, single, samples)

        return with_change(at, (own, prepared, samples), (change_of_part, unpacked(of_prepared, change), of_samples))

    def step(_: None, part: tuple[Any, Any]) -> tuple[None, Any]:
        own, change_of_part = part
        return None, of_part((own, prepared, single, samples), (change_of_part, packed_change, change_of_samples))

    return lax.scan(step, None, (parts, changes_of_parts))[1]


_mapped.defjvp(_mapped_jvp, symbolic_zeros=True)
