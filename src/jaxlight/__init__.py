"""Differentiable VRML97 / X3D lighting for material and light fitting.

This file is the public door. Each name is imported from its stage when it is first used, so that `import jaxlight`
(and with it `jaxlight --help`) is quick and touches no device, no configuration and no array.
"""

from __future__ import annotations

import importlib
import sys
import types
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .fit import Fit as Fit
    from .fit import Free as Free
    from .fit import View as View
    from .fit import check_gradients as check_gradients
    from .fit import fit as fit
    from .fit import fitted_values as fitted_values
    from .fit import write_report as write_report
    from .formats import SceneFileError as SceneFileError
    from .formats import SceneFileWarning as SceneFileWarning
    from .formats import load as load
    from .formats import read_image as read_image
    from .formats import save as save
    from .formats import write_image as write_image
    from .image import compare as compare
    from .image import decode as decode
    from .image import encode as encode
    from .image import render as render
    from .lighting import LightingOptions as LightingOptions
    from .lighting import compiler_options as compiler_options
    from .lighting import shade as shade
    from .lighting import sum_over_samples as sum_over_samples
    from .raster import Camera as Camera
    from .raster import Orthographic as Orthographic
    from .raster import SampleBuffer as SampleBuffer
    from .raster import rasterize as rasterize
    from .raster import samples_from_maps as samples_from_maps
    from .scene import DirectionalLights as DirectionalLights
    from .scene import Fog as Fog
    from .scene import Materials as Materials
    from .scene import PointLights as PointLights
    from .scene import Scene as Scene
    from .scene import SpotLights as SpotLights
    from .scene import Surface as Surface
    from .scene import Texture as Texture
    from .scene import nodes as nodes

_STAGES = {
    "scene": [
        "DirectionalLights",
        "Fog",
        "Materials",
        "PointLights",
        "Scene",
        "SpotLights",
        "Surface",
        "Texture",
        "nodes",
    ],
    "formats": ["SceneFileError", "SceneFileWarning", "load", "read_image", "save", "write_image"],
    "raster": ["Camera", "Orthographic", "SampleBuffer", "rasterize", "samples_from_maps"],
    "lighting": ["LightingOptions", "compiler_options", "shade", "sum_over_samples"],
    "image": ["compare", "decode", "encode", "render"],
    "fit": ["Fit", "Free", "View", "check_gradients", "fit", "fitted_values", "write_report"],
}
_STAGE_OF = {name: stage for stage, names in _STAGES.items() for name in names}

__all__ = list(_STAGE_OF)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version(__name__)
    if name not in _STAGE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_STAGE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    own = {name for name in globals() if name.startswith("__") and name.endswith("__")}
    return sorted({*own, *_STAGE_OF, "__version__"})


class _Door(types.ModuleType):
    """Keeps `jaxlight.fit` the function: importing the folder of the same name would put the module in its place."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _STAGE_OF and isinstance(value, types.ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Door
