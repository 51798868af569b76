"""Which free texels the samples of a fit see."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..lighting.tiles import Run, surface_runs
from ..scene.scene import Surface
from .parameters import TexelBlock
from .views import ViewData


class TexelSampling(eqx.Module):
    """Which texels the samples of a stack of views see; the same for a whole fit."""

    index: Int[Array, "views 4 slots"]
    weight: Float[Array, "views 4 slots"]
    runs: tuple[tuple[int, int, int], ...] = eqx.field(static=True)
    """(block, first slot, slot after the last); block -1: no free texture."""
    single: bool = eqx.field(static=True)
    """True if every sample sees one texel only: the texels' part of the curvature is then a diagonal."""


def texel_sampling(
    views: Sequence[ViewData], surfaces: tuple[Surface, ...], blocks: tuple[TexelBlock, ...]
) -> tuple[TexelSampling, ...]:
    """Which texels the views see, one entry a stack of views; nothing where no whole texture is free."""
    stacks = []
    for stack in views if blocks else ():
        samples = stack.samples
        runs = surface_runs(surfaces, samples)
        if samples.texel_index is None or samples.texel_weight is None:
            empty = jnp.zeros((len(stack.row), 4, 0))
            stacks.append(TexelSampling(empty.astype(jnp.int32), empty, tuple((-1, 0, 0) for _ in runs), True))
            continue
        slots = tuple((block_of(run, blocks), run.start * samples.tile, run.stop * samples.tile) for run in runs)
        single = bool(np.all(np.count_nonzero(np.asarray(samples.texel_weight), axis=1) <= 1))
        stacks.append(TexelSampling(samples.texel_index, samples.texel_weight, slots, single))
    return tuple(stacks)


def block_of(run: Run, blocks: tuple[TexelBlock, ...]) -> int:
    """The block of the texture that a run of tiles shows; -1: none."""
    textures = [block.texture for block in blocks]
    used = run.surface.textured and run.surface.texture in textures
    return textures.index(run.surface.texture) if used else -1
