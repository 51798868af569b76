"""What follows from the numbers that are differentiated by: all else need not be differentiated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def moved_leaves(function: Callable[[Any], Any], at: Any) -> Any:
    """A tree like function(at), whose leaves say whether floating-point numbers there may depend on `at`."""
    jaxpr, shapes = jax.make_jaxpr(function, return_shape=True)(at)
    moved = set(jaxpr.jaxpr.invars)
    for equation in jaxpr.jaxpr.eqns:
        if any(_is_variable(operand) and operand in moved for operand in equation.invars):
            moved.update(equation.outvars)
    shapes, tree = jax.tree.flatten(shapes)
    return tree.unflatten(
        _is_variable(result) and result in moved and jnp.issubdtype(shape.dtype, jnp.floating)
        for result, shape in zip(jaxpr.jaxpr.outvars, shapes, strict=True)
    )


def _is_variable(operand: Any) -> bool:
    return not hasattr(operand, "val")  # a literal has a value
