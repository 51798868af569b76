"""Stages put together into loops over samples, for colours that are not differentiated.

A loop evaluates the functions of its stages for one sample after the other and keeps all that is between them in
registers; planes that go from stage to stage have to go through the cache. For a GPU the same functions, number by
number, are operations on planes, of which XLA makes such loops by itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Self, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array, Float, Int

from ..processor import for_cpu
from .clusters import Arrangement, InRows
from .one_loop import in_one_loop, on_planes
from .stages import Stage
from .unstored import Stacked, Unstored, is_unstored, stored

UNROLLED = 8
"""Lights that one loop evaluates: it holds the code for each of them."""


class SideBySide(Unstored):
    """Planes as a loop over samples writes them: all numbers of a sample side by side."""

    numbers: Float[Array, "rows lanes numbers"]
    shapes: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """Of the leaves, without rows and lanes."""
    tree: Any = eqx.field(static=True)

    def stored(self) -> Any:
        """The planes, [rows, lanes] behind the axes of each leaf."""
        leaves, first = [], 0
        for shape in self.shapes:
            own = self.numbers[..., first : first + math.prod(shape)]
            leaves.append(jnp.moveaxis(own, -1, 0).reshape(*shape, *own.shape[:2]))
            first += math.prod(shape)
        return self.tree.unflatten(leaves)


class SampleLoops(Stage):
    """Puts stages together into loops over samples; nothing is differentiated."""

    stacks: ClassVar[bool] = False
    clusters: ClassVar[type[Arrangement]] = InRows
    lanes: int = eqx.field(static=True, kw_only=True)

    @property
    def in_planes(self) -> Stage:
        return Stage(self.always, ordinary=self.ordinary)

    def on_lanes(self, numbers: Any, lanes: int) -> Any:
        return numbers

    def lights_at_once(self, lights: int, samples: int) -> int:
        return UNROLLED

    def sum(self, term: Callable[[Any, Array], Any], total: Any, count: Int[Array, ""] | int) -> Any:
        if isinstance(count, int) and count == 1:
            return term(total, jnp.zeros((), jnp.int32))
        if total is None:
            shapes = jax.eval_shape(lambda: term(None, jnp.zeros((), jnp.int32)))
            total = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
        return lax.fori_loop(0, count, lambda number, total: term(total, number), total)

    def sum_over(self, term: Callable[[Self, Any, Any], Any], total: Any, parts: Any) -> Any:
        def with_part(total: Any, number: Array) -> Any:
            part = jax.tree.map(lambda leaf: lax.dynamic_index_in_dim(leaf, number, keepdims=False), parts)
            return term(self, total, part)

        return self.sum(with_part, total, jax.tree.leaves(parts)[0].shape[0])

    def together(self, function: Callable[..., Any], *operands: Any) -> Any:
        """function(stage, *operands) in one loop; gives `SideBySide`, or planes where these are quicker.

        Operands and results are pytrees of arrays [..., rows or 1, lanes or 1].
        """
        shapes = jax.eval_shape(lambda: stored(operands))
        rows = max(leaf.shape[-2] for leaf in jax.tree.leaves(shapes))
        single = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((*leaf.shape[:-2], 1, 1), leaf.dtype), shapes)

        def of_sample(ordinary: bool, operands: tuple[Any, ...]) -> Any:
            return stored(function(_Inside(cast(Array, True), ordinary=ordinary), *operands))

        results = jax.eval_shape(partial(of_sample, True), single)
        leaves, tree = jax.tree.flatten(results)
        shapes, shape = tuple(leaf.shape[:-2] for leaf in leaves), (rows, self.lanes)
        count = sum(map(math.prod, shapes))

        def program(ordinary: bool) -> ClosedJaxpr:
            return jax.make_jaxpr(lambda given: jax.tree.leaves(of_sample(ordinary, given)))(single)

        def never() -> Array:
            return jnp.full((*shape, count), self.unreached(), leaves[0].dtype)

        def loop(ordinary: bool) -> Array:
            return in_one_loop(program(ordinary), _single_planes(operands), shape)

        with jax.named_scope(f"loop.{getattr(function, 'func', function).__name__.lstrip('_')}"):
            if not for_cpu():
                planes = iter(on_planes(program(False), _single_planes(operands), shape))
                own = [jnp.stack([next(planes) for _ in range(math.prod(s))]).reshape(*s, *shape) for s in shapes]
                return tree.unflatten(own)
            numbers = lax.switch(self.which(2), [lambda: loop(True), lambda: loop(False), never])
        return SideBySide(numbers, shapes, tree)


def _single_planes(operands: Any) -> list[Float[Array, "#rows #lanes"]]:
    """The planes of all numbers of the operands.

    Each is cut out of its array by itself: what several shared, XLA would make a function of, and LLVM not see that
    what it reads never changes.
    """
    planes = []
    for leaf in jax.tree.leaves(operands, is_leaf=is_unstored):
        if isinstance(leaf, Stacked):
            planes += _single_planes(leaf.planes)
        elif isinstance(leaf, SideBySide):
            planes += [leaf.numbers[..., k] for k in range(leaf.numbers.shape[-1])]
        else:
            array = stored(leaf)
            planes += [array[index] for index in np.ndindex(array.shape[:-2])]
    return planes


class _Inside(Stage):
    """Stages inside of a loop: none. It is known which form is evaluated."""

    def lights_at_once(self, lights: int, samples: int) -> int:
        return UNROLLED

    def __call__(self, function: Callable[..., Any], *operands: Any, name: str = "") -> Any:
        return function(*stored(operands))

    def each(
        self,
        function: Callable[..., Any],
        *operands: Any,
        derived: tuple[Any, ...] = (),
        derive: Callable[..., tuple[Any, ...]] | None = None,
        has_forms: bool = False,
        **for_derivatives: Any,
    ) -> Any:
        form = partial(function, ordinary=self.ordinary) if has_forms else function
        derived = derived if derive is None else derive(self, *operands)
        return form(*stored(operands), *stored(derived))
