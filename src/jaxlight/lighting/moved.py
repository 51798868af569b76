"""What follows from the numbers that are differentiated by: all else need not be differentiated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def moved_leaves(function: Callable[[Any], Any], at: Any) -> Any:
    """A tree like function(at), whose leaves say whether floating-point numbers there may depend on `at`."""
    return moved_by(function, at)(jax.tree.map(lambda _: True, at))


def moved_by(function: Callable[[Any], Any], at: Any) -> Callable[[Any], Any]:
    """From a tree like `at`, some of whose leaves are True, `moved_leaves` by these."""
    jaxpr, shapes = jax.make_jaxpr(function, return_shape=True)(at)
    leaves, tree = jax.tree.flatten(shapes)

    def moved_by_some(which: Any) -> Any:
        moved = {own for own, moves in zip(jaxpr.jaxpr.invars, jax.tree.leaves(which), strict=True) if moves}
        for equation in jaxpr.jaxpr.eqns:
            if any(_is_variable(operand) and operand in moved for operand in equation.invars):
                moved.update(equation.outvars)
        return tree.unflatten(
            _is_variable(result) and result in moved and jnp.issubdtype(shape.dtype, jnp.floating)
            for result, shape in zip(jaxpr.jaxpr.outvars, leaves, strict=True)
        )

    return moved_by_some


def _is_variable(operand: Any) -> bool:
    return not hasattr(operand, "val")  # a literal has a value
