"""Where the axis lies over which a function with a derivative rule of its own is mapped.

JAX (0.10 to 0.12) takes for granted that function and rule give their results with that axis in the same place: in a
jit that is mapped and then differentiated, what comes from the rule is read as if it came from the function.
"""

from __future__ import annotations

from typing import TypeVar

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

_Results = TypeVar("_Results")


def mapped_axis_first(results: _Results) -> _Results:
    """The arrays themselves; mapped over, with that axis as their first."""
    return jax.tree.map(_mapped_axis_first.bind, results)


_mapped_axis_first = Primitive("mapped_axis_first")
_mapped_axis_first.def_impl(lambda array: array)
_mapped_axis_first.def_abstract_eval(lambda array: array)
mlir.register_lowering(_mapped_axis_first, lambda _, array: [array])
ad.deflinear2(_mapped_axis_first, lambda cotangent, _: [mapped_axis_first(cotangent)])
batching.primitive_batchers[_mapped_axis_first] = lambda arrays, axes: (
    mapped_axis_first(jnp.moveaxis(arrays[0], axes[0], 0)),
    0,
)
