"""The sample buffer: what the lighting equation needs to know of every visible surface point, background left out.

Rows ([N, 3]) are how people read it; planes ([blocks, 3, block]), padded and grouped into tiles of one surface each,
are how it is stored, because the equation is evaluated tile by tile. The layout changes once, here.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from ..arrays import array_of, real_array
from ..formats.levels import refuse_levels
from ..scene.fields import boolean, float_type, integer, type_or_own, whole
from .sample_rows import SampleRows, check_finite, checked_rows
from .tile_layout import CLUSTER, TileLayout, layout_of

MAX_TILE = 1 << 24
"""Far more samples than tiles are made for: each surface fills up its last one."""
MANY_LIGHTS = 32
"""From so many lights of a kind on, samples are shaded with those only that reach them, and stored by place."""


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
        given = SampleRows(
            position,
            normal,
            eye,
            surface,
            color,
            texel_index,
            texel_weight,
            pixel,
            coverage,
            width,
            height,
            camera_to_world,
            pixel_to_world,
        )
        return cls.from_rows(given, tile=tile, by_place=by_place, dtype=dtype)

    @classmethod
    def from_rows(
        cls, given: SampleRows, *, tile: Any = None, by_place: Any = False, dtype: Any = None, rank: Any = None
    ) -> SampleBuffer:
        """`create`; surfaces are stored in the order of their `rank` [surfaces] (None: by row)."""
        dtype = float_type("SampleBuffer: dtype", dtype)
        rows = checked_rows(given, dtype)
        places = rows.position if boolean("SampleBuffer: by_place", by_place) else None
        return cls._stored(rows, layout_of(rows.surface, _checked(tile), places, rank), dtype)

    @classmethod
    def _stored(cls, rows: SampleRows, layout: TileLayout, dtype: Any) -> SampleBuffer:
        """The rows as planes, texels and pixels slot by slot."""
        source = layout.source
        places = rows.position[source]

        def stored(values: np.ndarray | None) -> Any:
            return None if values is None else array_of(values, dtype)

        def planes(values: np.ndarray | None) -> Any:
            """[N, components] -> [blocks, components, block]"""
            if values is None:
                return None
            blocks = values[source].reshape(-1, layout.group * layout.tile, values.shape[1])
            return stored(np.ascontiguousarray(blocks.swapaxes(1, 2)))

        def slots(values: np.ndarray | None, padding: float, own_type: Any) -> Any:
            return None if values is None else array_of(np.where(layout.is_padding, padding, values[source]), own_type)

        def bounds(size: int) -> tuple[Any, Any]:
            """Lowest and highest coordinates of every `size` samples."""
            own = places.reshape(-1, size, 3)
            return stored(own.min(axis=1).T), stored(own.max(axis=1).T)

        texel_index, texel_weight = (
            None if values is None else np.ascontiguousarray(values[source].T)
            for values in (rows.texel_index, rows.texel_weight)
        )
        tile_low, tile_high = bounds(layout.tile)
        cluster_low, cluster_high = bounds(min(CLUSTER, layout.tile))
        return cls(
            position_planes=planes(rows.position),
            normal_planes=planes(rows.normal),
            eye=stored(rows.eye),
            camera_to_world=stored(rows.camera_to_world),
            pixel_to_world=stored(rows.pixel_to_world),
            color_planes=planes(rows.color),
            texel_index=None if texel_index is None else array_of(texel_index, jnp.int32),
            texel_weight=stored(texel_weight),
            pixel_slots=slots(rows.pixel, (rows.width or 0) * (rows.height or 0), jnp.int32),
            coverage_slots=slots(rows.coverage, 0.0, jnp.promote_types(type_or_own(dtype), jnp.float32)),
            slot=None if layout.slot is None else array_of(layout.slot, jnp.int32),
            tile_surface=array_of(layout.tile_surface, jnp.int32),
            tile_low=tile_low,
            tile_high=tile_high,
            cluster_low=cluster_low,
            cluster_high=cluster_high,
            runs=layout.runs,
            count=len(rows.position),
            tile=layout.tile,
            group=layout.group,
            width=rows.width,
            height=rows.height,
        )

    def in_sample_order(self, slots: Array, axis: int = -1) -> Array:
        """[..., slots, ...] -> [..., N, ...] along an axis: padding dropped, samples in the order given."""
        if self.slot is not None:
            return jnp.take(slots, self.slot, axis=axis)
        return lax.slice_in_dim(slots, 0, self.count, axis=axis)

    def in_storage_order(self, values: Array, axis: int = -1) -> Array:
        """[..., N, ...] -> [..., slots, ...] along an axis, the opposite of `in_sample_order`. Padding has that of the
        sample whose colour it has too, so that functions of both never meet what is of no sample.

        Raises:
            ValueError: no numbers; not as many values as samples.
        """
        values = real_array("SampleBuffer: in_storage_order", values)
        axis = integer("SampleBuffer: in_storage_order: axis", axis)
        if not -values.ndim <= axis < values.ndim or values.shape[axis] != self.count:
            expected = f"{self.count} along axis {axis}, one a sample"
            raise ValueError(f"SampleBuffer: in_storage_order: expected {expected}, got {list(values.shape)}")
        if self.slot is None:  # all padding follows the last sample
            widths = [(0, 0)] * values.ndim
            widths[axis] = (0, self.slots - self.count)
            return jnp.pad(values, widths, mode="edge") if self.count else values
        slots, is_sample = jnp.arange(self.slots), self.is_sample
        filled_from = slots if is_sample is None else lax.cummax(jnp.where(is_sample, slots, 0))
        sample = jnp.zeros_like(slots).at[self.slot].set(jnp.arange(self.count), unique_indices=True)
        return jnp.take(values, sample[filled_from], axis=axis)

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
            if name == "color":
                refuse_levels("SampleBuffer: color", own)
            planes = getattr(self, f"{name}_planes")
            if planes is None:
                raise ValueError(f"SampleBuffer: {name}: the buffer has none that could be replaced")
            expected = (self.count, planes.shape[1])
            given = real_array(f"SampleBuffer: {name}", own).astype(planes.dtype)
            if given.shape != expected:
                raise ValueError(f"SampleBuffer: {name}: expected shape {list(expected)}, got {list(given.shape)}")
            if not isinstance(given, Tracer):
                check_finite(name, np.asarray(given))
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


def _checked(tile: Any) -> int | None:
    if tile is None:
        return None
    tile = whole("SampleBuffer: tile", tile, at_least=1)
    if tile & (tile - 1):
        raise ValueError(f"SampleBuffer: tile: expected a power of two, got {tile}")
    if tile > MAX_TILE:
        raise ValueError(f"SampleBuffer: tile: expected at most {MAX_TILE} samples, got {tile}")
    return tile
