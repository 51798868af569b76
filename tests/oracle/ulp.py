"""Units in the last place of float32 and float64, and how inputs move by one of them.

Inputs: a number moves to its two neighbours in the format; a zero (and an infinity) stays; a subnormal number may
also become zero, because processors may flush it. Outputs: one ulp is the distance from the float nearest to the
exact value to the next larger one, and never less than the smallest normal number: a factor or a term below that may
be flushed to zero on the way, and is then less than one ulp off. Values beyond the largest finite number have no ulp;
what is left to ask is finiteness.
"""

from __future__ import annotations

from typing import Any

import numpy as np

FORMATS: dict[int, Any] = {32: np.float32, 64: np.float64}


def underflow_threshold(precision: int) -> float:
    """Smallest normal number / machine epsilon: what is smaller may be lost once ordinary factors are multiplied on."""
    info = np.finfo(FORMATS[precision])
    return float(info.tiny) / float(info.eps)


def underflowing_base(exponent: Any, precision: int) -> np.ndarray:
    """Up to which x the slope of x^exponent, about x^(exponent - 1), is below the smallest normal number."""
    above = np.asarray(exponent, dtype=np.float64) - 1
    tiny = float(np.finfo(FORMATS[precision]).tiny)
    return np.where(above > 0, tiny ** (1 / np.where(above > 0, above, 1)), 0.0)


def neighbours(value: Any, precision: int) -> list[np.ndarray]:
    """The places [...] to which inputs [...] move by one ulp, in the input's own (wider) type."""
    wide = np.asarray(value)
    kind = FORMATS[precision]
    narrow = wide.astype(kind)
    stays = (narrow == 0) | ~np.isfinite(narrow)
    moved = [
        np.where(stays, wide, wide + (np.nextafter(narrow, kind(end)).astype(wide.dtype) - narrow.astype(wide.dtype)))
        for end in (np.inf, -np.inf)
    ]
    subnormal = ~stays & (np.abs(narrow) < np.finfo(kind).tiny)
    return [*moved, np.where(subnormal, 0, wide)] if np.any(subnormal) else moved


def input_ulp(value: Any, precision: int) -> np.ndarray:
    """The largest of an input's moves, as longdouble [...]."""
    wide = np.asarray(value, dtype=np.longdouble)
    with np.errstate(invalid="ignore"):
        moves = [np.where(np.isfinite(wide), np.abs(moved - wide), 0) for moved in neighbours(wide, precision)]
    return np.max(moves, axis=0)


def output_ulp(exact: Any, precision: int) -> np.ndarray:
    """One ulp of outputs [...] as longdouble; infinite beyond the largest finite number."""
    kind = FORMATS[precision]
    with np.errstate(over="ignore"):
        nearest = np.abs(np.asarray(exact, dtype=np.longdouble)).astype(kind)
    finite = np.isfinite(nearest)
    spacing = np.spacing(np.where(finite, nearest, kind(1)))
    spacing = np.maximum(spacing, np.finfo(kind).tiny)
    return np.where(finite, spacing.astype(np.longdouble), np.inf)


def error_in_ulp(computed: Any, exact: Any, precision: int) -> np.ndarray:
    """|computed - exact| in ulp of the exact value, as longdouble [...]; infinite where `computed` is not finite.

    `exact` is longdouble (or what converts to it without loss that matters).
    """
    computed = np.asarray(computed, dtype=np.longdouble)
    exact = np.asarray(exact, dtype=np.longdouble)
    with np.errstate(invalid="ignore"):
        error = np.abs(computed - exact) / output_ulp(exact, precision)
    return np.where(np.isfinite(computed), error, np.inf)
