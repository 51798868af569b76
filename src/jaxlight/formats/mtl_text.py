"""The text of material libraries (mtl), made ready for trimesh: all in one, in UTF-8, files of textures by their names.

trimesh takes what stands before the name of a texture's file for a part of that name, and drops all materials where one
of them has a colour of another number of components than three.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from .mesh_materials import MAX_EXPONENT
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
_COLORS = ("ka", "kd", "ks", "ke")
_NUMBERS = ("d", "illum", "ns", "tr")
_LARGEST = {"ns": MAX_EXPONENT, "illum": math.inf}
"""What is above is clamped; of other numbers, what is above 1. None may be negative."""


class Library(NamedTuple):
    """Materials, whatever the files they stand in."""

    data: bytes
    names: frozenset[str]
    textures: dict[str, str]
    """By the names of the materials, the files of those that have one."""


def joined_libraries(libraries: Iterable[bytes], notes: ReadNotes) -> Library:
    """All libraries in one; a material stands in the first that has it. Options of textures are noted."""
    lines: list[str] = []
    names: set[str] = set()
    textures: dict[str, str] = {}
    name = ""
    for data in libraries:
        known = False
        here: set[str] = set()
        for line in text_of(data).split("\n"):
            keyword, *words = line.split(None, 1) or ("",)
            rest = words[0].strip() if words else ""
            key = keyword.lower()
            if key == "newmtl":
                name = rest = name_in(rest)
                known = name in names
                here.add(name)
            if known or not rest or keyword.startswith("#"):
                continue
            if key == "map_kd":
                rest = textures[name] = _file_of(name_in(rest), notes)
            elif key in (*_COLORS, *_NUMBERS):
                rest = _values_of(name, keyword, rest.partition("#")[0].split(), notes)
            lines += [f"{keyword} {rest}"] if rest else []
        names |= here
    return Library("\n".join(lines).encode(), frozenset(names), textures)


def _values_of(material: str, keyword: str, words: list[str], notes: ReadNotes) -> str:
    """A colour of three numbers, of which one stands for all, or a number; empty (and noted) where it is none."""
    counts = (1, 3) if keyword.lower() in _COLORS else (1,)
    numbers = list(_numbers(words))
    if not (len(words) == len(numbers) in counts and all(map(math.isfinite, numbers))):
        expected = " or ".join(f"{count} number{'s' * (count > 1)}" for count in counts)
        notes.remarks.append(f"{keyword} of material {material!r} is left out: {expected}, got {' '.join(words)!r:.60}")
        return ""
    if not all(0.0 <= number <= _LARGEST.get(keyword.lower(), 1.0) for number in numbers):
        notes.clamped.append(f"{keyword} of material {material!r} ({' '.join(words)})")
    return " ".join(words * (3 // len(words) if len(counts) > 1 else 1))


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
