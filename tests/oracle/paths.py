"""Addresses of the numbers in a case: ("lights", 1, "location", 2) is `case.lights[1].location[2]`."""

from __future__ import annotations

import dataclasses
from typing import Any

from .case import Case, Frame, Light, Options

Path = tuple[str | int, ...]

MATERIAL_FIELDS = (
    "ambient_intensity",
    "diffuse_color",
    "emissive_color",
    "shininess",
    "specular_color",
    "transparency",
)
_EVERY_LIGHT = ("ambient_intensity", "color", "intensity")
LIGHT_FIELDS = {
    "directional": (*_EVERY_LIGHT, "direction"),
    "point": (*_EVERY_LIGHT, "attenuation", "location", "radius"),
    "spot": (*_EVERY_LIGHT, "attenuation", "location", "radius", "beam_width", "cut_off_angle", "direction"),
}
FOG_FIELDS = ("color", "visibility_range")
SAMPLE_FIELDS = ("position", "normal", "eye", "color", "texel")


def is_live(light: Light, options: Options) -> bool:
    """False for a light whose numbers are never read: off, out of scope, or above the support level."""
    if light.kind == "directional":
        return light.on and (light.in_scope or options.support_level < 3)
    return light.on and light.in_scope and options.support_level > 1


def float_paths(case: Case) -> list[Path]:
    """The paths of all numbers that the case's result may depend on, frames included, dead lights left out."""
    paths = _leaves(("sample",), case.sample, SAMPLE_FIELDS)
    if case.material is not None:
        paths += _leaves(("material",), case.material, MATERIAL_FIELDS)
    for i, light in enumerate(case.lights):
        if is_live(light, case.options):
            paths += _leaves(("lights", i), light, (*LIGHT_FIELDS[light.kind], "frame"))
    if case.fog is not None:
        paths += _leaves(("fog",), case.fog, (*FOG_FIELDS, "frame"))
    return paths


def get(case: Any, path: Path) -> float:
    """The number at `path`."""
    for step in path:
        case = getattr(case, step) if isinstance(step, str) else case[step]
    return case


def put(case: Any, path: Path, value: Any) -> Any:
    """The case with another number (or vector, or None) at `path`."""
    if not path:
        return value
    step, rest = path[0], path[1:]
    if isinstance(step, str):
        return dataclasses.replace(case, **{step: put(getattr(case, step), rest, value)})
    return (*case[:step], put(case[step], rest, value), *case[step + 1 :])


def show(path: Path) -> str:
    """`lights[1].location[2]`."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)[1:]


def _leaves(prefix: Path, owner: Any, names: tuple[str, ...]) -> list[Path]:
    return [path for name in names for path in _below((*prefix, name), getattr(owner, name))]


def _below(prefix: Path, value: float | tuple | Frame | None) -> list[Path]:
    if value is None:
        return []
    if isinstance(value, tuple):
        return [path for i, part in enumerate(value) for path in _below((*prefix, i), part)]
    return [prefix]
