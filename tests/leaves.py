"""Trees of arrays, compared array by array."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np


def same_leaves(found: Any, wanted: Any) -> bool:
    """Whether two trees have as many arrays, one at least, and the same to the last bit."""
    pairs = list(zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True))
    return bool(pairs) and all(np.array_equal(one, other) for one, other in pairs)


def assert_leaves_close(found: Any, wanted: Any, digits: float, *, least: float = 1.0) -> None:
    """To `digits` of the largest number of each array, or of `least` where that is larger."""
    pairs = list(zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True))
    assert pairs
    for one, other in pairs:
        size = float(np.max(np.abs(other), initial=least))
        np.testing.assert_allclose(one, other, rtol=0, atol=digits * size)
