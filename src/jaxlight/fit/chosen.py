"""Which numbers a path means, before bounds and ties: a catalogue of all fields of the world."""

from __future__ import annotations

import difflib
import fnmatch
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..given import several
from ..scene import paths
from ..scene.ranges import POSITIVE, Range
from ..scene.scene import Scene
from .parameters import World
from .views import label_of

MIN_BLOCK = 64
"""Colours of a whole texture from which on they are eliminated as a block instead of kept in a dense matrix."""


class Chosen(NamedTuple):
    """One free number before ties are resolved."""

    path: str
    label: str
    leaf: paths.Leaf | None
    row: int
    component: int
    element: int
    range: Range


class Catalogue:
    """All fields of the world, looked up once: as many paths as fields may come."""

    def __init__(self, world: World) -> None:
        self.scene = world.scene
        self._exposure = np.asarray(world.exposure)
        self._arrays: dict[paths.Leaf, np.ndarray] = {}
        self._first_rows: dict[str, list[int]] = {}
        self._fields: dict[paths.Leaf, dict[tuple[int, ...], tuple[int, paths.Field]]] = {}
        for place, field in enumerate(paths.fields(world.scene)):
            self._fields.setdefault(field.leaf, {})[field.index] = place, field

    def fields_in(self, leaf: paths.Leaf, mask: np.ndarray) -> list[tuple[int, paths.Field]]:
        """The fields of a leaf of which some number is in the mask, and their places in the order of all."""
        fields = self._fields[leaf]
        if () in fields:
            return [fields[()]]
        rows = np.flatnonzero(mask.reshape(len(mask), -1).any(axis=1))
        return [fields[row,] for row in rows.tolist()]

    def value(self, one: Chosen) -> float:
        """The present value of a number."""
        if one.leaf is not None and one.leaf not in self._arrays:
            self._arrays[one.leaf] = np.asarray(one.leaf.get(self.scene)).reshape(-1)
        array = self._exposure if one.leaf is None else self._arrays[one.leaf]
        value = float(array[one.element])
        if not np.isfinite(value):
            raise ValueError(f"{one.label}: a free field must start at a finite value, got {value}")
        return value

    def first_row(self, one: Chosen) -> int:
        """The first row of the number's node; rows of one node (USE) have its one value."""
        if one.leaf is None:
            return one.row
        return self.first_rows(one.leaf.kind)[one.row]

    def first_rows(self, kind: str) -> list[int]:
        """Of every row of a kind the first one of its node."""
        if kind not in self._first_rows:
            self._first_rows[kind] = paths.first_rows(self.scene, kind)
        return self._first_rows[kind]


def choose(
    catalogue: Catalogue, where: Any, view_names: Sequence[str], *, blocks: bool
) -> tuple[list[Chosen], list[paths.Leaf]]:
    """The numbers that the paths mean, in the order of the scene's fields, and the textures that are meant whole."""
    each = several(where)
    for path in each:
        if not (isinstance(path, str) or callable(path)):
            raise ValueError(f"free: expected a field path or a function of the scene, got {path!r:.80}")
        if callable(path) and not any(np.any(mask) for _, mask in paths.select(catalogue.scene, [path])):
            raise ValueError("free: a function of the scene chooses nothing of it")
    exposures = [path for path in each if isinstance(path, str) and path.startswith("View[")]
    chosen = []
    selections = paths.select(catalogue.scene, [path for path in each if path not in exposures])
    masks = {selection.leaf: selection.mask for selection in selections}
    textures = [
        leaf
        for leaf, mask in masks.items()
        if blocks and leaf.kind == "Texture" and mask.size >= MIN_BLOCK and np.all(mask)
    ]
    meant = [found for leaf in masks.keys() - set(textures) for found in catalogue.fields_in(leaf, masks[leaf])]
    for _, field in sorted(meant, key=lambda found: found[0]):
        mask = masks[field.leaf]
        numbers = np.arange(mask.size).reshape(mask.shape)[field.index].reshape(-1)
        wanted = mask[field.index].reshape(-1)
        labels, row = field.labels(catalogue.scene), field.index[0] if field.index else 0
        for component in np.flatnonzero(wanted).tolist():
            label, element = labels[component], int(numbers[component])
            chosen.append(Chosen(field.path, label, field.leaf, row, component, element, field.leaf.range))
    for path in exposures:
        for row in _exposure_rows(path, view_names):
            name = _exposure_path(view_names, row)
            chosen.append(Chosen(name, name, None, row, 0, row, POSITIVE))
    return chosen, textures


def canonical(scene: Scene, view_names: Sequence[str], path: str) -> str:
    """A path as `labels` has it: `Material[body].shininess` for `Material[0].shininess`; others as they are."""
    if path.startswith("View["):
        return _canonical_exposure(view_names, path)
    try:
        ((leaf, mask),) = paths.select(scene, path)
    except ValueError:
        return path
    first = paths.first_rows(scene, leaf.kind)
    meant = [
        field
        for field in paths.fields(scene)
        if field.leaf == leaf and np.any(mask[field.index]) and all(first[row] == row for row in field.index)
    ]
    if len(meant) != 1:
        return path
    inside = np.flatnonzero(mask[meant[0].index])
    if len(inside) == np.size(mask[meant[0].index]):
        return meant[0].path
    return meant[0].labels(scene)[inside[0]] if len(inside) == 1 else path


def _canonical_exposure(view_names: Sequence[str], path: str) -> str:
    try:
        rows = _exposure_rows(path, view_names)
    except ValueError:
        return path
    return _exposure_path(view_names, rows[0]) if len(rows) == 1 else path


def _exposure_path(view_names: Sequence[str], row: int) -> str:
    return f"{label_of(view_names[row], row)}.exposure"


def _exposure_rows(path: str, view_names: Sequence[str]) -> list[int]:
    match = re.fullmatch(r"View\[(.*)\]\.exposure", path)
    known = [_exposure_path(view_names, row) for row in range(len(view_names))]
    rows = []
    if match:
        which = match[1]
        # Names may have brackets, which patterns have too.
        rows = [i for i, name in enumerate(view_names) if name and name == which]
        rows = rows or [
            i for i, name in enumerate(view_names) if which == "*" or (name and fnmatch.fnmatchcase(name, which))
        ]
        if not rows and which.isdecimal() and int(which) < len(view_names):
            rows = [int(which)]
    if not rows:
        close = difflib.get_close_matches(path, known, n=4, cutoff=0.0)
        raise ValueError(f"there is no field {path!r}; the closest: {', '.join(close)}")
    return rows
