"""`shade`: the colour of every sample by the lighting equation."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from ..raster.samples import SampleBuffer
from ..scene import Scene
from .options import LightingOptions
from .plan import Plan, make_plan
from .prepared import compute_dtype, prepare
from .registers import WIDE
from .tiles import colors_of_run, in_fitting_tiles, surface_runs, tiles_at_once


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
    return samples.rows_in_sample_order(shade_tiles(scene, samples, options, plan=plan))


def shade_planes(
    scene: Scene, samples: SampleBuffer, options: LightingOptions | None = None, *, plan: Plan | None = None
) -> Float[Array, "4 slots"]:
    """`shade` in storage order: planes red, green, blue, alpha, one column a slot of the buffer, padding included."""
    tiles = shade_tiles(scene, samples, options, plan=plan)
    return jnp.swapaxes(tiles, 0, 1).reshape(4, -1)


def shade_tiles(
    scene: Scene, samples: SampleBuffer, options: LightingOptions | None = None, *, plan: Plan | None = None
) -> Float[Array, "tiles 4 tile"]:
    """`shade` as it is computed, tile by tile, padding included: the quickest form, for hot loops."""
    check_samples(scene, samples)
    if plan is None:
        plan = make_plan(scene, samples, options)
    compiled = _shade_tiles_wide if _runs_alone_on_cpu(scene, samples) else _shade_tiles
    return compiled(_without_document(scene), samples, plan)


def _tiles_of(scene: Scene, samples: SampleBuffer, plan: Plan) -> Array:
    tile, samples = samples.tile, in_fitting_tiles(scene, samples, plan)
    prepared = prepare(scene, samples, plan)
    count = tiles_at_once(scene, samples, plan)
    runs = [colors_of_run(run, prepared, samples, plan, count) for run in surface_runs(scene.surfaces, samples)]
    if not runs:
        return jnp.zeros((0, 4, tile), compute_dtype(samples))
    colors = jnp.concatenate(runs) if len(runs) > 1 else runs[0]
    if samples.tile == tile:
        return colors
    return jnp.swapaxes(colors.reshape(-1, tile // samples.tile, 4, samples.tile), 1, 2).reshape(-1, 4, tile)


_shade_tiles = jax.jit(_tiles_of, static_argnames="plan")
_shade_tiles_wide = jax.jit(_tiles_of, static_argnames="plan", compiler_options=WIDE)


def _runs_alone_on_cpu(scene: Scene, samples: SampleBuffer) -> bool:
    """True outside jit, grad and vmap, on the CPU."""
    leaves = jax.tree.leaves((scene, samples))
    if any(isinstance(leaf, Tracer) for leaf in leaves):
        return False
    return all(device.platform == "cpu" for device in samples.position_planes.devices())


def _without_document(scene: Scene) -> Scene:
    """The scene without what shading does not read, so that scenes that differ only there share compiled code."""
    return dataclasses.replace(scene, document=None)


def check_samples(scene: Scene, samples: SampleBuffer) -> None:
    """Raise ValueError if the samples do not fit the scene."""
    for row, _, _ in samples.runs:
        if row >= len(scene.surfaces):
            raise ValueError(f"samples: surface {row} asked for, but the scene has {len(scene.surfaces)} surfaces")
        surface = scene.surfaces[row]
        components = 0 if samples.color_planes is None else samples.color_planes.shape[1]
        if surface.color_components > components:
            raise ValueError(
                f"samples: surface {row} has {surface.color_components}-component vertex colours, "
                f"the buffer holds {components}"
            )
        if surface.texture >= 0 and samples.texel_index is None:
            raise ValueError(
                f"samples: surface {row} has a texture, but the buffer has no texel_index and texel_weight"
            )
