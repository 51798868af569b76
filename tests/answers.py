"""jaxlight's answers for oracle cases, many at a time, in the oracle's terms: colours, and derivatives by path.

Cases of one structure are stacked and mapped with `jax.vmap`, in chunks of one size, so that few programs are compiled.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from cases_to_scenes import options_of, scene_and_sample, scenes_and_samples, structure
from jaxlight.lighting import Plan, make_plan, shade_planes
from jaxlight.raster import SampleBuffer
from jaxlight.scene import Scene
from oracle.case import Case
from oracle.paths import Path, float_paths

CHUNK = 256


class Group(NamedTuple):
    """Cases of one structure: their places in the list that was given, and how jaxlight sees them."""

    index: np.ndarray
    cases: list[Case]
    plan: Plan
    paths: list[Path]


def groups(cases: Sequence[Case], chunk: int = CHUNK) -> Iterator[Group]:
    """The cases by structure, at most `chunk` at a time."""
    found: dict[tuple, list[int]] = {}
    for i, case in enumerate(cases):
        found.setdefault(structure(case), []).append(i)
    for places in found.values():
        for start in range(0, len(places), chunk):
            index = np.array(places[start : start + chunk])
            own = [cases[i] for i in index]
            yield Group(index, own, plan_of(own[0]), float_paths(own[0]))


def plan_of(case: Case) -> Plan:
    """The plan that holds for every case of the structure: nothing skipped but what the structure itself decides."""
    scene, samples = scene_and_sample(case, np.float32)
    return make_plan(scene, samples, options_of(case), free=True)


def inputs(group: Group, dtype: Any, chunk: int = CHUNK) -> tuple[Scene, SampleBuffer]:
    """The group as stacked scenes and samples; the last case is repeated until the chunk is full."""
    filled = group.cases + [group.cases[-1]] * (chunk - len(group.cases))
    return scenes_and_samples(filled, dtype)


def one(scene: Scene, samples: SampleBuffer, plan: Plan) -> jax.Array:
    """Colour and alpha [4] of one case."""
    return shade_planes(scene, samples, plan=plan)[:, 0]


def _floats(samples: SampleBuffer) -> tuple[SampleBuffer, SampleBuffer]:
    """What of a buffer is differentiated, and the rest."""
    rest = dataclasses.replace(samples, position_planes=None, normal_planes=None, eye=None, color_planes=None)
    return dataclasses.replace(
        jax.tree.map(lambda _: None, samples),
        position_planes=samples.position_planes,
        normal_planes=samples.normal_planes,
        eye=samples.eye,
        color_planes=samples.color_planes,
    ), rest


def _joined(own: SampleBuffer, rest: SampleBuffer) -> SampleBuffer:
    names = ("position_planes", "normal_planes", "eye", "color_planes")
    return dataclasses.replace(rest, **{name: getattr(own, name) for name in names})


def _of_both(scene_and_own: tuple[Scene, SampleBuffer], rest: SampleBuffer, plan: Plan) -> jax.Array:
    scene, own = scene_and_own
    return one(scene, _joined(own, rest), plan)


@partial(jax.jit, static_argnames="plan")
def stacked_values(scene: Scene, samples: SampleBuffer, plan: Plan) -> jax.Array:
    """[cases, 4]"""
    return _mapped(lambda a, b: one(a, b, plan), scene, samples)


def _mapped(function: Callable, scene: Scene, samples: SampleBuffer) -> Any:
    index, surface = samples.texel_index, samples.tile_surface
    index = None if index is None else index[0]
    samples = dataclasses.replace(samples, texel_index=None, tile_surface=None)

    def of_one(scene: Scene, samples: SampleBuffer, index: Any, surface: Any) -> Any:
        return function(scene, dataclasses.replace(samples, texel_index=index, tile_surface=surface))

    return jax.vmap(of_one, in_axes=(0, 0, None, None))(scene, samples, index, surface[0])


def _derivatives(transform: Callable, scene: Scene, samples: SampleBuffer, plan: Plan) -> Any:
    def of_one(scene: Scene, samples: SampleBuffer) -> Any:
        own, rest = _floats(samples)
        return transform(_of_both)((scene, own), rest, plan)

    return _mapped(of_one, scene, samples)


@partial(jax.jit, static_argnames="plan")
def stacked_reverse(scene: Scene, samples: SampleBuffer, plan: Plan) -> Any:
    """(gradients by scene, by samples), every leaf [cases, 4, ...]; reverse mode."""
    return _derivatives(jax.jacrev, scene, samples, plan)


@partial(jax.jit, static_argnames="plan")
def stacked_forward(scene: Scene, samples: SampleBuffer, plan: Plan) -> Any:
    """As `stacked_reverse`, in forward mode."""
    return _derivatives(jax.jacfwd, scene, samples, plan)


def by_path(derivatives: tuple[Scene, SampleBuffer], group: Group, scene: Scene) -> np.ndarray:
    """Derivatives as [cases, P, 4], float64, in the order of the group's paths."""
    count = len(group.cases)
    of_scene, of_samples = jax.tree.map(lambda leaf: np.asarray(leaf, dtype=np.float64)[:count], derivatives)
    rows = _rows(group.cases[0])

    def column(path: Path) -> np.ndarray:
        match path:
            case ("material", name, *k):
                return getattr(of_scene.materials, name)[(..., 0, *k)]
            case ("lights", i, "frame", r, 3):
                return getattr(of_scene, rows[i][0]).to_world[..., rows[i][1], r, 3]
            case ("lights", i, "frame", r, c):
                own = getattr(of_scene, rows[i][0])
                whole = own.to_world[..., rows[i][1], :, :3]
                if hasattr(own, "to_local"):
                    whole = whole + _through_inverse(
                        own.to_local[..., rows[i][1], :, :], getattr(scene, rows[i][0]).to_local[:count, rows[i][1]]
                    )
                return whole[..., r, c]
            case ("lights", i, name, *k):
                return getattr(getattr(of_scene, rows[i][0]), name)[(..., rows[i][1], *k)]
            case ("fog", "frame", r, c):
                if c == 3:
                    return np.zeros((count, 4))
                return _through_inverse(of_scene.fog.to_local, scene.fog.to_local[:count])[..., r, c]
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


def _rows(case: Case) -> dict[int, tuple[str, int]]:
    """Where light i of the case stands in the scene: kind and row."""
    seen: dict[str, int] = {}
    rows = {}
    for i, light in enumerate(case.lights):
        rows[i] = (light.kind, seen.get(light.kind, 0))
        seen[light.kind] = rows[i][1] + 1
    return rows


def _through_inverse(of_inverse: np.ndarray, inverse: Any) -> np.ndarray:
    """The derivative by a matrix, from that by its inverse: -M^T G M^T with M the inverse."""
    m = np.asarray(inverse, dtype=np.float64)[:, None]
    mt = np.swapaxes(m, -1, -2)
    return -mt @ of_inverse @ mt
