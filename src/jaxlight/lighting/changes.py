"""Changes of functions along the tangents that JAX gives to rules of its own, some of which are known to be zero."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array


def with_change(function: Callable[..., Any], primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
    """function(*primals), and its change by those tangents that are not symbolic zeros."""
    leaves, tree = jax.tree.flatten(primals)
    changes, moving = moving_leaves(tangents)

    def of_moving(*values: Array) -> Any:
        return function(*tree.unflatten(merged(leaves, moving, values)))

    return jax.jvp(of_moving, [leaves[number] for number in moving], [changes[number] for number in moving])


def moving_leaves(tangents: Any) -> tuple[list[Any], list[int]]:
    """The leaves of tangents, and which of them are no symbolic zeros."""
    changes = jax.tree.leaves(tangents, is_leaf=is_zero)
    return changes, [number for number, change in enumerate(changes) if not is_zero(change)]


def moves(tangents: Any) -> bool:
    """Whether any leaf of the tangents is no symbolic zero."""
    return bool(moving_leaves(tangents)[1])


def merged(values: Sequence[Any], numbers: Sequence[int], others: Sequence[Any]) -> list[Any]:
    """The values with others in the places of these numbers."""
    result = list(values)
    for number, other in zip(numbers, others, strict=True):
        result[number] = other
    return result


def is_zero(value: Any) -> bool:
    """Whether it is a symbolic zero."""
    return isinstance(value, SymbolicZero)
