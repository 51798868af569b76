"""Fits that begin with a part of the samples."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fit_scenes import key_light, material, precision, sphere_picture, sphere_samples, sphere_scene
from jaxlight import View, fit
from jaxlight.fit import part
from jaxlight.fit.fitting import run_fit
from jaxlight.fit.problem import make_problem
from jaxlight.fit.run import make_solver
from jaxlight.lighting.tiles import surface_runs

SIZE, TILE = 64, 32
FREE = [
    "Material[body].diffuse_color",
    "Material[body].specular_color",
    "Material[body].shininess",
    "PointLight[key].location",
]


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits of few samples begin with a part, too."""
    monkeypatch.setattr(part, "_LEAST_SAMPLES", 256)


def start(dtype: Any) -> Any:
    return sphere_scene(
        key_light(location=(0.8, 1.2, 2.5)), body=material(diffuse_color=(0.5,) * 3, shininess=0.15), dtype=dtype
    )


def view(dtype: Any, **picture: Any) -> View:
    return View(sphere_samples(SIZE, dtype=dtype, tile=TILE), sphere_picture(SIZE, **picture))


def test_few_samples_are_all_evaluated() -> None:
    result = fit(start(np.float32), view(np.float32), FREE, max_steps=2)
    assert {step.part for step in result.history} == {1.0}


@pytest.mark.usefixtures("small_parts")
def test_many_short_runs_are_all_evaluated() -> None:
    """A part has a tile of every run at least; where that is most of them, it is none."""
    small = sphere_samples(8, dtype=np.float32, tile=64)
    views = [View(small, sphere_picture(8))] * 40
    assert make_problem(start(np.float32), views, FREE)[1].part == part.WHOLE


@pytest.mark.parametrize("every", [1, 4, 7, 1000])
def test_a_part_takes_tiles_from_every_run(every: int) -> None:
    samples = sphere_samples(SIZE, tile=TILE)
    runs = surface_runs(start(np.float32).surfaces, samples)
    assert runs
    for run in runs:
        first, count = (int(number) for number in part.tiles_of_part(run, every))
        chosen = range(first, first + count * every, every)
        assert chosen and run.start <= chosen[0] and chosen[-1] < run.stop
        assert chosen[-1] + every >= run.stop


@pytest.mark.usefixtures("small_parts")
def test_the_share_of_a_part_is_what_is_heard_in_its_tiles() -> None:
    scene, seen = start(np.float32), view(np.float32)
    mask = np.random.default_rng(0).random((SIZE, SIZE)) < 0.5
    problem, description = make_problem(scene, dataclasses.replace(seen, mask=mask), FREE)
    heard = np.count_nonzero(np.asarray(problem.views[0].root_weight).reshape(-1, TILE), axis=1)
    (run,) = surface_runs(scene.surfaces, seen.samples)
    first, count = (int(number) for number in part.tiles_of_part(run, description.part.every))
    chosen = heard[first :: description.part.every]
    assert len(chosen) == count and description.part.share == chosen.sum() / heard.sum()


@pytest.mark.usefixtures("small_parts")
@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_the_part_leads_to_the_same_optimum(kind: str) -> None:
    with precision(kind) as dtype:
        noisy = view(dtype, noise=0.01)
        result = fit(start(dtype), noisy, FREE)
        problem, description = make_problem(start(dtype), noisy, FREE)
        whole = run_fit(problem, description._replace(part=part.WHOLE), make_solver(problem))
        parts = [step.part for step in result.history]
        assert result.converged and whole.converged
        assert parts[0] == parts[1] < 0.2 and parts[-1] == 1 and sorted(parts) == parts
        assert sum(p == 1 for p in parts) < len(whole.history)
        tolerance = 1e-6 if kind == "float64" else 1e-3
        np.testing.assert_allclose(result.values, whole.values, rtol=tolerance)
        assert result.loss == pytest.approx(whole.loss, rel=1e-5)
        assert result.accepted_steps <= len(result.history) - 2
        assert "% of the samples" in result.message
        # A part's loss, scaled up, is about that of all.
        assert result.history[0].loss == pytest.approx(whole.history[0].loss, rel=0.3)


@pytest.mark.usefixtures("small_parts")
@pytest.mark.parametrize(
    ("kind", "size", "tile", "begun"),
    [("float64", 64, 32, "with a part"), ("float32", 256, 1024, "with all")],
)
def test_what_only_rounding_is_left_of_has_converged(kind: str, size: int, tile: int, begun: str) -> None:
    """Where nothing shines the exponent has no meaning, and would wander for ever between sums of rounding errors."""
    dull = material(specular_color=(0.0, 0.0, 0.0))
    body = material(diffuse_color=(0.5,) * 3, specular_color=(0.2,) * 3, shininess=0.1)
    with precision(kind) as dtype:
        scene = sphere_scene(key_light(location=(0.8, 1.2, 2.5)), body=body, dtype=dtype)
        own = View(sphere_samples(size, dtype=dtype, tile=tile), sphere_picture(size, body=dull))
        problem, description = make_problem(scene, own, FREE)
        if begun == "with all":
            description = description._replace(part=part.WHOLE)
        result = run_fit(problem, description, make_solver(problem))
        assert result.converged and result.state.tried <= 8
        assert np.abs(result.value("Material[body].specular_color")).max() < 1e-6


@pytest.mark.usefixtures("small_parts")
def test_a_part_that_misses_the_highlight_is_not_believed() -> None:
    """All that the part sees is explained without a highlight; the rest of the picture is not."""
    with precision("float64") as dtype:
        samples = sphere_samples(SIZE, dtype=dtype, tile=TILE)
        problem, description = make_problem(start(dtype), View(samples, sphere_picture(SIZE)), FREE)
        assert description.part.every > 1
        target = sphere_picture(SIZE).reshape(-1, 3)
        dull = sphere_picture(SIZE, body=material(specular_color=(0.0, 0.0, 0.0))).reshape(-1, 3)
        (run,) = surface_runs(start(dtype).surfaces, samples)
        first, count = (int(number) for number in part.tiles_of_part(run, description.part.every))
        tiles = first + np.arange(count) * description.part.every
        slots = (tiles[:, None] * TILE + np.arange(TILE)).ravel()
        seen = np.asarray(samples.pixel_slots)[slots]
        seen = seen[seen < SIZE * SIZE]
        target[seen] = dull[seen]
        mixed = View(samples, target.reshape(SIZE, SIZE, 3))
        result = fit(start(dtype), mixed, FREE)
        problem, description = make_problem(start(dtype), mixed, FREE)
        whole = run_fit(problem, description._replace(part=part.WHOLE), make_solver(problem))
        parts = [step.part for step in result.history]
        turn = parts.index(1.0)
        assert result.history[turn + 1].loss == pytest.approx(whole.history[0].loss, rel=1e-12)
        assert len(parts) - turn - 1 == len(whole.history)
        np.testing.assert_array_equal(result.values, whole.values)


@pytest.mark.usefixtures("small_parts")
def test_the_most_steps_count_those_with_a_part() -> None:
    result = fit(start(np.float32), view(np.float32), FREE, max_steps=3)
    assert result.outcome == "max_steps" and result.state.tried == 3
    assert [step.step for step in result.history] == [0, 1, 2, 3, 4]
    assert result.history[-1].part == 1


@pytest.mark.usefixtures("small_parts")
@pytest.mark.parametrize("last", [0, 2, 5])
def test_a_fit_resumed_within_the_part_ends_in_the_same_bits(tmp_path: Path, last: int) -> None:
    class Killed(BaseException):
        pass

    def kill(step: Any) -> None:
        if step.step == last:
            raise Killed

    noisy = view(np.float32, noise=0.01)
    expected = fit(start(np.float32), noisy, FREE)
    path = tmp_path / "fit.npz"
    with pytest.raises(Killed):
        fit(start(np.float32), noisy, FREE, checkpoint=path, checkpoint_seconds=0, progress=kill)
    result = fit(start(np.float32), noisy, FREE, checkpoint=path, resume=True)
    assert result.values.tobytes() == expected.values.tobytes()
    assert [step.loss for step in result.history] == [step.loss for step in expected.history]
    assert result.message == expected.message


@pytest.mark.usefixtures("small_parts")
def test_an_interrupt_within_the_part_keeps_its_values() -> None:
    def interrupt(step: Any) -> None:
        if step.step == 2:
            raise KeyboardInterrupt

    result = fit(start(np.float32), view(np.float32), FREE, progress=interrupt)
    assert result.outcome == "interrupted" and result.history[-1].part < 1
    assert np.isfinite(result.rms) and result.loss < result.history[0].loss
    assert "not converged" in result.message and "% of the samples" in result.message
