"""Numbers from Python and NumPy, checked and as arrays of NumPy and JAX."""

from __future__ import annotations

import datetime
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .tracing import refuse_traced


def array_of(values: Any, dtype: Any) -> Array:
    """`jnp.asarray(values, dtype)` of numbers that are known: NumPy rounds them, and for JAX a conversion would be a
    program for each shape, to be compiled first."""
    with np.errstate(over="ignore"):
        rounded = np.asarray(values, dtype)
    return jnp.asarray(rounded, dtype)


_NO_NUMBERS = (str, bytes, complex, datetime.date, datetime.timedelta, type(None))
"""Of which NumPy makes numbers all the same."""
FILL = "fill them first: array.filled(0)"
"""What to do about masked numbers where nothing takes a mask; and where something does:"""
GIVE_MASK = "give its data, and False where it is masked as mask="


def refuse_masked(where: str, value: Any, instead: str = FILL) -> None:
    """Raise ValueError for a NumPy array of which something is masked: as plain numbers it would count again."""
    if np.ma.is_masked(value):
        masked = f"{np.ma.count_masked(value)} of whose {np.size(value)} numbers are masked"
        raise ValueError(f"{where}: got a masked array, {masked}; {instead}")


def known_numbers(where: str, value: Any, allowed: str = "real numbers", *, instead: str = FILL) -> np.ndarray:
    """Real numbers or truth values that somebody gives, of whatever type; raises ValueError that names what they are.

    NumPy alone would take real parts, read texts, count days and drop masks.
    """
    refuse_masked(where, value, instead)
    try:
        array = _as_given(value)
        if array.dtype.kind == "O" and not any(isinstance(number, _NO_NUMBERS) for number in array.flat):
            array = array.astype(np.float64)  # integers that no integer type holds, decimals, numbers of JAX
        if jnp.issubdtype(array.dtype, jnp.floating) and array.dtype.kind != "f":
            array = array.astype(np.float32)  # bfloat16, of which NumPy knows nothing
        if array.dtype.kind not in "biuf":
            raise TypeError
        # In a type that JAX knows, too: of this machine's order of bytes, and of at most 64 bits.
        own = np.float64 if array.dtype == np.longdouble else array.dtype.newbyteorder("=")
        with np.errstate(over="ignore"):
            array = array.astype(own, copy=False)
    except (TypeError, ValueError, OverflowError):
        refuse_traced(where, value)
        raise ValueError(f"{where}: expected {allowed}, got {' '.join(repr(value).split()):.60}") from None
    return array


def _as_given(value: Any) -> np.ndarray:
    """An array of NumPy's choice; of objects where it finds none, as for a list of JAX's bfloat16."""
    try:
        return np.asarray(value)
    except TypeError:
        return np.asarray(value, dtype=object)


def real_array(where: str, value: Any) -> Array:
    """Real numbers that somebody gives, traced or not; raises ValueError that names what they are."""
    refuse_masked(where, value)
    with np.errstate(over="ignore"):
        try:
            array = jnp.asarray(value)
        except (TypeError, ValueError, OverflowError):
            array = jnp.asarray(known_numbers(where, value, "real numbers"))
    if jnp.iscomplexobj(array):
        raise ValueError(f"{where}: expected real numbers, got {array.dtype}")
    return array
