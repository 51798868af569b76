"""One block of cases: jaxlight's colours and derivatives against the exact ones, in ulp and in ulp / condition."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import jax
import numpy as np
from mpmath import mpf

import answers
from oracle import fast_exact
from oracle.case import Case
from oracle.condition import moved_gradient_condition, near_ties
from oracle.exact import gradient_bounds
from oracle.paths import Path, float_paths, get
from oracle.ulp import error_in_ulp, output_ulp, underflow_threshold

from .figures import LIMITS

Precision = Literal["float32", "float64"]
BITS: dict[Precision, Any] = {"float32": 32, "float64": 64}
MAX_CONDITION = {"float32": 2.0**23 / 32, "float64": 2.0**52 / 32}
"""Of a derivative: beyond, 16 ulp times the condition is more than half of it, and first order says nothing."""

SETTLED = 64
"""Of so many cases at once that are in doubt the 50 digits decide."""

LARGEST = {"float32": 2.0**100, "float64": 2.0**1000}
"""Derivatives of the colour by an input that are asked for; of larger ones, only that they are finite."""


@dataclass(frozen=True)
class Judged:
    """Of N cases the worst of each: channels of the colour, or channels and inputs of the derivatives."""

    ulp: np.ndarray
    """[N] error in ulp; NaN where nothing is asked but to be finite."""
    relative: np.ndarray
    """[N] error in ulp / condition; NaN likewise."""
    finite: np.ndarray
    """[N] whether every number is."""
    by_field: dict[str, np.ndarray]
    """Derivatives: by input (`lights.location`), the errors in ulp / condition of the cases that have it."""
    by_allowance: dict[str, int]
    """Derivatives: by input, how many errors would be too large but for what frames are allowed."""


class Block:
    """Cases with their exact answers, for one precision."""

    def __init__(self, cases: Sequence[Case], precision: Precision):
        self.cases, self.precision = cases, precision
        self.exact = fast_exact.values(cases, BITS[precision])
        self.dtype = np.dtype(precision)
        self._derivatives: list[fast_exact.Gradients] | None = None

    @property
    def derivatives(self) -> list[fast_exact.Gradients]:
        """Exact derivatives, chunk by chunk."""
        if self._derivatives is None:
            self._derivatives = list(fast_exact.gradients(self.cases, BITS[self.precision]))
        return self._derivatives

    def judge_values(self) -> Judged:
        """The colours."""
        with jax.enable_x64(self.precision == "float64"):
            computed = answers.values(self.cases, self.dtype)
        ulp = error_in_ulp(computed, self.exact.rgba, BITS[self.precision])
        relative = ulp / self.exact.condition
        asked = self.exact.well_conditioned
        return Judged(
            ulp=np.where(asked, ulp.max(axis=1), np.nan).astype(np.float64),
            relative=np.where(asked, relative.max(axis=1), np.nan).astype(np.float64),
            finite=np.isfinite(computed).all(axis=1),
            by_field={},
            by_allowance={},
        )

    def judge_derivatives(self, mode: answers.Mode) -> Judged:
        """The derivatives by every input, in one mode."""
        count = len(self.cases)
        with jax.enable_x64(self.precision == "float64"):
            computed, rounding = answers.derivatives_with_rounding(self.cases, self.dtype, mode)
        judged = _unjudged(count)
        for exact in self.derivatives:
            own = np.array([computed[i] for i in exact.index])
            judged.finite[exact.index] = np.isfinite(own).all(axis=(1, 2))
            self._compare(own, np.array([rounding[i] for i in exact.index]), exact, judged)
        return judged

    def judge_second(self, count: int) -> Judged:
        """The first `count` cases' second derivatives along a direction, forward over reverse.

        Errors are in ulp of the sum of the sizes of what is added up, the largest among a vector's components; and over
        how many of these it moves with the inputs. Left out are derivatives by frames (their inverses move too), cases
        in which only some lights have one (in jaxlight the others' identities move), and those with second derivatives
        too large to be asked for, or a power or an f0 of fog that may underflow.
        """
        cases, bits = self.cases[:count], BITS[self.precision]
        with jax.enable_x64(self.precision == "float64"):
            computed = answers.derivatives(cases, self.dtype, "second")
        judged = _unjudged(len(cases))
        for exact in fast_exact.second_derivatives(cases, answers.direction, bits):
            own = np.array([computed[i] for i in exact.index])
            judged.finite[exact.index] = np.isfinite(own).all(axis=(1, 2))
            kept = np.array(["frame" not in path for path in exact.paths])
            alike = np.array([len({light.frame is None for light in cases[i].lights}) <= 1 for i in exact.index])
            in_range = (exact.steepest <= LARGEST[self.precision]) & ~exact.may_underflow
            asked = (exact.smooth & self.exact.well_conditioned[exact.index] & alike & in_range)[:, None, None]
            asked = asked & kept[None, :, None]
            unit = output_ulp(_over_components(exact.size, exact.paths), bits)
            with np.errstate(invalid="ignore"):
                error = np.abs(own - exact.change) / unit
                condition = np.maximum(1, _over_components(exact.moved, exact.paths) / unit)
            error = np.where(asked, np.where(np.isfinite(own), error, np.inf), np.nan)
            judged.ulp[exact.index] = _worst(error.reshape(len(error), -1))
            judged.relative[exact.index] = _worst((error / condition).reshape(len(error), -1))
        return judged

    def _compare(self, computed: np.ndarray, rounding: np.ndarray, exact: fast_exact.Gradients, judged: Judged) -> None:
        assert exact.condition is not None
        room = dataclasses.replace(exact, rounding=exact.rounding + rounding)
        ulp = room.error_in_ulp(computed, BITS[self.precision])
        # Only values tell what an input that is flushed to zero changes.
        whole = np.array([not _has_subnormals(self.cases[i], self.dtype) for i in exact.index])
        asked = (exact.differentiable & self.exact.well_conditioned[exact.index] & whole)[:, None, None]
        largest = np.maximum(np.abs(exact.low), np.abs(exact.high))
        in_range = largest.max(axis=2, keepdims=True) <= LARGEST[self.precision]
        asked = asked & (exact.condition <= MAX_CONDITION[self.precision]) & in_range
        least = underflow_threshold(BITS[self.precision])
        with np.errstate(invalid="ignore"):
            off = np.maximum(exact.low - computed, computed - exact.high) / least
        # Smaller ones may lose their digits to underflow on the way, but not become larger ones.
        ulp = np.where((largest < least) & np.isfinite(computed), np.maximum(off, 0), ulp)
        ulp = np.where(asked, ulp, np.nan)
        relative = ulp / exact.condition
        with np.errstate(invalid="ignore"):
            in_doubt = np.flatnonzero((relative > LIMITS["reverse"]).any(axis=(1, 2)))
        for row in in_doubt[:SETTLED]:
            settled = self._settled(self.cases[exact.index[row]], computed[row], rounding[row], exact.paths)
            relative[row] = np.where(np.isnan(relative[row]), np.nan, settled)
        judged.ulp[exact.index] = _worst(ulp.reshape(len(ulp), -1))
        judged.relative[exact.index] = _worst(relative.reshape(len(ulp), -1))
        with np.errstate(invalid="ignore"):
            strict = exact.error_in_ulp(computed, BITS[self.precision]) / exact.condition > LIMITS["reverse"]
            leaning = np.sum(strict & (rounding > 0) & (relative <= LIMITS["reverse"]), axis=(0, 2))
        for i, path in enumerate(exact.paths):
            judged.by_allowance[field(path)] = judged.by_allowance.get(field(path), 0) + int(leaning[i])
            errors = _worst(relative[:, i])
            known = judged.by_field.get(field(path), np.zeros(0))
            judged.by_field[field(path)] = np.concatenate([known, errors[~np.isnan(errors)]])

    def _settled(self, case: Case, computed: np.ndarray, rounding: np.ndarray, paths: Sequence[Path]) -> np.ndarray:
        """Errors of derivatives [P, 4] in ulp / condition by 50 digits; the condition by moving every input."""
        bits = BITS[self.precision]
        bounds, conditions = gradient_bounds(case, near_ties(case, bits)), moved_gradient_condition(case, bits)
        out, least = np.zeros(computed.shape), underflow_threshold(bits)
        for i, path in enumerate(paths):
            ends, condition = bounds.get(path, ((0, 0),) * 4), conditions.get(path, (1.0,) * 4)
            for c, (low, high) in enumerate(ends):
                off = max(low - computed[i, c], computed[i, c] - high) - rounding[i, c]
                largest = max(abs(float(low)), abs(float(high)))
                ulp = least if largest < least else float(output_ulp(largest, bits))
                out[i, c] = max(0.0, float(off / mpf(ulp))) / condition[c]
        return out


def _unjudged(count: int) -> Judged:
    return Judged(np.full(count, np.nan), np.full(count, np.nan), np.ones(count, dtype=bool), {}, {})


def _has_subnormals(case: Case, dtype: np.dtype) -> bool:
    """Whether an input is so small that processors may flush it to zero."""
    tiny = float(np.finfo(dtype).tiny)
    return any(0 < abs(get(case, path)) < tiny for path in float_paths(case))


def _over_components(size: np.ndarray, paths: Sequence[Path]) -> np.ndarray:
    """[n, P, 4] with every number replaced by the largest of the vector or colour that its input is a component of."""
    owner = [path[:-1] if isinstance(path[-1], int) else path for path in paths]
    out = size.copy()
    for one in set(owner):
        places = [i for i, other in enumerate(owner) if other == one]
        out[:, places] = size[:, places].max(axis=1, keepdims=True)
    return out


def field(path: Path) -> str:
    """The node field that a number belongs to: ("lights", 1, "location", 2) -> lights.location."""
    return ".".join(step for step in path if isinstance(step, str))


def _worst(errors: np.ndarray) -> np.ndarray:
    """[n, k] -> [n], NaN where all are."""
    worst = np.where(np.isnan(errors), -1.0, errors).max(axis=1)
    return np.where(worst < 0, np.nan, worst).astype(np.float64)
