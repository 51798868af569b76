"""What somebody gives, in the form of Python's own: scalars of NumPy and JAX, one thing or several of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import jax
import numpy as np
from jax.core import Tracer


def plain(value: Any) -> Any:
    """A scalar of NumPy, or an array without axes whose content is known, as Python has it; all else as it is."""
    is_array = isinstance(value, (np.generic, np.ndarray, jax.Array))
    if is_array and value.ndim == 0 and not isinstance(value, (Tracer, np.ma.MaskedArray)):
        return value.item()
    return value


def several(given: Any) -> list[Any]:
    """What is given alone, text for example, or in a list or whatever else gives one after the other."""
    given = plain(given)
    is_alone = isinstance(given, (str, bytes)) or not isinstance(given, Iterable) or getattr(given, "ndim", 1) == 0
    return [given] if is_alone else list(given)
