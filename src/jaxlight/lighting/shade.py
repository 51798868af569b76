"""`shade`: the colour of every sample by the lighting equation."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..promotion import usual_promotion
from ..raster.samples import SampleBuffer
from ..scene import Scene
from ..tracing import is_traced
from .changes import moves, with_change, without_zeros
from .checks import check_samples
from .compiling import jit_on_cpu
from .cores import in_threads, shares_of
from .mapped import mapped_axis_first
from .meshes import axes_of, left_to_xla, on_explicit_mesh, unaware, varying
from .options import LightingOptions
from .plan import Plan, Structure, check_place, make_plan
from .prepared import compute_dtype, prepare
from .tiles import (
    Share,
    color_and_alpha_of_run,
    is_one_loop,
    joined_shares,
    rows_of_run,
    surface_runs,
    tiles_at_once,
)

_Module = TypeVar("_Module", bound=eqx.Module)


def shade(
    scene: Scene, samples: SampleBuffer, options: LightingOptions | None = None, *, plan: Plan | None = None
) -> Float[Array, "samples 4"]:
    """The colour and alpha of every sample by the lighting equation (VRML97 4.14, X3D 17.2.2).

    Args:
        scene: materials, lights, fog and textures.
        samples: N visible surface points.
        options: readings of the specification.
        plan: what to compute, from `make_plan`; default: decided here from the numbers that are known. It is right for
            this scene with other numbers in place of those that were free when it was made, and for samples that lie
            where its own do.

    Returns:
        [N, 4]: red, green, blue as the equation gives them (not clamped, no transfer function), and alpha.

    Raises:
        ValueError: leaves of the scene that are not floating-point arrays of their shape, or hold NaN where that is
            known; a plan that was made for another scene, or for samples elsewhere; samples that name a surface the
            scene lacks, or lack a colour or texels that it asks for.
    """
    return _shade(_IN_SAMPLE_ORDER, scene, samples, options, plan)


def shade_slots(
    scene: Scene, samples: SampleBuffer, options: LightingOptions | None = None, *, plan: Plan | None = None
) -> Float[Array, "slots 4"]:
    """`shade` in storage order, as it is computed: one row a slot of the buffer, padding included."""
    return _shade(_SLOTS, scene, samples, options, plan)


def shade_planes(
    scene: Scene, samples: SampleBuffer, options: LightingOptions | None = None, *, plan: Plan | None = None
) -> Float[Array, "4 slots"]:
    """`shade` in storage order: planes red, green, blue, alpha, one column a slot of the buffer, padding included."""
    return _shade(_PLANES, scene, samples, options, plan)


def shade_tiles(
    scene: Scene, samples: SampleBuffer, options: LightingOptions | None = None, *, plan: Plan | None = None
) -> Float[Array, "tiles 4 tile"]:
    """`shade` in storage order, planes tile by tile, padding included: what derivatives of colours are quickest of."""
    return _shade(_PLANES_BY_TILE, scene, samples, options, plan)


def _in_sample_order(
    rows: Float[Array, "tiles tile numbers"], samples: SampleBuffer
) -> Float[Array, "samples numbers"]:
    return samples.in_sample_order(_slots(rows, samples), axis=0)


def _slots(rows: Float[Array, "tiles tile numbers"], samples: SampleBuffer) -> Float[Array, "slots numbers"]:
    return rows.reshape(-1, rows.shape[-1])


def _planes(rows: Float[Array, "tiles tile numbers"], samples: SampleBuffer) -> Float[Array, "numbers slots"]:
    return jnp.moveaxis(rows, -1, 0).reshape(rows.shape[-1], -1)


def _planes_by_tile(
    rows: Float[Array, "tiles tile numbers"], samples: SampleBuffer
) -> Float[Array, "tiles numbers tile"]:
    return jnp.swapaxes(rows, 1, 2)


class _Form(NamedTuple):
    """In which colours are given."""

    of: Callable[[Array, SampleBuffer], Array]
    """From the rows of all tiles, or some numbers of them."""
    axis: int
    """Of the result, along which the numbers of a sample follow one another."""


_IN_SAMPLE_ORDER = _Form(_in_sample_order, axis=1)
_SLOTS = _Form(_slots, axis=1)
_PLANES = _Form(_planes, axis=0)
_PLANES_BY_TILE = _Form(_planes_by_tile, axis=1)


@usual_promotion
def _shade(
    form: _Form, scene: Scene, samples: SampleBuffer, options: LightingOptions | None, plan: Plan | None
) -> Array:
    scene, plan = checked(scene, samples, options, plan)
    if on_explicit_mesh(scene, samples):
        return left_to_xla(partial(_shaded, form, plan), scene, samples)
    if is_traced(scene, samples):
        axes = axes_of(scene, samples)
        return unaware(_shaded, (form, plan), axes, *varying((scene, samples), axes))
    if not _is_on_cpu(samples):
        return _formed_in_jit(form, plan, scene, samples)
    runs, shares = surface_runs(scene.surfaces, samples, scene.textures), shares_of(samples.slots)
    if all(is_one_loop(run, scene, plan) for run in runs):
        return _shaded_by_all_cores(form, plan, scene, samples)
    if shares == 1:
        return _shaded_on_cpu(form, plan, scene, samples)
    rows = in_threads(lambda number: _share_of_rows(plan, scene, samples, number, shares), shares)
    return _joined(form, tuple(run.stop - run.start for run in runs), rows, samples)


def checked(
    scene: Scene, samples: SampleBuffer, options: LightingOptions | None, plan: Plan | None
) -> tuple[Scene, Plan]:
    """What is shaded, without names and nodes: scenes that differ only there share compiled code."""
    check_samples(scene, samples)
    if plan is None:
        plan = make_plan(scene, samples, options)
    elif not isinstance(plan, Plan):
        raise ValueError(f"plan: expected a Plan, got {type(plan).__name__}")
    elif options is not None:
        raise ValueError("options: a plan has options of its own; give one of the two")
    elif plan.made_for != Structure.of(scene):
        pairs = zip(plan.made_for._fields, plan.made_for, Structure.of(scene), strict=True)
        differs = " and ".join(name for name, its, own in pairs if its != own)
        raise ValueError(f"plan: made for a scene with other {differs} (numbers may differ, what is static may not)")
    else:
        check_place(plan, samples)
    # Plans that need the same terms share compiled code, wherever their samples lie.
    return _bare(scene), plan._replace(within=None)


def _bare(scene: Scene) -> Scene:
    groups = {
        kind: _with(own, names=("",) * len(own.names))
        for kind in ("materials", "directional", "point", "spot")
        if (own := getattr(scene, kind)) is not None
    }
    fog = None if scene.fog is None else _with(scene.fog, name="")
    textures = tuple(_with(texture, name="") for texture in scene.textures)
    return _with(scene, **groups, fog=fog, textures=textures, document=None)


def _with(owner: _Module, **changes: Any) -> _Module:
    """Copied as it is: `dataclasses.replace` would look at every surface again."""
    own = copy.copy(owner)
    for name, value in changes.items():
        object.__setattr__(own, name, value)
    return own


def _rows_of_runs(plan: Plan, scene: Scene, samples: SampleBuffer, share: Share | None) -> list[Array]:
    """The colours of all tiles or of a share of them, run by run."""
    prepared = prepare(scene, samples, plan)
    return [
        rows_of_run(run, prepared, samples, plan, share, one_loop=is_one_loop(run, scene, plan))
        for run in surface_runs(scene.surfaces, samples, scene.textures)
    ]


def _in_one(runs: list[Array], samples: SampleBuffer) -> Float[Array, "tiles tile 4"]:
    if not runs:
        return jnp.zeros((0, samples.tile, 4), compute_dtype(samples))
    return jnp.concatenate(runs) if len(runs) > 1 else runs[0]


def _formed(form: _Form, plan: Plan, scene: Scene, samples: SampleBuffer) -> Array:
    return mapped_axis_first(form.of(_in_one(_rows_of_runs(plan, scene, samples, None), samples), samples))


_formed_in_jit = jax.jit(_formed, static_argnums=(0, 1))
_shaded_on_cpu = jit_on_cpu(_formed, static_argnums=(0, 1))
_shaded_by_all_cores = jit_on_cpu(_formed, all_cores=True, static_argnums=(0, 1))


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _shaded(form: _Form, plan: Plan, scene: Scene, samples: SampleBuffer) -> Array:
    return _formed_in_jit(form, plan, scene, samples)


@usual_promotion
def _shaded_jvp(form: _Form, plan: Plan, primals: Any, tangents: Any) -> tuple[Array, Array]:
    return _change_in_jit(form, plan, primals, without_zeros(tangents))


# The rule is compiled, and not only what it is the rule of: JAX would trace that too, and throw it away.
_shaded.defjvp(_shaded_jvp, symbolic_zeros=True)


@partial(jax.jit, static_argnums=(0, 1))
def _change_in_jit(form: _Form, plan: Plan, primals: Any, tangents: Any) -> tuple[Array, Array]:
    """`_formed`, and its change along tangents without zeros."""
    change, own = tangents
    by_images = moves((own.position_planes, own.normal_planes, own.color_planes, own.texel_weight, change.textures))

    def in_stages(scene: Scene, samples: SampleBuffer) -> Array:
        # Joined at the very end, so that a loss of colours alone meets no image with alpha.
        parts = [form.of(rows, samples) for rows in _rows_in_stages(plan, scene, samples, by_images)]
        return mapped_axis_first(jnp.concatenate(parts, axis=form.axis))

    return with_change(in_stages, primals, tangents)


def _rows_in_stages(plan: Plan, scene: Scene, samples: SampleBuffer, by_images: bool) -> list[Array]:
    """The colours of all tiles and then alpha, in the form that is differentiated."""
    count = tiles_at_once(scene, samples, plan)
    prepared = prepare(scene, samples, plan, count)
    runs = [
        color_and_alpha_of_run(run, prepared, samples, plan, count, by_images=by_images)
        for run in surface_runs(scene.surfaces, samples, scene.textures)
    ]
    if not runs:
        return [_in_one([], samples)]
    return [jnp.swapaxes(jnp.concatenate(part), 1, 2) for part in zip(*runs, strict=True)]


@partial(jit_on_cpu, static_argnums=(0, 4))
def _share_of_rows(plan: Plan, scene: Scene, samples: SampleBuffer, number: Int[Array, ""], shares: int) -> list[Array]:
    return _rows_of_runs(plan, scene, samples, Share(number, shares))


@partial(jax.jit, static_argnums=(0, 1))
def _joined(form: _Form, lengths: tuple[int, ...], shares: list[list[Array]], samples: SampleBuffer) -> Array:
    """`_shaded` from all shares of runs of so many tiles."""
    runs = [joined_shares(list(run), length) for run, length in zip(zip(*shares, strict=True), lengths, strict=True)]
    return form.of(_in_one(runs, samples), samples)


def _is_on_cpu(samples: SampleBuffer) -> bool:
    planes = samples.position_planes
    devices = planes.devices() if isinstance(planes, jax.Array) else jax.devices()
    return all(device.platform == "cpu" for device in devices)
