"""What a person frees: paths, bounds, ties and priors, resolved to the parameters of a fit."""

from __future__ import annotations

import dataclasses
import difflib
import fnmatch
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..scene import paths
from ..scene.paths import Path, Range
from .parameters import FreeField, FreeLeaf, Parameters, TexelBlock, World

MIN_BLOCK = 64
"""Colours of a whole texture from which on they are eliminated as a block instead of kept in a dense matrix."""


@dataclasses.dataclass(frozen=True, eq=False)
class Free:
    """A field to fit, with more to say about it than its path.

    Args:
        where: path, function of the scene, or several of them.
        lower, upper: bounds tighter than the specification's range; a number, or one a component.
        tied: True: all nodes that `where` means share one value, component by component; "all": all its numbers are
            one number (a grey colour).
        smoothness: whole textures only: standard deviation of the difference of neighbouring texels.
        total_variation: whole textures only: mean absolute difference of neighbouring texels; keeps edges.
        mean, deviation: a Gaussian prior: what the value should be, and how far from it is one standard deviation.
            `mean` None: the start value.
    """

    where: Path | Sequence[Path]
    _: dataclasses.KW_ONLY
    lower: Any = None
    upper: Any = None
    tied: bool | Literal["all"] = False
    mean: Any = None
    deviation: Any = None
    smoothness: float | None = None
    total_variation: float | None = None


class _Chosen(NamedTuple):
    """One free number before ties are resolved."""

    path: str
    label: str
    leaf: paths.Leaf | None
    row: int
    component: int
    element: int
    range: Range


def free_parameters(
    world: World, free: Any, view_names: Sequence[str], dtype: Any, *, blocks: bool = True
) -> tuple[Parameters, list[FreeField]]:
    """The parameters that `free` means, and their description by field.

    Args:
        free: a path, a function of the scene, a `Free`, a list of these, or a mapping from path to `Free` options.
        view_names: name of each view, for `View[name].exposure`.
        blocks: whether whole textures become blocks; False: every texel is a number like any other.

    Raises:
        ValueError: nothing is free, no such field, a field named twice, bounds that exclude the start.
    """
    requests = _requests(free)
    if not requests:
        raise ValueError("free: no field is free; name at least one, such as 'Material[0].diffuse_color'")
    values: list[float] = []
    lower: list[float] = []
    upper: list[float] = []
    means: list[float] = []
    precisions: list[float] = []
    taken: dict[tuple[Any, int], int] = {}
    members: dict[str, list[tuple[_Chosen, int]]] = {}
    whole: list[tuple[Free, paths.Leaf]] = []
    catalogue = _Catalogue(world)
    for request in requests:
        chosen, textures = _choose(catalogue, request.where, view_names, blocks=blocks and not request.tied)
        whole += [(request, leaf) for leaf in textures]
        if not chosen and textures:
            continue
        if request.smoothness is not None or request.total_variation is not None:
            raise ValueError(f"{chosen[0].path}: smoothness and total_variation are for whole textures, not tied")
        rows = list(dict.fromkeys(one.path for one in chosen))
        _check_lengths(request, chosen)
        if request.tied not in (True, False, "all"):
            raise ValueError(f"{rows[0]}: tied: expected True, False or 'all', got {request.tied!r}")
        if request.tied is True:
            _check_tie(chosen, rows)
        first_of_row: dict[int, int] = {}
        seen: dict[str, int] = {}
        for one in chosen:
            component = seen[one.path] = seen.get(one.path, -1) + 1
            tie = 0 if request.tied == "all" else component
            if (one.leaf, one.element) in taken:
                raise ValueError(f"free: {one.label} is named twice")
            value = catalogue.value(one)
            if request.tied and tie in first_of_row:
                number = first_of_row[tie]
            else:
                number = first_of_row[tie] = len(values)
                low, high = _bounds(request, one, component, value)
                mean, deviation = _prior(request, one, component, value)
                values.append(min(max(value, low), high))
                lower.append(low)
                upper.append(high)
                means.append(mean)
                precisions.append(0.0 if deviation is None else deviation**-2)
            taken[one.leaf, one.element] = number
            members.setdefault(one.path, []).append((one, number))
    leaves = []
    for leaf in dict.fromkeys(leaf for leaf, _ in taken):
        pairs = [(element, number) for (owner, element), number in taken.items() if owner == leaf]
        elements, numbers = (jnp.asarray(column, dtype=jnp.int32) for column in zip(*pairs, strict=True))
        leaves.append(FreeLeaf(elements, numbers, leaf))
    columns = [np.array(column) for column in (values, lower, upper, means, precisions)]
    made = []
    for request, leaf in whole:
        if any(owner == leaf for owner, _ in taken) or any(block.texture == leaf.row for block in made):
            raise ValueError(f"free: Texture[{leaf.row}].image is named twice")
        block, own = _texel_block(world, request, leaf, len(columns[0]), dtype)
        made.append(block)
        columns = [np.concatenate(pair) for pair in zip(columns, own, strict=True)]
    arrays = (jnp.asarray(column, dtype=dtype) for column in columns)
    return Parameters(*arrays, leaves=tuple(leaves), blocks=tuple(made)), _described(members)


def _described(members: dict[str, list[tuple[_Chosen, int]]]) -> list[FreeField]:
    return [
        FreeField(
            path,
            parts[0][0].leaf,
            parts[0][0].row,
            tuple(one.label for one, _ in parts),
            np.array([one.component for one, _ in parts]),
            np.array([number for _, number in parts]),
            parts[0][0].range,
        )
        for path, parts in members.items()
    ]


def _texel_block(
    world: World, request: Free, leaf: paths.Leaf, offset: int, dtype: Any
) -> tuple[TexelBlock, list[np.ndarray]]:
    """The block of a whole texture, and its start, bounds and prior, flat."""
    image = np.asarray(leaf.get(world.scene), np.float64)
    path = next(field.path for field in paths.fields(world.scene) if field.leaf == leaf)
    shape = (image.shape[0], image.shape[1], 1 if image.shape[2] <= 2 else 3)
    start = image[..., : shape[2]]

    def spread(option: str, given: Any, default: Any) -> np.ndarray:
        try:
            return np.broadcast_to(np.asarray(default if given is None else given, np.float64), shape).reshape(-1)
        except ValueError:
            allowed = f"one number, one a component, or an image of shape {list(shape)}"
            raise ValueError(f"{path}: {option}: expected {allowed}, got {given!r:.60}") from None

    low, high = (
        spread("lower", request.lower, leaf.range.lower),
        spread("upper", request.upper, leaf.range.upper),
    )
    outside = (start.reshape(-1) < low - 1e-6) | (start.reshape(-1) > high + 1e-6)
    if np.any(outside):
        raise ValueError(f"{path}: {np.count_nonzero(outside)} texels start outside their bounds")
    if request.mean is not None and request.deviation is None:
        raise ValueError(f"{path}: a prior mean needs a deviation")
    deviation = spread("deviation", request.deviation, np.inf)
    for option in ("deviation", "smoothness", "total_variation"):
        given = getattr(request, option)
        if given is not None and not np.all(np.asarray(given) > 0):
            raise ValueError(f"{path}: {option}: expected a number > 0, got {given!r:.40}")
    smoothness = 0.0 if request.smoothness is None else request.smoothness**-2
    variation = 0.0 if request.total_variation is None else 1 / request.total_variation
    block = TexelBlock(
        smoothness=jnp.asarray(smoothness, dtype),
        total_variation=jnp.asarray(variation, dtype),
        texture=leaf.row,
        offset=offset,
        shape=shape,
        path=path,
    )
    values = np.clip(start.reshape(-1), low, high)
    return block, [values, low, high, spread("mean", request.mean, start), deviation**-2.0]


def _requests(free: Any) -> list[Free]:
    if isinstance(free, Mapping):
        return [Free(path, **dict(options or {})) for path, options in free.items()]
    if isinstance(free, (str, Free)) or callable(free):
        free = [free]
    requests = []
    for one in free:
        if not (isinstance(one, (str, Free)) or callable(one)):
            raise ValueError(f"free: expected a field path, a function of the scene or a Free, got {one!r:.80}")
        requests.append(one if isinstance(one, Free) else Free(one))
    return requests


class _Catalogue:
    """All fields of the world, looked up once: as many paths as fields may come."""

    def __init__(self, world: World) -> None:
        self.scene = world.scene
        self._exposure = np.asarray(world.exposure)
        self._arrays: dict[paths.Leaf, np.ndarray] = {}
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

    def value(self, one: _Chosen) -> float:
        """The present value of a number."""
        if one.leaf is not None and one.leaf not in self._arrays:
            self._arrays[one.leaf] = np.asarray(one.leaf.get(self.scene)).reshape(-1)
        array = self._exposure if one.leaf is None else self._arrays[one.leaf]
        value = float(array[one.element])
        if not np.isfinite(value):
            raise ValueError(f"{one.label}: a free field must start at a finite value, got {value}")
        return value


def _choose(
    catalogue: _Catalogue, where: Any, view_names: Sequence[str], *, blocks: bool
) -> tuple[list[_Chosen], list[paths.Leaf]]:
    """The numbers that the paths mean, in the order of the scene's fields, and the textures that are meant whole."""
    each = [where] if isinstance(where, str) or callable(where) else list(where)
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
            chosen.append(_Chosen(field.path, label, field.leaf, row, component, element, field.leaf.range))
    for path in exposures:
        for row in _exposure_rows(path, view_names):
            name = f"View[{view_names[row] or row}].exposure"
            chosen.append(_Chosen(name, name, None, row, 0, row, paths.POSITIVE))
    return chosen, textures


def _exposure_rows(path: str, view_names: Sequence[str]) -> list[int]:
    match = re.fullmatch(r"View\[(.*)\]\.exposure", path)
    known = [f"View[{name or row}].exposure" for row, name in enumerate(view_names)]
    rows = []
    if match:
        which = match[1]
        rows = [i for i, name in enumerate(view_names) if which == "*" or (name and fnmatch.fnmatchcase(name, which))]
        if not rows and which.isdigit() and int(which) < len(view_names):
            rows = [int(which)]
    if not rows:
        close = difflib.get_close_matches(path, known, n=4, cutoff=0.0)
        raise ValueError(f"there is no field {path!r}; the closest: {', '.join(close)}")
    return rows


def _check_tie(chosen: list[_Chosen], rows: list[str]) -> None:
    sizes = {row: sum(one.path == row for one in chosen) for row in rows}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{row} ({size})" for row, size in sizes.items())
        raise ValueError(f"free: tied fields need the same number of components; got {listed}")


def _check_lengths(request: Free, chosen: list[_Chosen]) -> None:
    sizes = Counter(one.path for one in chosen)
    for option in ("lower", "upper", "mean", "deviation"):
        given = getattr(request, option)
        length = 1 if given is None else np.size(given)
        for path, size in sizes.items():
            if length not in (1, size):
                raise ValueError(f"{path}: {option}: expected one number or {size}, got {length}")


def _component(given: Any, component: int) -> float:
    array = np.asarray(given, dtype=np.float64).reshape(-1)
    return float(array[0 if len(array) == 1 else component])


def _bounds(request: Free, one: _Chosen, component: int, value: float) -> tuple[float, float]:
    allowed = one.range
    # An open end is no value one can reach: stop a little before it.
    low = 1e-3 * min(1.0, abs(value)) if allowed.open_below else allowed.lower
    high = allowed.upper
    if request.lower is not None:
        low = max(low, _component(request.lower, component))
    if request.upper is not None:
        high = min(high, _component(request.upper, component))
    if allowed.open_below and value <= allowed.lower:
        raise ValueError(f"{one.label} starts at {value:g}, but must be in {allowed}")
    slack = 1e-6 * max(1.0, abs(value))
    if not low - slack <= value <= high + slack:
        raise ValueError(f"{one.label} starts at {value:g}, outside its bounds [{low:g}, {high:g}]")
    return low, high


def _prior(request: Free, one: _Chosen, component: int, value: float) -> tuple[float, float | None]:
    if request.deviation is None:
        if request.mean is not None:
            raise ValueError(f"{one.path}: a prior mean needs a deviation")
        return value, None
    deviation = _component(request.deviation, component)
    if not deviation > 0:
        raise ValueError(f"{one.path}: deviation: expected a number > 0, got {deviation:g}")
    return (value if request.mean is None else _component(request.mean, component)), deviation
