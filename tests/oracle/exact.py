"""The lighting equation at 50 digits, one sample at a time, with derivatives: `evaluate` and `gradient_bounds`."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from mpmath import mp, mpf

from .case import Case
from .exact_equation import shade
from .paths import Path
from .tape import Decision, Tape

DIGITS = 50
MORE_DIGITS = 250
"""For directions that are opposite to within 10^-20: is L + V zero, or tiny?"""
MAX_TIES = 8

Four = tuple[Any, Any, Any, Any]


@dataclass(frozen=True)
class Exact:
    """Result at one sample: red, green, blue, alpha, and their derivatives by path (an absent one is zero).

    `inputs[i]` is the path of input number i; inputs of dead lights, and what no formula reads, are not among them.
    `singular`: inputs that reach an undefined unit vector [19], the tip of a distance or an infinite slope: they have
    no derivative, any finite one is right.
    """

    rgba: Four
    gradient: dict[Path, Four]
    hessian: dict[tuple[Path, Path], Four]
    decisions: tuple[Decision, ...]
    singular: frozenset[Path]
    inputs: tuple[Path, ...]


def evaluate(case: Case, order: int = 0, *, ties: Mapping[str, bool] | None = None, digits: int = DIGITS) -> Exact:
    """The case's colour and alpha, with derivatives up to `order` (0, 1 or 2), as mpmath numbers.

    `hessian` holds each pair of inputs once, in the order of `inputs`. `ties` overrides how decisions fall, by name,
    for the derivatives on either side of a kink; at other margins than (almost) 0 it makes no sense.
    """
    with mp.workdps(digits):
        tape = Tape(case, order, ties or {})
        rgba = shade(tape)
    if tape.needs_more_digits and digits < MORE_DIGITS:
        return evaluate(case, order, ties=ties, digits=MORE_DIGITS)
    zero = mpf(0)
    paths = tuple(tape.inputs)
    pairs = sorted({pair for channel in rgba for pair in channel.hessian or {}})

    def four(values: Callable[[Any], Any]) -> Four:
        r, g, b, a = (values(channel) for channel in rgba)
        return r, g, b, a

    return Exact(
        rgba=four(lambda c: c.value),
        gradient={p: four(lambda c, i=i: c.gradient.get(i, zero)) for i, p in enumerate(paths)} if order else {},
        hessian={(paths[i], paths[j]): four(lambda c, i=i, j=j: c.hessian.get((i, j), zero)) for i, j in pairs},
        decisions=tuple(tape.decisions.values()),
        singular=frozenset(paths[i] for i in tape.singular),
        inputs=paths,
    )


def gradient_bounds(
    case: Case, is_tie: Callable[[Decision], bool] = lambda decision: decision.margin == 0
) -> dict[Path, tuple[tuple[Any, Any], ...]]:
    """By path, the lowest and highest right derivative of each of the four channels.

    They differ only at a kink: there every value between 0 and the one-sided derivative of the kinked term is right,
    so both sides of every tie are evaluated. The part of a power that may underflow may be off by as much as it is.
    Singular inputs get (-inf, inf). `is_tie` may widen what counts as a tie (`condition.near_ties`: what counts in a
    floating-point format).
    """
    first = evaluate(case, 1)
    ties = [d for d in first.decisions if is_tie(d)]
    names = [d.name for d in ties if d.kind == "kink"]
    if len(names) > MAX_TIES:
        raise ValueError(f"{case.label or 'case'}: {len(names)} ties; at most {MAX_TIES} can be tried")
    choices = itertools.product((False, True), repeat=len(names))
    sides = [evaluate(case, 1, ties=dict(zip(names, choice, strict=True))) for choice in choices]
    lost = [evaluate(case, 1, ties={d.name: False}) for d in ties if d.kind == "underflow"]
    singular = frozenset().union(*(side.singular for side in sides))
    paths = dict.fromkeys(path for side in sides for path in side.gradient)
    none = (mpf(0),) * 4

    def bounds(path: Path, channel: int) -> tuple[Any, Any]:
        if path in singular:
            return -mp.inf, mp.inf
        here, *values = (side.gradient.get(path, none)[channel] for side in (first, *sides))
        margin = sum(abs(here - without.gradient.get(path, none)[channel]) for without in lost)
        return min(values) - margin, max(values) + margin

    return {path: tuple(bounds(path, channel) for channel in range(4)) for path in paths}
