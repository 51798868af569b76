"""Triangles of one shape, in its own coordinates: what most geometry nodes become."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..scene.flatness import are_flat


@dataclasses.dataclass(frozen=True, eq=False)
class Triangles:
    """T triangles, corners counterclockwise seen from the front; every attribute is given at the corners (float64)."""

    position: np.ndarray
    """[T, 3 corners, 3]."""
    normal: np.ndarray
    """[T, 3 corners, 3], any length, as the equation is to interpolate them."""
    texcoord: np.ndarray
    """[T, 3 corners, 2]."""
    color: np.ndarray | None = None
    """[T, 3 corners, 3 or 4], or None."""

    @classmethod
    def none(cls) -> Triangles:
        """Of what draws nothing."""
        empty = np.zeros((0, 3, 3))
        return cls(empty, empty, empty[..., :2])

    def __len__(self) -> int:
        return len(self.position)

    def select(self, keep: np.ndarray) -> Triangles:
        """The triangles of a boolean mask or index list."""
        return Triangles(
            self.position[keep],
            self.normal[keep],
            self.texcoord[keep],
            None if self.color is None else self.color[keep],
        )

    def without_degenerate(self) -> Triangles:
        """Without triangles that have no area: two corners coincide, or all three lie on a line."""
        flat = are_flat(self.position)
        return self.select(~flat) if np.any(flat) else self
