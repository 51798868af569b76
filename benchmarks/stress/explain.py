"""One case in full: its numbers, the exact answer, jaxlight's, and where they differ most."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np

import answers
from oracle.case import Case
from oracle.paths import show
from oracle.ulp import error_in_ulp

from .judge import BITS, Block, Precision

SHOWN = 8


def explain(case: Case, precisions: Sequence[Precision]) -> list[str]:
    """Lines about a case, in each precision."""
    lines = [repr(case)]
    for precision in precisions:
        block = Block([case], precision)
        exact, bits = block.exact, BITS[precision]
        with jax.enable_x64(precision == "float64"):
            (colour,) = answers.values([case], block.dtype, chunk=1)
            (by_reverse,) = answers.derivatives([case], block.dtype, "reverse", chunk=1)
            (by_forward,) = answers.derivatives([case], block.dtype, "forward", chunk=1)
        nearest = ", ".join(f"{kind} {distance[0]:.3g}" for kind, distance in exact.distances.items())
        ulp = error_in_ulp(colour, exact.rgba[0], bits)
        lines += [
            f"{precision}: well-conditioned {bool(exact.well_conditioned[0])}; ulp to the nearest {nearest}",
            *(
                f"  {'rgba'[c]}: {colour[c]:.9g}, exact {float(exact.rgba[0, c]):.9g}, {float(ulp[c]):.3g} ulp, "
                f"condition {exact.condition[0, c]:.3g}"
                for c in range(4)
            ),
        ]
        (derivatives,) = block.derivatives
        assert derivatives.condition is not None
        errors = [
            derivatives.error_in_ulp(d[None], bits)[0] / derivatives.condition[0] for d in (by_reverse, by_forward)
        ]
        worst = np.maximum(*errors)
        for flat in np.argsort(-worst, axis=None)[:SHOWN]:
            i, c = np.unravel_index(flat, worst.shape)
            low, high = float(derivatives.low[0, i, c]), float(derivatives.high[0, i, c])
            lines.append(
                f"  d{'rgba'[c]} / d {show(derivatives.paths[i])}: reverse {by_reverse[i, c]:.9g}, "
                f"forward {by_forward[i, c]:.9g}, exact {low:.9g}{'' if low == high else f' to {high:.9g}'}, "
                f"{float(worst[i, c]):.3g} ulp / condition, condition {derivatives.condition[0, i, c]:.3g}"
            )
    return lines
