"""What a reader met and could not take as it stands, collected into one warning a file."""

from __future__ import annotations

import collections
import dataclasses
import warnings
from collections.abc import Hashable, Iterable
from pathlib import Path

from .errors import SceneFileWarning

ROUNDED = 1e-6
"""A number that is out of range by less is clamped without a word."""
_MOST_NAMED = 12
_LONGEST = 200


def _lists() -> dict[Hashable, list[str]]:
    return collections.defaultdict(list)


@dataclasses.dataclass
class ReadNotes:
    """Counts and names of what was skipped, simplified, clamped or missing while one file was read."""

    skipped: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    """Nodes and statements left out with all that is in them, by name."""
    simplified: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    """Nodes read as something simpler, by what was done."""
    unused: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    """Fields that change the picture elsewhere and that jaxlight does not have, by name."""
    unknown: dict[Hashable, list[str]] = dataclasses.field(default_factory=_lists)
    """Attributes left out, as `Material[a].difuseColor (line 7; diffuseColor is meant?)`, those alike under one key."""
    beside_use: dict[Hashable, list[str]] = dataclasses.field(default_factory=_lists)
    """What an element with a USE says besides, as `Transform.scale (USE='a', line 7)`, alike ones under one key."""
    clamped: list[str] = dataclasses.field(default_factory=list)
    """Values that were out of range, as `Material[a].diffuseColor (line 7)`."""
    remarks: list[str] = dataclasses.field(default_factory=list)
    """What else was not as it should be, a sentence each; and what the library that read the file said about it."""
    missing: list[str] = dataclasses.field(default_factory=list)
    """Textures and other files that could not be had, and why."""

    def sentences(self) -> list[str]:
        """One sentence for each kind of note that there is."""
        found = []
        if self.skipped:
            total = self.skipped.total()
            noun = "node" if total == 1 else "nodes"
            found.append(f"skipped {total} {noun} that jaxlight does not know: {_counted(self.skipped)}")
        if self.simplified:
            found.append(f"simplified: {_counted(self.simplified)}")
        if self.unused:
            found.append(f"fields not used: {_counted(self.unused)}")
        if self.unknown:
            total = sum(map(len, self.unknown.values()))
            count = "1 attribute" if total == 1 else f"{total} attributes"
            found.append(f"skipped {count} that jaxlight does not know: {_grouped(self.unknown)}")
        if self.beside_use:
            found.append(f"ignored beside a USE: {_grouped(self.beside_use)}")
        if self.clamped:
            count = "1 value" if len(self.clamped) == 1 else f"{len(self.clamped)} values"
            found.append(f"clamped {count} to the allowed range: {_listed(self.clamped)}")
        if self.missing:
            count = "1 file" if len(self.missing) == 1 else f"{len(self.missing)} files"
            found.append(f"{count} not used: {_listed(self.missing)}")
        if self.remarks:
            found.append(f"remarks: {_listed(self.remarks)}")
        return found

    def warn(self, path: Path, stacklevel: int) -> None:
        """One SceneFileWarning with all of it, or none. `stacklevel` as in `warnings.warn`, seen from the caller."""
        sentences = self.sentences()
        if sentences:
            warnings.warn(f"{path}: {'; '.join(sentences)}", SceneFileWarning, stacklevel=stacklevel + 1)


def _counted(counts: collections.Counter[str]) -> str:
    return _listed(f"{name} x{count}" for name, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def _grouped(notes: dict[Hashable, list[str]]) -> str:
    """The first note under each key, and how many there are like it."""
    return _listed(f"{first}{f' and {len(alike)} alike' if alike else ''}" for first, *alike in notes.values())


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST // 2]}...{text[-_LONGEST // 2 :]}"


def _listed(items: Iterable[str]) -> str:
    items = list(items)
    hidden = len(items) - _MOST_NAMED
    return ", ".join(_short(item) for item in items[:_MOST_NAMED]) + (f" and {hidden} more" if hidden > 0 else "")
