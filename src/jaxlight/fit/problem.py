"""A fit as data: one pytree that residuals, normal equations and solvers take as an argument."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..scene.flags import Flags
from ..scene.scene import Scene
from .parameters import FreeField, Parameters, World, free_parameters
from .views import View, ViewData, view_data

LossKind = Literal["squares", "huber", "cauchy"]


class Problem(eqx.Module):
    """What is fitted to what. Every number is a leaf; two problems of the same shape share their compiled code."""

    world: World
    """The scene and exposures at the start; fields that are not free keep these values."""
    parameters: Parameters
    views: tuple[ViewData, ...]
    """Views of the same structure are stacked along a leading axis."""
    loss_scale: Float[Array, ""]
    """Residual at which a robust loss turns from squares to tolerance."""
    loss_kind: LossKind = eqx.field(static=True)
    shade: Callable[..., Any] = eqx.field(static=True)
    """`shade(scene, samples) -> planes [4, slots]`."""

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
    """True when weights are stated to be 1 / variance."""


def make_problem(
    scene: Scene,
    views: View | Sequence[View],
    free: Any,
    *,
    loss: LossKind = "squares",
    loss_scale: float | None = None,
    noise_known: bool = False,
    shade: Callable[..., Any] | None = None,
) -> tuple[Problem, Description]:
    """Check everything on the host and bring it into the form that compiled code takes.

    Raises:
        ValueError: names the view, field or option, what came and what is allowed.
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"scene: expected a Scene, got {type(scene).__name__}")
    each = [views] if isinstance(views, View) else list(views)
    if not each or not all(isinstance(view, View) for view in each):
        raise ValueError("views: expected a View or a list of at least one View")
    if loss not in ("squares", "huber", "cauchy"):
        raise ValueError(f"loss: expected 'squares', 'huber' or 'cauchy', got {loss!r}")
    if loss != "squares" and not (loss_scale is not None and np.isfinite(loss_scale) and loss_scale > 0):
        raise ValueError(f"loss_scale: the {loss} loss needs a number > 0, got {loss_scale!r}")
    if shade is None:
        from ..lighting import shade_planes

        shade = shade_planes
    names = [view.name for view in each]
    dtype = _float_type(scene)
    _check_finite(scene)
    world = World(scene, jnp.asarray([view.exposure for view in each], dtype=dtype))
    parameters, fields = free_parameters(world, free, names, dtype)
    data = [view_data(scene, view, row, dtype) for row, view in enumerate(each)]
    labels = [""] * len(parameters.start)
    for field in fields:
        for label, number in zip(field.labels, field.numbers.tolist(), strict=True):
            labels[number] = labels[number] or label
    problem = Problem(
        world=world,
        parameters=parameters,
        views=_stack(data),
        loss_scale=jnp.asarray(1.0 if loss_scale is None else loss_scale, dtype=dtype),
        loss_kind=loss,
        shade=shade,
    )
    count = sum(int(np.count_nonzero(np.asarray(one.root_weight))) * (3 // one.root_weight.shape[0]) for one in data)
    return problem, Description(fields, labels, names, count, noise_known)


def scene_of_view(world: World, view: ViewData) -> Scene:
    """The scene as this view saw it: only the lights that shone."""
    scene = world.scene
    for attribute, rows in zip(("directional", "point", "spot"), view.lights, strict=True):
        lights = getattr(scene, attribute)
        if lights is not None and rows is not None:
            chosen = None if rows.shape[0] == 0 else _take_lights(lights, rows)
            scene = dataclasses.replace(scene, **{attribute: chosen})
    return scene


def _take_lights(lights: Any, rows: Array) -> Any:
    changes = {
        field.name: jnp.take(getattr(lights, field.name), rows, axis=0)
        for field in dataclasses.fields(lights)
        if not field.metadata.get("static", False)
    }
    # Names stay on the host side of a fit; here they would only tell equal programs apart.
    count = rows.shape[0]
    in_scope = Flags(np.ones((lights.in_scope.array.shape[0], count)))
    return dataclasses.replace(lights, **changes, names=("",) * count, on=Flags(np.ones(count)), in_scope=in_scope)


def _stack(views: list[ViewData]) -> tuple[ViewData, ...]:
    """Views of one structure stacked along a leading axis, so that they share one compiled loop."""
    groups: dict[Any, list[ViewData]] = {}
    for view in views:
        leaves, structure = jax.tree.flatten(view)
        groups.setdefault((structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves)), []).append(view)
    return tuple(jax.tree.map(lambda *leaves: jnp.stack(leaves), *group) for group in groups.values())


def _float_type(scene: Scene) -> Any:
    floats = [leaf for leaf in jax.tree.leaves(scene) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    return jnp.result_type(*floats) if floats else jnp.result_type(float)


def _check_finite(scene: Scene) -> None:
    from ..scene.paths import fields

    for field in fields(scene):
        value = field.value(scene)
        allowed_infinite = field.leaf.field == "radius"
        if np.any(np.isnan(value)) or (not allowed_infinite and not np.all(np.isfinite(value))):
            raise ValueError(f"{field.path}: every number must be finite, got {value}")
