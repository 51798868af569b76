"""Changes of functions along the tangents that JAX gives to rules of its own, some of which are known to be zero."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import jaxpr_as_fun
from jaxtyping import Array

from .pruned import pruned


def with_change(function: Callable[..., Any], primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
    """function(*primals), and its change by those tangents that are no zeros, symbolic or left out."""
    leaves, tree = jax.tree.flatten(primals)
    changes = tree.flatten_up_to(tangents)
    moving = [number for number, change in enumerate(changes) if not (change is None or is_zero(change))]

    def of_moving(*values: Array) -> Any:
        return function(*tree.unflatten(merged(leaves, moving, values)))

    return jax.jvp(of_moving, [leaves[number] for number in moving], [changes[number] for number in moving])


def of_some(push: Callable[[Any], Any], values: Any, which: Any) -> Callable[[Any], Any]:
    """A linear function of the changes of all values as one of those of some, where `which` is True.

    What the others lead to is left out. The changes are given as a tree with None for the others.
    """
    zeros = jax.tree.map(jnp.zeros_like, values)
    moving = eqx.filter(zeros, which)

    def along(changes: Any) -> Any:
        return jax.jvp(lambda own: push(eqx.combine(own, zeros)), (moving,), (changes,))[1]

    jaxpr, shapes = jax.make_jaxpr(along, return_shape=True)(moving)
    evaluated, tree = jaxpr_as_fun(pruned(jaxpr)), jax.tree.structure(shapes)
    return lambda changes: tree.unflatten(evaluated(*jax.tree.leaves(changes)))


def without_zeros(tangents: Any) -> Any:
    """Tangents with None for symbolic zeros, so that a compiled function and a loop can be given them."""
    return jax.tree.map(lambda change: None if is_zero(change) else change, tangents, is_leaf=is_zero)


def moves(tangents: Any) -> bool:
    """Whether any leaf of the tangents is no symbolic zero."""
    return not all(is_zero(change) for change in jax.tree.leaves(tangents, is_leaf=is_zero))


def merged(values: Sequence[Any], numbers: Sequence[int], others: Sequence[Any]) -> list[Any]:
    """The values with others in the places of these numbers."""
    result = list(values)
    for number, other in zip(numbers, others, strict=True):
        result[number] = other
    return result


def is_zero(value: Any) -> bool:
    """Whether it is a symbolic zero."""
    return isinstance(value, SymbolicZero)
