"""The benchmarks' own promises: the reference is right, contenders agree with it, the harness, gate and parser work."""

from __future__ import annotations

import dataclasses
import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks import gate, memory, report, yardstick
from benchmarks import reference as reference_module
from benchmarks.contenders.base import Operation
from benchmarks.contenders.jaxlight_fit import JaxlightFit
from benchmarks.entrants import JAXLIGHT, JAXLIGHT_BY_TILES, PEERS, Entrant
from benchmarks.errors import color_errors, gradient_errors
from benchmarks.fits import ENTRANTS as FITS
from benchmarks.harness import Case, Measurement, Plan, measure
from benchmarks.peers import headline
from benchmarks.profile import operations, stage_shares
from benchmarks.reference import answer
from benchmarks.worker import Cases
from benchmarks.workload import Arrays, Workload, make_arrays

SMALL = Workload(samples=600, lights=3, sample_color=False)


def bumped(arrays: Arrays, name: str, index: tuple[int, ...], by: Any) -> Arrays:
    group, field = name.split(".")
    fields = dict(getattr(arrays, group))
    fields[field] = fields[field].astype(np.longdouble)
    fields[field][index] += by
    return arrays._replace(**{group: fields})


@pytest.mark.parametrize("kind", ["point", "directional", "spot"])
@pytest.mark.parametrize("sample_color", [False, True])
def test_reference_gradient_is_the_central_difference(kind: Any, sample_color: bool) -> None:
    work = dataclasses.replace(SMALL, kind=kind, sample_color=sample_color)
    arrays = make_arrays(work)
    gradient = answer(work, arrays, dtype=np.longdouble).gradient
    step = np.longdouble(1e-6)
    assert set(gradient) == set(arrays.parameters)
    for name, expected in gradient.items():
        difference = np.zeros(expected.shape)
        for index in np.ndindex(expected.shape):
            up, down = (
                np.sum((answer(work, moved, dtype=np.longdouble, gradient=False).colors - arrays.target) ** 2)
                for moved in (bumped(arrays, name, index, step), bumped(arrays, name, index, -step))
            )
            difference[index] = (up - down) / (2 * step)
        np.testing.assert_allclose(expected, difference, rtol=1e-7, atol=1e-8 * np.max(np.abs(expected)))


def test_reference_of_every_third_sample_is_every_third_of_the_whole() -> None:
    arrays = make_arrays(SMALL)
    whole, part = answer(SMALL, arrays), answer(SMALL, arrays, stride=3)
    assert np.array_equal(part.colors, whole.colors[:, ::3])
    assert part.gradient == {}


def test_lights_that_are_off_add_nothing() -> None:
    off, half = (dataclasses.replace(SMALL, lights=count, dark=dark) for count, dark in ((2, "off"), (1, "none")))
    assert np.array_equal(answer(off, make_arrays(off)).colors, answer(half, make_arrays(half)).colors)


def test_the_reference_leaves_out_only_lights_that_add_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    work = Workload(samples=2500, lights=60, cover=4)
    arrays = make_arrays(work)
    culled = answer(work, arrays)
    monkeypatch.setattr(reference_module, "_may_reach", lambda lights, position: np.ones(60, bool))
    whole = answer(work, arrays)
    assert np.array_equal(culled.colors, whole.colors)
    for name, expected in whole.gradient.items():
        np.testing.assert_allclose(culled.gradient[name], expected, rtol=1e-13)


@pytest.mark.parametrize("entrant", PEERS, ids=lambda entrant: entrant.label)
@pytest.mark.parametrize("sample_color", [False, True])
def test_peers_agree_with_the_reference(entrant: Entrant, sample_color: bool) -> None:
    if entrant.missing():
        pytest.skip(f"{entrant.label}: {entrant.missing()}")
    if entrant.label == "torch.compile":
        pytest.skip("runs the eager program, which is tested; compiling it takes half a minute")
    if entrant.label.startswith("Dr.Jit"):
        llvm = importlib.import_module("benchmarks.contenders.dr_jit")._newest_llvm()
        if llvm is None or not any(version in llvm for version in ("-17", "-18", ".19", ".20", ".21", ".22")):
            pytest.skip("Dr.Jit ends the process where LLVM is too old")
    work = dataclasses.replace(SMALL, sample_color=sample_color)
    arrays = make_arrays(work)
    reference = answer(work, arrays)
    contender = entrant.contender()(work, arrays)
    color_errors(contender.colors(contender.prepare("forward")()), reference)
    found = contender.value_and_gradient(contender.prepare("value_and_gradient")())
    assert set(found.gradient) == set(reference.gradient)
    assert gradient_errors(*found, reference).largest < 2e-5


def test_wrong_answers_are_refused() -> None:
    arrays = make_arrays(SMALL)
    reference = answer(SMALL, arrays)
    with pytest.raises(ValueError, match="colours are wrong"):
        color_errors(reference.colors + 1e-3, reference)
    with pytest.raises(ValueError, match="not finite"):
        color_errors(reference.colors * np.nan, reference)
    wrong = {**reference.gradient, "lights.color": reference.gradient["lights.color"] * 1.01}
    with pytest.raises(ValueError, match="derivative is wrong"):
        gradient_errors(reference.value, wrong, reference)
    with pytest.raises(ValueError, match=r"unknown: lights\.hue"):
        gradient_errors(reference.value, {"lights.hue": np.zeros(3)}, reference)


def test_errors_are_counted_in_units_in_the_last_place() -> None:
    reference = answer(SMALL, make_arrays(SMALL))
    single = reference.colors.astype(np.float32)
    exact = reference._replace(colors=single.astype(np.float64))
    statistics = color_errors(single + 3 * np.spacing(single), exact)
    assert statistics.median_ulp == statistics.high_ulp == statistics.largest_ulp == 3


def test_the_harness_measures_and_says_why_not() -> None:
    naive = next(entrant for entrant in PEERS if entrant.label == "naive JAX")
    absent = Entrant("absent", "nothing:Nothing", ("no_such_package",))
    broken = Entrant("broken", "nothing:Nothing")
    cases = [Case(entrant, "forward", SMALL) for entrant in (naive, absent, broken)]
    done, missing, failed = measure(cases, Plan(rounds=2, slot_seconds=0.01, cores=()))
    assert done.skipped is None
    assert done.calls >= 2
    assert done.seconds > 0
    assert done.compile_seconds > 0
    assert done.error is not None
    assert done.error["largest"] < 1e-5
    assert missing.skipped == "no_such_package not installed"
    assert failed.skipped is not None
    assert "ModuleNotFoundError" in failed.skipped


def test_memory_is_weighed_against_the_samples_of_all_views(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(JaxlightFit, "prepare", lambda self, operation: lambda: None)
    found = []
    for views in (1, 3):
        entrant = Entrant("fit", "jaxlight_fit:JaxlightFit", options=(("views", views),))
        found.append(Cases(entrant).load("", dataclasses.asdict(SMALL), "normal_equations", None)["input_bytes"])
    assert found == [make_arrays(SMALL).input_bytes, 3 * make_arrays(SMALL).input_bytes]


def test_peak_memory_sees_a_known_allocation() -> None:
    size = 64 * 2**20
    peak = memory.peak_bytes(lambda: np.ones(size // 8).sum())
    # The kernel counts in batches of some pages.
    assert 0.98 * size < peak < 1.2 * size


def test_the_yardstick_table_is_parsed() -> None:
    table = (
        "threads 1, N=1048576\n"
        "kernel: ns per sample*light    L=1  L=8  L=64 | ns/sample L=1 8 64 | max|err| rms (vs double, L=8)\n"
        "point full (att+radius+spec+expfog+tex)   1.478  0.662  0.576 |   1.48   5.30   36.89 | 1e-6 1e-7\n"
    )
    assert yardstick.parse(table) == {yardstick.FORWARD: {1: 1.478, 8: 0.662, 64: 0.576}}
    with pytest.raises(ValueError, match="no line of the form"):
        yardstick.parse("Segmentation fault")


def test_a_yardstick_that_cannot_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no_such_program"):
        yardstick.Yardstick(tmp_path / "no_such_program", (0,)).run()


def test_the_gate_knows_directions_and_tolerances(tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    gate.write_baseline([gate.Metric("time", 2.0, "lower", 0.1), gate.Metric("gain", 3.0, "higher", 0.1)], path)

    def words(time: float, gain: float) -> list[str]:
        verdicts = gate.compare([gate.Metric("time", time, "lower"), gate.Metric("gain", gain, "higher")], path)
        return [verdict.word for verdict in sorted(verdicts, key=lambda verdict: verdict.name, reverse=True)]

    assert words(2.19, 2.71) == ["ok", "ok"]
    assert words(1.0, 9.0) == ["ok", "ok"]
    assert words(2.21, 2.71) == ["REGRESSION", "ok"]
    assert words(2.0, 2.69) == ["ok", "REGRESSION"]
    assert [verdict.word for verdict in gate.compare([gate.Metric("time", 2.0, "lower")], path)].count(
        "not measured"
    ) == 1
    with pytest.raises(ValueError, match="measured none"):
        gate.compare([gate.Metric("other", 1.0, "lower")], path)
    with pytest.raises(ValueError, match="no baseline"):
        gate.compare([], tmp_path / "nothing.json")


def test_gradients_are_judged_by_the_same_contender_whichever_run() -> None:
    def names(*entrants: Entrant) -> set[str]:
        cases = [Case(JAXLIGHT, "forward", SMALL), *(Case(own, "value_and_gradient", SMALL) for own in entrants)]
        nothing = yardstick.Yardstick(None, (0,))
        return {metric.name for metric in headline([Measurement(case, seconds=1.0) for case in cases], nothing)}

    assert names(JAXLIGHT) == set()
    assert names(JAXLIGHT, JAXLIGHT_BY_TILES) == {"gradient/3/over forward", "gradient/3/memory over inputs"}


def test_a_new_baseline_keeps_what_was_not_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "baseline.json"
    gate.write_baseline([gate.Metric("kept", 1.0, "lower"), gate.Metric("new", 1.0, "lower")], path)
    monkeypatch.setattr(gate, "processor", lambda: "another")
    assert gate.other_processors(path) == [report.processor()]
    gate.write_baseline([gate.Metric("new", 2.0, "lower")], path)
    assert gate.other_processors(path) == [report.processor()]
    metrics = json.loads(path.read_text())["metrics"]
    assert {name: entry["value"] for name, entry in metrics.items()} == {"kept": 1.0, "new": 2.0}


def test_fits_start_away_from_the_truth_and_are_judged_by_it() -> None:
    from benchmarks.errors import parameter_errors
    from benchmarks.fit_problem import FREE, WORK, fit_start

    arrays = make_arrays(dataclasses.replace(WORK, samples=64))
    start = fit_start(arrays)
    assert tuple(start) == FREE
    assert parameter_errors(start, arrays.parameters).largest > 0.3
    assert parameter_errors({name: arrays.parameters[name] for name in FREE}, arrays.parameters).largest == 0
    assert {entrant.label for entrant, _ in FITS} >= {"jaxlight", "optimistix LM, naive JAX"}


def test_a_profile_leaves_out_no_instruction() -> None:
    """Long sums XLA divides, and puts in instructions that come from no operation of the program."""
    program = """
  %wrapped_reduce-window.2 = f32[3,2]{1,0} fusion(%plane, %zero), kind=kLoop, metadata={stack_frame_id=2}
  ROOT %total.1 = f32[3]{0} fusion(%a, %b), kind=kLoop, metadata={op_name="jit(f)/stage.seen/reduce_sum"}
"""
    found = {"wrapped_reduce-window.2": "wrapped_reduce-window", "total.1": "jit(f)/stage.seen/reduce_sum"}
    assert operations(program) == found


@pytest.mark.parametrize(
    ("lights", "operation", "names"),
    [
        (1, "forward", ["colors"]),
        (9, "forward", ["directions", "received|no stage: while", "mixed"]),
        (1, "value_and_gradient", ["seen", "power", "colored", "weights.change (reverse)"]),
    ],
)
def test_a_profile_tells_loops_and_stages_apart(lights: int, operation: Operation, names: list[str]) -> None:
    shares, nanoseconds = stage_shares(Workload(2**13, lights), operation, "full", rounds=3)
    assert all(set(either.split("|")) & set(shares) for either in names)
    assert sum(share for share, _ in shares.values()) == pytest.approx(1)
    assert nanoseconds > 0 and all(loops > 0 for _, loops in shares.values())
