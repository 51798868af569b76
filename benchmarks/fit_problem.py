"""The common fit: from a picture of a sphere under one point light, its material and where the light stands."""

from __future__ import annotations

import numpy as np

from .reference import answer
from .workload import Arrays, Fields, Workload, make_arrays

FREE = ("material.diffuse_color", "material.specular_color", "material.shininess", "lights.location")
"""Ten numbers. The light's intensity is fixed: only its product with the colours is seen."""
WORK = Workload(samples=256 * 256, lights=1, sample_color=False, radius=100.0, fog="NONE", shape="sphere")


def fit_arrays(work: Workload) -> Arrays:
    """The workload's arrays with its own picture, in double precision, as the target."""
    arrays = make_arrays(work)
    return arrays._replace(target=answer(work, arrays, gradient=False).colors)


def fit_start(arrays: Arrays) -> dict[str, np.ndarray]:
    """Where every solver starts, by the names of `Arrays.parameters`."""
    return {
        "material.diffuse_color": np.full(3, 0.5, np.float32),
        "material.specular_color": np.full(3, 0.3, np.float32),
        "material.shininess": np.array(0.1, np.float32),
        "lights.location": arrays.lights["location"] + np.array([-1.0, 1.0, 1.0], np.float32),
    }


def with_values(arrays: Arrays, values: dict[str, np.ndarray]) -> Arrays:
    """The arrays with some fields replaced, by the names of `Arrays.parameters`."""
    groups: dict[str, Fields] = {"material": dict(arrays.material), "lights": dict(arrays.lights)}
    for name, value in values.items():
        group, field = name.split(".")
        groups[group][field] = value
    return arrays._replace(**groups)
