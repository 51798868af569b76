"""Exact answers for many cases at once, in 80-bit floats: what a release run compares 100 000 cases with.

Judges float32, and float64 with an uncertainty of its own (some hundredths of an ulp times the condition; `exact`
settles what is in doubt). Conditions, distances and bounds are those of `condition` and `exact.gradient_bounds`.
Cases may come in any order and of any shape; those of one shape are computed together.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .case import Case
from .condition import MAX_CONDITION, MIN_DISTANCE
from .dual import Dual
from .fast_equation import shade
from .fast_tape import WIDE, Columns, FastTape
from .paths import Path, is_live
from .ulp import input_ulp, neighbours, output_ulp

CHUNK = {0: 4096, 1: 4096, 2: 512}
"""Cases computed at once, by order of the derivatives."""

MOVES = 8
"""So many times all inputs are moved, for the condition of second derivatives."""


@dataclass(frozen=True)
class Values:
    """Of N cases, in order: rgba [N, 4] (longdouble), condition [N, 4], distances [N] in ulp by kind of decision."""

    rgba: np.ndarray
    condition: np.ndarray
    distances: dict[str, np.ndarray]

    @property
    def well_conditioned(self) -> np.ndarray:
        """[N], as `Conditioning.well_conditioned`."""
        return (self.condition.max(axis=1) <= MAX_CONDITION) & (self.distances["jump"] >= MIN_DISTANCE)


@dataclass(frozen=True)
class Gradients:
    """Of n cases of one shape: derivatives by P inputs of 4 channels.

    `index` [n]: their places in the list that was given; `paths` (P); `low` and `high` [n, P, 4] (longdouble): the
    lowest and highest right derivative, equal but for kinks within 16 ulp and underflow; `condition` [n, P, 4], the
    worst of both sides, or None.
    """

    index: np.ndarray
    paths: list[Path]
    low: np.ndarray
    high: np.ndarray
    condition: np.ndarray | None
    distances: dict[str, np.ndarray]
    rounding: np.ndarray
    """[n, P, 4]: how far 80-bit arithmetic itself may be off, where terms cancel that add up to the derivative."""

    @property
    def differentiable(self) -> np.ndarray:
        """[n]: no jump and no point without derivatives within 16 ulp (the condition of the value apart)."""
        return (self.distances["jump"] >= MIN_DISTANCE) & (self.distances["cone"] >= MIN_DISTANCE)

    def error_in_ulp(self, computed: Any, precision: int) -> np.ndarray:
        """How far derivatives [n, P, 4] lie outside low ... high, in ulp of the larger; infinite if not finite."""
        computed = np.asarray(computed, dtype=WIDE)
        ulp = np.maximum(output_ulp(self.low, precision), output_ulp(self.high, precision))
        with np.errstate(invalid="ignore"):
            below, above = (self.low - self.rounding - computed) / ulp, (computed - self.rounding - self.high) / ulp
        return np.where(np.isfinite(computed), np.maximum(np.maximum(below, above), 0), np.inf)


@dataclass(frozen=True)
class SecondDerivatives:
    """Of n cases of one shape, [n, P, 4]: the sums over j of d2f / dx_i dx_j times a step of x_j."""

    index: np.ndarray
    paths: list[Path]
    change: np.ndarray
    size: np.ndarray
    """Of the terms' sizes, added up."""
    moved: np.ndarray
    """How far the terms move, added up, when all inputs move by one ulp, up or down at random; the most of `MOVES`."""
    steepest: np.ndarray
    """[n]: the largest of all second derivatives."""
    may_underflow: np.ndarray
    """[n]: whether a power or the fog's f0 may, that something multiplies."""
    distances: dict[str, np.ndarray]

    @property
    def smooth(self) -> np.ndarray:
        """[n]: nothing that has no second derivative within 16 ulp."""
        return np.min([self.distances[kind] for kind in ("jump", "kink", "cone")], axis=0) >= MIN_DISTANCE


def values(cases: Sequence[Case], precision: int = 32, *, conditioning: bool = True) -> Values:
    """Colour and alpha of every case, with its conditioning in float32 or float64 (else conditions are NaN)."""
    rgba = np.zeros((len(cases), 4), dtype=WIDE)
    condition = np.full((len(cases), 4), np.nan)
    distances = {kind: np.full(len(cases), np.inf) for kind in ("jump", "kink", "cone")}
    for index, columns in _chunks(cases, 1 if conditioning else 0):
        tape = FastTape(columns, 1 if conditioning else 0, precision)
        channels = _run(tape)
        rgba[index] = value = _stack([c.value for c in channels], columns.count)
        if conditioning:
            moved = _moved(columns, value, precision)
            for name in tape.powers_lost:  # an intermediate result that may underflow moves by all it is
                without = _run(FastTape(columns, 0, precision, frozenset([name])))
                moved = moved + np.abs(_stack([c.value for c in without], columns.count) - value)
            condition[index] = _condition(moved, value, precision)
            for kind, distance in tape.distances.items():
                distances[kind][index] = distance
    return Values(rgba, condition, distances)


def gradients(cases: Sequence[Case], precision: int = 32, *, conditioning: bool = True) -> Iterator[Gradients]:
    """Derivatives (with bounds at kinks) and their conditions to first order, chunk by chunk of cases of one shape."""
    order = 2 if conditioning else 1
    for index, columns in _chunks(cases, order):
        yield _gradients_of_chunk(index, columns, order, precision)


def _gradients_of_chunk(index: np.ndarray, columns: Columns, order: int, precision: int) -> Gradients:
    tape = FastTape(columns, order, precision)
    channels = _run(tape)
    base = _gradient(channels, columns)
    low, high = base.copy(), base.copy()
    condition = _gradient_condition(channels, columns, base, precision) if order == 2 else None

    def turned_over(names: frozenset[str]) -> np.ndarray:
        """How the derivatives change; their condition is that of the worse side."""
        nonlocal condition
        channels = _run(FastTape(columns, order, precision, names, MIN_DISTANCE))
        side = _gradient(channels, columns)
        if condition is not None:
            condition = np.maximum(condition, _gradient_condition(channels, columns, side, precision))
        return side - base

    for group in _independent_kinks(tape.kinks):
        down, up = np.zeros_like(base), np.zeros_like(base)
        for flip in _sides(group):
            change = turned_over(flip)
            down, up = np.minimum(down, change), np.maximum(up, change)
        low, high = low + down, high + up
    for name in tape.powers_lost:
        change = np.abs(turned_over(frozenset([name])))
        low, high = low - change, high + change
    return Gradients(index, columns.paths, low, high, condition, tape.distances, _rounding(base, columns))


def _rounding(gradient: np.ndarray, columns: Columns) -> np.ndarray:
    """4 roundings of the largest change that any input's relative change makes, over the size of the own vector."""
    sizes = np.zeros_like(columns.values)
    for i, path in enumerate(columns.paths):
        vector = [k for k, other in enumerate(columns.paths) if other[:-1] == path[:-1]] if len(path) > 2 else [i]
        sizes[i] = np.abs(columns.values[vector]).max(axis=0)
    with np.errstate(all="ignore"):
        reach = np.nan_to_num(np.abs(gradient) * np.abs(columns.values.T)[:, :, None]).max(axis=1, keepdims=True)
        return np.nan_to_num(4 * np.finfo(WIDE).eps * reach / sizes.T[:, :, None], posinf=0.0)


def second_derivatives(
    cases: Sequence[Case], direction: Callable[[Path], float], precision: int = 32
) -> Iterator[SecondDerivatives]:
    """How the derivatives change when every input x moves by x times what `direction` gives for its path."""
    random = np.random.default_rng(len(cases))
    for index, columns in _chunks(cases, 2):
        tape = FastTape(columns, 2, precision)
        channels = _run(tape)
        terms = _terms(channels, columns, direction)
        seconds = [second for channel in channels for second in (channel.hessian or {}).values()]
        steepest = np.max(
            [np.zeros(columns.count), *(np.broadcast_to(np.abs(x), columns.count) for x in seconds)], axis=0
        )
        moved = np.zeros((columns.count, len(columns.paths), 4), dtype=WIDE)
        for _ in range(MOVES):
            other = columns
            for i, values in enumerate(columns.values):
                up, down = neighbours(values, precision)[:2]
                other = other.replaced(i, np.where(random.random(columns.count) < 0.5, up, down))
            there = _terms(_run(FastTape(other, 2, precision)), other, direction)
            with np.errstate(invalid="ignore"):
                moved = np.fmax(moved, _sum({key: np.abs(there[key] - term) for key, term in terms.items()}, columns))
        change, size = _sum(terms, columns), _sum({key: np.abs(term) for key, term in terms.items()}, columns)
        yield SecondDerivatives(index, columns.paths, change, size, moved, steepest, tape.may_lose, tape.distances)


_Terms = dict[tuple[int, int, int], np.ndarray]
"""d2f / dx_i dx_j times the step of x_j, by i, channel and j."""


def _terms(channels: tuple[Dual, ...], columns: Columns, direction: Callable[[Path], float]) -> _Terms:
    steps = np.array([direction(path) for path in columns.paths])[:, None] * columns.values
    return {
        (row, c, other): second * steps[other]
        for c, channel in enumerate(channels)
        for (i, j), second in (channel.hessian or {}).items()
        for row, other in {(i, j), (j, i)}
    }


def _sum(terms: _Terms, columns: Columns) -> np.ndarray:
    """[n, P, 4]."""
    out = np.zeros((len(columns.paths), 4, columns.count), dtype=WIDE)
    for (row, c, _), term in terms.items():
        out[row, c] += term
    return out.transpose(2, 0, 1)


def _independent_kinks(kinks: dict[str, np.ndarray]) -> list[dict[str, np.ndarray]]:
    """By name, in which cases [n] a kink is near; grouped by lights, whose effects add up."""
    near = {name: distance < MIN_DISTANCE for name, distance in kinks.items()}
    near = {name: where for name, where in near.items() if np.any(where)}
    if "fog.range" in near:
        return [near]  # the fog's factor joins all lights
    lights: dict[str, dict[str, np.ndarray]] = {}
    for name, where in near.items():
        lights.setdefault(name.split(".")[0], {})[name] = where
    return list(lights.values())


def _sides(near: dict[str, np.ndarray]) -> list[frozenset[str]]:
    """Every choice of kinks to turn over that some case needs: the non-empty subsets of those near to it."""
    names = list(near)
    patterns = np.unique(np.stack([near[name] for name in names], axis=1), axis=0)
    found = {
        frozenset(subset)
        for pattern in patterns
        for chosen in [[name for name, is_near in zip(names, pattern, strict=True) if is_near]]
        for size in range(1, len(chosen) + 1)
        for subset in itertools.combinations(chosen, size)
    }
    return sorted(found, key=sorted)


def shape_of(case: Case) -> tuple:
    """What two cases must share to be computed together: all but the numbers."""
    sample, fog = case.sample, case.fog
    lights = tuple(
        (i, light.kind, light.frame is not None) for i, light in enumerate(case.lights) if is_live(light, case.options)
    )
    return (
        case.material is None,
        case.line_or_point,
        case.options,
        None if sample.color is None else len(sample.color),
        None if sample.texel is None else len(sample.texel),
        None if fog is None else (fog.fog_type, fog.frame is not None),
        lights,
    )


def _chunks(cases: Sequence[Case], order: int) -> Iterator[tuple[np.ndarray, Columns]]:
    groups: dict[tuple, list[int]] = {}
    for i, case in enumerate(cases):
        groups.setdefault(shape_of(case), []).append(i)
    for group in groups.values():
        for start in range(0, len(group), CHUNK[order]):
            index = np.array(group[start : start + CHUNK[order]])
            # The label is no part of the shape, and the first case's would mislead.
            template = replace(cases[index[0]], label="")
            yield index, Columns([template, *(cases[i] for i in index[1:])])


def _run(tape: FastTape) -> tuple[Dual, ...]:
    with np.errstate(all="ignore"):
        return shade(tape)


def _stack(parts: Sequence[Any], count: int) -> np.ndarray:
    """[count, parts]."""
    return np.stack([np.broadcast_to(np.asarray(part, dtype=WIDE), (count,)) for part in parts], axis=-1)


def _gradient(channels: tuple[Dual, ...], columns: Columns) -> np.ndarray:
    """[n, P, 4]."""
    out = np.zeros((len(columns.paths), 4, columns.count), dtype=WIDE)
    for c, channel in enumerate(channels):
        for i, slope in channel.gradient.items():
            out[i, c] = slope
    return out.transpose(2, 0, 1)


def _moved(columns: Columns, base: np.ndarray, precision: int) -> np.ndarray:
    """[n, 4]: how far the value moves when each input moves by one ulp, summed over inputs."""
    total = np.zeros_like(base)
    for i in range(len(columns.paths)):
        furthest = np.zeros_like(base)
        for column in neighbours(columns.values[i], precision):
            if np.array_equal(column, columns.values[i], equal_nan=True):
                continue
            end = _run(FastTape(columns.replaced(i, column), 0, precision))
            furthest = np.maximum(furthest, np.abs(_stack([c.value for c in end], columns.count) - base))
        total += furthest
    return total


def _gradient_condition(
    channels: tuple[Dual, ...], columns: Columns, gradient: np.ndarray, precision: int
) -> np.ndarray:
    """[n, P, 4]: how far each derivative moves, to first order, in its ulp."""
    ulps = input_ulp(columns.values, precision)
    moved = np.zeros((len(columns.paths), 4, columns.count), dtype=WIDE)
    for c, channel in enumerate(channels):
        for (i, j), second in (channel.hessian or {}).items():
            size = np.abs(second)
            moved[i, c] += size * ulps[j]
            if i != j:
                moved[j, c] += size * ulps[i]
    return _condition(moved.transpose(2, 0, 1), gradient, precision)


def _condition(moved: np.ndarray, value: np.ndarray, precision: int) -> np.ndarray:
    with np.errstate(over="ignore"):  # of what is beyond all bounds
        return np.maximum(1.0, (moved / output_ulp(value, precision)).astype(np.float64))
