"""One exact evaluation's memory: which inputs it read, which comparisons it made, where no derivative is defined."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from mpmath import mp, mpf

from .case import Case, Fog, Light
from .dual import Dual, Vector, cross, dot, minus, times
from .paths import Path, get

Kind = Literal["kink", "jump", "cone", "underflow"]


@dataclass(frozen=True)
class Decision:
    """A comparison that the equation makes: it went one way because `margin` > 0, or the other.

    `kind`: across it the value jumps ("jump"), or is continuous with a jump of the derivative ("kink"); at a "cone"
    there is no derivative at all (the tip of |x|, an infinite slope). "underflow" is no comparison of the equation: a
    margin that a format may lose (see `ulp.underflow_threshold`) may as well be taken for 0. `slopes[i]` bounds how
    fast the margin moves with input i; `rounding`: it is a sum of numbers near 1 and so moves by an ulp of 1 even if
    no input does; `exponent`: a power of it is taken, which has no condition near 0 until its slope underflows.
    """

    name: str
    kind: Kind
    margin: Any
    slopes: dict[int, Any]
    rounding: bool = False
    exponent: Any = None


class Tape:
    """Numbers the inputs as they are read; records decisions and singular inputs."""

    def __init__(self, case: Case, order: int, ties: Mapping[str, bool]):
        self.case, self.order, self.ties = case, order, ties
        self.inputs: dict[Path, Dual] = {}
        self.decisions: dict[str, Decision] = {}
        self.singular: set[int] = set()
        self.needs_more_digits = False

    def number(self, *path: str | int) -> Dual:
        """The input at a path (a float, or an mpmath number)."""
        if path not in self.inputs:
            self.inputs[path] = Dual.variable(mpf(get(self.case, path)), len(self.inputs), mpf(1), self.order)
        return self.inputs[path]

    def vector(self, *path: str | int) -> Vector:
        """Three inputs."""
        return self.number(*path, 0), self.number(*path, 1), self.number(*path, 2)

    def constant(self, value: Any) -> Dual:
        """A number without derivatives."""
        return Dual(mpf(value), {}, {} if self.order == 2 else None)

    def decide(
        self,
        name: str,
        kind: Kind,
        margin: Any,
        slopes: dict[int, Any],
        *,
        at_tie: bool = False,
        rounding: bool = False,
        exponent: Any = None,
    ) -> bool:
        """True if the margin is positive, `at_tie` if it is 0; recorded."""
        bounds = {i: abs(slope) for i, slope in slopes.items()}
        self.decisions[name] = Decision(name, kind, margin, bounds, rounding, exponent)
        return self.ties.get(name, at_tie if margin == 0 else margin > 0)

    def compare(self, name: str, kind: Kind, margin: Dual) -> bool:
        """True if the margin is positive; recorded."""
        return self.decide(name, kind, margin.value, margin.gradient)

    def length(self, name: str, kind: Kind, vector: Vector, *, rounding: bool = False) -> Dual | None:
        """|vector|, or None for the zero vector, whose inputs become singular [19]."""
        square = dot(vector, vector)
        root = mp.sqrt(square.value)
        slopes = length_slopes(vector)
        self.decide(name, kind, root, slopes, rounding=rounding)
        if root == 0:
            self.decide(f"{name} is zero", "cone", root, slopes)
            self.singular.update(slopes)
            return None
        return square.chain(root, 1 / (2 * root), -1 / (4 * square.value * root))

    def distance(self, name: str, vector: Vector) -> Dual:
        """|vector| as a number: 0 is nothing special but for the derivative."""
        return self.length(name, "cone", vector) or self.constant(0)

    def to_world(self, owner: Path, node: Light | Fog, vector: Vector) -> Vector:
        """A vector of the node's coordinate system in the world."""
        if node.frame is None:
            return vector
        x, y, z = (dot(self.vector(*owner, "frame", row), vector) for row in range(3))
        return x, y, z

    def to_local(self, owner: Path, node: Light | Fog, vector: Vector) -> Vector:
        """A world vector in the node's coordinate system, by Cramer's rule."""
        if node.frame is None:
            return vector
        rows = [self.vector(*owner, "frame", row) for row in range(3)]
        adjugate = [cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])]
        x, y, z = (sum((adjugate[j][k] * vector[j] for j in range(1, 3)), adjugate[0][k] * vector[0]) for k in range(3))
        return times((x, y, z), dot(rows[0], adjugate[0]).reciprocal())

    def world_offset(self, owner: Path, node: Light | Fog, vector: Vector) -> Vector:
        """The vector minus the origin of the node's coordinate system."""
        if node.frame is None:
            return vector
        x, y, z = (self.number(*owner, "frame", row, 3) for row in range(3))
        return minus(vector, (x, y, z))


def length_slopes(vector: Vector, factor: Any = 1) -> dict[int, Any]:
    """By input, how fast the vector can move (and so its length): the length of its partial derivative."""
    inputs = set().union(*(part.gradient for part in vector))
    return {i: factor * mp.sqrt(sum(part.gradient.get(i, 0) ** 2 for part in vector)) for i in inputs}


def sum_slopes(a: dict[int, Any], b: dict[int, Any]) -> dict[int, Any]:
    """The sum of two bounds on how fast something moves."""
    return {i: abs(a.get(i, 0)) + abs(b.get(i, 0)) for i in {*a, *b}}


def exp(x: Dual) -> Dual:
    """e^x."""
    value = mp.exp(x.value)
    return x.chain(value, value, value)


def exp_minus_one(x: Dual) -> Dual:
    """e^x - 1 with all its digits near 0."""
    value = mp.exp(x.value)
    return x.chain(mp.expm1(x.value), value, value)


def log(x: Dual) -> Dual:
    """The natural logarithm."""
    inverse = 1 / x.value
    return x.chain(mp.log(x.value), inverse, -inverse * inverse)


def angle_between(a: Vector, b: Vector) -> Dual:
    """The angle between two vectors; at 0 and pi, where it has no derivative, one of 0."""
    w = cross(a, b)
    square = dot(w, w)
    along = dot(a, b)
    if square.value == 0:
        return along.constant().map(lambda value: mp.pi if value < 0 else mpf(0))
    root = mp.sqrt(square.value)
    sine = square.chain(root, 1 / (2 * root), -1 / (4 * square.value * root))
    angle = mp.atan2(root, along.value)
    # The derivatives are those of atan(s / c) or of pi / 2 - atan(c / s): the better-behaved quotient.
    ratio, sign = (sine / along, 1) if abs(along.value) > root else (along / sine, -1)
    t = ratio.value
    slope = sign / (1 + t * t)
    return ratio.chain(angle, slope, -2 * t * slope / (1 + t * t))
