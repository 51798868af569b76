"""Sums over lights of their colours times planes of weights, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from .changes import is_zero, merged
from .own_sums import multilinear
from .stage_derivatives import StageKind, change_along, directions_of, each
from .stages import Stage
from .unstored import Inlined, is_unstored

SUMMED = 8
"""Lights that are added up at once, if there are more than twice as many: longer sums XLA does not vectorise. If there
are more than four times as many, so many are differentiated at once: planes of derivatives by all numbers of all lights
would leave the cache before they are summed over samples."""


def sums_of_colors(
    stage: Stage,
    colors: Float[Array, "3 lights 1 lanes"],
    weights: Callable[..., Any],
    *operands: Any,
    **how: Any,
) -> Any:
    """Of each of the weights the sum over lights of color * weight; planes [3, rows, lanes].

    Args:
        weights, operands, how: of `Stage.each`, which gives a pytree of planes [lights, rows, lanes] for them.
    """
    lights = colors.shape[1]
    if lights > 4 * SUMMED and not stage.forward:
        return _sums_of_many(stage.how(weights, **how), stage, colors, operands)
    own = stage.each(weights, *operands, **how)
    if lights == 1:
        return jax.tree.map(lambda weight: Inlined(_times, (colors[:, 0], weight)), own)
    if lights <= 2 * SUMMED:
        return _sums(colors, own)
    return _sums_in_parts(colors, own) if stage.forward else _sums_for_reverse(colors, own)


def _sums(colors: Array, weights: Any) -> Any:
    return jax.tree.map(lambda weight: multilinear(_sum_over_lights, colors, weight), weights)


def _times(color: Array, weight: Array) -> Array:
    return multilinear(jnp.multiply, color, weight)


def _sum_over_lights(colors: Array, weight: Array) -> Array:
    return jnp.sum(colors * weight, axis=1)


def _sums_in_parts(colors: Array, weights: Any) -> Any:
    full, rest = divmod(colors.shape[1], SUMMED)

    def part(first: Array | int, count: int) -> Any:
        own = jax.tree.map(lambda plane: lax.dynamic_slice_in_dim(plane, first, count), weights)
        return _sums(lax.dynamic_slice_in_dim(colors, first, count, axis=1), own)

    def with_part(number: Array, totals: Any) -> Any:
        return _added(totals, part(number * SUMMED, SUMMED))

    return lax.fori_loop(0, full, with_part, part(full * SUMMED, rest))


_sums_for_reverse = jax.custom_jvp(_sums_in_parts)
"""`_sums_in_parts` whose changes are no sums in parts: cotangents would be put together from parts."""


@_sums_for_reverse.defjvp
def _sums_jvp(primals, tangents):
    return _sums_for_reverse(*primals), jax.jvp(_sums, primals, tangents)[1]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _sums_of_many(how: StageKind, stage: Stage, colors: Array, operands: tuple[Any, ...]) -> Any:
    """Sums whose derivatives are those of some lights after the others."""
    return _sums_for_reverse(colors, each(how, stage, operands, ()))


def _sums_of_many_jvp(how: StageKind, primals: Any, tangents: Any) -> tuple[Any, Any]:
    (stage, colors, operands), (_, color_change, changes) = primals, tangents
    derived, how = () if how.derive is None else how.derive(stage, *operands), how._replace(derive=None)
    weights = each(how, stage, operands, derived)
    moving, directions = directions_of(operands, changes)
    lights = colors.shape[1]
    per_light = [_has_row_a_light(direction, lights) for direction in directions]

    def with_some(total: Any, some: tuple[Array, Array, list[Array]]) -> tuple[Any, None]:
        first, own_colors, own_rows = some
        own = merged(directions, [n for n, own in enumerate(per_light) if own], own_rows)
        known, derived_rows, results = _rows_of_some((operands, derived, weights), lights, first)
        own_change = change_along(how, stage, known, derived_rows, results, moving, own)
        return _added(total, _sums(own_colors, own_change)), None

    sums = _sums_for_reverse(colors, weights)
    change = jax.tree.map(jnp.zeros_like, sums)
    if moving:
        rows = [_in_parts(direction) for direction, own in zip(directions, per_light, strict=True) if own]
        color_rows = jnp.swapaxes(_in_parts(jnp.swapaxes(colors, 0, 1)), 1, 2)
        change = lax.scan(with_some, change, (_firsts(lights), color_rows, rows))[0]
    # Not where the sum above begins: cotangents of colours would wait for it.
    return sums, change if is_zero(color_change) else _added(change, _sums(color_change, weights))


_sums_of_many.defjvp(_sums_of_many_jvp, symbolic_zeros=True)


def _firsts(lights: int) -> Int[Array, " parts"]:
    """The first of SUMMED lights of every part; the last part ends with the last light, and may overlap the others."""
    return jnp.minimum(jnp.arange(-(-lights // SUMMED)) * SUMMED, lights - SUMMED)


def _in_parts(rows: Float[Array, "lights ..."]) -> Float[Array, "parts some ..."]:
    """Rows of the lights of every part, zeros for those of an earlier one."""
    lights = rows.shape[0]
    full = lights // SUMMED * SUMMED
    earlier = jnp.zeros((-lights % SUMMED, *rows.shape[1:]), rows.dtype)
    return jnp.concatenate([rows[:full], earlier, rows[full:]]).reshape(-1, SUMMED, *rows.shape[1:])


def _rows_of_some(planes: Any, lights: int, first: Array) -> Any:
    """Planes of SUMMED lights from the first on, left where they lie."""

    def rows(plane: Any) -> Any:
        return Inlined(_some_rows, (plane, first)) if _has_row_a_light(plane, lights) else plane

    return jax.tree.map(rows, planes, is_leaf=is_unstored)


def _some_rows(plane: Array, first: Array) -> Array:
    return lax.dynamic_slice_in_dim(plane, first, SUMMED)


def _has_row_a_light(plane: Any, lights: int) -> bool:
    """Whether it is a plane [lights, rows, lanes], and not one for all lights, [rows, lanes]."""
    return len(plane.shape) == 3 and plane.shape[0] == lights


def _added(total: Any, own: Any) -> Any:
    return jax.tree.map(jnp.add, total, own)
