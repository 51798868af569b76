"""The part of the samples that a fit begins with: one tile in so many."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..lighting.tiles import Run, surface_runs
from ..scene import Scene
from .views import ViewData

_EVERY = (16, 8, 4)
_LEAST_TILES, _LEAST_SAMPLES = 8, 4096
"""Of what a part consists at least."""


class Part(NamedTuple):
    """A part of the samples."""

    every: int
    """One tile in so many; 1: all."""
    share: float
    """Share of the residuals that it holds."""


WHOLE = Part(1, 1.0)


def tiles_of_part(run: Run, every: Any) -> tuple[Any, Any]:
    """The first tile of a run that belongs to the part, and how many do, each `every` tiles after the last."""
    tiles = run.stop - run.start
    offset = jnp.minimum((every - 1) // 2, tiles - 1)
    return run.start + offset, (tiles - offset + every - 1) // every


def choose_part(views: Sequence[ViewData], scene: Scene) -> Part:
    """The part for these views: all of it where there are few tiles, many short runs of them, or pixels that gather
    several samples."""
    runs = [(view, run) for view in views for run in surface_runs(scene.surfaces, view.samples, scene.textures)]
    tiles = sum(run.stop - run.start for _, run in runs)
    slots = sum((run.stop - run.start) * view.samples.tile for view, run in runs)
    enough = [every for every in _EVERY if tiles >= every * _LEAST_TILES and slots >= every * _LEAST_SAMPLES]
    every = enough[0] if enough else 1
    if every == 1 or any(view.pixel is not None for view in views):
        return WHOLE
    chosen = total = 0
    for view, run in runs:
        heard = np.asarray(view.root_weight)
        heard = heard.reshape(heard.shape[0], -1, view.samples.tile)[:, run.start : run.stop]
        first, _ = tiles_of_part(run, every)
        chosen += np.count_nonzero(heard[:, int(first) - run.start :: every])
        total += np.count_nonzero(heard)
    return Part(every, chosen / total) if 0 < chosen <= total / 2 else WHOLE
