"""Stages with several results and the derivatives of all of them.

Only what a stage is given and gives is ever stored: derivatives compute anew what they need.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jaxtyping import Array

from .changes import is_zero, merged, moves, with_change, without_zeros
from .linear_stage import linear_stage
from .own_sums import spread
from .pruned import pruned
from .unstored import is_unstored, stored

Forms = Sequence[Callable[..., Any]]
"""The only form of a function, or two: for ordinary tiles, and with care."""


class Boundary(Protocol):
    """A `Stage`, which knows nothing of derivatives."""

    def which(self, forms: int) -> Array: ...

    def of_forms(self, forms: Forms, *operands: Any) -> Any: ...


class StageKind(NamedTuple):
    """What is static of `Stage.each`."""

    function: Callable[..., Any]
    wide: tuple[int, ...]
    shared: Callable[..., Any] | None
    has_forms: bool
    forward: bool
    derive: Callable[..., tuple[Any, ...]] | None

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


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def each(how: StageKind, stage: Boundary, operands: tuple[Any, ...], derived: tuple[Any, ...]) -> Any:
    """`Stage.each`."""
    if how.derive is not None:
        derived = how.derive(stage, *operands)
    return stage.of_forms(how.forms, *operands, *derived)


def _each_jvp(how: StageKind, primals: Any, tangents: Any) -> Any:
    (stage, operands, derived), (_, changes, _) = primals, tangents
    if how.derive is not None:  # here, where nothing moves: its change is counted with that of the operands
        derived, how = how.derive(stage, *operands), how._replace(derive=None)
    results = each(how, stage, operands, derived)
    if not moves(changes):
        return results, jax.tree.map(jnp.zeros_like, results)
    directions = directions_of(operands, changes, inlined=how.forward)
    return results, change_along(how, stage, operands, derived, results, *directions)


def directions_of(operands: Any, changes: Any, *, inlined: bool = False) -> tuple[list[int], list[Any]]:
    """Which of the operands' planes move, and how.

    `inlined`: the directions of planes that are not stored are no planes either, but those of what they follow from.
    """
    pairs = list(zip(_planes(operands), _planes(changes), strict=True))
    moving = [number for number, (_, change) in enumerate(pairs) if moves(change)]
    if inlined:
        return moving, [without_zeros(pairs[n][1]) for n in moving]
    # Of planes that are not stored, too: derivatives by the array that one lies in would compute the stage anew for
    # every part of that.
    return moving, [with_change(stored, pairs[n][:1], pairs[n][1:])[1] for n in moving]


def change_along(
    how: StageKind, stage: Boundary, operands: Any, derived: Any, results: Any, moving: list[int], directions: list[Any]
) -> Any:
    """The change of the results by those planes of the operands that move, see `directions_of`, behind a boundary.

    Args:
        how: derives nothing.
        operands, derived, results: planes, or what stands for planes.
    """
    with jax.named_scope(f"stage.{name_of(how.function)}.change"):
        return _change(how, stage, operands, derived, results, moving, directions)


def _change(
    how: StageKind, stage: Boundary, operands: Any, derived: Any, results: Any, moving: list[int], directions: list[Any]
) -> Any:
    inside = how.shared_forms
    if how.forward and inside is not None:
        # Many directions share it. Each plane is a stage of its own: some directions ask for none.
        derived, inside = (*derived, _each_by_itself(stage, inside, (results, *operands, *derived))), None
    shapes = [result.shape for result in jax.tree.leaves(jax.eval_shape(lambda: stored(results)))]
    shape: tuple[int, ...] = np.broadcast_shapes(*shapes)
    is_wide = [position in how.wide for position, own in enumerate(operands) for _ in jax.tree.leaves(stored(own))]

    def widened(number: int, plane: Any) -> Any:
        return spread(plane, shape) if is_wide[number] else plane

    def change(form: int, known: tuple[Any, Any, Any], directions: list[Any]) -> Any:
        if how.forward:
            own = [_planes(known[0])[number] for number in moving]
            directions = [with_change(stored, pair[:1], pair[1:])[1] for pair in zip(own, directions, strict=True)]
        operands, derived, results = stored(known)
        planes, tree = jax.tree.flatten(operands)
        shared = () if inside is None else (inside[form](results, *tree.unflatten(planes), *derived),)

        def of_moving(*values: Array) -> Any:
            return how.forms[form](*tree.unflatten(merged(planes, moving, values)), *derived, *shared)

        return jax.jvp(of_moving, [widened(number, planes[number]) for number in moving], directions)[1]

    wide = [widened(number, direction) for number, direction in zip(moving, directions, strict=True)]
    changes_of = [partial(change, form) for form in range(len(how.forms))]
    known = (operands, derived, results if inside else None)
    return linear_stage(stage.which(len(changes_of)), changes_of, known, wide)


def _each_by_itself(stage: Boundary, forms: Forms, operands: tuple[Any, ...]) -> Any:
    traced = [jax.make_jaxpr(form, return_shape=True)(*jax.eval_shape(stored, operands)) for form in forms]
    shapes, tree = jax.tree.flatten(traced[0][1])

    def plane(jaxpr: ClosedJaxpr, *operands: Any) -> Array:
        return jaxpr_as_fun(jaxpr)(*jax.tree.leaves(operands))[0]

    def own_plane(number: int) -> Array:
        return stage.of_forms([partial(plane, pruned(jaxpr, number)) for jaxpr, _ in traced], *operands)

    return tree.unflatten(map(own_plane, range(len(shapes))))


def _planes(operands: Any) -> list[Any]:
    """Planes, what stands for planes, and symbolic zeros."""
    return jax.tree.leaves(operands, is_leaf=lambda leaf: is_unstored(leaf) or is_zero(leaf))


each.defjvp(_each_jvp, symbolic_zeros=True)


def name_of(function: Callable[..., Any]) -> str:
    """The name of the function, or of the one around a lambda."""
    while isinstance(function, partial):
        function = function.func
    names = function.__qualname__.removesuffix(".<locals>.<lambda>")
    return names.rsplit(".", 1)[-1].lstrip("_")
