"""The sample buffer: what the lighting equation needs to know of every visible surface point, background left out.

Rows ([N, 3]) are how people read it; planes ([blocks, 3, block]), padded and grouped into tiles of one surface each,
are how it is stored, because the equation is evaluated tile by tile. The layout changes once, here.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from ..arrays import array_of, known_numbers, refuse_masked
from ..formats.levels import refuse_levels
from ..processor import sizes
from ..scene.fields import boolean, float_type, largest_of, type_or_own, whole

MIN_TILE = 64
MAX_TILE = 1 << 24
"""Far more samples than tiles are made for: each surface fills up its last one."""
MANY_LIGHTS = 32
"""From so many lights of a kind on, samples are shaded with those only that reach them, and stored by place."""
CLUSTER = 16
"""Samples, one after the other in a tile, that share a list of the lights that may reach them."""
_INDICES = 2**31
"""How many there are in an int32."""


class SampleBuffer(eqx.Module):
    """Samples of a rasterised image, one a visible surface point (and pixel, or part of a pixel).

    Build it with `SampleBuffer.create`, `rasterize` or `samples_from_maps`. World space, the units of the scene.
    """

    position_planes: Float[Array, "blocks 3 block"]
    """Of every block, `group` tiles of one surface, all x, then all y, then all z: read at once under few lights."""
    normal_planes: Float[Array, "blocks 3 block"]
    eye: Float[Array, "3"]
    """The viewer's position."""
    camera_to_world: Float[Array, "3 3"] | None
    """Rotation from camera axes (x right, y up, looking along -z) to the world; aims the headlight."""
    pixel_to_world: Float[Array, "3 3"] | None
    """(u, v, 1) in pixels, (0, 0) the outer corner of the top left one, to the direction of its ray in world axes; what
    is behind the geometry is seen along it."""
    color_planes: Float[Array, "blocks components block"] | None
    """Interpolated per-vertex or per-face colour (RGB or RGBA), or None."""
    texel_index: Int[Array, "4 slots"] | None
    """The four texels (row * width + column) around each sample in its surface's texture, or None."""
    texel_weight: Float[Array, "4 slots"] | None
    pixel_slots: Int[Array, " slots"] | None
    """Pixel (row * width + column, row 0 at the top) of each slot; padding holds height * width."""
    coverage_slots: Float[Array, " slots"] | None
    """Share of its pixel that a sample stands for (1 / samples-per-pixel); padding holds 0. None: 1."""
    slot: Int[Array, " samples"] | None
    """Slot of each sample; None when sample i lies in slot i."""
    tile_surface: Int[Array, " tiles"]
    """Row in `Scene.surfaces` of each tile."""
    tile_low: Float[Array, "3 tiles"]
    """Lowest coordinates of the samples of each tile; `tile_high`: the highest."""
    tile_high: Float[Array, "3 tiles"]
    cluster_low: Float[Array, "3 clusters"]
    """Lowest coordinates of the samples of each cluster; `cluster_high`: the highest."""
    cluster_high: Float[Array, "3 clusters"]
    runs: tuple[tuple[int, int, int], ...] = eqx.field(static=True)
    """(surface, first tile, tile after the last) in storage order."""
    count: int = eqx.field(static=True)
    tile: int = eqx.field(static=True)
    group: int = eqx.field(static=True)
    """So many tiles from each multiple of it on are of one surface; a power of two."""
    width: int | None = eqx.field(static=True)
    height: int | None = eqx.field(static=True)

    @classmethod
    def create(
        cls,
        position: Any,
        normal: Any,
        eye: Any,
        *,
        surface: Any = 0,
        color: Any = None,
        texel_index: Any = None,
        texel_weight: Any = None,
        pixel: Any = None,
        coverage: Any = None,
        width: int | None = None,
        height: int | None = None,
        camera_to_world: Any = None,
        pixel_to_world: Any = None,
        tile: int | None = None,
        by_place: bool = False,
        dtype: Any = None,
    ) -> SampleBuffer:
        """A buffer from rows, in any order; results of `shade` come in the same order.

        Args:
            position: [N, 3], world space.
            normal: [N, 3], world space, any length (the equation normalises it).
            eye: [3], the viewer's position.
            surface: row in `Scene.surfaces`, one for all or [N].
            color: [N, 3] or [N, 4], the interpolated vertex colours, of which 1 is the brightest.
            texel_index, texel_weight: [N, 4], texels (row * width + column) of the surface's texture and their weights.
            pixel: [N], row * width + column, row 0 at the top; needs `width` and `height`.
            coverage: [N], share of the pixel that a sample stands for (kept in float32 at least); default: all of it.
            camera_to_world: [3, 3], rotation from camera axes to the world, along whose -z the headlight shines.
            pixel_to_world: [3, 3], (u, v, 1) in pixels to the direction of its ray in world axes.
            tile: samples a tile, a power of two (default: chosen from N).
            by_place: store neighbours in space together, whatever the order of the rows. Worth it for many lights with
                a small radius, of which a cluster of samples then meets few.
            dtype: float64 (where x64 is enabled), float32, float16 or bfloat16, the type of the arrays; default: JAX's
                (float64 where x64 is enabled, otherwise float32).

        Raises:
            ValueError: a shape, a type, a value or an index that does not fit; says which.
        """
        dtype = float_type("SampleBuffer: dtype", dtype)
        position = _rows("position", position, (3,))
        count = len(position)
        normal = _rows("normal", normal, (3,), count)
        eye = _vector("eye", eye, (3,))
        surface = _indices("surface", surface, (count,), or_one=True)
        if color is not None:
            refuse_levels("SampleBuffer: color", known_numbers("SampleBuffer: color", color))
            color = _rows("color", color, (3, 4), count)
        if (texel_index is None) != (texel_weight is None):
            raise ValueError("SampleBuffer: texel_index and texel_weight go together; one of them is missing")
        if texel_index is not None:
            texel_index = _indices("texel_index", texel_index, (count, 4))
            texel_weight = _rows("texel_weight", texel_weight, (4,), count)
        width = None if width is None else whole("SampleBuffer: width", width, at_least=1)
        height = None if height is None else whole("SampleBuffer: height", height, at_least=1)
        if pixel is not None:
            if width is None or height is None:
                raise ValueError("SampleBuffer: pixel needs width and height")
            if width * height >= _INDICES:
                raise ValueError(f"SampleBuffer: pixel: expected fewer than {_INDICES} pixels, got {width} x {height}")
            pixel = _indices("pixel", pixel, (count,), below=width * height)
        coverage = None if coverage is None else _vector("coverage", coverage, (count,))
        if coverage is not None and np.any((coverage < 0) | (coverage > 1 + 1e-6)):
            least, most = coverage.min(), coverage.max()
            raise ValueError(f"SampleBuffer: coverage: expected shares in [0, 1], got {least} to {most}")
        if pixel is not None:
            _check_shares(pixel, coverage)
        camera_to_world = None if camera_to_world is None else _vector("camera_to_world", camera_to_world, (3, 3))
        pixel_to_world = None if pixel_to_world is None else _vector("pixel_to_world", pixel_to_world, (3, 3))
        tile = None if tile is None else whole("SampleBuffer: tile", tile, at_least=1)
        if tile is not None and tile & (tile - 1):
            raise ValueError(f"SampleBuffer: tile: expected a power of two, got {tile}")
        if tile is not None and tile > MAX_TILE:
            raise ValueError(f"SampleBuffer: tile: expected at most {MAX_TILE} samples, got {tile}")
        by_place = boolean("SampleBuffer: by_place", by_place)
        largest = largest_of(dtype)
        stored = {
            "position": position,
            "normal": normal,
            "eye": eye,
            "color": color,
            "texel_weight": texel_weight,
            "camera_to_world": camera_to_world,
            "pixel_to_world": pixel_to_world,
        }
        for name, numbers in stored.items():
            most = 0.0 if numbers is None else float(np.abs(numbers).max(initial=0.0))
            if most > largest:
                raise ValueError(f"SampleBuffer: {name}: {most:g} is larger than its type holds, {largest:g}")
        layout = _layout(surface, tile, position if by_place else None)

        def planes(values: np.ndarray | None) -> Any:
            """[N, components] -> [blocks, components, block]"""
            if values is None:
                return None
            blocks = values[layout.source].reshape(-1, layout.group * layout.tile, values.shape[1])
            return array_of(np.ascontiguousarray(blocks.swapaxes(1, 2)), dtype)

        def slots(values: np.ndarray | None, padding: float) -> Any:
            return None if values is None else np.where(layout.is_padding, padding, values[layout.source])

        in_tiles = position[layout.source].reshape(-1, layout.tile, 3)
        in_clusters = in_tiles.reshape(-1, min(CLUSTER, layout.tile), 3)
        index = None if texel_index is None else np.ascontiguousarray(texel_index[layout.source].T)
        pixels = slots(pixel, (width or 0) * (height or 0))
        share = slots(coverage, 0.0)
        return cls(
            position_planes=planes(position),
            normal_planes=planes(normal),
            eye=array_of(eye, dtype),
            camera_to_world=None if camera_to_world is None else array_of(camera_to_world, dtype),
            pixel_to_world=None if pixel_to_world is None else array_of(pixel_to_world, dtype),
            color_planes=planes(color),
            texel_index=None if index is None else array_of(index, jnp.int32),
            texel_weight=None
            if texel_weight is None
            else array_of(np.ascontiguousarray(texel_weight[layout.source].T), dtype),
            pixel_slots=None if pixels is None else array_of(pixels, jnp.int32),
            coverage_slots=None
            if share is None
            else array_of(share, jnp.promote_types(type_or_own(dtype), jnp.float32)),
            slot=None if layout.slot is None else array_of(layout.slot, jnp.int32),
            tile_surface=array_of(layout.tile_surface, jnp.int32),
            tile_low=array_of(in_tiles.min(axis=1).T, dtype),
            tile_high=array_of(in_tiles.max(axis=1).T, dtype),
            cluster_low=array_of(in_clusters.min(axis=1).T, dtype),
            cluster_high=array_of(in_clusters.max(axis=1).T, dtype),
            runs=layout.runs,
            count=count,
            tile=layout.tile,
            group=layout.group,
            width=width,
            height=height,
        )

    def in_sample_order(self, slots: Array, axis: int = -1) -> Array:
        """[..., slots, ...] -> [..., N, ...] along an axis: padding dropped, samples in the order given."""
        if self.slot is not None:
            return jnp.take(slots, self.slot, axis=axis)
        return lax.slice_in_dim(slots, 0, self.count, axis=axis)

    def in_storage_order(self, values: Array, axis: int = -1) -> Array:
        """[..., N, ...] -> [..., slots, ...] along an axis, the opposite of `in_sample_order`; padding has the first.

        Raises:
            ValueError: no numbers; not as many values as samples.
        """
        try:
            values = jnp.asarray(values)
        except (TypeError, ValueError):
            raise ValueError(f"SampleBuffer: in_storage_order: expected numbers, got {values!r:.60}") from None
        if not -values.ndim <= axis < values.ndim or values.shape[axis] != self.count:
            expected = f"{self.count} along axis {axis}, one a sample"
            raise ValueError(f"SampleBuffer: in_storage_order: expected {expected}, got {list(values.shape)}")
        rows = jnp.moveaxis(values, axis, 0)
        filled = jnp.broadcast_to(rows[:1], (self.slots, *rows.shape[1:]))
        return jnp.moveaxis(filled.at[self._own_slots].set(rows, unique_indices=True), 0, axis)

    @property
    def is_sample(self) -> Bool[Array, " slots"] | None:
        """Which slots hold a sample and no padding; None: all."""
        if self.slots == self.count:
            return None
        return jnp.zeros(self.slots, bool).at[self._own_slots].set(True, unique_indices=True)

    @property
    def _own_slots(self) -> Array:
        return jnp.arange(self.count) if self.slot is None else self.slot

    def rows_in_sample_order(self, planes: Array) -> Array:
        """[tiles, components, tile], or blocks, -> [N, components]: padding dropped, samples in the order given."""
        return self.in_sample_order(jnp.swapaxes(planes, 1, 2).reshape(-1, planes.shape[1]), axis=0)

    def with_rows(
        self, *, position: Array | None = None, normal: Array | None = None, color: Array | None = None
    ) -> SampleBuffer:
        """The same samples with other positions, normals or colours, of which derivatives may be taken.

        Args:
            position, normal: [N, 3], world space, in the order in which the samples were given.
            color: [N, components], as many components as the buffer has.

        Raises:
            ValueError: another shape, a number that is not finite (where that is known), or colours for a buffer
                without them.
        """
        rows = {"position": position, "normal": normal, "color": color}
        changed: dict[str, Any] = {}
        for name, own in rows.items():
            if own is None:
                continue
            refuse_masked(f"SampleBuffer: {name}", own)
            if name == "color":
                refuse_levels("SampleBuffer: color", own)
            planes = getattr(self, f"{name}_planes")
            if planes is None:
                raise ValueError(f"SampleBuffer: {name}: the buffer has none that could be replaced")
            expected = (self.count, planes.shape[1])
            try:
                if jnp.issubdtype(getattr(own, "dtype", float), jnp.complexfloating):
                    raise TypeError
                given = jnp.asarray(own, planes.dtype)
            except (TypeError, ValueError):
                raise ValueError(f"SampleBuffer: {name}: expected real numbers, got {own!r:.60}") from None
            if given.shape != expected:
                raise ValueError(f"SampleBuffer: {name}: expected shape {list(expected)}, got {list(given.shape)}")
            if not isinstance(given, Tracer):
                _check_finite(name, np.asarray(given))
            changed[f"{name}_planes"] = self._with_rows_in(planes, given)
        if position is not None:
            places = lax.stop_gradient(jnp.moveaxis(changed["position_planes"], 1, 0))
            for name, size in (("tile", self.tile), ("cluster", self.cluster)):
                own = places.reshape(3, -1, size)
                changed |= {f"{name}_low": own.min(axis=2), f"{name}_high": own.max(axis=2)}
        return dataclasses.replace(self, **changed)

    def _with_rows_in(self, planes: Array, rows: Array) -> Array:
        """Planes [blocks, components, block] with these rows of all samples; padding as it was."""
        blocks, components, block = planes.shape
        slots = jnp.swapaxes(planes, 1, 2).reshape(-1, components)
        slots = slots.at[self._own_slots].set(rows, unique_indices=True)
        return jnp.swapaxes(slots.reshape(blocks, block, components), 1, 2)

    def parts(self, count: int) -> dict[str, Array]:
        """What differs between parts of `count` tiles each, a divisor of `group`, by field: [parts, ...]."""

        def cut(planes: Array) -> Array:
            """[blocks, components, block] -> [parts, 1, components, part]"""
            components = planes.shape[1]
            parts = jnp.swapaxes(planes.reshape(-1, components, self.group // count, count * self.tile), 1, 2)
            return parts.reshape(-1, 1, components, count * self.tile)

        def cut_row(row: Array) -> Array:
            """[..., slots] or [..., tiles] -> [parts, ..., part]"""
            return jnp.moveaxis(row.reshape(*row.shape[:-1], self.tile_surface.shape[0] // count, -1), -2, 0)

        planes = {name: cut for name in ("position_planes", "normal_planes", "color_planes")}
        bounds = ("tile_low", "tile_high", "cluster_low", "cluster_high")
        rows = {name: cut_row for name in ("texel_index", "texel_weight", "tile_surface", *bounds)}
        found = {name: (own, getattr(self, name)) for name, own in (planes | rows).items()}
        return {name: own(array) for name, (own, array) in found.items() if array is not None}

    def of_part(self, part: dict[str, Array]) -> SampleBuffer:
        """One of the `parts` as a buffer of one block, whose samples stand for no pixels."""
        (tiles,) = part["tile_surface"].shape
        return dataclasses.replace(self, **part, pixel_slots=None, coverage_slots=None, slot=None, runs=(), group=tiles)

    @property
    def slots(self) -> int:
        """Places in storage: samples and padding."""
        return self.tile_surface.shape[-1] * self.tile

    @property
    def cluster(self) -> int:
        """Samples of a cluster."""
        return min(CLUSTER, self.tile)

    @property
    def position(self) -> Float[Array, "samples 3"]:
        """Positions in world space."""
        return self.rows_in_sample_order(self.position_planes)

    @property
    def normal(self) -> Float[Array, "samples 3"]:
        """Normals in world space, as given (any length)."""
        return self.rows_in_sample_order(self.normal_planes)

    @property
    def color(self) -> Float[Array, "samples components"] | None:
        """Interpolated vertex colours, RGB or RGBA, or None."""
        return None if self.color_planes is None else self.rows_in_sample_order(self.color_planes)

    @property
    def surface(self) -> Int[Array, " samples"]:
        """Row in `Scene.surfaces` of each sample."""
        return self.in_sample_order(jnp.repeat(self.tile_surface, self.tile))

    @property
    def pixel(self) -> Int[Array, " samples"] | None:
        """Pixel of each sample, row * width + column, row 0 at the top; or None."""
        return None if self.pixel_slots is None else self.in_sample_order(self.pixel_slots)

    @property
    def coverage(self) -> Float[Array, " samples"] | None:
        """Share of its pixel that each sample stands for; None: 1."""
        return None if self.coverage_slots is None else self.in_sample_order(self.coverage_slots)


class _Layout(NamedTuple):
    """How rows go to slots: tiles of one surface each, padding filled with the surface's last sample."""

    source: np.ndarray
    is_padding: np.ndarray
    slot: np.ndarray | None
    tile_surface: np.ndarray
    runs: tuple[tuple[int, int, int], ...]
    tile: int
    group: int


def _layout(surface: np.ndarray, tile: int | None, position: np.ndarray | None = None) -> _Layout:
    """`position` [N, 3]: neighbours in space go together; None: samples stay as they come."""
    order = np.argsort(surface, kind="stable")
    rows, counts = np.unique(surface, return_counts=True)
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
    return _Layout(source, is_padding, None if in_order else slot, np.repeat(rows, tiles), runs, tile, group)


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


def _rows(what: str, value: Any, columns: tuple[int, ...], count: int | None = None) -> np.ndarray:
    """`value` as finite floats [N, columns]; raises ValueError that names `what`."""
    array = _array(what, value)
    if array.ndim != 2 or array.shape[1] not in columns or (count is not None and len(array) != count):
        expected = f"[{'N' if count is None else count}, {' or '.join(map(str, columns))}]"
        raise ValueError(f"SampleBuffer: {what}: expected shape {expected}, got {list(array.shape)}")
    return array


def _vector(what: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = _array(what, value)
    if array.shape != shape:
        raise ValueError(f"SampleBuffer: {what}: expected shape {list(shape)}, got {list(array.shape)}")
    return array


def _array(what: str, value: Any) -> np.ndarray:
    array = known_numbers(f"SampleBuffer: {what}", value)
    array = array if array.dtype == np.float32 else array.astype(np.float64)
    _check_finite(what, array)
    return array


def _check_finite(what: str, array: np.ndarray) -> None:
    if not np.all(np.isfinite(array)):
        bad = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"SampleBuffer: {what}: every number must be finite; {what}{bad} is {array[tuple(bad)]}")


def _check_shares(pixel: np.ndarray, coverage: np.ndarray | None) -> None:
    """Shares that were rounded to 8 bits may add up to a little more than 1."""
    covered = np.bincount(pixel, coverage)
    most = int(np.argmax(covered)) if covered.size else 0
    if covered.size and covered[most] > 1.01:
        hint = "; without coverage each sample stands for a whole pixel" if coverage is None else ""
        raise ValueError(
            "SampleBuffer: coverage: expected shares of a pixel that add up to at most 1, "
            f"got {covered[most]:g} in pixel {most}{hint}"
        )


def _indices(
    what: str, value: Any, shape: tuple[int, ...], *, below: int | None = None, or_one: bool = False
) -> np.ndarray:
    """`value` as integers >= 0 (and < below) of the given shape, or one for all."""
    expected = f"integers of shape {list(shape)}{' or one' if or_one else ''}"
    array = known_numbers(f"SampleBuffer: {what}", value, expected)
    if or_one and array.ndim == 0:
        array = np.full(shape, array)
    if array.shape != shape or not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"SampleBuffer: {what}: expected {expected}, got {array.dtype} {list(array.shape)}")
    if array.size and (array.min() < 0 or array.max() >= (_INDICES if below is None else below)):
        allowed = f">= 0 and below {_INDICES}" if below is None else f"in [0, {below})"
        raise ValueError(f"SampleBuffer: {what}: every index must be {allowed}; got {array.min()} to {array.max()}")
    return array.astype(np.int64)
