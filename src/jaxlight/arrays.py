"""Numbers from Python and NumPy as JAX arrays."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


def array_of(values: Any, dtype: Any) -> Array:
    """`jnp.asarray(values, dtype)` of numbers that are known: NumPy rounds them, and for JAX a conversion would be a
    program for each shape, to be compiled first."""
    with np.errstate(over="ignore"):
        rounded = np.asarray(values, dtype)
    return jnp.asarray(rounded, dtype)


def real_array(where: str, value: Any) -> Array:
    """Real numbers that somebody gives, traced or not; raises ValueError that names what they are."""
    try:
        array = jnp.asarray(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{where}: expected real numbers, got {value!r:.60}") from None
    if jnp.iscomplexobj(array):
        raise ValueError(f"{where}: expected real numbers, got {array.dtype}")
    return array
