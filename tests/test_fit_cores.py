"""Fits whose tiles are divided among cores: the same steps to the same values as on one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fit_scenes import EYE, precision, sphere_picture, sphere_points, sphere_scene
from jaxlight import Fit, SampleBuffer, View, fit
from jaxlight.lighting import cores
from test_fit_part import FREE, SIZE, start, view

SHARES = 3


@pytest.fixture
def threads(several_cores: Callable[[str, int], list[int]]) -> list[int]:
    """Into how many threads each evaluation is divided."""
    return several_cores("jaxlight.fit.run", SHARES)


def fitted(dtype: Any) -> Fit:
    return fit(start(dtype), [view(dtype, noise=0.01), view(dtype, noise=0.02)], FREE)


def test_cores_change_no_step(threads: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """A trial that is refused asks for no derivatives."""
    with precision("float64") as dtype:
        divided = fitted(dtype)
        assert divided.converged and set(threads) == {SHARES}
        refused = sum(not step.accepted for step in divided.history)
        assert len(threads) == 2 * len(divided.history) - refused
        threads.clear()
        monkeypatch.setattr(cores, "cores", lambda: 1)
        alone = fitted(dtype)
    assert not threads and len(alone.history) == len(divided.history)
    for path in FREE:
        np.testing.assert_allclose(divided.value(path), alone.value(path), rtol=1e-9)


def test_tiles_that_cannot_be_shared_out_evenly_count_once(threads: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    with precision("float64") as dtype:
        (points, pixel), tile = sphere_points(SIZE), 32
        points, pixel = points[: 32 * tile], pixel[: 32 * tile]
        samples = SampleBuffer.create(points, points, EYE, tile=tile, dtype=dtype)
        own = View(samples, sphere_picture(SIZE).reshape(-1, 3)[pixel])
        divided = fit(start(dtype), own, FREE, max_steps=1)
        assert set(threads) == {SHARES}
        monkeypatch.setattr(cores, "cores", lambda: 1)
        alone = fit(start(dtype), own, FREE, max_steps=1)
    assert divided.history[0].loss == pytest.approx(alone.history[0].loss, rel=1e-12)


def test_pixels_that_gather_samples_are_not_divided(threads: list[int]) -> None:
    points, pixel = sphere_points(SIZE)
    half = SIZE // 2
    row, column = np.divmod(pixel, SIZE)
    samples = SampleBuffer.create(
        points, points, EYE, pixel=row // 2 * half + column // 2, coverage=np.full(len(points), 0.25), width=half,
        height=half, dtype=np.float32,
    )  # fmt: skip
    picture = sphere_picture(SIZE).reshape(half, 2, half, 2, 3).mean(axis=(1, 3))
    result = fit(sphere_scene(dtype=np.float32), View(samples, picture), FREE, max_steps=1)
    assert not threads and np.isfinite(result.loss)
