"""Coverage: what of their pixels the samples of a view cover, and which pixels they cover wholly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..raster.samples import SampleBuffer

SLACK = 1e-6
"""By which the shares of a pixel that is covered wholly may add up to less than 1, where their type rounds by less."""


class Coverage(NamedTuple):
    """The pixels in which samples lie, in float64 whatever the samples' own type."""

    pixel: np.ndarray
    """[P], row * width + column, rising."""
    point: np.ndarray
    """[N], which of these pixels each sample lies in."""
    share: np.ndarray
    """[N], share of its pixel that each sample stands for."""
    covered: np.ndarray
    """[P], sum of the shares."""
    is_whole: np.ndarray
    """[P], whether a view without a background can be compared there."""

    @classmethod
    def of(cls, samples: SampleBuffer) -> Coverage:
        """Of samples that know their pixels; those are whole whose shares, before they were rounded, may add up to 1.

        bfloat16 tells k shares of 1 / k from k - 1 of them up to k = 190, float16 up to more than `rasterize` takes.
        """
        pixel, point = np.unique(np.asarray(samples.pixel), return_inverse=True)
        given = np.ones(samples.count) if samples.coverage is None else np.asarray(samples.coverage)
        share, rounding = given.astype(np.float64), np.spacing(given).astype(np.float64) / 2
        covered, slack = (np.bincount(point, of_sample, len(pixel)) for of_sample in (share, rounding))
        return cls(pixel, point, share, covered, covered > 1 - np.maximum(slack, SLACK))
