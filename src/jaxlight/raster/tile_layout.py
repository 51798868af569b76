"""Where samples go in storage: into tiles of one surface each, and neighbours into the same cluster."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..processor import sizes

MIN_TILE = 64
CLUSTER = 16
"""Samples, one after the other in a tile, that share a list of the lights that may reach them."""


class TileLayout(NamedTuple):
    """How rows go to slots: tiles of one surface each, padding filled with the surface's last sample."""

    source: np.ndarray
    is_padding: np.ndarray
    slot: np.ndarray | None
    tile_surface: np.ndarray
    runs: tuple[tuple[int, int, int], ...]
    tile: int
    group: int


def layout_of(
    surface: np.ndarray, tile: int | None, position: np.ndarray | None = None, rank: np.ndarray | None = None
) -> TileLayout:
    """The layout of samples of these surfaces [N].

    Args:
        surface: row of each in `Scene.surfaces`.
        tile: samples a tile; None: chosen from N.
        position: [N, 3]: neighbours in space go together; None: samples stay as they come.
        rank: [surfaces], in which order surfaces are stored; None: by row.
    """
    place = surface if rank is None else rank[surface]
    order = np.argsort(place, kind="stable")
    _, first, counts = np.unique(place, return_index=True, return_counts=True)
    rows = surface[first]
    if tile is None:
        tile = _tile_size(len(surface), len(rows))
    tiles = -(-counts // tile)
    group = _group_size(tiles)
    tiles = -(-tiles // group) * group
    last_tile = np.cumsum(tiles)
    first_tile = last_tile - tiles
    first_sample = np.cumsum(counts) - counts
    if position is not None:
        for first, count in zip(first_sample, counts, strict=True):
            mine = order[first : first + count]
            order[first : first + count] = mine[_neighbours_together(position[mine], min(CLUSTER, tile))]
    slots = np.arange(tiles.sum() * tile)
    run = np.repeat(np.arange(len(rows)), tiles * tile)
    within = slots - first_tile[run] * tile
    source = order[first_sample[run] + np.minimum(within, counts[run] - 1)]
    is_padding = within >= counts[run]
    slot = np.empty(len(surface), dtype=np.int64)
    slot[source[~is_padding]] = slots[~is_padding]
    in_order = bool(np.all(slot == np.arange(len(surface))))
    runs = tuple(zip(rows.tolist(), first_tile.tolist(), last_tile.tolist(), strict=True))
    return TileLayout(source, is_padding, None if in_order else slot, np.repeat(rows, tiles), runs, tile, group)


def _neighbours_together(position: np.ndarray, smallest: int) -> np.ndarray:
    """An order of positions [N, 3] in which aligned runs of `smallest`, of twice as many, and so on lie close together.

    Each run is halved across its longest side, as in a k-d tree.
    """
    count = len(position)
    order = np.arange(count)
    size = 1 << max(count - 1, 0).bit_length()
    while size > smallest and count:
        run, starts, here = np.arange(count) // size, np.arange(0, count, size), position[order]
        extent = np.maximum.reduceat(here, starts) - np.minimum.reduceat(here, starts)
        along = here[np.arange(count), np.argmax(extent, axis=1)[run]]
        order = order[np.lexsort((along, run))]
        size //= 2
    return order


def _tile_size(samples: int, surfaces: int) -> int:
    """The largest power of two that wastes little on padding: that for images, less for few samples a surface."""
    wanted = max(MIN_TILE, min(sizes().tile, samples // (4 * max(surfaces, 1))))
    return 1 << (wanted.bit_length() - 1)


def _group_size(tiles: np.ndarray) -> int:
    """The largest power of two to which the surfaces' tiles can be filled up at little waste."""
    group, most = sizes().group, int(np.sum(tiles) * sizes().padding)
    while group > 1 and np.sum(-tiles % group) > most:
        group //= 2
    return group
