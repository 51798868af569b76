"""What fits reach where the answer is known: `python -m benchmarks.fit_figures --help`."""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro

from jaxlight.fit import Fit, Free, View, fit
from jaxlight.fit.fitting import run_fit
from jaxlight.fit.problem import Description, Problem, make_problem
from jaxlight.fit.run import advance, begin, make_solver, solve
from jaxlight.fit.uncertainty import uncertainty
from jaxlight.lighting import make_plan, shade_slots

from .contenders.jaxlight_shade import samples_of, scene_of
from .fit_problem import WORK, with_values
from .fit_texture import TEXELS, texture_problem
from .reference import answer
from .report import table
from .workload import Arrays, Workload, make_arrays

FREE: list[Any] = [
    "Material[0].diffuse_color",
    Free("Material[0].specular_color", tied="all"),
    "Material[0].shininess",
    "PointLight[0].location",
    "PointLight[0].color.r",
    "PointLight[0].color.b",
]
"""Ten numbers. The gauge: one channel of the light is known and the highlight is grey."""
AMBIENT = "Material[0].ambient_intensity"
EVERYTHING = [
    *(f"Material[0].{field}" for field in ("diffuse_color", "specular_color", "emissive_color", "shininess")),
    AMBIENT,
    *(f"PointLight[0].{field}" for field in ("color", "intensity", "ambient_intensity", "location", "attenuation")),
]
TRUTH = {
    "material.diffuse_color": np.array([0.6, 0.3, 0.2]),
    "material.specular_color": np.full(3, 0.4),
    "material.shininess": np.array(0.3),
    "lights.location": np.array([[1.5, 2.0, 3.0]]),
    "lights.color": np.array([[1.0, 0.9, 0.8]]),
}
START = {
    "material.diffuse_color": np.full(3, 0.5),
    "material.specular_color": np.full(3, 0.2),
    "material.shininess": np.array(0.1),
    "lights.location": np.array([[0.0, 0.0, 4.0]]),
    "lights.color": np.array([[0.5, 0.9, 0.5]]),
}


@dataclasses.dataclass
class Options:
    """Figures of fits whose answer is known. Each part prints a table."""

    only: tuple[str, ...] = ("steps", "cost", "bounds", "starts", "intervals", "texture")
    """Which parts."""
    quick: bool = False
    """Small pictures and few fits, to see that it works; the figures mean little."""
    seed: int = 2024


class Case(NamedTuple):
    """A picture of the sphere with its truth."""

    arrays: Arrays
    """Holds the truth; the target is its picture."""
    work: Workload

    def problem(self, start: dict[str, np.ndarray], noise: float = 0.0, seed: int = 0) -> Any:
        """(scene at the start, view) in the precision that is switched on."""
        dtype = np.dtype(float) if jax.config.jax_enable_x64 else np.dtype(np.float32)
        target = self.arrays.target.T
        target = target + noise * np.random.default_rng(seed).normal(size=target.shape)
        scene = scene_of(self.work, with_values(self.arrays, start), dtype)
        return scene, View(samples_of(self.arrays, dtype), target)


def case(quick: bool, **changes: Any) -> Case:
    """The sphere under one point light, rendered in float64 by the reference, with some of the truth changed."""
    work = dataclasses.replace(WORK, samples=32**2 if quick else WORK.samples)
    arrays = with_values(
        make_arrays(work), {**TRUTH, **{k.replace("__", "."): np.asarray(v) for k, v in changes.items()}}
    )
    return Case(arrays._replace(target=answer(work, arrays, gradient=False).colors), work)


def truth_of(one: Case, free: list[Any]) -> np.ndarray:
    """The true values of the free numbers."""
    scene, view = one.problem({})
    return np.asarray(make_problem(scene, view, free)[0].parameters.start)


def relative_error(found: Fit, truth: np.ndarray, known: np.ndarray | None = None) -> float:
    """Of the worst number, relative to its true value; absolute where that is 0."""
    wrong = np.abs(found.values - truth) / np.where(truth == 0, 1, np.abs(truth))
    return float(np.max(wrong if known is None else wrong[known]))


def seconds_of(run: Callable[[], Fit]) -> tuple[Fit, float, float]:
    """(result, seconds of the first call, seconds of the next)."""
    began = time.perf_counter()
    run()
    first = time.perf_counter() - began
    began = time.perf_counter()
    found = run()
    return found, first, time.perf_counter() - began


def steps(options: Options) -> str:
    """One picture in both precisions."""
    rows = []
    for precision in ("float32", "float64"):
        with jax.enable_x64(precision == "float64"):
            one = case(options.quick)
            scene, view = one.problem(START)
            found, first, warm = seconds_of(lambda scene=scene, view=view: fit(scene, view, FREE))
            error = relative_error(found, truth_of(one, FREE))
        rows.append([precision, found.accepted_steps, len(found.history) - 1, error, warm, first - warm, found.outcome])
    return table(["precision", "accepted steps", "tried", "relative error", "seconds", "compile s", "outcome"], rows)


def cost(options: Options) -> str:
    """Processor time of one step: loss of the trial, J^T J and J^T r where it is taken, and the step after it; and how
    long it takes by the clock, on all cores of the process."""
    size = 64 if options.quick else 512
    work = dataclasses.replace(WORK, samples=size**2)
    arrays = make_arrays(work)
    scene, samples = scene_of(work, arrays, np.float32), samples_of(arrays, np.float32)
    plan = make_plan(scene, samples, free=True)
    target = answer(work, with_values(arrays, TRUTH), gradient=False).colors.T
    problem, _ = make_problem(scene, View(samples, target), EVERYTHING)
    solver = make_solver(problem)
    state = advance(problem, solver, begin(problem, solver))
    forward, forward_clock = seconds(lambda: shade_slots(scene, samples, plan=plan))
    step, step_clock = seconds(lambda: advance(problem, solver, state))
    columns = ["numbers", "forward ms", "step ms", "step / forward", "forward by the clock ms", "step by the clock ms"]
    numbers = len(problem.parameters.start)
    return table(columns, [[numbers, 1e3 * forward, 1e3 * step, step / forward, 1e3 * forward_clock, 1e3 * step_clock]])


def seconds(run: Callable[[], Any], calls: int = 15) -> tuple[float, float]:
    """Medians of warm calls: of processor time, and by the clock."""
    jax.block_until_ready(run())
    taken = []
    for _ in range(calls):
        began = time.process_time(), time.perf_counter()
        jax.block_until_ready(run())
        taken.append((time.process_time() - began[0], time.perf_counter() - began[1]))
    processor, clock = np.median(taken, axis=0)
    return float(processor), float(clock)


def bounds(options: Options) -> str:
    """The true value inside and on its bound."""
    specular, free_ambient = "material__specular_color", [*FREE, AMBIENT]
    ambient_light = {"lights__ambient_intensity": np.array([0.5])}
    start_ambient = {**START, "material.ambient_intensity": np.array(0.5)}
    # Without a highlight nothing splits the light's colour from the material's: it is known.
    plain = [
        "Material[0].diffuse_color",
        "Material[0].specular_color",
        "Material[0].shininess",
        "PointLight[0].location",
    ]
    start_plain = {name: value for name, value in START.items() if name != "lights.color"}
    cases: list[tuple[str, dict[str, Any], dict[str, Any], list[Any], dict[str, np.ndarray]]] = [
        ("specular 0", {}, {specular: np.zeros(3)}, plain, start_plain),
        (
            "ambient 0",
            {"material__ambient_intensity": np.array(0.2), **ambient_light},
            {"material__ambient_intensity": np.array(0.0), **ambient_light},
            free_ambient,
            start_ambient,
        ),
        ("diffuse 1", {}, {"material__diffuse_color": np.array([1.0, 0.3, 0.2])}, FREE, START),
    ]
    rows = []
    for precision in ("float32", "float64"):
        with jax.enable_x64(precision == "float64"):
            for name, inside, on_bound, free, start in cases:
                taken, errors = [], []
                for changes in (inside, on_bound):
                    one = case(options.quick, **changes)
                    scene, view = one.problem(start)
                    found = fit(scene, view, free)
                    # Nor does anything tell the highlight's exponent.
                    known = np.array([not (name == "specular 0" and "shininess" in label) for label in found.labels])
                    taken.append(found.accepted_steps)
                    errors.append(relative_error(found, truth_of(one, free), known if changes is on_bound else None))
                rows.append([name, precision, *taken, taken[1] / taken[0], *errors])
    heads = ["true value", "precision", "steps inside", "on the bound", "ratio", "error inside", "error on the bound"]
    return table(heads, rows)


def starts(options: Options) -> str:
    """From random starts: colours and exponents anywhere in [0.05, 0.95], the light anywhere before the sphere."""
    count = 4 if options.quick else 64
    random = np.random.default_rng(options.seed)
    rows = []
    for precision in ("float32", "float64"):
        with jax.enable_x64(precision == "float64"):
            one = case(options.quick)
            truth = truth_of(one, FREE)
            drawn = random.uniform(0.05, 0.95, (count, len(truth)))
            towards = random.normal(size=(count, 3))
            towards[:, 2] = np.abs(towards[:, 2])
            drawn[:, 5:8] = towards * random.uniform(2, 6, (count, 1)) / np.linalg.norm(towards, axis=1, keepdims=True)
            problem, description = make_problem(*one.problem({}), FREE)
            solver, reached = make_solver(problem), []
            for start in drawn:
                state = begin(problem, solver, start, description.part.every)
                end = run_fit(problem, description, solver, state=state)
                error = np.max(np.abs(end.values / truth - 1))
                reached.append((error < (1e-4 if precision == "float32" else 1e-6), end.accepted_steps))
            good = [taken for there, taken in reached if there]
        share = f"{len(good)} of {count} ({100 * len(good) / count:.0f} %)"
        rows.append([precision, share, int(np.median(good)), max(good)])
    return table(["precision", "reached the optimum", "median steps", "most steps"], rows)


def intervals(options: Options) -> str:
    """How often the 95 % intervals of noisy fits hold the truth."""
    count, noise = (20 if options.quick else 500), 0.02
    with jax.enable_x64(True):
        small = dataclasses.replace(WORK, samples=24**2)
        arrays = with_values(make_arrays(small), TRUTH)
        one = Case(arrays._replace(target=answer(small, arrays, gradient=False).colors), small)
        truth = truth_of(one, FREE)
        problem, description = make_problem(*one.problem({}), FREE)
        solver, random = make_solver(problem), np.random.default_rng(options.seed)
        covered, ended = [], 0
        clean = np.asarray(problem.views[0].target)
        for _ in range(count):
            noisy = eqx.tree_at(
                lambda p: p.views[0].target, problem, jnp.asarray(clean + noise * random.normal(size=clean.shape))
            )
            end = solve(noisy, solver, noisy.parameters.start, 100)
            ended += bool(end.state.terminate)
            covered.append(_covers(noisy, description, end, truth))
    share = np.mean(covered, axis=0)
    rows = [[label, f"{100 * part:.1f} %"] for label, part in zip(description.labels, share, strict=True)]
    rows.append([f"all, {count} fits of which {ended} converged", f"{100 * np.mean(share):.1f} %"])
    return table(["number", "95 % interval holds the truth"], rows)


def _covers(problem: Problem, description: Description, end: Any, truth: np.ndarray) -> np.ndarray:
    known = uncertainty(problem, description, end.value)
    return np.abs(np.asarray(end.value) - truth) <= 1.96 * known.standard_error


def texture(options: Options) -> str:
    """A whole texture and two lights at once."""
    size, pixels = (32, 48) if options.quick else (TEXELS, 320)
    rows = []
    for precision in ("float32", "float64"):
        with jax.enable_x64(precision == "float64"):
            made = texture_problem(size, pixels)
            found, first, warm = seconds_of(lambda made=made: fit(made.scene, made.views, made.free))
            seen = made.seen
            wrong = np.abs(found.value("Texture[0].image") - made.image)
            error = relative_error(found, made.truth)
            rows.append(
                [precision, found.accepted_steps, float(wrong[seen].max()), error, warm, first - warm, found.outcome]
            )
    heads = ["precision", "accepted steps", "texel error", "lights' relative error", "seconds", "compile s", "outcome"]
    return table(heads, rows)


PARTS = {
    "steps": (steps, "One material and one point light from one picture of a sphere"),
    "cost": (cost, "A step on 512 x 512 samples"),
    "bounds": (bounds, "The true value on a bound"),
    "starts": (starts, "Random starts"),
    "intervals": (intervals, "Intervals of noisy fits"),
    "texture": (texture, "A texture of 256 x 256 x 3 and two point lights from four views"),
}


def main() -> int:
    """Prints the tables; the exit status."""
    options = tyro.cli(Options, description=__doc__)
    for name in options.only:
        if name not in PARTS:
            print(f"--only: unknown {name}; known are {', '.join(PARTS)}", file=sys.stderr)
            return 2
    for name in options.only:
        part, title = PARTS[name]
        print(f"## {title}\n\n{part(options)}\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
