"""The values that the specification allows each field of a node, as the checks of the node classes have them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

from . import fields


class Range(NamedTuple):
    """The values that the specification allows a field: [lower, upper], or (lower, upper] when `open_below`."""

    lower: float = -math.inf
    upper: float = math.inf
    open_below: bool = False

    def __str__(self) -> str:
        left = "(" if self.open_below or self.lower == -math.inf else "["
        right = ")" if self.upper == math.inf else "]"
        upper = "pi/2" if self.upper == math.pi / 2 else f"{self.upper:g}"
        return f"{left}{self.lower:g}, {upper}{right}"


UNIT, NON_NEGATIVE, POSITIVE, ANY = Range(0.0, 1.0), Range(0.0), Range(0.0, open_below=True), Range()
SPOT_ANGLE = Range(0.0, math.pi / 2, open_below=True)

_OF_CHECKS: dict[Callable[..., Any], Range] = {
    fields.color: UNIT,
    fields.factors: NON_NEGATIVE,
    fields.non_negative: NON_NEGATIVE,
    fields.positive: POSITIVE,
    fields.reach: NON_NEGATIVE,
    fields.rgb_rows: UNIT,
    fields.rgba_rows: UNIT,
    fields.spot_angle: SPOT_ANGLE,
    fields.texture_image: UNIT,
    fields.unit_interval: UNIT,
}


def allowed_range(kind: type, field: str) -> Range:
    """What the field of a node class may be."""
    check = next(own.metadata["check"] for own in dataclasses.fields(kind) if own.name == field)
    return _OF_CHECKS.get(check, ANY)
