"""jaxlight's answers for oracle cases, many at a time, in the oracle's terms: colours, and derivatives by path.

Cases of one structure are stacked and mapped with `jax.vmap`, in chunks of one size, so that few programs are compiled.
Nothing is skipped but what the structure itself decides, and every float is free.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import numpy as np

from cases_to_scenes import options_of, scene_and_sample, scenes_and_samples, structure
from jaxlight.lighting import Plan, make_plan, shade_planes
from jaxlight.raster import SampleBuffer
from jaxlight.scene import Scene
from oracle.case import Case
from oracle.paths import Path, float_paths

CHUNK = 256
Mode = Literal["reverse", "forward", "second"]
"""`second`: forward over reverse, along `direction`."""
DIFFERENTIATED = ("position_planes", "normal_planes", "eye", "color_planes")


class Group(NamedTuple):
    """Cases of one structure: their places in the list that was given, and how jaxlight sees them."""

    index: np.ndarray
    cases: list[Case]
    plan: Plan
    paths: list[Path]


def values(cases: Sequence[Case], dtype: Any, chunk: int = CHUNK) -> np.ndarray:
    """Colour and alpha of every case, float64 [N, 4]."""
    out = np.zeros((len(cases), 4))
    for group in groups(cases, chunk):
        out[group.index] = np.asarray(stacked_values(*inputs(group, dtype, chunk), group.plan))[: len(group.cases)]
    return out


def derivatives(cases: Sequence[Case], dtype: Any, mode: Mode = "reverse", chunk: int = CHUNK) -> list[np.ndarray]:
    """Of every case the derivatives of colour and alpha by its P inputs, float64 [P, 4], as `oracle.float_paths`."""
    return derivatives_with_rounding(cases, dtype, mode, chunk)[0]


def derivatives_with_rounding(
    cases: Sequence[Case], dtype: Any, mode: Mode = "reverse", chunk: int = CHUNK
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """`derivatives`, and by how much those by or in frames may be off because of how they are had, [P, 4] too.

    jaxlight holds a frame and its inverse M. Reverse mode gives the derivatives F and G by both; that by the frame is
    had here, F - M^T G M^T; in forward mode the inverse moves with the frame. That by a location is the frame times
    that by its place in the world. Terms cancel in both; each number of F and G is allowed one ulp, in either mode, and
    the rounding of M. In reverse mode one ulp of F and G is at least the smallest normal number, as everywhere: in a
    frame that measures in units of 1e-12 those by M = 1e12 are flushed to zero.
    """
    out: list[np.ndarray] = [np.zeros((0, 4))] * len(cases)
    rounding = out.copy()
    for group in groups(cases, chunk):
        scene, samples = inputs(group, dtype, chunk)
        found = stacked(mode, scene, samples, group.plan)
        derivative = by_path(found, group, scene, mode)
        by_both = stacked("reverse", scene, samples, group.plan) if mode == "forward" else found
        format_ = np.finfo(dtype)
        least = 0.0 if mode == "forward" else float(format_.tiny / format_.eps)
        allowed = format_.eps * by_path(by_both, group, scene, "reverse", sizes=least)
        for row, i in enumerate(group.index):
            out[i], rounding[i] = derivative[row], allowed[row]
    return out, rounding


def groups(cases: Sequence[Case], chunk: int = CHUNK) -> Iterator[Group]:
    """The cases by structure, at most `chunk` at a time."""
    found: dict[tuple, list[int]] = {}
    for i, case in enumerate(cases):
        found.setdefault(structure(case), []).append(i)
    for places in found.values():
        plan, paths = plan_of(cases[places[0]]), float_paths(cases[places[0]])
        for start in range(0, len(places), chunk):
            index = np.array(places[start : start + chunk])
            yield Group(index, [cases[i] for i in index], plan, paths)


def plan_of(case: Case) -> Plan:
    """The plan that holds for every case of the structure."""
    scene, samples = scene_and_sample(case, np.float32)
    return make_plan(scene, samples, options_of(case), free=True)


def inputs(group: Group, dtype: Any, chunk: int = CHUNK) -> tuple[Scene, SampleBuffer]:
    """The group as stacked scenes and samples; the last case is repeated until the chunk is full."""
    missing = chunk - len(group.cases)

    def filled(leaf: jax.Array) -> np.ndarray:
        return np.pad(np.asarray(leaf), [(0, missing), *[(0, 0)] * (leaf.ndim - 1)], mode="edge")

    return jax.tree.map(filled, scenes_and_samples(group.cases, dtype))


def color_of_one(scene: Scene, samples: SampleBuffer, plan: Plan) -> jax.Array:
    """Colour and alpha [4] of one case."""
    return shade_planes(scene, samples, plan=plan)[:, 0]


@partial(jax.jit, static_argnames="plan")
def stacked_values(scene: Scene, samples: SampleBuffer, plan: Plan) -> jax.Array:
    """[cases, 4]"""
    return mapped(lambda a, b: color_of_one(a, b, plan), scene, samples)


@partial(jax.jit, static_argnames=("mode", "plan"))
def stacked(mode: Mode, scene: Scene, samples: SampleBuffer, plan: Plan) -> tuple[Scene, SampleBuffer]:
    """Derivatives by scene and samples, every leaf [cases, 4, ...]."""
    transform = {"reverse": jax.jacrev, "forward": jax.jacfwd, "second": jax.jacrev}[mode]

    def of_one(scene: Scene, samples: SampleBuffer) -> Any:
        def derivative(point: tuple[Scene, SampleBuffer]) -> Any:
            return transform(color_of_inputs)(point, samples, plan)

        point = (scene, taken(samples))
        return jax.jvp(derivative, (point,), (steps(point),))[1] if mode == "second" else derivative(point)

    def color_of_inputs(point: tuple[Scene, SampleBuffer], samples: SampleBuffer, plan: Plan) -> jax.Array:
        own = with_inverses(point[0]) if mode == "forward" else point[0]
        own_samples = {name: getattr(point[1], name) for name in DIFFERENTIATED}
        return color_of_one(own, dataclasses.replace(samples, **own_samples), plan)

    return mapped(of_one, scene, samples)


def direction(path: Path) -> float:
    """Step over value of an input in second derivatives: every node field has its own."""
    fields = [step for step in path if isinstance(step, str)]
    return STEPS[fields[-1]]


STEPS = {
    **{"ambient_intensity": 0.5, "attenuation": -0.75, "beam_width": 0.375, "color": 0.625, "cut_off_angle": 0.5},
    **{"diffuse_color": 0.5, "direction": 0.875, "emissive_color": 1.0, "eye": -0.375, "frame": 0.25},
    **{"intensity": -0.5, "location": 0.75, "normal": 0.625, "position": -0.25, "radius": 0.0, "shininess": 0.375},
    **{"specular_color": -0.625, "texel": 0.75, "transparency": 0.5, "visibility_range": 0.25},
}


def steps(point: tuple[Scene, SampleBuffer]) -> tuple[Scene, SampleBuffer]:
    """Every input times its `direction`; the inverse of a frame moves the other way."""
    names = {"to_world": 0.25, "to_local": -0.25, "position_planes": STEPS["position"], "image": STEPS["texel"]}
    names |= {"normal_planes": STEPS["normal"], "color_planes": STEPS["color"]}

    def step(path: tuple, leaf: jax.Array) -> jax.Array:
        name = path[-1].name
        return leaf * (names[name] if name in names else STEPS[name])

    return jax.tree_util.tree_map_with_path(step, point)


def with_inverses(scene: Scene) -> Scene:
    """The scene with inverses of frames that move with them; of the fog's, only the inverse is there to be moved."""

    def of_lights(lights: Any) -> Any:
        if not hasattr(lights, "to_local"):
            return lights
        return dataclasses.replace(lights, to_local=_moving_inverse(lights.to_world[..., :3], lights.to_local))

    fog = scene.fog
    if fog is not None:
        fog = dataclasses.replace(fog, to_local=_moving_inverse(fog.to_local, fog.to_local))
    kinds = {kind: of_lights(getattr(scene, kind)) for kind in ("point", "spot")}
    return dataclasses.replace(scene, fog=fog, **kinds)


@jax.custom_jvp
def _moving_inverse(frame: jax.Array, inverse: jax.Array) -> jax.Array:
    return inverse


@_moving_inverse.defjvp
def _moving_inverse_jvp(primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
    return primals[1], -primals[1] @ tangents[0] @ primals[1]


def taken(samples: SampleBuffer) -> SampleBuffer:
    """What of a buffer is differentiated, all else None."""
    return dataclasses.replace(
        jax.tree.map(lambda _: None, samples), **{name: getattr(samples, name) for name in DIFFERENTIATED}
    )


def mapped(function: Callable[[Scene, SampleBuffer], Any], scene: Scene, samples: SampleBuffer) -> Any:
    """`function` of every case; integers are the same for all, so that the program's branches stay branches."""
    index, surface = samples.texel_index, samples.tile_surface
    samples = dataclasses.replace(samples, texel_index=None, tile_surface=None)

    def of_one(scene: Scene, samples: SampleBuffer, index: Any, surface: Any) -> Any:
        return function(scene, dataclasses.replace(samples, texel_index=index, tile_surface=surface))

    first = None if index is None else index[0]
    return jax.vmap(of_one, in_axes=(0, 0, None, None))(scene, samples, first, surface[0])


def by_path(
    derivatives: tuple[Scene, SampleBuffer], group: Group, scene: Scene, mode: Mode, *, sizes: float | None = None
) -> np.ndarray:
    """Derivatives as float64 [cases, P, 4], in the order of the group's paths.

    `sizes`: instead, of those by frames and by locations in frames the sizes of what is added up, and 0 of all others;
    numbers by frames and their inverses count as at least `sizes`.
    """
    count = len(group.cases)
    of_scene, of_samples = jax.tree.map(lambda leaf: np.asarray(leaf, dtype=np.float64)[:count], derivatives)
    rows = light_rows(group.cases[0])

    def by_location_sizes(path: Path) -> np.ndarray:
        """The derivative by a location is that by the frame's translation, turned by the frame.

        Twice: that derivative is rounded, and so was the place in the world, which turns it by as much.
        """
        match path:
            case ("lights", i, "location", k) if group.cases[0].lights[i].frame is not None:
                kind, row = rows[i]
                by_translation = np.abs(getattr(of_scene, kind).to_world[..., row, :, 3])
                axis = np.abs(np.asarray(getattr(scene, kind).to_world, dtype=np.float64)[:count, None, row, :, k])
                return 2 * np.sum(axis * by_translation, axis=-1)
        return np.zeros((count, 4))

    def column(path: Path) -> np.ndarray:
        if sizes is not None and "frame" not in path:
            return by_location_sizes(path)
        match path:
            case ("material", name, *k):
                return getattr(of_scene.materials, name)[(..., 0, *k)]
            case ("lights", i, "frame", r, c):
                kind, row = rows[i]
                if mode == "forward":
                    return getattr(of_scene, kind).to_world[..., row, r, c]
                return _by_frame(getattr(of_scene, kind), getattr(scene, kind), row, count, sizes)[..., r, c]
            case ("lights", i, name, *k):
                kind, row = rows[i]
                return getattr(getattr(of_scene, kind), name)[(..., row, *k)]
            case ("fog", "frame", r, c):
                if c == 3:
                    return np.zeros((count, 4))
                if mode == "forward":
                    return of_scene.fog.to_local[..., r, c]
                return _through_inverse(of_scene.fog.to_local, scene.fog.to_local[:count], sizes)[..., r, c]
            case ("fog", name, *k):
                return getattr(of_scene.fog, name)[(..., *k)]
            case ("sample", "eye", k):
                return of_samples.eye[..., k]
            case ("sample", "texel", k):
                return of_scene.textures[0].image[..., 0, 0, k]
            case ("sample", name, k):
                return getattr(of_samples, f"{name}_planes").reshape(count, 4, -1)[..., k]
        raise ValueError(f"path {path}: unknown")

    return np.stack([column(path) for path in group.paths], axis=1)


def light_rows(case: Case) -> dict[int, tuple[str, int]]:
    """Where light i of the case stands in the scene: kind and row."""
    seen = {"directional": 0, "point": 0, "spot": 0}
    rows = {}
    for i, light in enumerate(case.lights):
        rows[i] = (light.kind, seen[light.kind])
        seen[light.kind] += 1
    return rows


def _by_frame(derivative: Any, lights: Any, row: int, count: int, sizes: float | None) -> np.ndarray:
    """The derivative by a light's frame [cases, 4, 3, 4], from those by `to_world` and by its inverse; or its sizes."""
    whole = derivative.to_world[..., row, :, :].copy()
    whole = whole if sizes is None else np.maximum(np.abs(whole), sizes)
    if hasattr(derivative, "to_local"):
        whole[..., :3] += _through_inverse(derivative.to_local[..., row, :, :], lights.to_local[:count, row], sizes)
    return whole


def _through_inverse(by_inverse: np.ndarray, inverse: Any, sizes: float | None) -> np.ndarray:
    """The derivative by a matrix, from that by its inverse M: -M^T G M^T; or the sizes of its terms, added up.

    The sizes count twice: M, too, is rounded when it is stored, by half an ulp, and stands there twice.
    """
    transposed = np.swapaxes(np.asarray(inverse, dtype=np.float64)[:, None], -1, -2)
    if sizes is not None:
        return 2 * np.abs(transposed) @ np.maximum(np.abs(by_inverse), sizes) @ np.abs(transposed)
    return -transposed @ by_inverse @ transposed
