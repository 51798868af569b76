"""What a run found, gathered block by block: rows of a table, and the figures that must hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

LIMITS = {"values": 4.0, "reverse": 16.0, "forward": 16.0, "second": 16.0}
"""Worst error allowed, in ulp / condition."""
WITHIN_2 = 0.999
"""Share of values that must be within 2 ulp x condition."""


@dataclass
class Row:
    """One family or feature: what its cases came to."""

    name: str
    count: int = 0
    infinite: int = 0
    """Cases with a number that is not finite."""
    ulp: list[np.ndarray] = field(default_factory=list)
    relative: list[np.ndarray] = field(default_factory=list)
    worst: float = -1.0
    worst_label: str = ""

    def add(self, labels: Sequence[str], ulp: np.ndarray, relative: np.ndarray, finite: np.ndarray) -> None:
        """More cases; NaN errors are of cases of which nothing is asked but to be finite."""
        self.count += len(labels)
        self.infinite += int(np.sum(~finite))
        asked = ~np.isnan(relative)
        self.ulp.append(ulp[asked].astype(np.float32))
        self.relative.append(relative[asked].astype(np.float32))
        if np.any(asked):
            place = int(np.argmax(np.where(asked, relative, -1)))
            if relative[place] > self.worst:
                self.worst, self.worst_label = float(relative[place]), labels[place]

    def cells(self) -> list[str | int | float | None]:
        """Under HEADER."""
        ulp, relative = np.concatenate(self.ulp), np.concatenate(self.relative)
        if len(relative) == 0:
            return [self.name, self.count, 0, None, None, None, None, None, self.infinite, ""]
        share = f"{100 * np.mean(relative <= 2):.6g} %"
        medians = float(np.median(ulp)), float(np.median(relative))
        worst = float(ulp.max()), self.worst
        first = [self.name, self.count, len(relative)]
        return [*first, worst[0], medians[0], worst[1], medians[1], share, self.infinite, self.worst_label]


HEADER = (
    "",
    "cases",
    "asked",
    "worst ulp",
    "median ulp",
    "worst / condition",
    "median / condition",
    "within 2",
    "not finite",
    "worst case",
)


@dataclass
class Table:
    """All rows of one quantity (values, or derivatives in a mode) in one precision."""

    precision: str
    quantity: str
    rows: dict[str, Row] = field(default_factory=dict)
    by_field: dict[str, list[float]] = field(default_factory=dict)
    """Worst error in ulp / condition, number of cases, and of errors within the limit by allowance only, by input."""

    def row(self, name: str) -> Row:
        """The row of this name, new if need be."""
        return self.rows.setdefault(name, Row(name))

    def add_field(self, name: str, worst: float, count: float, by_allowance: float) -> None:
        """More cases that have this input."""
        known, before, allowed = self.by_field.get(name, [0.0, 0, 0])
        self.by_field[name] = [max(known, worst), before + count, allowed + by_allowance]

    def merge(self, other: Table) -> None:
        """Another table of the same quantity, of cases of another sort."""
        self.rows |= other.rows
        for name, values in other.by_field.items():
            self.add_field(name, *values)

    def violations(self) -> list[str]:
        """The figures that do not hold, a sentence each."""
        found = []
        limit = LIMITS[self.quantity]
        for row in self.rows.values():
            where = f"{self.precision} {self.quantity}, {row.name}"
            relative = np.concatenate(row.relative)
            if row.infinite:
                found.append(f"{where}: {row.infinite} cases are not finite")
            if row.worst > limit:
                found.append(f"{where}: {row.worst:.3g} ulp x condition, more than {limit:g}: {row.worst_label}")
            if self.quantity == "values" and len(relative) and np.mean(relative <= 2) < WITHIN_2:
                found.append(f"{where}: only {100 * np.mean(relative <= 2):.4g} % within 2 ulp x condition")
        return found
