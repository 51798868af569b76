"""Stages with several results, each a loop of its own, and the derivatives of all of them.

Only what a stage is given and gives is ever stored: derivatives compute anew what they need.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .changes import merged, moving_leaves
from .linear_stage import linear_stage
from .loop_gradient import gradient_in_one_loop
from .one_loop import MOST_RESULTS
from .unstored import is_unstored, stored


class Boundary(Protocol):
    """A `Stage`, which knows nothing of derivatives."""

    always: Array

    def __call__(self, function: Callable[..., Any], *operands: Any, name: str = "") -> Any: ...

    def leaf_by_leaf(self, function: Callable[..., Any], *operands: Any) -> Any: ...


class How(NamedTuple):
    """What is static of `Stage.each`."""

    function: Callable[..., Any]
    wide: tuple[int, ...]
    shared: Callable[..., Any] | None
    less: Callable[..., Any] | None
    of_numbers: bool


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def each(how: How, stage: Boundary, operands: tuple[Any, ...], derived: tuple[Any, ...]) -> Any:
    """`Stage.each`."""
    return stage.leaf_by_leaf(how.function, *operands, *derived)


def _each_jvp(how: How, primals: Any, tangents: Any) -> Any:
    (stage, operands, derived), (_, changes, _) = primals, tangents
    changes, moving = moving_leaves(changes)
    results = each(how, stage, operands, derived)
    fields = _fields(operands, moving) if how.of_numbers else {}
    rest = [number for number in moving if number not in fields]
    found = jax.tree.map(jnp.zeros_like, results) if not moving else None
    with jax.named_scope(f"stage.{name_of(how.function)}.change"):
        if rest:
            found = _change(how, stage, operands, derived, results, changes, rest)
        if fields:
            directions = [changes[number] for number in fields]
            own = _change_by_fields(how, stage, operands, derived, results, directions, list(fields.values()))
            found = own if found is None else jax.tree.map(jnp.add, found, own)
    return results, found


def _fields(operands: Any, moving: list[int]) -> dict[int, int]:
    """Of the moving leaves those that are the same in all rows, and which planes they are."""
    found, number = {}, 0
    for place, plane in enumerate(jax.tree.leaves(operands, is_leaf=is_unstored)):
        leaves = jax.tree.leaves(plane)
        if number in moving and not is_unstored(plane) and plane.shape[-2] == 1:
            found[number] = place
        number += len(leaves)
    return found if len(found) <= MOST_RESULTS else {}


def _change_by_fields(
    how: How, stage: Boundary, operands: Any, derived: Any, results: Any, directions: list[Array], places: list[int]
) -> Any:
    """The change of the results by the planes in these places, the same in all rows."""

    def of_planes(moved: Any, operands: Any, derived: Any, results: Any) -> Any:
        if how.shared is None:
            return how.function(*moved, *derived)
        return how.function(*moved, *derived, how.shared(results, *operands, *derived))

    def change(known: tuple[Boundary, Any], directions: list[Array]) -> Any:
        operands, derived, results = stored(known[1])
        planes, tree = jax.tree.flatten(operands)

        def of_moving(*values: Array) -> Any:
            return of_planes(tree.unflatten(merged(planes, places, values)), operands, derived, results)

        return jax.jvp(of_moving, [planes[place] for place in places], directions)[1]

    def gradient(known: tuple[Boundary, Any], cotangents: Any) -> list[Array]:
        stage, given = known
        planes, tree = jax.tree.flatten(stored(given))

        def of_numbers(*numbers: Array) -> Any:
            given = tree.unflatten(numbers)
            return of_planes(given[0], *jax.lax.stop_gradient(given))

        return gradient_in_one_loop(stage, of_numbers, planes, places, cotangents)

    known = (stage, (operands, derived, results))
    return linear_stage(stage.always.astype(jnp.int32), [change], known, directions, gradient=gradient)


def _change(
    how: How, stage: Boundary, operands: Any, derived: Any, results: Any, changes: list[Array], moving: list[int]
) -> Any:
    """The change of the results by the moving leaves of the operands."""
    function, wide, shared, less, _ = how
    leaves, tree = jax.tree.flatten(operands)
    which, choices = stage.always.astype(jnp.int32), [derived]
    if shared is not None:
        planes = stage.leaf_by_leaf(shared, results, *operands, *derived)
        choices = [(*derived, planes)]
        if less is not None:
            needed, fewer = less(planes)
            lanes = stage(partial(jnp.sum, axis=-2), needed, name=f"{name_of(function)}.needed")
            which = jnp.where(jnp.any(lanes > 0), 2 * which, which)
            choices = [(*derived, fewer), (*derived, planes)]

    shape = jnp.broadcast_shapes(*(result.shape for result in jax.tree.leaves(results)))
    is_wide = [
        position in wide and not is_unstored(plane)
        for position, operand in enumerate(operands)
        for plane in jax.tree.leaves(operand, is_leaf=is_unstored)
        for _ in jax.tree.leaves(plane)
    ]

    def widened(number: int, plane: Array) -> Array:
        return jnp.broadcast_to(plane, shape) if is_wide[number] else plane

    directions = [widened(number, changes[number]) for number in moving]

    def change(choice: int, known: tuple[list[Array], list[Any]], directions: list[Array]) -> Any:
        leaves, derived = known[0], known[1][choice]

        def of_moving(*values: Array) -> Any:
            return function(*stored(tree.unflatten(merged(leaves, moving, values))), *derived)

        return jax.jvp(of_moving, [widened(number, leaves[number]) for number in moving], directions)[1]

    functions = [partial(change, choice) for choice in range(len(choices))]
    return linear_stage(which, functions, (leaves, choices), directions)


each.defjvp(_each_jvp, symbolic_zeros=True)


def name_of(function: Callable[..., Any]) -> str:
    """The name of the function, or of the one around a lambda."""
    names = getattr(function, "func", function).__qualname__.removesuffix(".<locals>.<lambda>")
    return names.rsplit(".", 1)[-1].lstrip("_")
