"""A fit as data: one pytree that residuals, normal equations and solvers take as an argument."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..arrays import array_of
from ..given import plain, several
from ..lighting import LightingOptions, make_plan
from ..lighting.checks import check_samples
from ..raster.samples import SampleBuffer
from ..scene.checks import check_scene
from ..scene.fields import positive
from ..scene.flags import Flags
from ..scene.paths import LIGHT_ATTRIBUTES, Leaf, fields
from ..scene.scene import Scene
from .columns import Columns
from .directions import Apart, OnlyView, columns_of
from .free import free_parameters
from .parameters import FreeField, Parameters, World
from .part import WHOLE, Part, choose_part
from .residuals import LossKind
from .sampling import TexelSampling, texel_sampling
from .strides import UNLIMITED, Strides, stride_of
from .views import View, ViewData, exposure_of, is_of_surfaces_alone, label_of, view_data


class Problem(eqx.Module):
    """What is fitted to what. Every number is a leaf; two problems of the same shape share their compiled code."""

    world: World
    """The scene and exposures at the start; fields that are not free keep these values."""
    parameters: Parameters
    columns: Columns
    strides: Strides
    sampling: tuple[TexelSampling, ...]
    """Which texels of whole free textures each stack of views sees; empty if there are none."""
    views: tuple[ViewData, ...]
    """Views of the same structure are stacked along a leading axis."""
    every: Int[Array, ""]
    """One tile in so many is evaluated (`part.Part`); 1: all."""
    count: Float[Array, ""]
    """Number of residuals that count (weight > 0)."""
    signal: Float[Array, ""]
    """Half the sum of squares of the weighted targets: the loss of a black picture."""
    loss_scale: Float[Array, ""]
    """Residual at which a robust loss turns from squares to tolerance."""
    loss_kind: LossKind = eqx.field(static=True)
    settles: bool = eqx.field(static=True)
    """Whether numbers that are linear together are kept at their best: squares, no sensor limits, no whole textures."""
    found: Float[Array, " parameters"] | None = None
    """Where a fit ended, in the problem of a `Fit`: `fitted_values` begins there."""

    @property
    def rho(self) -> tuple[LossKind, Array]:
        """The loss and its scale."""
        return self.loss_kind, self.loss_scale

    def at(self, values: Float[Array, " parameters"]) -> World:
        """The world with the free numbers set to `values`."""
        return self.parameters.world(self.world, values)


class Description(NamedTuple):
    """The host-side part of a fit: words for its numbers. Never goes into compiled code."""

    fields: list[FreeField]
    labels: list[str]
    """Name of each parameter; tied numbers carry the name of the first."""
    view_names: list[str]
    residuals: int
    """Number of residuals that count (weight > 0)."""
    noise_known: bool
    """True when every view states its noise."""
    weighted: bool
    """True when a view that states it has weights besides, other than 0 and 1."""
    alone: list[str]
    """Views that are taken for pictures of their surfaces alone, some of which are transparent."""
    part: Part
    """What of the samples the fit begins with."""
    document: Any
    """The document of the scene, which the problem does without."""


def make_problem(
    scene: Scene,
    views: View | Sequence[View],
    free: Any,
    *,
    loss: LossKind = "squares",
    loss_scale: float | None = None,
    options: LightingOptions | None = None,
) -> tuple[Problem, Description]:
    """Check everything on the host and bring it into the form that compiled code takes.

    Raises:
        ValueError: names the view, field or option, what came and what is allowed.
    """
    check_scene(scene)
    each = several(views)
    if not each or not all(isinstance(view, View) for view in each):
        came = next((f"a {type(one).__name__}" for one in each if not isinstance(one, View)), "none")
        raise ValueError(f"views: expected a View or a list of at least one View, got {came}")
    loss = plain(loss)
    if not isinstance(loss, str) or loss not in ("squares", "huber", "cauchy"):
        raise ValueError(f"loss: expected 'squares', 'huber' or 'cauchy', got {loss!r:.60}")
    if loss != "squares":
        loss_scale = positive(f"loss_scale: for the {loss} loss", loss_scale)
    elif loss_scale is not None:
        raise ValueError(
            f"loss_scale: squares have none; leave it out or choose 'huber' or 'cauchy', got {loss_scale!r:.60}"
        )
    names = [view.name for view in each]
    _check_names(names)
    dtype = _float_type(scene, each)
    limits = jnp.finfo(dtype)
    if loss_scale is not None and not float(limits.tiny) <= loss_scale * loss_scale <= float(limits.max):
        raise ValueError(f"loss_scale: expected a number whose square {dtype} holds, got {loss_scale:g}")
    _check_finite(scene)
    exposures = [exposure_of(view, row) for row, view in enumerate(each)]
    world = World(scene, array_of(exposures, dtype))
    parameters, fields = free_parameters(world, free, names, dtype)
    # The document is no number and would only make programs of equal scenes differ.
    world = World(_in_type(dataclasses.replace(scene, document=None), parameters, dtype), world.exposure)
    data = [_planned(world, parameters, view_data(scene, view, row, dtype), options) for row, view in enumerate(each)]
    for row, one in enumerate(data):
        if parameters.blocks and one.pixel is not None:
            raise ValueError(
                f"{label_of(names[row], row)}.samples: whole textures cannot be fitted to views with several samples a "
                f"pixel; take one a pixel"
            )
    labels = [""] * parameters.few
    for field in fields:
        for label, number in zip(field.labels, field.numbers.tolist(), strict=True):
            labels[number] = labels[number] or label
    count = sum(int(np.count_nonzero(np.asarray(one.root_weight))) * (3 // one.root_weight.shape[0]) for one in data)
    data = _without_limits_that_none_has(data)
    stacks = _stack(data)
    problem = Problem(
        world=world,
        parameters=parameters,
        columns=_columns(scene, parameters, data, dtype),
        strides=_strides(scene, parameters, fields, each, dtype),
        sampling=texel_sampling(stacks, scene.surfaces, parameters.blocks),
        views=stacks,
        every=array_of(1, jnp.int32),
        count=array_of(count, dtype),
        signal=array_of(min(sum(_signal(one) for one in data), float(jnp.finfo(dtype).max)), dtype),
        loss_scale=array_of(1.0 if loss_scale is None else loss_scale, dtype),
        loss_kind=loss,
        settles=loss == "squares"
        and not parameters.blocks
        and all(one.saturated is None and one.dark is None for one in data),
    )
    noise_known = all(view.noise is not None for view in each)
    weighted = any(view.noise is not None and _weighs(view.weight) for view in each)
    part = WHOLE if parameters.blocks else choose_part(data, scene)
    alone = [label_of(view.name, row) for row, view in enumerate(each) if is_of_surfaces_alone(scene, view)]
    return problem, Description(fields, labels, names, count, noise_known, weighted, alone, part, scene.document)


def _weighs(weight: Any) -> bool:
    """Whether weights do more than leave out points."""
    return weight is not None and not np.all(np.isin(np.asarray(weight), (0, 1)))


def _check_names(names: Sequence[str]) -> None:
    """Each view is called by another name, those without one by their number."""
    for row, name in enumerate(names):
        if not isinstance(name, str):
            raise ValueError(f"views[{row}].name: expected text, got {name!r:.60}")
    called = [name or str(row) for row, name in enumerate(names)]
    for row, name in enumerate(called):
        if name in called[:row]:
            named = row if names[row] else called.index(name)
            raise ValueError(f"views[{named}].name: {name!r} is named twice")


def _columns(scene: Scene, parameters: Parameters, views: list[ViewData], dtype: Any) -> Columns:
    """The directions; texels are coupled to numbers of any view and material, and so may be a pixel of several samples
    to those of several materials."""
    apart = Apart(
        materials=not parameters.blocks and all(view.pixel is None for view in views),
        views=not parameters.blocks,
        lights=all(rows is None for view in views for rows in view.lights),
        only_view=_only_view(scene, views),
    )
    return columns_of(parameters, dtype, apart)


def _only_view(scene: Scene, views: list[ViewData]) -> OnlyView:
    """Of every light the only view in which it shone."""
    found = {}
    for kind, attribute in enumerate(LIGHT_ATTRIBUTES):
        lights = getattr(scene, attribute)
        shone = np.zeros((len(views), 0 if lights is None else len(lights.names)), bool)
        for row, view in zip(shone, views, strict=True):
            chosen = view.lights[kind]
            row[slice(None) if chosen is None else np.asarray(chosen)] = True
        found[attribute] = np.where(shone.sum(axis=0) == 1, shone.argmax(axis=0), -1)
    return found


def _signal(view: ViewData) -> float:
    weighted = np.asarray(view.root_weight, np.float64) * np.asarray(view.target, np.float64)
    return float(np.sum(weighted * weighted)) / 2


def _planned(world: World, parameters: Parameters, view: ViewData, options: LightingOptions | None) -> ViewData:
    """The view with what its lighting needs: no term with a free field is left out."""
    scene = scene_of_view(world, view)
    check_samples(scene, view.samples)
    free = [leaf.get(scene) for leaf in _free_leaves(parameters) if getattr(scene, leaf.attribute) is not None]
    # Without their bounds views share compiled code; their samples stay where they are.
    plan = make_plan(scene, view.samples, options, free=free)._replace(within=None)
    return dataclasses.replace(view, plan=plan)


def _free_leaves(parameters: Parameters) -> set[Leaf]:
    """Of the scene."""
    textures = {Leaf("Texture", "image", block.texture) for block in parameters.blocks}
    return textures | {part.leaf for part in parameters.leaves if part.leaf is not None}


def _in_type(scene: Scene, parameters: Parameters, dtype: Any) -> Scene:
    """The scene whose free leaves are of the fit's type: in a narrower one steps would be rounded."""
    for leaf in _free_leaves(parameters):
        if leaf.get(scene).dtype != dtype:
            scene = leaf.set(scene, array_of(leaf.get(scene), dtype))
    return scene


def _strides(scene: Scene, parameters: Parameters, fields: list[FreeField], views: list[View], dtype: Any) -> Strides:
    """How far each parameter may go in a step; lights are measured from the middle of what the views show."""
    middles = [(np.asarray(v.samples.tile_low) + np.asarray(v.samples.tile_high)) / 2 for v in views]
    middle = np.mean([np.mean(each, axis=1, dtype=np.float64) for each in middles], axis=0)
    count = len(parameters.start)
    down, up, floor = np.full(count, np.inf), np.full(count, np.inf), np.ones(count)
    origin, group, term, terms_held = np.zeros(count), np.arange(count), np.zeros(count), np.zeros(count)
    for field in fields:
        stride = UNLIMITED if field.leaf is None else stride_of(field.leaf.field)
        down[field.numbers], up[field.numbers], floor[field.numbers] = stride
        group[field.numbers] = field.numbers[0]
        if field.leaf is None or field.leaf.field not in ("location", "direction", "attenuation"):
            continue
        lights = getattr(scene, field.leaf.attribute)
        vector, center = np.asarray(field.leaf.get(scene)[field.row], np.float64), np.zeros(3)
        if field.leaf.field != "direction":
            to_world = np.asarray(lights.to_world[field.row], np.float64)
            center = np.linalg.solve(to_world[:, :3], middle - to_world[:, 3])
        if field.leaf.field == "attenuation":
            distance = np.linalg.norm(np.asarray(lights.location[field.row], np.float64) - center)
            terms = distance ** np.arange(3)
            term[field.numbers] = terms[field.components]
            terms_held[field.numbers] = np.sum(np.delete(terms * vector, field.components))
            continue
        origin[field.numbers] = center[field.components]
        # Components that are not free are part of the vector's length.
        held = np.linalg.norm(np.delete(vector - center, field.components))
        floor[field.numbers] = np.maximum(floor[field.numbers], held)
    down, up, floor, origin, term, terms_held = (
        array_of(own, dtype) for own in (down, up, floor, origin, term, terms_held)
    )
    return Strides(down, up, floor, origin, jnp.asarray(group), term, terms_held)


def scene_of_view(world: World, view: ViewData) -> Scene:
    """The scene as this view saw it: only the lights that shone."""
    scene = world.scene
    for attribute, rows, in_scope in zip(LIGHT_ATTRIBUTES, view.lights, view.in_scope, strict=True):
        lights = getattr(scene, attribute)
        if lights is not None and rows is not None:
            chosen = None if rows.shape[0] == 0 else _take_lights(lights, rows, in_scope)
            scene = dataclasses.replace(scene, **{attribute: chosen})
    return scene


def _take_lights(lights: Any, rows: Array, in_scope: Any) -> Any:
    """Some rows of the lights of a kind, all of them on."""
    changes = {
        field.name: jnp.take(getattr(lights, field.name), rows, axis=0)
        for field in dataclasses.fields(lights)
        if not field.metadata.get("static", False)
    }
    # Names stay on the host side of a fit; here they would only tell equal programs apart.
    count = rows.shape[0]
    return dataclasses.replace(lights, **changes, names=("",) * count, on=Flags(np.ones(count)), in_scope=in_scope)


def _without_limits_that_none_has(views: list[ViewData]) -> list[ViewData]:
    """The views without `saturated` or `dark` where these are infinite in all of them."""
    for limit in ("saturated", "dark"):
        if all(np.isinf(getattr(view, limit)) for view in views):
            views = [dataclasses.replace(view, **{limit: None}) for view in views]
    return views


def _stack(views: list[ViewData]) -> tuple[ViewData, ...]:
    """Views of one structure stacked along a leading axis, so that they share one compiled loop."""
    groups: dict[Any, list[ViewData]] = {}
    for view in views:
        leaves, structure = jax.tree.flatten(view)
        groups.setdefault((structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves)), []).append(view)
    return tuple(
        jax.tree.map(lambda *leaves: array_of(np.stack(leaves), leaves[0].dtype), *group) for group in groups.values()
    )


def _float_type(scene: Scene, views: list[View]) -> Any:
    """That of the scene's numbers."""
    floats = [leaf for leaf in jax.tree.leaves(scene) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    dtype = jnp.result_type(*floats) if floats else jnp.result_type(float)
    if dtype.itemsize < 4:
        raise ValueError(f"scene: expected numbers of float32 or float64, got {dtype}")
    for row, view in enumerate(views):
        own = view.samples.position_planes.dtype if isinstance(view.samples, SampleBuffer) else dtype
        if jnp.promote_types(own, dtype) != dtype:
            raise ValueError(f"{label_of(view.name, row)}.samples: expected {dtype} as the scene has, got {own}")
    return dtype


def _check_finite(scene: Scene) -> None:
    for field in fields(scene):
        value = field.value(scene)
        allowed_infinite = field.leaf.field == "radius"
        if np.any(np.isnan(value)) or (not allowed_infinite and not np.all(np.isfinite(value))):
            raise ValueError(f"{field.path}: every number must be finite, got {value}")
