"""Tables of booleans that are static under jit: compared and hashed by content."""

from __future__ import annotations

from typing import Any

import numpy as np


class Flags:
    """An immutable array of booleans, hashable by content.

    Which lights are on, and which surfaces they may reach, changes the program, not its numbers: as static data it
    leaves a scene's leaves all floating-point, so that `jax.grad` takes a scene as it is.
    """

    __slots__ = ("_hash", "array")

    array: np.ndarray

    def __init__(self, values: Any) -> None:
        array = np.array(values, dtype=bool)
        array.setflags(write=False)
        self.array = array
        self._hash = hash((array.shape, array.tobytes()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Flags) and self._hash == other._hash and np.array_equal(self.array, other.array)

    def __hash__(self) -> int:
        return self._hash

    def __repr__(self) -> str:
        return f"Flags({np.array2string(self.array, threshold=8)})"
