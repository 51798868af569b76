"""The lighting equation and its derivatives in plain NumPy: what contenders are checked by.

Double or extended precision, written from X3D 17.2.2.4 with the half vector as it stands there, one light at a time;
imports nothing of the package.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .workload import Arrays, Fields, Workload

_CHUNK = 65536
"""Samples times lights that are worked on at once."""
_NEIGHBOURS = 1024
"""Samples at once where most lights reach none of them."""


class Answer(NamedTuple):
    """What a contender should have computed."""

    colors: np.ndarray
    """[3, N]."""
    at_jump: np.ndarray
    """[N]: samples so close to a light's radius that rounding decides on which side they are; not compared."""
    value: float
    """Sum of squared residuals."""
    gradient: dict[str, np.ndarray]
    """Its derivative, by the names of `Arrays.parameters`; empty where only every `stride`-th sample was computed."""
    stride: int = 1

    def save(self, path: Path) -> None:
        """Writes a file for `load`."""
        np.savez(
            path,
            colors=self.colors,
            at_jump=self.at_jump,
            value=np.array(self.value),
            stride=np.array(self.stride),
            **{f"gradient/{name}": g for name, g in self.gradient.items()},
        )

    @classmethod
    def load(cls, path: str) -> Answer:
        """Reads what `save` wrote."""
        with np.load(path) as file:
            gradient = {name.removeprefix("gradient/"): file[name] for name in file.files if "/" in name}
            return cls(file["colors"], file["at_jump"], float(file["value"]), gradient, int(file["stride"]))


def answer(
    work: Workload, arrays: Arrays, *, dtype: Any = np.float64, gradient: bool = True, stride: int = 1
) -> Answer:
    """Colours, sum of squared residuals and gradient of a workload.

    Args:
        work: the workload.
        arrays: its arrays; taken as exact numbers.
        dtype: np.float64, or np.longdouble to judge float64.
        gradient: False leaves the derivatives out (an empty dictionary).
        stride: only every so many samples; more than 1 leaves the derivatives out.
    """
    gradient = gradient and stride == 1
    planes = {name: getattr(arrays, name) for name in ("position", "normal", "target", "sample_color")}
    arrays = arrays._replace(**{k: v if v is None else v[:, ::stride] for k, v in planes.items()})
    material = {k: v.astype(dtype) for k, v in arrays.material.items()}
    lights = {k: v.astype(dtype) for k, v in arrays.lights.items()}
    total = {name: np.zeros(np.shape(v), dtype) for name, v in arrays.parameters.items()} if gradient else {}
    colors = np.empty(arrays.position.shape, dtype)
    at_jump = np.zeros(arrays.position.shape[1], bool)
    step = max(_CHUNK // work.lights, 64) if not work.cover else _NEIGHBOURS
    for start in range(0, arrays.position.shape[1], step):
        rows = slice(start, start + step)
        chunk = _Chunk(arrays, rows, material, work, dtype)
        reaching = np.flatnonzero(arrays.on & _may_reach(lights, chunk.position)).tolist()
        terms = {i: _term(chunk, {k: v[i] for k, v in lights.items()}) for i in reaching}
        colors[:, rows] = chunk.fogged(sum((chunk.light_color(term) for term in terms.values()), chunk.emissive))
        for term in terms.values():
            at_jump[rows] |= term.at_jump
        if gradient:
            residual = colors[:, rows] - arrays.target[:, rows]
            _add_gradient(total, chunk, terms, 2 * chunk.visible * residual)
    value = float(np.sum((colors - arrays.target) ** 2))
    return Answer(colors, at_jump, value, {name: np.asarray(total[name], np.float64) for name in total}, stride)


def _may_reach(lights: Fields, position: np.ndarray) -> np.ndarray:
    """[L]: False for lights whose radius ends before the box around these samples: all their terms are exactly 0."""
    if "radius" not in lights:
        return np.ones(len(lights["intensity"]), bool)
    low, high = position.min(axis=1), position.max(axis=1)
    place = lights["location"]
    gap = np.maximum(np.maximum(low - place, place - high), 0)
    return np.sqrt(np.sum(gap**2, axis=1)) <= lights["radius"] * (1 + 1e-4)


class _Chunk:
    """Some samples, with what all lights share."""

    def __init__(self, arrays: Arrays, rows: slice, material: Fields, work: Workload, dtype: Any) -> None:
        self.material, self.work = material, work
        self.position = arrays.position[:, rows].astype(dtype)
        self.normal = _unit(arrays.normal[:, rows].astype(dtype))
        diffuse = material["diffuse_color"][:, None]
        self.diffuse = diffuse if arrays.sample_color is None else arrays.sample_color[:, rows].astype(dtype)
        self.emissive = material["emissive_color"][:, None]
        self.specular = material["specular_color"][:, None]
        self.fog_color = arrays.fog_color.astype(dtype)[:, None]
        to_eye = arrays.eye.astype(dtype)[:, None] - self.position
        distance = np.sqrt(np.sum(to_eye**2, axis=0))
        self.view = to_eye / distance
        self.visible = _fog_factor(work.fog, distance, dtype(arrays.fog_visibility))

    def fogged(self, color: np.ndarray) -> np.ndarray:
        return self.fog_color * (1 - self.visible) + self.visible * color

    def light_color(self, term: _Term) -> np.ndarray:
        """What one light adds: its colour x (diffuse weight x diffuse colour + specular weight x specular colour)."""
        return term.light["color"][:, None] * (term.diffuse * self.diffuse + term.specular * self.specular)


def _fog_factor(fog: str, distance: np.ndarray, visibility: Any) -> np.ndarray:
    """f0 of table 17.5."""
    if fog == "NONE":
        return np.ones_like(distance)
    inside = distance < visibility
    left = np.where(inside, visibility - distance, 1)
    return np.where(inside, left / visibility if fog == "LINEAR" else np.exp(-distance / left), 0)


class _Term(NamedTuple):
    """One light on a chunk; the letters are the equation's."""

    light: Fields
    l: np.ndarray
    distance: np.ndarray
    reach: np.ndarray
    """1 within the radius, else 0."""
    attenuation: np.ndarray
    spot: np.ndarray
    angle: np.ndarray
    n_l: np.ndarray
    n_h: np.ndarray
    half: np.ndarray
    """|L + V|."""
    peak: np.ndarray
    """(N.H)^(128 shininess)."""
    diffuse: np.ndarray
    specular: np.ndarray
    at_jump: np.ndarray


def _term(chunk: _Chunk, light: Fields) -> _Term:
    ones = np.ones_like(chunk.visible)
    distance, reach, attenuation, spot, angle, at_jump = ones, ones, ones, ones, 0 * ones, np.zeros(ones.shape, bool)
    if chunk.work.kind == "directional":
        l = -_unit(light["direction"][:, None]) * ones
    else:
        to_light = light["location"][:, None] - chunk.position
        distance = np.sqrt(np.sum(to_light**2, axis=0))
        l = to_light / distance
        reach = np.where(distance <= light["radius"], ones, 0)
        at_jump = np.abs(distance / light["radius"] - 1) < 1e-6
        c1, c2, c3 = light["attenuation"]
        attenuation = 1 / np.maximum(c1 + c2 * distance + c3 * distance**2, 1)
    if chunk.work.kind == "spot":
        angle = np.arccos(np.clip(-np.sum(l * _unit(light["direction"][:, None]), axis=0), -1, 1))
        width = light["cut_off_angle"] - light["beam_width"]
        spot = np.clip((light["cut_off_angle"] - angle) / width, 0, 1)
    n_l = np.sum(chunk.normal * l, axis=0)
    half_vector = l + chunk.view
    half = np.sqrt(np.sum(half_vector**2, axis=0))
    n_h = np.maximum(np.sum(chunk.normal * half_vector, axis=0) / half, 0)
    peak = n_h ** (128 * chunk.material["shininess"])
    weight = reach * attenuation * spot
    ambient = light["ambient_intensity"] * chunk.material["ambient_intensity"]
    diffuse = weight * (ambient + light["intensity"] * np.maximum(n_l, 0))
    specular = weight * light["intensity"] * peak
    return _Term(light, l, distance, reach, attenuation, spot, angle, n_l, n_h, half, peak, diffuse, specular, at_jump)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.sqrt(np.sum(vectors**2, axis=0))


def _add_gradient(total: Fields, chunk: _Chunk, terms: dict[int, _Term], bar: np.ndarray) -> None:
    """Adds the derivatives of `sum(bar * colour before fog)` to `total`, by the chain rule from the colour back."""
    total["material.emissive_color"] += bar.sum(axis=1)
    if "material.diffuse_color" in total:
        total["material.diffuse_color"] += sum(
            (bar * t.light["color"][:, None] * t.diffuse).sum(axis=1) for t in terms.values()
        )
    total["material.specular_color"] += sum(
        (bar * t.light["color"][:, None] * t.specular).sum(axis=1) for t in terms.values()
    )
    for row, term in terms.items():
        _add_light_gradient(total, row, chunk, term, bar)


def _add_light_gradient(total: Fields, row: int, chunk: _Chunk, term: _Term, bar: np.ndarray) -> None:
    light, material = term.light, chunk.material
    weight = term.reach * term.attenuation * term.spot
    lit = np.maximum(term.n_l, 0)
    total["lights.color"][row] += (bar * (term.diffuse * chunk.diffuse + term.specular * chunk.specular)).sum(axis=1)
    d_diffuse = (bar * light["color"][:, None] * chunk.diffuse).sum(axis=0)
    d_specular = (bar * light["color"][:, None] * chunk.specular).sum(axis=0)
    total["lights.intensity"][row] += np.sum(weight * (d_diffuse * lit + d_specular * term.peak))
    total["lights.ambient_intensity"][row] += np.sum(d_diffuse * weight) * material["ambient_intensity"]
    total["material.ambient_intensity"] += np.sum(d_diffuse * weight) * light["ambient_intensity"]

    exponent = 128 * material["shininess"]
    d_peak = d_specular * weight * light["intensity"]
    inside = term.n_h > 0
    safe = np.where(inside, term.n_h, 1)
    total["material.shininess"] += 128 * np.sum(np.where(inside, d_peak * term.peak * np.log(safe), 0))
    d_n_h = np.where(inside, d_peak * exponent * term.peak / safe, 0)

    # L: through N.L, and through H = (L + V) / |L + V|.
    d_n_l = d_diffuse * weight * light["intensity"] * (term.n_l > 0)
    h = (term.l + chunk.view) / term.half
    d_l = d_n_l * chunk.normal + d_n_h * (chunk.normal - term.n_h * h) / term.half
    d_weight = (
        d_diffuse * (light["ambient_intensity"] * material["ambient_intensity"] + light["intensity"] * lit)
        + d_specular * light["intensity"] * term.peak
    )
    if chunk.work.kind == "directional":
        total["lights.direction"][row] += -_through_unit(light["direction"], d_l.sum(axis=1))
        return
    if chunk.work.kind == "spot":
        d_l += _add_spot_gradient(total, row, term, d_weight * term.reach * term.attenuation)
    over = term.attenuation < 1
    d_sum = np.where(over, -d_weight * term.reach * term.spot * term.attenuation**2, 0)
    total["lights.attenuation"][row] += [np.sum(d_sum * term.distance**power) for power in range(3)]
    d_distance = d_sum * (light["attenuation"][1] + 2 * light["attenuation"][2] * term.distance)
    d_to_light = (d_l - term.l * np.sum(term.l * d_l, axis=0)) / term.distance + d_distance * term.l
    total["lights.location"][row] += d_to_light.sum(axis=1)


def _add_spot_gradient(total: Fields, row: int, term: _Term, d_spot: np.ndarray) -> np.ndarray:
    """Adds the derivatives of the spot ramp; returns the derivative [3, samples] with respect to L."""
    light = term.light
    width = light["cut_off_angle"] - light["beam_width"]
    on_ramp = np.where((term.spot > 0) & (term.spot < 1), d_spot / width, 0)
    total["lights.beam_width"][row] += np.sum(on_ramp * term.spot)
    total["lights.cut_off_angle"][row] += np.sum(on_ramp * (1 - term.spot))
    d_cosine = on_ramp / np.where(on_ramp != 0, np.sin(term.angle), 1)
    axis = _unit(light["direction"])
    total["lights.direction"][row] += _through_unit(light["direction"], -(d_cosine * term.l).sum(axis=1))
    return -d_cosine * axis[:, None]


def _through_unit(vector: np.ndarray, bar: np.ndarray) -> np.ndarray:
    """The derivative with respect to a vector, from the one with respect to the unit vector along it."""
    unit = _unit(vector)
    return (bar - unit * np.sum(unit * bar)) / np.sqrt(np.sum(vector**2))
