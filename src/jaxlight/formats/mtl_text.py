"""The text of material libraries (mtl), made ready for trimesh: all in one, in UTF-8, files of textures by their names.

trimesh takes what stands before the name of a texture's file for a part of that name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from .notes import ReadNotes
from .plain_text import name_in, text_of

_VALUES = {
    "-blendu": 1, "-blendv": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-type": 1, "-boost": 1, "-bm": 1, "-texres": 1,
    "-mm": 2,
}  # fmt: skip
"""Options of textures, and how many values each has."""
_VECTORS = ("-o", "-s", "-t")
"""Those that have one to three numbers."""
_NO_CHANGE = {"-blendu on", "-blendv on", "-cc off", "-clamp off", "-mm 0 1"}
_NO_NUMBERS = {"-o": 0.0, "-s": 1.0, "-t": 0.0}
"""Numbers that leave a texture where it is."""


class Library(NamedTuple):
    """Materials, whatever the files they stand in."""

    data: bytes
    names: frozenset[str]


def joined_libraries(libraries: Iterable[bytes], notes: ReadNotes) -> Library:
    """All libraries in one; a material stands in the first that has it. Options of textures are noted."""
    lines: list[str] = []
    names: set[str] = set()
    for data in libraries:
        known = False
        here: set[str] = set()
        for line in text_of(data).split("\n"):
            keyword, *words = line.split(None, 1) or ("",)
            rest = words[0].strip() if words else ""
            if keyword.lower() == "newmtl":
                name = name_in(rest)
                known = name in names
                here.add(name)
                rest = name
            elif keyword.lower() == "map_kd":
                rest = _file_of(name_in(rest), notes)
            elif not keyword.lower().startswith("map_"):
                rest = rest.partition("#")[0].rstrip()
            if rest and not known and not keyword.startswith("#"):
                lines.append(f"{keyword} {rest}")
        names |= here
    return Library("\n".join(lines).encode(), frozenset(names))


def _file_of(reference: str, notes: ReadNotes) -> str:
    """The name of a texture's file, which may have spaces in it, behind its options."""
    words = reference.split(" ")
    while len(words) > 1 and words[0].lower() in (*_VALUES, *_VECTORS):
        option = words[0].lower()
        count = sum(1 for _ in _numbers(words[1:4])) if option in _VECTORS else _VALUES[option]
        values = words[1 : 1 + count]
        if not _changes_nothing(option, values):
            notes.unused[f"mtl map_Kd {option}"] += 1
        words = words[1 + count :]
    return " ".join(words)


def _changes_nothing(option: str, values: list[str]) -> bool:
    if option in _VECTORS:
        return all(value == _NO_NUMBERS[option] for value in _numbers(values))
    return " ".join([option, *values]).lower() in _NO_CHANGE


def _numbers(words: list[str]) -> Iterator[float]:
    """The numbers that words begin with."""
    for word in words:
        try:
            yield float(word)
        except ValueError:
            return
