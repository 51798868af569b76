"""Boundaries between the stages of a tile, which XLA's CPU backend keeps as small vectorised loops.

Left alone, XLA fuses a tile's whole expression, and the slice that cuts the tile out of the buffer, into loops that it
evaluates element by element, several times over. It drops `lax.optimization_barrier` before it fuses, but never
moves work across a conditional whose predicate it cannot know. The results of a stage come from one loop (`at_once`).
A GPU has no such caches, and waits where a program has to decide: for it there is no boundary, and of two forms of a
function always that with care.

Profiles know a stage by the name of its function (`jax.named_scope`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

from ..processor import for_cpu, sizes
from . import own_sums
from .at_once import at_once
from .clusters import Arrangement, InLanes
from .running_sum import running_sum
from .stage_derivatives import Forms, StageKind, each, name_of
from .unstored import stored

LOOPS_ARE_HOISTED = jax.__version_info__ >= (0, 11)
"""Whether XLA may make one function of a loop and all that it holds. Sorts are compiled one by one: only then."""


class Stage(eqx.Module):
    """Evaluates functions behind a boundary; `always` is true, but only the running program knows."""

    always: Bool[Array, ""]
    ordinary: Bool[Array, ""] | bool = eqx.field(default=False, kw_only=True)
    """Whether functions of which there are two forms are evaluated in that without care (see `ordinary`)."""
    stacks: ClassVar[bool] = True
    """Whether some stages read several components at once."""
    clusters: ClassVar[type[Arrangement]] = InLanes
    forward: bool = eqx.field(static=True, default=False, kw_only=True)
    """Whether derivatives are only taken in forward mode, where none are summed over samples."""

    def __call__(self, function: Callable[..., Any], *operands: Any, name: str = "") -> Any:
        """function(*operands), a stage of its own; `name` (default: the function's) is for profiles."""
        return self._bounded([function], operands, name or name_of(function))

    def which(self, forms: int) -> Int[Array, ""]:
        """Which of so many forms is evaluated, from 0 on: of two that for ordinary tiles or the one with care.

        None of them, `forms`, as far as XLA knows; it never happens.
        """
        form = jnp.where(self.ordinary, 0, 1) if forms == 2 else 0
        return jnp.where(self.always, form, forms)

    @property
    def in_planes(self) -> Stage:
        """For what is kept as planes."""
        return self

    def on_lanes(self, numbers: Any, lanes: int) -> Any:
        """Numbers of a tile, on one lane each, as they are differentiated by: in reverse mode on all lanes, so that
        derivatives add up lane by lane first."""
        if self.forward:
            return numbers
        return jax.tree.map(lambda plane: own_sums.spread(plane, (*plane.shape[:-1], lanes)), numbers)

    def unreached(self) -> Bool[Array, ""]:
        """A value for branches that are never taken.

        For later releases of JAX it is sorted: XLA would make one function of a loop over tiles that holds no sort, in
        which it reads every number as if it could have changed, and many loops are slower.
        """
        return lax.sort(jnp.stack([self.always, ~self.always]))[0] if LOOPS_ARE_HOISTED else self.always

    def lights_at_once(self, lights: int, samples: int) -> int:
        """How many of so many lights are evaluated at once for so many samples."""
        limits = sizes()
        most = limits.lights if lights * samples <= limits.largest_plane else max(1, limits.chunk // samples)
        return min(lights, most)

    def sum(self, term: Callable[[Any, Array], Any], total: Any, count: Int[Array, ""] | int) -> Any:
        """The sum of `total` (None: 0) and `count` terms: term(so far, number), or so far and term(None, number)."""

        def own_term(number: Array) -> Any:
            return stored(term(None, number))

        one = isinstance(count, int) and count == 1
        own = own_term(jnp.zeros((), jnp.int32)) if one else running_sum(own_term, jnp.asarray(count, jnp.int32))
        return own if total is None else jax.tree.map(jnp.add, stored(total), own)

    def sum_over(self, term: Callable[[Self, Any, Any], Any], total: Any, parts: Any) -> Any:
        """The sum of `total` (None: 0) and of a term for every part along the leading axis of `parts`, as `sum`:
        term(stage, so far, part)."""
        first = jax.eval_shape(lambda: stored(term(self, None, jax.tree.map(lambda leaf: leaf[0], parts))))
        zeros = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), first)

        # Checkpoint: what derivatives need of a part is computed anew, and never stored for all.
        @jax.checkpoint
        def term_of(number: Array, part: Any) -> Any:
            # Stages that are known before the loop JAX would take apart: planes of their constants would be stored.
            own = dataclasses.replace(self, always=self.always & (number >= 0))
            return stored(term(own, None, part))

        def with_term(total: Any, numbered: tuple[Array, Any]) -> tuple[Any, None]:
            return jax.tree.map(jnp.add, total, term_of(*numbered)), None

        numbers = jnp.arange(jax.tree.leaves(parts)[0].shape[0])
        return lax.scan(with_term, zeros if total is None else stored(total), (numbers, parts))[0]

    def together(self, function: Callable[..., Any], *operands: Any) -> Any:
        """function(self, *operands), whose stages may be put into one: here they are not."""
        return function(self, *operands)

    def of_forms(self, forms: Forms, *operands: Any) -> Any:
        """The form of the function that is asked for, of the operands, a stage whose results are computed at once."""

        def results(form: Callable[..., Any], *given: Any) -> Any:
            leaves, tree = jax.tree.flatten(form(*given))
            return tree.unflatten(at_once(leaves))

        own = [partial(results, form) for form in forms]
        return self._bounded(own, operands, name_of(forms[-1]))

    def _bounded(self, forms: Forms, operands: tuple[Any, ...], name: str) -> Any:
        if not for_cpu():
            with jax.named_scope(f"stage.{name}"):
                return forms[-1](*stored(operands))
        found: list[Any] = []

        def noted(form: Callable[..., Any], *given: Any) -> Any:
            results = jax.tree.map(jnp.asarray, form(*stored(given)))
            found.append(jax.tree.map(lambda plane: jax.ShapeDtypeStruct(plane.shape, plane.dtype), results))
            return results

        def never(*_: Any) -> Any:
            # Zeros, made of `always`: XLA takes two equal stages for one only if both branches are given something.
            value = self.unreached()
            return jax.tree.map(lambda like: jnp.full(like.shape, value, like.dtype), found[0])

        with jax.named_scope(f"stage.{name}"):
            # Last what is never taken: only then is it known what it has to give.
            branches = [*(partial(noted, form) for form in forms), never]
            return lax.switch(self.which(len(forms)), branches, *operands)

    def each(
        self,
        function: Callable[..., Any],
        *operands: Any,
        derived: tuple[Any, ...] = (),
        derive: Callable[..., tuple[Any, ...]] | None = None,
        wide: tuple[int, ...] = (),
        shared: Callable[..., Any] | None = None,
        has_forms: bool = False,
    ) -> Any:
        """function(*operands, *derived), a stage whose results are computed at once; their derivatives are one more.

        Derivatives are computed anew from the operands: only operands and results are ever stored.

        Args:
            function: closes over no traced value.
            operands: pytrees of planes, some of them `Inlined`.
            derived: what follows from the operands, and whose change `function` already counts with theirs.
            derive: derive(self, *operands) gives `derived`, in stages of its own.
            wide: positions of smaller operands whose derivatives are planes too, which are summed over samples
                afterwards. XLA vectorises a sum only if what it adds up is a short expression.
            shared: shared(results, *operands, *derived) gives planes for derivatives, to which `function` is given
                them as one more of `derived`.
            has_forms: function and what is shared take a keyword `ordinary`: there are two forms of them.
        """
        how = self.how(function, derive=derive, wide=wide, shared=shared, has_forms=has_forms)
        return each(how, self, operands, derived)

    def how(
        self,
        function: Callable[..., Any],
        *,
        derive: Callable[..., tuple[Any, ...]] | None = None,
        wide: tuple[int, ...] = (),
        shared: Callable[..., Any] | None = None,
        has_forms: bool = False,
    ) -> StageKind:
        """What is static of `each` with these arguments."""
        return StageKind(function, () if self.forward else wide, shared, has_forms, self.forward, derive)
