"""Free fields and the flat vector of numbers that a solver moves: which element of which leaf each number sets."""

from __future__ import annotations

import dataclasses
import difflib
import fnmatch
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..scene import paths
from ..scene.paths import Path, Range
from ..scene.scene import Scene


class World(eqx.Module):
    """All that a fit can change: the scene, and what belongs to the pictures."""

    scene: Scene
    exposure: Float[Array, " views"]


@dataclasses.dataclass(frozen=True, eq=False)
class Free:
    """A field to fit, with more to say about it than its path.

    Args:
        where: path, function of the scene, or several of them.
        lower, upper: bounds tighter than the specification's range; a number, or one a component.
        tied: True: all nodes that `where` means share one value, component by component; "all": all its numbers are
            one number (a grey colour).
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


class FreeLeaf(eqx.Module):
    """Numbers of one leaf that are free: element `elements[k]` of the leaf is parameter `sources[k]`."""

    elements: Int[Array, " numbers"]
    sources: Int[Array, " numbers"]
    leaf: paths.Leaf | None = eqx.field(static=True)
    """Leaf of the scene; None: the exposures."""

    def put(self, world: World, values: Float[Array, " parameters"]) -> World:
        """The world with this leaf's free elements set."""
        old = world.exposure if self.leaf is None else self.leaf.get(world.scene)
        new = old.reshape(-1).at[self.elements].set(values[self.sources], unique_indices=True).reshape(old.shape)
        if self.leaf is None:
            return eqx.tree_at(lambda w: w.exposure, world, new)
        return eqx.tree_at(lambda w: w.scene, world, self.leaf.set(world.scene, new))


class Parameters(eqx.Module):
    """The free numbers of a fit as one flat vector: start, bounds, prior, and where each goes."""

    start: Float[Array, " parameters"]
    lower: Float[Array, " parameters"]
    upper: Float[Array, " parameters"]
    prior_mean: Float[Array, " parameters"]
    prior_precision: Float[Array, " parameters"]
    """1 / variance of the Gaussian prior; 0: none."""
    leaves: tuple[FreeLeaf, ...]

    def world(self, world: World, values: Float[Array, " parameters"]) -> World:
        """The world with the free numbers set to `values`."""
        for leaf in self.leaves:
            world = leaf.put(world, values)
        return world


class FreeField(NamedTuple):
    """One free field as messages and reports name it; parameter `numbers[k]` sets its component `components[k]`."""

    path: str
    leaf: paths.Leaf | None
    """None: an exposure."""
    row: int
    labels: tuple[str, ...]
    components: np.ndarray
    numbers: np.ndarray
    range: Range


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
    world: World, free: Any, view_names: Sequence[str], dtype: Any
) -> tuple[Parameters, list[FreeField]]:
    """The parameters that `free` means, and their description by field.

    Args:
        free: a path, a function of the scene, a `Free`, a list of these, or a mapping from path to `Free` options.
        view_names: name of each view, for `View[name].exposure`.

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
    for request in requests:
        chosen = _choose(world, request.where, view_names)
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
            value = _value(world, one)
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
    described = [
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
    arrays = (jnp.asarray(np.array(column), dtype=dtype) for column in (values, lower, upper, means, precisions))
    return Parameters(*arrays, leaves=tuple(leaves)), described


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


def _choose(world: World, where: Any, view_names: Sequence[str]) -> list[_Chosen]:
    """The numbers that the paths mean, in the order of the scene's fields."""
    each = [where] if isinstance(where, str) or callable(where) else list(where)
    exposures = [path for path in each if isinstance(path, str) and path.startswith("View[")]
    chosen = []
    selections = paths.select(world.scene, [path for path in each if path not in exposures])
    masks = {selection.leaf: selection.mask for selection in selections}
    for field in paths.fields(world.scene):
        if field.leaf not in masks:
            continue
        mask = masks[field.leaf]
        numbers = np.arange(mask.size).reshape(mask.shape)[field.index].reshape(-1)
        wanted = mask[field.index].reshape(-1)
        if not np.any(wanted):
            continue
        labels, row = field.labels(world.scene), field.index[0] if field.index else 0
        for component in np.flatnonzero(wanted).tolist():
            label, element = labels[component], int(numbers[component])
            chosen.append(_Chosen(field.path, label, field.leaf, row, component, element, field.leaf.range))
    for path in exposures:
        for row in _exposure_rows(path, view_names):
            name = f"View[{view_names[row] or row}].exposure"
            chosen.append(_Chosen(name, name, None, row, 0, row, paths.POSITIVE))
    return chosen


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


def _value(world: World, one: _Chosen) -> float:
    leaf = world.exposure if one.leaf is None else one.leaf.get(world.scene)
    value = float(np.asarray(leaf).reshape(-1)[one.element])
    if not np.isfinite(value):
        raise ValueError(f"{one.label}: a free field must start at a finite value, got {value}")
    return value


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
