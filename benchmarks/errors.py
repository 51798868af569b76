"""How far a contender's answer lies from the reference."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .reference import Answer

COLOR_LIMIT = 2e-5
"""Largest error of a colour, relative to the largest colour, at which a contender still shades the same scene."""
GRADIENT_LIMIT = 1e-3
"""Likewise of a derivative, relative to the largest of its field."""


@dataclasses.dataclass(frozen=True)
class ErrorStatistics:
    """Errors of colours, or of derivatives relative to the largest of their field."""

    largest: float
    root_mean_square: float
    median_ulp: float
    """Units in the last place of the contender's float type; 0 for derivatives, as all ulp figures."""
    high_ulp: float
    """Not exceeded by 99.9 % of the values."""
    largest_ulp: float
    left_out: int
    """Samples not compared: at a light's radius, where rounding decides."""


def color_errors(
    colors: np.ndarray, reference: Answer, float_type: Any = np.float32, limit: float = COLOR_LIMIT
) -> ErrorStatistics:
    """Errors of [3, N] colours; raises ValueError where they are beyond `limit` or not finite."""
    kept = ~reference.at_jump
    expected = reference.colors[:, kept]
    difference = np.abs(colors[:, kept] - expected)
    if not np.all(np.isfinite(difference)):
        raise ValueError(f"{np.sum(~np.isfinite(difference))} colours are not finite")
    size = float(np.max(np.abs(expected)))
    if difference.max() > limit * size:
        raise ValueError(f"colours are wrong by {difference.max():.1e}, more than {limit:g} of the largest")
    ulp = np.asarray(difference / np.spacing(np.abs(expected).astype(float_type)), np.float64)
    difference = np.asarray(difference, np.float64)
    return ErrorStatistics(
        largest=float(difference.max()),
        root_mean_square=float(np.sqrt(np.mean(difference**2))),
        median_ulp=float(np.median(ulp)),
        high_ulp=float(np.quantile(ulp, 0.999)),
        largest_ulp=float(ulp.max()),
        left_out=int(np.sum(~kept)),
    )


def gradient_errors(value: float, gradient: dict[str, np.ndarray], reference: Answer) -> ErrorStatistics:
    """Errors of value and gradient; raises ValueError for a field that is unknown, not finite, or beyond the limit.

    Fields that the contender does not claim to have are not compared; the lights of a field may be the first few only.
    """
    unknown = sorted(set(gradient) - set(reference.gradient))
    if unknown or not gradient:
        raise ValueError(f"the gradient's fields are unknown: {', '.join(unknown) or 'there is none'}")
    relative = [np.array([value / reference.value - 1])]
    for name, full in reference.gradient.items():
        if name not in gradient:
            continue
        expected = full[: len(gradient[name])] if full.ndim and name.startswith("lights.") else full
        got = np.asarray(gradient[name], np.float64).reshape(expected.shape)
        relative.append(np.ravel(np.abs(got - expected) / max(np.max(np.abs(expected)), 1e-30)))
    every = np.abs(np.concatenate(relative))
    if not np.all(np.isfinite(every)):
        raise ValueError("the gradient is not finite")
    if every.max() > GRADIENT_LIMIT:
        raise ValueError(f"a derivative is wrong by {every.max():.1e} of its field's largest")
    mean = float(np.sqrt(np.mean(every**2)))
    return ErrorStatistics(float(every.max()), mean, 0.0, 0.0, 0.0, int(reference.at_jump.sum()))


def parameter_errors(values: dict[str, np.ndarray], truth: dict[str, np.ndarray]) -> ErrorStatistics:
    """Errors of fitted numbers, relative to their field's largest; a bad fit is a result, not a failure."""
    relative = [
        np.ravel(np.abs(np.asarray(value, np.float64).reshape(truth[name].shape) - truth[name]))
        / np.max(np.abs(truth[name]))
        for name, value in values.items()
    ]
    every = np.concatenate(relative)
    return ErrorStatistics(float(every.max()), float(np.sqrt(np.mean(every**2))), 0.0, 0.0, 0.0, 0)
