"""How sensitive a case is: the yardstick for errors in floating point.

**Condition number** of a value f with inputs x_i (every float of the case that is read, frames included), in a format:

    condition = max(1, sum_i max(|f(x_i + ulp) - f|, |f(x_i - ulp) - f|) / ulp(f))

each input moved alone to its neighbours in the format (see `ulp`: zeros stay, subnormals may also become zero), f at
full precision. An algorithm that is right for slightly wrong inputs has an error of a few ulp times the condition.

**Condition number of a derivative** g = df/dx_k: the same of g, or to first order

    condition = max(1, sum_i |d2f/dx_k dx_i| ulp(x_i) / ulp(g))

which is quicker, and too small where the first order vanishes: near L = -V with N, L and V in one plane, say.

**Well-conditioned**: condition at most 1000, and every jump at least 16 ulp away. The distance of a decision is
|margin| / sum_i |d margin / dx_i| ulp(x_i): the number of ulps by which all inputs would have to conspire to turn it.
(L + V is a sum of rounded unit vectors, so its length moves by one ulp of 1 besides. A vector written as zeros cannot
move: its zero is no accident, and what follows from it is well-conditioned.)

**Differentiable**: well-conditioned, and points without any derivative are 16 ulp away, too. At and near kinks every
value within `exact.gradient_bounds` is right. A power (N.H)^n below smallest normal number / epsilon (float32: 2^-103)
may lose its digits: multiplied by ordinary factors it underflows, while its slopes may stay above.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .case import Case
from .exact import Exact, evaluate
from .paths import Path, get, put
from .tape import Decision
from .ulp import input_ulp, neighbours, output_ulp, underflow_threshold, underflowing_base

MAX_CONDITION = 1000.0
MIN_DISTANCE = 16.0


@dataclass(frozen=True)
class Conditioning:
    """Condition number of each channel (red, green, blue, alpha), and each decision's kind and distance in ulp."""

    condition: tuple[float, float, float, float]
    decisions: dict[str, tuple[str, float]]

    def nearest(self, *kinds: str) -> float:
        """Distance in ulp of the nearest decision of these kinds; infinite if there is none."""
        return min((distance for kind, distance in self.decisions.values() if kind in kinds), default=np.inf)

    @property
    def well_conditioned(self) -> bool:
        """True if values can be asked to be right to a few ulp times the condition."""
        return max(self.condition) <= MAX_CONDITION and self.nearest("jump") >= MIN_DISTANCE

    @property
    def differentiable(self) -> bool:
        """True if derivatives can be asked for, too (at kinks: within bounds)."""
        return self.well_conditioned and self.nearest("cone") >= MIN_DISTANCE


def condition(case: Case, precision: int = 32) -> Conditioning:
    """The case's conditioning in float32 or float64."""
    exact = evaluate(case, 1)
    moved = [0.0] * 4
    for path in exact.inputs:
        value = float(get(case, path))
        others = {float(x) for x in neighbours(value, precision)} - {value}
        ends = [evaluate(put(case, path, other)).rgba for other in others]
        for c in range(4):
            moved[c] += max((abs(end[c] - exact.rgba[c]) for end in ends), default=0)
    r, g, b, a = (_condition(moved[c], exact.rgba[c], precision) for c in range(4))
    distances = {d.name: (d.kind, distance(d, case, exact, precision)) for d in exact.decisions}
    return Conditioning((r, g, b, a), distances)


def gradient_condition(case: Case, precision: int = 32) -> dict[Path, tuple[float, float, float, float]]:
    """The condition number of the derivative of each channel by each input; meant for differentiable cases."""
    exact = evaluate(case, 2)
    moved = {path: [0.0] * 4 for path in exact.inputs}
    ulps = {path: float(input_ulp(get(case, path), precision)) for path in exact.inputs}
    for (p, q), second in exact.hessian.items():
        for c in range(4):
            moved[p][c] += abs(second[c]) * ulps[q]
            if p != q:
                moved[q][c] += abs(second[c]) * ulps[p]
    return _conditions(moved, exact, precision)


def moved_gradient_condition(case: Case, precision: int = 32) -> dict[Path, tuple[float, float, float, float]]:
    """`gradient_condition` not to first order but by moving every input; next to kinks, that of the worse side."""
    is_near = near_ties(case, precision)
    kinks = [d for d in evaluate(case, 1).decisions if d.kind == "kink"]
    near = [is_near(d) for d in kinks]
    worst: dict[Path, tuple[float, float, float, float]] = {}
    for side in (False, True) if any(near) else (False,):
        sides = {d.name: side if here else d.margin > 0 for d, here in zip(kinks, near, strict=True)}
        for path, own in _moved_condition(case, precision, sides).items():
            r, g, b, a = (max(pair) for pair in zip(own, worst.get(path, own), strict=True))
            worst[path] = r, g, b, a
    return worst


def _moved_condition(
    case: Case, precision: int, sides: Mapping[str, bool]
) -> dict[Path, tuple[float, float, float, float]]:
    exact = evaluate(case, 1, ties=sides)
    none = (0.0,) * 4
    moved = {path: [0.0] * 4 for path in exact.inputs}
    for path in exact.inputs:
        value = float(get(case, path))
        others = {float(x) for x in neighbours(value, precision)} - {value}
        ends = [evaluate(put(case, path, other), 1, ties=sides).gradient for other in others]
        for p, gradient in exact.gradient.items():
            for c in range(4):
                moved[p][c] += max((abs(end.get(p, none)[c] - gradient[c]) for end in ends), default=0)
    return _conditions(moved, exact, precision)


def distance(decision: Decision, case: Case, exact: Exact, precision: int = 32) -> float:
    """How many ulps the inputs are away from turning the decision; a jump that no input can reach is infinitely far."""
    ulps = ((slope, input_ulp(get(case, exact.inputs[i]), precision)) for i, slope in decision.slopes.items())
    reach = sum(slope * float(ulp) for slope, ulp in ulps)
    reach += float(input_ulp(1.0, precision)) if decision.rounding else 0.0
    if reach == 0:  # what no input moves
        return 0.0 if decision.margin == 0 and decision.kind != "jump" else np.inf
    margin = abs(decision.margin)
    if decision.exponent is not None:
        margin += float(underflowing_base(float(decision.exponent), precision))
    return float(margin / reach)


def near_ties(case: Case, precision: int = 32) -> Callable[[Decision], bool]:
    """For `exact.gradient_bounds`: kinks within 16 ulp, and powers that may underflow."""
    exact = evaluate(case, 1)

    def is_tie(decision: Decision) -> bool:
        if decision.kind == "underflow":
            return bool(decision.margin < underflow_threshold(precision))
        return distance(decision, case, exact, precision) < MIN_DISTANCE

    return is_tie


def _conditions(
    moved: dict[Path, list[Any]], exact: Exact, precision: int
) -> dict[Path, tuple[float, float, float, float]]:
    """Of the derivatives, by how far they move."""

    def four(path: Path) -> tuple[float, float, float, float]:
        r, g, b, a = (_condition(moved[path][c], exact.gradient[path][c], precision) for c in range(4))
        return r, g, b, a

    return {path: four(path) for path in exact.inputs}


def _condition(moved: Any, value: Any, precision: int) -> float:
    return max(1.0, float(moved / float(output_ulp(float(value), precision))))
