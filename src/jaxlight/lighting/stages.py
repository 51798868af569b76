"""Boundaries between the stages of a tile, which XLA's CPU backend keeps as small vectorised loops.

Left alone, XLA fuses a tile's whole expression, and the slice that cuts the tile out of the buffer, into loops that it
evaluates element by element, several times over. It drops `lax.optimization_barrier` before it fuses, but never
moves work across a conditional whose predicate it cannot know. A stage with one result is one loop.

Profiles know a stage by the name of its function (`jax.named_scope`).
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Bool, Int

from .linear_stage import linear_stage, merged
from .loop_gradient import gradient_in_one_loop
from .one_loop import MOST_RESULTS
from .running_sum import running_sum

PLANE = 8192
"""Lights times samples that are evaluated at once: what a tile's planes may hold to stay in the cache."""


class Unstored(eqx.Module):
    """What stands for planes: `stored` gives them."""

    @abc.abstractmethod
    def stored(self) -> Any:
        """A plane, or a pytree of planes."""


class Inlined(Unstored):
    """A plane that is not stored: every stage that takes it computes it in its own loop.

    For what is as quickly computed as loaded, or lies in a large array: copied by a stage of its own, only that one
    loop would wait for memory.
    """

    function: Callable[..., Array] = eqx.field(static=True)
    """Closes over no traced value."""
    operands: tuple[Any, ...]
    """Of the function; some may be inlined themselves."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the plane."""
        return jax.eval_shape(self.stored).shape

    def stored(self) -> Array:
        """The plane."""
        return self.function(*stored(self.operands))


def stored(operands: Any) -> Any:
    """The pytree with all planes themselves."""
    return jax.tree.map(lambda leaf: leaf.stored() if is_unstored(leaf) else leaf, operands, is_leaf=is_unstored)


def is_unstored(value: Any) -> bool:
    """Whether it stands for planes."""
    return isinstance(value, Unstored)


def _shapes_of(function: Callable[..., Any], operands: tuple[Any, ...]) -> Any:
    return jax.eval_shape(lambda: function(*stored(operands)))


def with_change(function: Callable[..., Any], primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
    """function(*primals), and its change by those tangents that are not symbolic zeros."""
    leaves, tree = jax.tree.flatten(primals)
    changes, moving = _moving(tangents)

    def of_moving(*values: Array) -> Any:
        return function(*tree.unflatten(merged(leaves, moving, values)))

    return jax.jvp(of_moving, [leaves[number] for number in moving], [changes[number] for number in moving])


def change_of(function: Callable[..., Any], primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> Any:
    """The change of function(*primals) by those tangents that are not symbolic zeros."""
    return with_change(function, primals, tangents)[1]


def _moving(tangents: Any) -> tuple[list[Any], list[int]]:
    """The leaves of tangents, and which of them are no symbolic zeros."""
    changes = jax.tree.leaves(tangents, is_leaf=_is_zero)
    return changes, [number for number, change in enumerate(changes) if not _is_zero(change)]


class Stage(eqx.Module):
    """Evaluates functions behind a boundary; `always` is true, but only the running program knows."""

    always: Bool[Array, ""]
    stacks: ClassVar[bool] = True
    """Whether some stages read several components at once."""
    forward: bool = eqx.field(static=True, default=False)
    """Whether derivatives are only taken in forward mode, where none are summed over samples."""

    def __call__(self, function: Callable[..., Any], *operands: Any, name: str = "") -> Any:
        """function(*operands), a stage of its own; `name` (default: the function's) is for profiles."""
        return self._bounded(function, operands, _shapes_of(function, operands), name or _name(function))

    def most_lights(self, samples: int) -> int:
        """How many lights are evaluated at once for so many samples."""
        return max(1, PLANE // samples)

    def sum(self, term: Callable[[Any, Array], Any], total: Any, count: Int[Array, ""]) -> Any:
        """The sum of `total` (None: 0) and `count` terms: term(so far, number), or so far and term(None, number)."""
        own = running_sum(lambda number: stored(term(None, number)), count)
        return own if total is None else jax.tree.map(jnp.add, stored(total), own)

    def sum_over(self, term: Callable[[Any, Any], Any], total: Any, parts: Any) -> Any:
        """The sum of `total` (None: 0) and of a term for every part along the leading axis of `parts`, as `sum`."""
        first = jax.eval_shape(lambda: stored(term(None, jax.tree.map(lambda leaf: leaf[0], parts))))
        zeros = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), first)

        # Checkpoint: what derivatives need of a part is computed anew, and never stored for all.
        @jax.checkpoint
        def term_of(part: Any) -> Any:
            return stored(term(None, part))

        start = zeros if total is None else stored(total)
        return lax.scan(lambda total, part: (jax.tree.map(jnp.add, total, term_of(part)), None), start, parts)[0]

    def together(self, function: Callable[..., Any], in_range: Any, *operands: Any) -> Any:
        """function(self, in_range, *operands), whose stages may be put into one: here they are not."""
        return function(self, in_range, *operands)

    def leaf_by_leaf(self, function: Callable[..., Any], *operands: Any) -> Any:
        """function(*operands), each result a stage of its own."""
        shapes, tree = jax.tree_util.tree_flatten_with_path(_shapes_of(function, operands))

        def result(number: int) -> Array:
            path, shape = shapes[number]
            name = _name(function) + jax.tree_util.keystr(path)
            return self._bounded(lambda *given: jax.tree.leaves(function(*given))[number], operands, shape, name)

        return tree.unflatten([result(number) for number in range(len(shapes))])

    def _bounded(self, function: Callable[..., Any], operands: tuple[Any, ...], shapes: Any, name: str) -> Any:
        def never() -> Any:
            # Zeros, made of `always`: XLA takes two equal stages for one only if both branches are given something.
            return jax.tree.map(lambda shape: jnp.full(shape.shape, self.always, shape.dtype), shapes)

        with jax.named_scope(f"stage.{name}"):
            return lax.cond(self.always, lambda: function(*stored(operands)), never)

    def each(
        self,
        function: Callable[..., Any],
        *operands: Any,
        derived: tuple[Any, ...] = (),
        wide: tuple[int, ...] = (),
        shared: Callable[..., Any] | None = None,
        less: Callable[[Any], tuple[Array, Any]] | None = None,
        of_numbers: bool = False,
    ) -> Any:
        """function(*operands, *derived), each result a stage of its own; all their derivatives are one more stage.

        Derivatives are computed anew from the operands: only operands and results are ever stored.

        Args:
            function: closes over no traced value.
            operands: pytrees of planes, some of them `Inlined`.
            derived: what follows from the operands, and whose change `function` already counts with theirs.
            wide: positions of smaller operands whose derivatives are summed over samples in stages of their own. XLA
                vectorises a sum only if what it adds up is a short expression.
            shared: shared(results, *operands, *derived) gives planes that derivatives by several operands share, each
                a stage of its own; XLA would compute them once for every operand. For derivatives `function` is given
                them as one more of `derived`.
            less: less(what is shared) gives a plane that is positive where that is needed and else 0, and what does as
                well, with less to compute, if it is needed nowhere.
            of_numbers: function is one of numbers, element by element of planes. Gradients by what all rows have in
                common are then one loop.
        """
        how = _How(function, () if self.forward else wide, shared, less, of_numbers and not self.forward)
        return _each(how, self, operands, derived)


class _How(NamedTuple):
    """What is static of `Stage.each`."""

    function: Callable[..., Any]
    wide: tuple[int, ...]
    shared: Callable[..., Any] | None
    less: Callable[..., Any] | None
    of_numbers: bool


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _each(how: _How, stage: Stage, operands: tuple[Any, ...], derived: tuple[Any, ...]) -> Any:
    return stage.leaf_by_leaf(how.function, *operands, *derived)


def _each_jvp(how: _How, primals: Any, tangents: Any) -> Any:
    (stage, operands, derived), (_, changes, _) = primals, tangents
    changes, moving = _moving(changes)
    results = _each(how, stage, operands, derived)
    fields = _fields(operands, moving) if how.of_numbers else {}
    rest = [number for number in moving if number not in fields]
    found = jax.tree.map(jnp.zeros_like, results) if not moving else None
    with jax.named_scope(f"stage.{_name(how.function)}.change"):
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
    how: _How, stage: Stage, operands: Any, derived: Any, results: Any, directions: list[Array], places: list[int]
) -> Any:
    """The change of the results by the planes in these places, the same in all rows."""

    def of_planes(moved: Any, operands: Any, derived: Any, results: Any) -> Any:
        if how.shared is None:
            return how.function(*moved, *derived)
        return how.function(*moved, *derived, how.shared(results, *operands, *derived))

    def change(known: tuple[Stage, Any], directions: list[Array]) -> Any:
        operands, derived, results = stored(known[1])
        planes, tree = jax.tree.flatten(operands)

        def of_moving(*values: Array) -> Any:
            return of_planes(tree.unflatten(merged(planes, places, values)), operands, derived, results)

        return jax.jvp(of_moving, [planes[place] for place in places], directions)[1]

    def gradient(known: tuple[Stage, Any], cotangents: Any) -> list[Array]:
        stage, given = known
        planes, tree = jax.tree.flatten(stored(given))

        def of_numbers(*numbers: Array) -> Any:
            given = tree.unflatten(numbers)
            return of_planes(given[0], *jax.lax.stop_gradient(given))

        return gradient_in_one_loop(stage, of_numbers, planes, places, cotangents)

    known = (stage, (operands, derived, results))
    return linear_stage(stage.always.astype(jnp.int32), [change], known, directions, gradient=gradient)


def _change(
    how: _How, stage: Stage, operands: Any, derived: Any, results: Any, changes: list[Array], moving: list[int]
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
            lanes = stage(partial(jnp.sum, axis=-2), needed, name=f"{_name(function)}.needed")
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


_each.defjvp(_each_jvp, symbolic_zeros=True)


def _name(function: Callable[..., Any]) -> str:
    """The name of the function, or of the one around a lambda."""
    names = getattr(function, "func", function).__qualname__.removesuffix(".<locals>.<lambda>")
    return names.rsplit(".", 1)[-1].lstrip("_")


def _is_zero(value: Any) -> bool:
    return isinstance(value, SymbolicZero)
