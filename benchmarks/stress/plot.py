"""The errors as curves: the share of cases whose error, in ulp / condition, is larger."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .figures import LIMITS, Table


def save_plot(tables: Sequence[Table], path: Path) -> None:
    """A panel a quantity, a curve a row group and precision; without matplotlib a sentence on standard error."""
    try:
        import matplotlib

        matplotlib.use("agg")
        import matplotlib.pyplot as plt
    except ImportError:
        print("no plot: matplotlib is not installed (pip install jaxlight[plot])", file=sys.stderr)
        return
    quantities = list(dict.fromkeys(one.quantity for one in tables))
    figure, panels = plt.subplots(1, len(quantities), figsize=(4.5 * len(quantities), 4), sharey=True, squeeze=False)
    for panel, quantity in zip(panels[0], quantities, strict=True):
        for one in (one for one in tables if one.quantity == quantity):
            for name, errors in _groups(one).items():
                if len(errors):
                    ordered = np.sort(np.maximum(errors, 1e-3))
                    share = 1 - np.arange(len(ordered)) / len(ordered)
                    panel.plot(ordered, share, drawstyle="steps-post", label=f"{one.precision}, {name}")
        panel.axvline(LIMITS[quantity], color="black", linestyle=":", linewidth=1)
        panel.set(xscale="log", yscale="log", xlabel="error, ulp / condition", title=quantity)
        panel.grid(alpha=0.3)
    panels[0, 0].set_ylabel("share of cases with a larger error")
    panels[0, 0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _groups(one: Table) -> dict[str, np.ndarray]:
    """Errors of the random and of the adversarial cases."""
    random = [row.relative for name, row in one.rows.items() if name == "random"]
    adversarial = [row.relative for name, row in one.rows.items() if not name.startswith("random")]
    return {
        "random": np.concatenate([part for parts in random for part in parts] or [np.zeros(0)]),
        "adversarial": np.concatenate([part for parts in adversarial for part in parts] or [np.zeros(0)]),
    }
