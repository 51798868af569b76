"""Planes that are not stored: whoever needs one computes it, or reads it where it lies."""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array


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


class Stacked(Unstored):
    """Planes one above the other, which are put together only where they are asked for as one."""

    planes: tuple[Array, ...]
    """All of the same shape; may be inlined themselves."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of all of them."""
        return (len(self.planes), *self.planes[0].shape)

    def stored(self) -> Array:
        """All planes, along a new leading axis."""
        return jnp.stack(stored(self.planes))


def stored(operands: Any) -> Any:
    """The pytree with all planes themselves."""
    return jax.tree.map(lambda leaf: leaf.stored() if is_unstored(leaf) else leaf, operands, is_leaf=is_unstored)


def is_unstored(value: Any) -> bool:
    """Whether it stands for planes."""
    return isinstance(value, Unstored)
