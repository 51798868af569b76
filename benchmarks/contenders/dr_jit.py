"""Dr.Jit on the LLVM backend: planes x, y, z, lights unrolled while tracing, reverse mode for the gradient."""

from __future__ import annotations

import glob
import os
import re
from typing import Any

import numpy as np


def _newest_llvm() -> str | None:
    """The newest LLVM library installed; Dr.Jit may pick one that is too old to know the processor."""
    found = glob.glob("/usr/lib/*/libLLVM*.so*") + glob.glob("/usr/lib/llvm-*/lib/libLLVM*.so*")
    version = {path: [int(n) for n in re.findall(r"\d+", os.path.basename(path))] for path in found}
    return max(version, key=lambda path: version[path], default=None)


if (_llvm := _newest_llvm()) is not None:
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", _llvm)

import drjit as dr  # noqa: E402
from drjit.llvm.ad import Array3f, Float, UInt32  # noqa: E402

from ..workload import Arrays, Workload  # noqa: E402
from .base import Contender, Operation, Run, ValueAndGradient, split  # noqa: E402


def shade(parameters: Any, scene: Any) -> Array3f:
    """The samples' colours; `parameters` holds Float and Array3f of width 1, lists of them for the lights."""
    material, lights = split(parameters)
    texels = scene["sample_color"] if "sample_color" in scene else material["diffuse_color"]
    normal, position = scene["normal"], scene["position"]
    to_eye = scene["eye"] - position
    eye_distance = dr.norm(to_eye)
    view = to_eye / eye_distance
    exponent = 128 * material["shininess"]
    diffuse, specular = Array3f(0), Array3f(0)
    for k in range(len(lights["location"])):
        to_light = lights["location"][k] - position
        squared = dr.squared_norm(to_light)
        inverse = dr.rsqrt(squared)
        distance = squared * inverse
        l = to_light * inverse
        half = l + view
        n_l = dr.maximum(dr.dot(normal, l), 0)
        n_h = dr.maximum(dr.dot(normal, half) * dr.rsqrt(dr.squared_norm(half)), 1e-30)
        peak = dr.exp2(exponent * dr.log2(n_h))
        attenuation = lights["attenuation"][k]
        falloff = dr.maximum(attenuation.x + attenuation.y * distance + attenuation.z * squared, 1)
        weight = dr.select(distance <= scene["radius"][k], dr.rcp(falloff), 0)
        ambient = lights["ambient_intensity"][k] * material["ambient_intensity"]
        intensity = lights["intensity"][k]
        diffuse += lights["color"][k] * (weight * (ambient + intensity * n_l))
        specular += lights["color"][k] * (weight * intensity * peak)
    visible = dr.exp(-eye_distance / (scene["fog_visibility"] - eye_distance))
    color = material["emissive_color"] + diffuse * texels + specular * material["specular_color"]
    return dr.fma(visible, color - scene["fog_color"], scene["fog_color"])


def _value(array: np.ndarray) -> Any:
    """A scalar field or a colour, opaque: a changed number is an input of the kernel, not a new kernel."""
    value = Float(array.reshape(1)) if array.ndim == 0 else Array3f(array[:, None])
    dr.make_opaque(value)
    return value


def _leaves(parameters: Any) -> list[Any]:
    return [leaf for value in parameters.values() for leaf in (value if isinstance(value, list) else [value])]


class DrJit(Contender):
    """The function above; it compiles in the first call and finds its kernel in a cache after that, but traces anew."""

    def __init__(self, work: Workload, arrays: Arrays) -> None:
        dr.set_thread_count(len(os.sched_getaffinity(0)))
        dr.set_flag(dr.JitFlag.KernelHistory, False)
        self._parameters = {
            name: [_value(row) for row in value] if name.startswith("lights.") else _value(value)
            for name, value in arrays.parameters.items()
        }
        self._scene: dict[str, Any] = {
            "position": Array3f(arrays.position),
            "normal": Array3f(arrays.normal),
            "target": Array3f(arrays.target),
            "eye": _value(arrays.eye),
            "fog_color": _value(arrays.fog_color),
            "fog_visibility": _value(np.array(arrays.fog_visibility, np.float32)),
            "radius": [_value(row) for row in arrays.lights["radius"]],
        }
        if arrays.sample_color is not None:
            self._scene["sample_color"] = Array3f(arrays.sample_color)
        dr.eval(self._scene)
        dr.sync_thread()

    def prepare(self, operation: Operation) -> Run:
        return self._forward if operation == "forward" else self._gradient

    def seen(self, parameters: Any) -> Any:
        """The parameters as the gradient's equation reads them."""
        return parameters

    def release(self) -> None:
        dr.flush_malloc_cache()

    def _forward(self) -> Array3f:
        color = shade(self._parameters, self._scene)
        dr.eval(color)
        dr.sync_thread()
        return color

    def _gradient(self) -> Any:
        leaves = _leaves(self._parameters)
        dr.enable_grad(leaves)
        residual = shade(self.seen(self._parameters), self._scene) - self._scene["target"]
        value = dr.sum(dr.squared_norm(residual))
        dr.backward(value)
        gradient = {
            name: [dr.grad(row) for row in leaf] if isinstance(leaf, list) else dr.grad(leaf)
            for name, leaf in self._parameters.items()
        }
        dr.eval(value, gradient)
        dr.sync_thread()
        dr.disable_grad(leaves)
        return value, gradient

    def colors(self, result: Any) -> np.ndarray:
        return np.array(result)

    def value_and_gradient(self, result: Any) -> ValueAndGradient:
        def numpy(value: Any) -> np.ndarray:
            if isinstance(value, list):
                return np.stack([numpy(row) for row in value])
            return np.array(value).reshape(-1) if isinstance(value, Array3f) else np.array(value)[0]

        return ValueAndGradient(float(result[0][0]), {name: numpy(leaf) for name, leaf in result[1].items()})


class DrJitGathered(DrJit):
    """Parameters read by `gather`: its adjoint adds up inside the kernel instead of storing a wide array for each."""

    def seen(self, parameters: Any) -> Any:
        first = dr.zeros(UInt32, dr.width(self._scene["position"]))

        def gather(value: Any) -> Any:
            if isinstance(value, list):
                return [gather(row) for row in value]
            if isinstance(value, Array3f):
                return Array3f(*(gather(component) for component in value))
            return dr.gather(Float, value, first)

        return {name: gather(value) for name, value in parameters.items()}
