"""jaxlight's fit: all its steps, one evaluation of the normal equations, and loss and gradient tile by tile."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlight.fit import View
from jaxlight.fit.fitting import run_fit
from jaxlight.fit.normal import loss_and_gradient, normal_equations
from jaxlight.fit.problem import make_problem
from jaxlight.fit.run import make_solver
from jaxlight.lighting import compiler_options

from ..fit_problem import FREE, fit_arrays, fit_start, with_values
from ..workload import Arrays, Workload
from .base import Contender, FitResult, Operation, Run, ValueAndGradient
from .jaxlight_shade import samples_of, scene_of

_NODES = {"material": "Material", "lights": "PointLight"}


def path_of(name: str, row: int) -> str:
    """`lights.location` -> `PointLight[row].location`."""
    group, field = name.split(".")
    return f"{_NODES[group]}[{row}].{field}"


class JaxlightFit(Contender):
    """All steps of a `fit` of the common fields, its log of them included; J^T J and J^T r; or loss and gradient of all
    fields. The problem is brought into arrays beforehand, as it is for the others.

    Args:
        work, arrays: the workload.
        precision: float type of scene and samples.
        free_lights: for the normal equations: all fields of the material and of so many lights are free; -1: only
            the material's shininess.
        views: for the normal equations: so many views of these samples.
        exposures: for the normal equations: the exposures of all views but the first are free too.
        materials: so many, all alike and all free, a band of the samples each.
    """

    def __init__(
        self,
        work: Workload,
        arrays: Arrays,
        precision: str = "float32",
        free_lights: int = 1,
        views: int = 1,
        exposures: bool = False,
        materials: int = 1,
    ) -> None:
        self._work, self._arrays, self._dtype = work, arrays, jnp.dtype(precision)
        self._free_lights, self.views, self._exposures, self._materials = free_lights, views, exposures, materials

    def prepare(self, operation: Operation) -> Run:
        if operation == "fit":
            return self._prepare_fit()
        if operation == "value_and_gradient":
            self._free_lights = self._work.lights
            return self._prepare(loss_and_gradient)
        return self._prepare(normal_equations)

    def _prepare_fit(self) -> Run:
        arrays = fit_arrays(self._work)
        scene = scene_of(self._work, with_values(arrays, fit_start(arrays)), self._dtype)
        view = View(samples_of(arrays, self._dtype), arrays.target.T)
        problem, description = make_problem(scene, view, [path_of(name, 0) for name in FREE])
        solver = make_solver(problem)
        return lambda: run_fit(problem, description, solver)

    def fitted(self, result: Any) -> FitResult:
        values = {name: np.asarray(result.value(path_of(name, 0))) for name in FREE}
        return FitResult(values, len(result.history))

    def _names(self) -> list[tuple[str, int]]:
        """Free fields and rows."""
        if self._free_lights < 0:
            return [("material.shininess", 0)]
        names = list(self._arrays.parameters)
        fields = [name for name in names if name.startswith("material.")]
        lights = [name for name in names if name.startswith("lights.")]
        materials = [(name, row) for row in range(self._materials) for name in fields]
        return materials + [(name, row) for row in range(self._free_lights) for name in lights]

    def _prepare(self, function: Any) -> Run:
        scene = scene_of(self._work, self._arrays, self._dtype, self._materials)
        samples = samples_of(self._arrays, self._dtype, materials=self._materials)
        views = [View(samples, self._arrays.target.T) for _ in range(self.views)]
        free = [path_of(name, row) for name, row in self._names()]
        if self._exposures:
            free += [f"View[{view}].exposure" for view in range(1, self.views)]
        problem, self._description = make_problem(scene, views, free)
        values = problem.parameters.start
        compiled = jax.jit(function, compiler_options=compiler_options()).lower(problem, values).compile()
        return lambda: jax.block_until_ready(compiled(problem, values))

    def value_and_gradient(self, result: Any) -> ValueAndGradient:
        """The loss is half the sum of squares, over all views."""
        factor = 2 / self.views
        loss, slope = result[:2]
        flat = np.asarray(slope) * factor
        by_path = {field.path: flat[field.numbers] for field in self._description.fields}
        gradient: dict[str, list[np.ndarray]] = {}
        for name, row in self._names():
            gradient.setdefault(name, []).append(by_path[path_of(name, row)])
        shapes = self._arrays.parameters
        fields = {
            name: np.stack(rows).reshape(len(rows), *shapes[name].shape[1:])
            if name.startswith("lights.")
            else np.sum(rows, axis=0).reshape(shapes[name].shape)
            for name, rows in gradient.items()
        }
        return ValueAndGradient(float(loss) * factor, fields)
