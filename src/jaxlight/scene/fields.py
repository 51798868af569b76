"""The value checks of node fields: each takes (where, value), returns the canonical value or raises ValueError.

`where` names the field (`Material[body].diffuse_color`) for the message.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..arrays import known_numbers
from ..given import plain


def with_article(name: str) -> str:
    """`a Box`, `an Appearance`."""
    return f"{'an' if name[:1].lower() in 'aeiou' else 'a'} {name}"


def _refusal(where: str, value: Any, allowed: str) -> ValueError:
    shown = np.array2string(value, threshold=6) if isinstance(value, np.ndarray) else repr(value)
    in_one_line = " ".join(map(str.strip, shown.splitlines()))
    return ValueError(f"{where}: expected {allowed}, got {in_one_line[:80]}")


def _misshapen(where: str, array: np.ndarray, allowed: str) -> ValueError:
    return ValueError(f"{where}: expected {allowed}, got an array of shape {list(array.shape)}")


def _floats(where: str, value: Any, shape: tuple[int, ...], allowed: str) -> np.ndarray:
    array = known_numbers(where, value, allowed).astype(np.float64)
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise _refusal(where, value, allowed)
    return array


def _rows(where: str, value: Any, columns: int, allowed: str) -> np.ndarray:
    array = np.array(known_numbers(where, value, allowed), dtype=np.float64)
    if array.size == 0:
        array = np.zeros((0, columns))
    if array.ndim != 2 or array.shape[1] != columns:
        raise _misshapen(where, array, allowed)
    finite = np.all(np.isfinite(array), axis=1)
    if not np.all(finite):
        row = int(np.argmin(finite))
        raise ValueError(f"{_refusal(where, array[row], allowed)} in row {row}")
    array.setflags(write=False)
    return array


def number(
    where: str,
    value: Any,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    at_most: float = math.inf,
    below: float = math.inf,
    infinite: bool = False,
) -> float:
    """One number in the given range; finite unless `infinite`."""
    bounds = []
    bounds += [f"> {above:g}"] if above > -math.inf else []
    bounds += [f">= {at_least:g}"] if at_least > -math.inf else []
    bounds += [f"<= {at_most:g}"] if at_most < math.inf else []
    bounds += [f"< {below:g}"] if below < math.inf else []
    allowed = " ".join(["a number" if infinite else "a finite number", " and ".join(bounds)]).strip()
    array = known_numbers(where, value, allowed)
    if array.shape != () or array.dtype == bool:
        raise _refusal(where, value, allowed)
    x = float(array)
    if math.isnan(x) or (math.isinf(x) and not infinite) or not (at_least <= x <= at_most):
        raise _refusal(where, value, allowed)
    if not (x > above or above == -math.inf) or not (x < below or below == math.inf):
        raise _refusal(where, value, allowed)
    return x


def unit_interval(where: str, value: Any) -> float:
    """One number in [0, 1]."""
    return number(where, value, at_least=0.0, at_most=1.0)


def non_negative(where: str, value: Any) -> float:
    """One number >= 0."""
    return number(where, value, at_least=0.0)


def reach(where: str, value: Any) -> float:
    """One number >= 0, or infinity."""
    return number(where, value, at_least=0.0, infinite=True)


def positive(where: str, value: Any) -> float:
    """One number > 0."""
    return number(where, value, above=0.0)


def whole(where: str, value: Any, *, at_least: int, at_most: int | None = None, what: str = "a whole number") -> int:
    """One whole number in the given range."""
    allowed = f"{what} >= {at_least}" if at_most is None else f"{what} in [{at_least}, {at_most}]"
    try:
        n = operator.index(value)
    except TypeError:
        raise _refusal(where, value, allowed) from None
    if isinstance(value, bool) or n < at_least or (at_most is not None and n > at_most):
        raise _refusal(where, value, allowed)
    return n


def integer(where: str, value: Any) -> int:
    """One whole number."""
    x = number(where, value)
    if x != int(x):
        raise _refusal(where, value, "a whole number")
    return int(x)


def type_or_own(dtype: jnp.dtype | None) -> jnp.dtype:
    """What `float_type` gives, with JAX's own type for None."""
    return jnp.result_type(float) if dtype is None else dtype


def largest_of(dtype: Any) -> float:
    """The largest number of a float type; None: JAX's own type."""
    return float(jnp.finfo(type_or_own(dtype)).max)


_FLOATS = tuple(map(jnp.dtype, (jnp.float64, jnp.float32, jnp.float16, jnp.bfloat16)))


def float_type(where: str, value: Any) -> jnp.dtype | None:
    """A type of floating-point numbers that shading takes and JAX now has; None, JAX's own, stays."""
    allowed = f"a floating-point type such as 'float32' (one of {', '.join(dtype.name for dtype in _FLOATS)})"
    try:
        dtype = None if value is None else jnp.dtype(value)
    except (TypeError, ValueError):
        raise _refusal(where, value, allowed) from None
    if dtype is not None and dtype not in _FLOATS:
        raise _refusal(where, value, allowed)
    if dtype == np.float64 and not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise _refusal(where, value, 'a type that JAX has now (float64: jax.config.update("jax_enable_x64", True))')
    return dtype


def spot_angle(where: str, value: Any) -> float:
    """An angle in (0, pi/2] radians; a few float32 ulp above pi/2 (files write 1.570796 and 1.5708) become pi/2."""
    angle = number(where, value, above=0.0, at_most=math.pi / 2 + 1e-4)
    return min(angle, math.pi / 2)


def boolean(where: str, value: Any) -> bool:
    """True or False."""
    own = plain(value)
    if not isinstance(own, bool):
        raise _refusal(where, value, "True or False")
    return own


def string(where: str, value: Any) -> str:
    """A string."""
    own = plain(value)
    if not isinstance(own, str):
        raise _refusal(where, value, "a string")
    return own


def strings(where: str, value: Any) -> tuple[str, ...]:
    """Strings; a single one counts as a list of one."""
    if not isinstance(value, (str, list, tuple)):
        raise _refusal(where, value, "a string or a list of them")
    return tuple(string(where, each) for each in ((value,) if isinstance(value, str) else value))


def choice(*words: str) -> Callable[[str, Any], str]:
    """A check for one of the given words."""

    def check(where: str, value: Any) -> str:
        own = plain(value)
        if not isinstance(own, str) or own not in words:
            raise _refusal(where, value, " or ".join(repr(word) for word in words))
        return own

    return check


def rising_angles(where: str, value: Any) -> tuple[float, ...]:
    """Angles >= 0 in radians of which none is smaller than the one before it; a single one counts as a list of one."""
    each = np.atleast_1d(known_numbers(where, value, "numbers >= 0")).tolist()
    angles = tuple(non_negative(where, angle) for angle in each)
    if list(angles) != sorted(angles):
        raise _refusal(where, value, "angles that do not decrease")
    return angles


def vector2(where: str, value: Any) -> tuple[float, float]:
    """Two finite numbers."""
    x, y = _floats(where, value, (2,), "2 finite numbers").tolist()
    return x, y


def vector3(
    where: str, value: Any, *, at_least: float = -math.inf, above: float = -math.inf, what: str = "3 finite numbers"
) -> tuple[float, float, float]:
    """Three finite numbers, each in range."""
    what += f" >= {at_least:g}" if at_least > -math.inf else ""
    what += f" > {above:g}" if above > -math.inf else ""
    array = _floats(where, value, (3,), what)
    if np.any(array < at_least) or (above > -math.inf and np.any(array <= above)):
        raise _refusal(where, value, what)
    x, y, z = array.tolist()
    return x, y, z


def factors(where: str, value: Any) -> tuple[float, float, float]:
    """Three finite numbers >= 0."""
    return vector3(where, value, at_least=0.0)


def lengths(where: str, value: Any) -> tuple[float, float, float]:
    """Three finite numbers > 0."""
    return vector3(where, value, above=0.0)


def direction(where: str, value: Any) -> tuple[float, float, float]:
    """Three finite numbers; need not have length 1 (it is normalised where it is used)."""
    return vector3(where, value)


def color(where: str, value: Any) -> tuple[float, float, float]:
    """Three numbers in [0, 1]."""
    array = _floats(where, value, (3,), "3 numbers in [0, 1]")
    if np.any((array < 0) | (array > 1)):
        raise _refusal(where, value, "3 numbers in [0, 1]")
    r, g, b = array.tolist()
    return r, g, b


def axis_angle(where: str, value: Any) -> tuple[float, float, float, float]:
    """An axis and an angle in radians."""
    x, y, z, angle = _floats(where, value, (4,), "4 finite numbers (axis x, y, z and angle in radians)").tolist()
    if x == y == z == 0.0 and angle != 0.0:
        raise _refusal(where, value, "an axis that is not zero")
    return x, y, z, angle


def rgb_rows(where: str, value: Any) -> np.ndarray:
    """Colours [n, 3] in [0, 1]."""
    return _color_rows(where, value, 3)


def rgba_rows(where: str, value: Any) -> np.ndarray:
    """Colours [n, 4] in [0, 1]."""
    return _color_rows(where, value, 4)


def _color_rows(where: str, value: Any, columns: int) -> np.ndarray:
    allowed = f"colours of shape [n, {columns}] in [0, 1]"
    array = _rows(where, value, columns, allowed)
    if np.any((array < 0) | (array > 1)):
        raise _refusal(where, array, allowed)
    return array


def vector2_rows(where: str, value: Any) -> np.ndarray:
    """Vectors [n, 2]."""
    return _rows(where, value, 2, "finite numbers of shape [n, 2]")


def vector3_rows(where: str, value: Any) -> np.ndarray:
    """Vectors [n, 3]."""
    return _rows(where, value, 3, "finite numbers of shape [n, 3]")


def index_list(where: str, value: Any) -> np.ndarray:
    """A flat list of indices >= -1 (-1 ends a face)."""
    allowed = "a flat list of integers >= -1"
    array = known_numbers(where, value, allowed)
    if array.size == 0:
        array = np.zeros(0, dtype=np.int64)
    if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer) or np.any(array < -1):
        raise _refusal(where, array, allowed)
    if np.any(array > np.iinfo(np.int64).max):
        raise _refusal(where, array, f"{allowed} and below {2**63}")
    array = array.astype(np.int64)
    array.setflags(write=False)
    return array


def texture_image(where: str, value: Any) -> np.ndarray | None:
    """None, or an image [height, width, 1 to 4 components] of values in [0, 1], row 0 at the bottom.

    What nobody can change is kept as it is: textures of one picture share it.
    """
    if value is None:
        return None
    allowed = "an image of shape [height, width, 1 to 4] with values in [0, 1]"
    array = value if _is_fixed(value) else np.array(known_numbers(where, value, allowed), dtype=np.float64)
    if array.ndim != 3 or array.shape[2] not in (1, 2, 3, 4) or array.size == 0:
        raise _misshapen(where, array, allowed)
    if not np.all((array >= 0) & (array <= 1)):
        raise _refusal(where, array, allowed)
    array.setflags(write=False)
    return array


def _is_fixed(value: Any) -> bool:
    """Whether these are double-precision numbers of an array of their own that nobody writes to."""
    if type(value) is not np.ndarray or value.dtype != np.float64:
        return False
    return value.flags.owndata and not value.flags.writeable
