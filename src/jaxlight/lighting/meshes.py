"""Arrays on a mesh of devices.

Inside of `jax.shard_map` JAX keeps account of which axes of the mesh every value varies over. It wants the branches of
a conditional, and what goes into a turn of a loop and what comes out, to vary alike. Colours need nothing of other
devices, so they are computed as if nothing varied. Seen from outside, all that they are computed from, and they
themselves, vary over every axis over which any of it does; JAX then sums derivatives by what is the same on all
devices, as it does of any function.

On a mesh of explicit axes JAX divides arrays as it is told, operation by operation. Here it is told nothing: that is
left to XLA, as on a mesh of other axes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jax.sharding import PartitionSpec, auto_axes, use_abstract_mesh
from jaxtyping import Array

Axes = tuple[Any, ...]
"""Names of axes of a mesh; none outside of `jax.shard_map`, and where that is told to check nothing."""

_Tree = TypeVar("_Tree")


def is_inside() -> bool:
    """Whether what is traced now is part of what each device does."""
    return bool(jax.sharding.get_abstract_mesh().manual_axes)


def on_explicit_mesh(*operands: Any) -> bool:
    """Whether any of their leaves lies on a mesh whose axes JAX divides as it is told, operation by operation."""
    return any(bool(jax.typeof(leaf).sharding.mesh.explicit_axes) for leaf in jax.tree.leaves(operands))


def left_to_xla(function: Callable[..., Any], *operands: Any) -> Any:
    """function(*operands), in which XLA divides arrays among the devices of an explicit mesh; all have the result."""
    mesh = next(mesh for leaf in jax.tree.leaves(operands) if (mesh := jax.typeof(leaf).sharding.mesh).explicit_axes)
    with use_abstract_mesh(mesh):
        return auto_axes(function, out_sharding=PartitionSpec())(*operands)


def axes_of(*operands: Any) -> Axes:
    """The axes over which any of their leaves varies."""
    return tuple(sorted(frozenset().union(*map(_axes, jax.tree.leaves(operands))), key=str))


def varying(operands: _Tree, axes: Axes) -> _Tree:
    """The same values, each of which varies over these axes."""

    def cast(leaf: Any) -> Any:
        missing = tuple(axis for axis in axes if axis not in _axes(leaf))
        return lax.pcast(leaf, missing, to="varying") if missing else leaf

    return jax.tree.map(cast, operands) if axes else operands


def unaware(function: Callable[..., Any], static: tuple[Any, ...], axes: Axes, *operands: Any) -> Any:
    """function(*static, *operands), in which nothing varies, of operands and with results that vary over these axes."""
    return _program(function, static, axes, *operands) if axes else function(*static, *operands)


# One program, of which derivatives keep the operands alone: what does not seem to vary is never seen outside.
@partial(jax.jit, static_argnums=(0, 1, 2))
@partial(jax.checkpoint, static_argnums=(0, 1, 2))
def _program(function: Callable[..., Any], static: tuple[Any, ...], axes: Axes, *operands: Any) -> Any:
    return _told_to_vary(function(*static, *_told_to_vary(operands, ())), axes)


def _told_to_vary(operands: _Tree, axes: Axes) -> _Tree:
    return jax.tree.map(lambda leaf: _as_if_varying.bind(leaf, axes=axes), operands)


def _axes(value: Any) -> frozenset[Any]:
    return jax.typeof(value).manual_axis_type.varying


def _of_axes(aval: Any, *, axes: Axes) -> Any:
    return aval.update(manual_axis_type=aval.manual_axis_type.update(varying=frozenset(axes)))


def _transpose(cotangent: Array, operand: Any, *, axes: Axes) -> list[Array]:
    varies = operand.aval.manual_axis_type.varying
    return [_as_if_varying.bind(cotangent, axes=tuple(sorted(varies, key=str)))]


_as_if_varying = Primitive("as_if_varying")
_as_if_varying.def_impl(lambda array, *, axes: array)
_as_if_varying.def_abstract_eval(_of_axes)
mlir.register_lowering(_as_if_varying, lambda _, array, *, axes: [array])
ad.deflinear2(_as_if_varying, _transpose)
batching.defvectorized(_as_if_varying)
