"""Plots of the results; without matplotlib there are only tables."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .harness import Measurement

Series = dict[str, tuple[Sequence[float], Sequence[float]]]
"""Label -> x values, y values."""


def available() -> bool:
    """Whether matplotlib is installed; says so once if not."""
    if importlib.util.find_spec("matplotlib") is None:
        print("skipped: plot (matplotlib not installed)")
        return False
    return True


def _axes(width: float = 8.0, height: float = 5.0, columns: int = 1) -> tuple[Any, Any]:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt.subplots(1, columns, figsize=(width, height), layout="constrained")


def _save(figure: Any, path: Path) -> None:
    import matplotlib.pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    plt.close(figure)
    print(f"wrote {path}")


def peers(path: Path, measurements: Sequence[Measurement]) -> None:
    """Bars: nanoseconds per sample and light, a panel an operation, a group a number of lights."""
    done = [m for m in measurements if m.skipped is None]
    if not done or not available():
        return
    kinds = list(dict.fromkeys((m.case.operation, m.case.work.sample_color) for m in done))
    figure, axes = _axes(5.5 * len(kinds), 5.0, len(kinds))
    for axis, (operation, sample_color) in zip(axes if len(kinds) > 1 else [axes], kinds, strict=True):
        group = [m for m in done if (m.case.operation, m.case.work.sample_color) == (operation, sample_color)]
        lights = sorted({m.case.work.lights for m in group})
        labels = list(dict.fromkeys(m.case.entrant.label for m in group))
        for row, label in enumerate(labels):
            own = {m.case.work.lights: m.nanoseconds for m in group if m.case.entrant.label == label}
            places = [lights.index(count) + row / (len(labels) + 1) for count in own]
            axis.bar(places, list(own.values()), 1 / (len(labels) + 1), label=label)
        axis.set_xticks([i + 0.4 for i in range(len(lights))], [f"{count} lights" for count in lights])
        axis.set_yscale("log")
        axis.set_ylim(bottom=min(m.nanoseconds for m in group) / 2)
        axis.set_ylabel("ns per sample and light")
        axis.set_title(f"{operation.replace('_', ' ')}, {'a colour a sample' if sample_color else 'one material'}")
    (axes[0] if len(kinds) > 1 else axes).legend(fontsize="small")
    _save(figure, path)


def lines(path: Path, series: Series, *, x: str, y: str, title: str, markers_only: bool = False) -> None:
    """Curves or points on logarithmic axes."""
    if not series or not available():
        return
    figure, axis = _axes()
    for label, (across, up) in series.items():
        axis.plot(across, up, "o" if markers_only else "o-", label=label, markersize=5)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.set_title(title)
    axis.grid(True, which="both", alpha=0.3)
    axis.legend(fontsize="small")
    _save(figure, path)
