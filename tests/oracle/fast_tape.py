"""Many cases of one shape at once: columns of 80-bit floats with forward derivatives, and distances of decisions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .case import Case, Fog, Light
from .dual import Dual, Vector, cross, dot, minus, times
from .paths import Path, float_paths, get
from .ulp import FORMATS, input_ulp, underflow_threshold

WIDE = np.longdouble
if np.finfo(WIDE).nmant < 63:
    raise ImportError("oracle.fast_exact needs 80-bit (or wider) long doubles, which this processor's NumPy lacks")

ONE = WIDE(1)


class Columns:
    """The inputs of cases that differ only in numbers: `values[i]` is input `paths[i]` of each of them."""

    def __init__(self, cases: Sequence[Case]):
        self.template = cases[0]
        self.paths: list[Path] = float_paths(self.template)
        self.index = {path: i for i, path in enumerate(self.paths)}
        self.values = np.array([[get(case, path) for path in self.paths] for case in cases], dtype=WIDE).T
        self.count = len(cases)

    def replaced(self, i: int, values: np.ndarray) -> Columns:
        """The same with another column i."""
        other = object.__new__(Columns)
        other.__dict__.update(self.__dict__)
        other.values = self.values.copy()
        other.values[i] = values
        return other


class FastTape:
    """One evaluation over columns.

    `distances[kind]` is, a case, the distance in ulp of the nearest decision of that kind (orders 1 and 2 only).
    `flip`: names of kinks whose decisions are turned over in the cases that are closer to them than `flip_within`.
    """

    def __init__(
        self,
        columns: Columns,
        order: int,
        precision: int,
        flip: frozenset[str] = frozenset(),
        flip_within: float = 0.0,
    ):
        self.columns, self.order = columns, order
        self.flip, self.flip_within = flip, flip_within
        self.case = columns.template
        self.ulps = input_ulp(columns.values, precision) if order else None
        self.ulp_of_one = input_ulp(1.0, precision)
        self.precision = precision
        self.distances = {kind: np.full(columns.count, np.inf) for kind in ("jump", "kink", "cone")}
        self.kinks: dict[str, np.ndarray] = {}
        self.powers_lost: list[str] = []
        self.may_lose = np.zeros(columns.count, dtype=bool)
        """In which cases `powers_lost` are, or a factor is flushed to zero, that second derivatives multiply."""
        self.active: Any = np.True_
        """Where what is being computed matters; elsewhere its decisions do not count."""

    def number(self, *path: str | int) -> Dual:
        """The input at a path."""
        i = self.columns.index[path]
        return Dual.variable(self.columns.values[i], i, ONE, self.order)

    def vector(self, *path: str | int) -> Vector:
        """Three inputs."""
        return self.number(*path, 0), self.number(*path, 1), self.number(*path, 2)

    def constant(self, value: Any) -> Dual:
        """The same number in every case."""
        return Dual(WIDE(value), {}, {} if self.order == 2 else None)

    def decide(
        self,
        kind: str,
        margin: Any,
        slopes: dict[int, Any],
        name: str = "",
        where: Any = np.True_,
        rounding: bool = False,
        room: Any = 0.0,
    ) -> np.ndarray:
        """margin > 0, a case; its distance is noted where `where` and `active` hold. A kink has a name to flip.

        `room`: the margin counts as so much larger.
        """
        positive = np.broadcast_to(margin > 0, (self.columns.count,))
        if self.ulps is None:
            return positive
        reach = sum((np.abs(slope) * self.ulps[i] for i, slope in slopes.items()), start=WIDE(0))
        if rounding:
            reach = reach + self.ulp_of_one
        with np.errstate(all="ignore"):
            unreachable = np.inf if kind == "jump" else np.where(margin == 0, 0, np.inf)
            distance = np.where(reach > 0, (np.abs(margin) + room) / reach, unreachable)
        distance = np.where(where & self.active, distance, np.inf).astype(np.float64)
        self.distances[kind] = np.minimum(self.distances[kind], distance)
        if kind == "kink":
            self.kinks[name] = distance
            if name in self.flip:
                positive = positive ^ (distance < self.flip_within)
        return positive

    def underflow(self, name: str, x: Dual) -> Dual:
        """x, or 0 where it may underflow and is chosen (by `flip`) to be lost."""
        lost = (x.value > 0) & (x.value < underflow_threshold(self.precision)) & self.active
        if np.any(lost):
            self.powers_lost.append(name)
            self.may_lose |= lost
        return select(lost, self.constant(0), x) if name in self.flip else x

    def flushed(self, x: Dual, where: Any) -> None:
        """Notes in which cases x may be flushed to zero: of what is multiplied by it, even by 1e10, nothing is left."""
        self.may_lose |= where & (x.value > 0) & (x.value < np.finfo(FORMATS[self.precision]).tiny)

    def length(
        self, kind: str, vector: Vector, *, tiny: float = 0.0, where: Any = np.True_, rounding: bool = False
    ) -> Dual:
        """|vector|; 0, without derivatives, up to `tiny`."""
        square = dot(vector, vector)
        zero = square.value <= WIDE(tiny) ** 2
        safe = np.where(zero, ONE, square.value)
        root = np.sqrt(safe)
        slopes = self.length_slopes(vector)
        self.decide(kind, np.where(zero, 0, root), slopes, where=where, rounding=rounding)
        self.decide("cone", np.where(zero, 0, root), slopes, where=where & zero)
        nonzero = square.chain(root, 1 / (2 * root), -1 / (4 * safe * root))
        return select(zero, self.constant(0), nonzero)

    def length_slopes(self, vector: Vector, factor: Any = 1) -> dict[int, Any]:
        """By input, how fast the vector can move."""
        inputs = set().union(*(part.gradient for part in vector))
        return {i: factor * np.sqrt(sum(part.gradient.get(i, ONE * 0) ** 2 for part in vector)) for i in inputs}

    def to_world(self, owner: Path, node: Light | Fog, vector: Vector) -> Vector:
        """A vector of the node's coordinate system in the world."""
        if node.frame is None:
            return vector
        x, y, z = (dot(self.vector(*owner, "frame", row), vector) for row in range(3))
        return x, y, z

    def to_local(self, owner: Path, node: Light | Fog, vector: Vector) -> Vector:
        """A world vector in the node's coordinate system: the columns' reciprocal vectors."""
        if node.frame is None:
            return vector
        a, b, c = (
            (
                self.number(*owner, "frame", 0, k),
                self.number(*owner, "frame", 1, k),
                self.number(*owner, "frame", 2, k),
            )
            for k in range(3)
        )
        inverse = dot(a, cross(b, c)).reciprocal()
        x, y, z = (dot(cross(p, q), vector) for p, q in ((b, c), (c, a), (a, b)))
        return times((x, y, z), inverse)

    def world_offset(self, owner: Path, node: Light | Fog, vector: Vector) -> Vector:
        """The vector minus the origin of the node's coordinate system."""
        if node.frame is None:
            return vector
        x, y, z = (self.number(*owner, "frame", row, 3) for row in range(3))
        return minus(vector, (x, y, z))


def select(mask: Any, yes: Dual, no: Dual) -> Dual:
    """`yes` where the mask holds, else `no`, with its derivatives."""

    def merged(a: dict, b: dict) -> dict:
        return {key: np.where(mask, a.get(key, 0), b.get(key, 0)) for key in {**a, **b}}

    second = None
    if yes.hessian is not None or no.hessian is not None:
        second = merged(yes.hessian or {}, no.hessian or {})
    return Dual(np.where(mask, yes.value, no.value), merged(yes.gradient, no.gradient), second)


def safe_reciprocal(x: Dual) -> Dual:
    """1 / x, and 0 without derivatives where x is 0."""
    zero = x.value == 0
    return select(zero, Dual(WIDE(0)), x.map_value(np.where(zero, ONE, x.value)).reciprocal())


def sum_slopes(a: dict[int, Any], b: dict[int, Any]) -> dict[int, Any]:
    """The sum of two bounds on how fast something moves."""
    return {i: np.abs(a.get(i, 0)) + np.abs(b.get(i, 0)) for i in {*a, *b}}


def exp(x: Dual) -> Dual:
    """e^x."""
    value = np.exp(x.value)
    return x.chain(value, value, value)


def exp_minus_one(x: Dual) -> Dual:
    """e^x - 1 with all its digits near 0."""
    value = np.exp(x.value)
    return x.chain(np.expm1(x.value), value, value)


def log(x: Dual) -> Dual:
    """The natural logarithm."""
    inverse = 1 / x.value
    return x.chain(np.log(x.value), inverse, -inverse * inverse)


def arc_tangent(sine: Dual, cosine: Dual) -> Dual:
    """atan2 of two numbers that are not both 0; derivatives through the smaller of the two over the larger."""
    s, c = sine.value, cosine.value
    angle = np.arctan2(s, c)
    steep = np.abs(c) < np.abs(s)
    above = cosine * sine.map_value(np.where(steep, s, ONE)).reciprocal()
    below = sine * cosine.map_value(np.where(steep, ONE, c)).reciprocal()

    def through(ratio: Dual, sign: int) -> Dual:
        t = ratio.value
        slope = sign / (1 + t * t)
        return ratio.chain(angle, slope, -2 * t * slope / (1 + t * t))

    return select(steep, through(above, -1), through(below, 1))
