"""What a scene needs: decided once, outside jit, as a small hashable value that is static to the compiled function.

A term is skipped when the numbers it would use are known (not traced) and not free, and give exactly zero. Traced
values (inside jit, grad, vmap) and the fields a caller declares free are never skipped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import numpy as np
from jax.core import Tracer

from ..raster.samples import MANY_LIGHTS, SampleBuffer
from ..scene import DirectionalLights, PointLights, Scene, SpotLights
from ..scene.checks import check_scene
from ..scene.flags import Flags
from ..scene.paths import select
from ..scene.scene import FrameKind
from .options import LightingOptions

MOSTLY = 0.5
"""Lights that reach a larger share of the tiles, as their numbers are now, are not looked for tile by tile."""

TILES_ASKED = 64


class LightPlan(NamedTuple):
    """What the lights of one kind need."""

    rows: tuple[int, ...] | None
    """The rows that can contribute; None: all."""
    headlight: bool
    """Whether the last of these rows is the browser's headlight."""
    frame: FrameKind
    ambient: bool
    scoped: bool
    """Whether some of these lights do not reach some surface."""
    attenuation: Literal["linear", "quadratic"] | None
    radius: bool
    culled: bool
    """Whether each tile computes only the lights that may reach it."""


class FogPlan(NamedTuple):
    """Which fog; whether its frame measures distances as the world does."""

    fog_type: Literal["LINEAR", "EXPONENTIAL"]
    identity_frame: bool


class LightStructure(NamedTuple):
    """What is static of the lights of one kind."""

    frame: FrameKind
    headlight: bool
    on: Flags
    in_scope: Flags


class Structure(NamedTuple):
    """What is static of a scene, and so the same for all numbers that it may be given."""

    materials: int
    directional: LightStructure | None
    point: LightStructure | None
    spot: LightStructure | None
    fog: tuple[str, FrameKind] | None

    @classmethod
    def of(cls, scene: Scene) -> Structure:
        """That of a scene."""

        def of_lights(lights: DirectionalLights | PointLights | SpotLights | None) -> LightStructure | None:
            if lights is None:
                return None
            return LightStructure(lights.frame, getattr(lights, "headlight", False), lights.on, lights.in_scope)

        materials, fog = scene.materials, scene.fog
        return cls(
            materials=0 if materials is None else len(materials.names),
            directional=of_lights(scene.directional),
            point=of_lights(scene.point),
            spot=of_lights(scene.spot),
            fog=None if fog is None else (fog.fog_type, fog.frame),
        )


class Plan(NamedTuple):
    """What the compiled function computes; hashable, equal for scenes that need the same terms."""

    made_for: Structure
    options: LightingOptions
    directional: LightPlan | None
    point: LightPlan | None
    spot: LightPlan | None
    fog: FogPlan | None
    specular: bool
    emissive: bool
    within: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    """Lowest and highest coordinates of the samples for which lights were left out, or their radius was, by where
    the samples lie; None: nothing depends on it."""

    @property
    def lights(self) -> tuple[LightPlan | None, LightPlan | None, LightPlan | None]:
        """For directional, point and spot lights."""
        return self.directional, self.point, self.spot

    @property
    def culled(self) -> bool:
        """Whether of some lights those that reach a tile have to be found."""
        return any(lights is not None and lights.culled for lights in self.lights)


def check_place(plan: Plan, samples: SampleBuffer) -> None:
    """Raise ValueError for samples that lie outside of those that the plan was made for, as far as that is known."""
    bounds = None if plan.within is None else _bounds(_Known(set()), samples)
    if plan.within is None or bounds is None:
        return
    low, high = _box(bounds)
    if np.any(np.less(low, plan.within[0])) or np.any(np.greater(high, plan.within[1])):
        raise ValueError(
            f"plan: made for samples from {list(plan.within[0])} to {list(plan.within[1])}, of which a light's radius "
            f"reaches none or all; got samples from {list(low)} to {list(high)}: make a plan for these"
        )


def plan_of_lights(plan: Plan, rows: tuple[tuple[int, ...], ...], counts: tuple[int, ...]) -> Plan:
    """The plan for some lights alone: since light adds up, derivatives by their fields need no others.

    Args:
        plan: for all lights.
        rows: which directional, point and spot lights.
        counts: how many there are of each kind in the scene.
    """
    own = [_of_rows(*kind) for kind in zip(plan.lights, rows, counts, strict=True)]
    return plan._replace(directional=own[0], point=own[1], spot=own[2], emissive=False)


def number_of_lights(plan: Plan, counts: tuple[int, ...]) -> int:
    """How many lights a plan evaluates, of so many of each kind."""
    kinds = zip(plan.lights, counts, strict=True)
    return sum(count if own.rows is None else len(own.rows) for own, count in kinds if own is not None)


def _of_rows(plan: LightPlan | None, rows: tuple[int, ...], count: int) -> LightPlan | None:
    if plan is None:
        return None
    present = tuple(range(count)) if plan.rows is None else plan.rows
    kept = tuple(row for row in present if row in rows)
    if not kept:
        return None
    headlight, culled = plan.headlight and present[-1] in rows, plan.culled and len(kept) >= MANY_LIGHTS
    return plan._replace(rows=kept, headlight=headlight, culled=culled)


class _Known:
    """The values of leaves that are known and not free; None for the others."""

    def __init__(self, free: set[int]) -> None:
        self._free = free
        """Their identities."""

    def __call__(self, leaf: Any) -> np.ndarray | None:
        return None if id(leaf) in self._free else self.at_present(leaf)

    def at_present(self, leaf: Any) -> np.ndarray | None:
        """The values of a leaf that may be free: only for what changes neither values nor derivatives."""
        return None if isinstance(leaf, Tracer) else np.asarray(leaf)

    def all_zero(self, leaf: Any) -> bool:
        value = self(leaf)
        return value is not None and not np.any(value)


def make_plan(
    scene: Scene,
    samples: SampleBuffer | None = None,
    options: LightingOptions | None = None,
    *,
    free: Any = (),
) -> Plan:
    """The plan for a scene: what can be skipped without changing a value or a wanted derivative.

    It is right for samples that lie where these do; others are refused where their places are known, and inside a jit
    that is given them they are not.

    Args:
        scene: its known numbers decide.
        samples: their bounds decide which lights reach nothing; None: unknown.
        options: readings of the specification.
        free: what must keep its derivatives and may change: paths or functions of the scene as `fit` takes them, or
            leaves of `scene` (the arrays that it holds); True: all.

    Raises:
        ValueError: no scene that can be shaded, no buffer, or something that is not in the scene.
    """
    check_scene(scene)
    if not isinstance(samples, SampleBuffer | None):
        raise ValueError(f"samples: expected a SampleBuffer or None, got {type(samples).__name__}")
    if not isinstance(options, LightingOptions | None):
        raise ValueError(f"options: expected LightingOptions, got {type(options).__name__}")
    options = options or LightingOptions()
    known = _Known(_identities(scene, free))
    bounds = None if samples is None else _bounds(known, samples)
    materials = scene.materials
    lit = materials is not None
    specular = materials is not None and not known.all_zero(materials.specular_color)
    ambient = materials is not None and not known.all_zero(materials.ambient_intensity)
    emissive = materials is not None and not known.all_zero(materials.emissive_color)

    def light_plan(lights: DirectionalLights | PointLights | SpotLights | None) -> tuple[LightPlan | None, bool]:
        if lights is None or not lit:
            return None, False
        return _light_plan(lights, known, options, ambient, bounds)

    local = options.support_level > 1
    directional, point, spot = (
        light_plan(scene.directional),
        *(light_plan(lights) if local else (None, False) for lights in (scene.point, scene.spot)),
    )
    fog = None
    if scene.fog is not None:
        visibility = known(scene.fog.visibility_range)
        if visibility is None or visibility > 0:
            fog = FogPlan(scene.fog.fog_type, scene.fog.frame == "identity")
    return Plan(
        made_for=Structure.of(scene),
        options=options,
        directional=directional[0],
        point=point[0],
        spot=spot[0],
        fog=fog,
        specular=specular,
        emissive=emissive,
        within=_box(bounds) if bounds is not None and (point[1] or spot[1]) else None,
    )


def _identities(scene: Scene, free: Any) -> set[int]:
    """Of the leaves that are free."""
    present = set(map(id, jax.tree.leaves(scene)))
    if free is True:
        return present
    found: set[int] = set()
    for one in jax.tree.leaves(free):
        if isinstance(one, str) or callable(one):
            found |= {id(selection.leaf.get(scene)) for selection in select(scene, one)}
        elif id(one) in present:
            found.add(id(one))
        else:
            shown = f"an array of shape {list(one.shape)}" if hasattr(one, "shape") else repr(one)[:60]
            raise ValueError(
                "free: expected True, paths such as 'Material[0].diffuse_color', or leaves that the scene holds, "
                f"got {shown} that is none of them"
            )
    return found


def _light_plan(
    lights: DirectionalLights | PointLights | SpotLights,
    known: _Known,
    options: LightingOptions,
    ambient: bool,
    bounds: tuple[np.ndarray, np.ndarray] | None,
) -> tuple[LightPlan | None, bool]:
    """The plan for the lights of one kind, None if none of them can contribute, and whether it depends on where
    samples lie."""
    scope = lights.in_scope.array
    directional = isinstance(lights, DirectionalLights)
    unscoped = directional and options.support_level < 3
    keep = lights.on.array.copy()
    if not unscoped:
        keep &= scope.any(axis=0)
    ambient = ambient and not known.all_zero(lights.ambient_intensity)
    color, intensity = known(lights.color), known(lights.intensity)
    ambient_intensity = known(lights.ambient_intensity)
    if color is not None:
        keep &= color.any(axis=1)
    if intensity is not None and (not ambient or ambient_intensity is not None):
        keep &= (intensity != 0) | ((ambient_intensity != 0) if ambient else False)
    frame = lights.frame
    reach = None if directional else _reach(lights, known, frame, bounds)
    by_place = False
    if reach is not None:
        by_place = not np.all(reach.some[keep])
        keep &= reach.some
    if not keep.any():
        return None, by_place
    reaches_all = False
    if reach is not None:
        reaches_all = bool(np.all(reach.all[keep]))
        by_place |= reaches_all and not np.all(reach.endless[keep])
    if reach is None and not directional:
        reach = _reach(lights, known.at_present, frame, bounds)
    mostly = not isinstance(lights, SpotLights) and reach is not None and bool(np.mean(reach.share[keep]) > MOSTLY)
    attenuation = None if directional else _attenuation(lights, known, options, keep)
    plan = LightPlan(
        rows=None if keep.all() else tuple(np.flatnonzero(keep).tolist()),
        headlight=directional and lights.headlight and bool(keep[-1]),
        frame=frame,
        ambient=ambient,
        scoped=not unscoped and not bool(scope[:, keep].all()),
        attenuation=attenuation,
        radius=not directional and not reaches_all,
        culled=bool(keep.sum() >= MANY_LIGHTS) and not (directional or mostly),
    )
    return plan, by_place


def _attenuation(
    lights: PointLights | SpotLights, known: _Known, options: LightingOptions, keep: np.ndarray
) -> Literal["linear", "quadratic"] | None:
    """Which terms of the attenuation polynomial can matter."""
    c = known(lights.attenuation)
    if c is None:
        return "linear" if options.support_level == 2 else "quadratic"
    c = c[keep]
    if np.all(c[:, 0] <= 1) and not np.any(c[:, 1:]):
        return None
    return "linear" if options.support_level == 2 or not np.any(c[:, 2]) else "quadratic"


def _bounds(known: _Known, samples: SampleBuffer) -> tuple[np.ndarray, np.ndarray] | None:
    """Lowest and highest coordinates of the tiles, [3, tiles] each, if known."""
    low, high = known(samples.tile_low), known(samples.tile_high)
    if low is None or high is None or low.size == 0:
        return None
    return low.astype(np.float64), high.astype(np.float64)


def _box(bounds: tuple[np.ndarray, np.ndarray]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Around all tiles."""
    return tuple(bounds[0].min(axis=1).tolist()), tuple(bounds[1].max(axis=1).tolist())


class _Reach(NamedTuple):
    """How far lights reach; [lights] each."""

    some: np.ndarray
    """Whether the radius reaches some sample."""
    all: np.ndarray
    """Whether it surely encloses all."""
    share: np.ndarray
    """The share of tiles that it reaches."""
    endless: np.ndarray
    """Whether it has no end, and reaches all wherever they are."""


def _reach(
    lights: PointLights | SpotLights,
    known: Callable[[Any], np.ndarray | None],
    frame: FrameKind,
    bounds: tuple[np.ndarray, np.ndarray] | None,
) -> _Reach | None:
    """None if it is not known."""
    place, radius, to_world = known(lights.location), known(lights.radius), known(lights.to_world)
    if place is None or radius is None or to_world is None or bounds is None or frame == "general":
        return None
    if not (np.all(np.isfinite(place)) and not np.any(np.isnan(radius))):
        return None
    to_world = to_world.astype(np.float64)
    center = np.einsum("lij,lj->li", to_world[:, :, :3], place) + to_world[:, :, 3]
    radius = radius * _lengths(to_world[:, :, 0])
    low, high = bounds[0].min(axis=1), bounds[1].max(axis=1)
    farthest = _lengths(np.maximum(np.abs(low - center), np.abs(high - center)))
    slack = 1e-5 * (np.abs(center).max(axis=1) + np.abs([low, high]).max() + farthest)
    # Some tiles tell the share well enough.
    some = slice(None, None, -(-bounds[0].shape[1] // TILES_ASKED))
    nearest = _nearest(center[:, :, None], bounds[0][:, some], bounds[1][:, some])
    return _Reach(
        some=~(_nearest(center, low, high) - slack > radius),  # also where that is not known
        all=farthest + slack <= radius,
        share=np.mean(nearest <= radius[:, None], axis=1),
        endless=np.isposinf(radius),
    )


def _nearest(center: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The distance to the nearest point between `low` and `high`; components on axis 1 of `center`."""
    return _lengths(np.maximum(0, np.maximum(low - center, center - high)))


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """Along axis 1, also of vectors whose squares overflow or underflow."""
    largest = np.max(np.abs(vectors), axis=1, keepdims=True)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.linalg.norm(vectors / np.where(largest > 0, largest, 1), axis=1) * largest[:, 0]
