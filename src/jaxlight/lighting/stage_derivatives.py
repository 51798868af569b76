"""Stages with several results, each a loop of its own, and the derivatives of all of them.

Only what a stage is given and gives is ever stored: derivatives compute anew what they need.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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

Forms = Sequence[Callable[..., Any]]
"""The only form of a function, or two: for ordinary tiles, and with care."""


class Boundary(Protocol):
    """A `Stage`, which knows nothing of derivatives."""

    always: Array

    @property
    def which(self) -> Array: ...

    def __call__(self, function: Callable[..., Any], *operands: Any, name: str = "") -> Any: ...

    def leaf_by_leaf(self, forms: Forms, *operands: Any) -> Any: ...


class How(NamedTuple):
    """What is static of `Stage.each`."""

    function: Callable[..., Any]
    wide: tuple[int, ...]
    shared: Callable[..., Any] | None
    has_forms: bool
    of_numbers: bool

    @property
    def forms(self) -> Forms:
        """Of the function."""
        return self._forms_of(self.function)

    @property
    def shared_forms(self) -> Forms | None:
        """Of what is shared."""
        return None if self.shared is None else self._forms_of(self.shared)

    def _forms_of(self, function: Callable[..., Any]) -> Forms:
        return [partial(function, ordinary=ordinary) for ordinary in (True, False)] if self.has_forms else [function]

    def which(self, stage: Boundary) -> Array:
        """Which of the forms is evaluated, counted from 1."""
        return stage.which if self.has_forms else stage.always.astype(jnp.int32)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def each(how: How, stage: Boundary, operands: tuple[Any, ...], derived: tuple[Any, ...]) -> Any:
    """`Stage.each`."""
    return stage.leaf_by_leaf(how.forms, *operands, *derived)


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

    def of_planes(form: int, moved: Any, operands: Any, derived: Any, results: Any) -> Any:
        function, shared = how.forms[form], how.shared_forms
        if shared is None:
            return function(*moved, *derived)
        return function(*moved, *derived, shared[form](results, *operands, *derived))

    def change(form: int, known: tuple[Boundary, Any], directions: list[Array]) -> Any:
        operands, derived, results = stored(known[1])
        planes, tree = jax.tree.flatten(operands)

        def of_moving(*values: Array) -> Any:
            return of_planes(form, tree.unflatten(merged(planes, places, values)), operands, derived, results)

        return jax.jvp(of_moving, [planes[place] for place in places], directions)[1]

    def gradient(form: int, known: tuple[Boundary, Any], cotangents: Any) -> list[Array]:
        stage, given = known
        planes, tree = jax.tree.flatten(stored(given))

        def of_numbers(*numbers: Array) -> Any:
            given = tree.unflatten(numbers)
            return of_planes(form, given[0], *jax.lax.stop_gradient(given))

        return gradient_in_one_loop(stage, of_numbers, planes, places, cotangents)

    known, forms = (stage, (operands, derived, results)), range(len(how.forms))
    changes, gradients = ([partial(function, form) for form in forms] for function in (change, gradient))
    return linear_stage(how.which(stage), changes, known, directions, gradients=gradients)


def _change(
    how: How, stage: Boundary, operands: Any, derived: Any, results: Any, changes: list[Array], moving: list[int]
) -> Any:
    """The change of the results by the moving leaves of the operands."""
    leaves, tree = jax.tree.flatten(operands)
    if how.shared_forms is not None:
        derived = (*derived, stage.leaf_by_leaf(how.shared_forms, results, *operands, *derived))
    shape = jnp.broadcast_shapes(*(result.shape for result in jax.tree.leaves(results)))
    is_wide = [
        position in how.wide and not is_unstored(plane)
        for position, operand in enumerate(operands)
        for plane in jax.tree.leaves(operand, is_leaf=is_unstored)
        for _ in jax.tree.leaves(plane)
    ]

    def widened(number: int, plane: Array) -> Array:
        return jnp.broadcast_to(plane, shape) if is_wide[number] else plane

    directions = [widened(number, changes[number]) for number in moving]

    def change(form: Callable[..., Any], known: tuple[list[Array], Any], directions: list[Array]) -> Any:
        leaves, derived = known

        def of_moving(*values: Array) -> Any:
            return form(*stored(tree.unflatten(merged(leaves, moving, values))), *derived)

        return jax.jvp(of_moving, [widened(number, leaves[number]) for number in moving], directions)[1]

    changes_of = [partial(change, form) for form in how.forms]
    return linear_stage(how.which(stage), changes_of, (leaves, derived), directions)


each.defjvp(_each_jvp, symbolic_zeros=True)


def name_of(function: Callable[..., Any]) -> str:
    """The name of the function, or of the one around a lambda."""
    while isinstance(function, partial):
        function = function.func
    names = function.__qualname__.removesuffix(".<locals>.<lambda>")
    return names.rsplit(".", 1)[-1].lstrip("_")
