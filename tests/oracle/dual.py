"""Numbers that carry their first and second derivatives forward, sparsely, over any kind of scalar.

The scalar is whatever supports + - * /: an mpmath number, or a NumPy array with one element a case. Inputs are
numbered; a derivative that is absent is zero.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Pair = tuple[int, int]


class Dual:
    """`value`, `gradient[i]` = d/dx_i and, in second order, `hessian[i, j]` (i <= j) = d2/dx_i dx_j (else None)."""

    __slots__ = ("gradient", "hessian", "value")

    def __init__(self, value: Any, gradient: dict[int, Any] | None = None, hessian: dict[Pair, Any] | None = None):
        self.value = value
        self.gradient = {} if gradient is None else gradient
        self.hessian = hessian

    @classmethod
    def variable(cls, value: Any, index: int, one: Any, order: int) -> Dual:
        """Input number `index`; `one` is 1 in the scalar's kind; `order` 0, 1 or 2."""
        return cls(value, {index: one} if order else {}, {} if order == 2 else None)

    def chain(self, value: Any, first: Any, second: Any) -> Dual:
        """f(self), given f's value and its first and second derivative there."""
        gradient = {i: first * g for i, g in self.gradient.items()}
        if self.hessian is None:
            return Dual(value, gradient)
        hessian = {pair: first * h for pair, h in self.hessian.items()}
        slopes = sorted(self.gradient.items())
        for a, (i, g) in enumerate(slopes):
            bent = second * g
            for j, k in slopes[a:]:
                _add(hessian, (i, j), bent * k)
        return Dual(value, gradient, hessian)

    def __add__(self, other: Any) -> Dual:
        if not isinstance(other, Dual):
            return Dual(self.value + other, self.gradient, self.hessian)
        return Dual(
            self.value + other.value, _sum(self.gradient, other.gradient), _sum_or_none(self.hessian, other.hessian)
        )

    __radd__ = __add__

    def __neg__(self) -> Dual:
        return self.scaled(-1)

    def __sub__(self, other: Any) -> Dual:
        return self + (-other)

    def __rsub__(self, other: Any) -> Dual:
        return (-self) + other

    def scaled(self, factor: Any) -> Dual:
        """Times a constant."""
        hessian = None if self.hessian is None else {pair: factor * h for pair, h in self.hessian.items()}
        return Dual(factor * self.value, {i: factor * g for i, g in self.gradient.items()}, hessian)

    def __mul__(self, other: Any) -> Dual:
        if not isinstance(other, Dual):
            return self.scaled(other)
        gradient = _sum(_times(self.gradient, other.value), _times(other.gradient, self.value))
        if self.hessian is None and other.hessian is None:
            return Dual(self.value * other.value, gradient)
        hessian = _sum(_times(self.hessian or {}, other.value), _times(other.hessian or {}, self.value))
        for i, g in self.gradient.items():
            for j, k in other.gradient.items():
                product = g * k
                _add(hessian, (i, j) if i <= j else (j, i), product + product if i == j else product)
        return Dual(self.value * other.value, gradient, hessian)

    __rmul__ = __mul__

    def reciprocal(self) -> Dual:
        """1 / self."""
        inverse = 1 / self.value
        square = inverse * inverse
        return self.chain(inverse, -square, 2 * square * inverse)

    def __truediv__(self, other: Any) -> Dual:
        return self * (other.reciprocal() if isinstance(other, Dual) else 1 / other)

    def constant(self) -> Dual:
        """The value alone, without its derivatives."""
        return Dual(self.value, {}, None if self.hessian is None else {})

    def map_value(self, value: Any) -> Dual:
        """Another value with the same derivatives (to step over a point where a formula fails)."""
        return Dual(value, self.gradient, self.hessian)

    def map(self, function: Callable[[Any], Any]) -> Dual:
        """`function` of the value and of every derivative."""
        hessian = None if self.hessian is None else {pair: function(h) for pair, h in self.hessian.items()}
        return Dual(function(self.value), {i: function(g) for i, g in self.gradient.items()}, hessian)


Vector = tuple[Dual, Dual, Dual]


def dot(a: Vector, b: Vector) -> Dual:
    """The dot product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """The cross product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def plus(a: Vector, b: Vector) -> Vector:
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a: Vector, b: Vector) -> Vector:
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def times(a: Vector, factor: Any) -> Vector:
    """The vector times a number."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def _times(terms: dict, factor: Any) -> dict:
    return {key: term * factor for key, term in terms.items()}


def _sum(a: dict, b: dict) -> dict:
    """The sum of two sparse derivatives, as a new dictionary."""
    total = dict(a)
    for key, term in b.items():
        _add(total, key, term)
    return total


def _sum_or_none(a: dict | None, b: dict | None) -> dict | None:
    return None if a is None and b is None else _sum(a or {}, b or {})


def _add(terms: dict, key: Any, term: Any) -> None:
    terms[key] = terms[key] + term if key in terms else term
