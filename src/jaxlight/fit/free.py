"""What a person frees: paths, bounds, ties and priors, resolved to the parameters of a fit."""

from __future__ import annotations

import contextlib
import dataclasses
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..arrays import array_of, known_numbers, refuse_masked
from ..given import plain, several
from ..scene import paths
from ..scene.fields import largest_of, number
from ..scene.paths import Path
from .chosen import MIN_BLOCK, Catalogue, Chosen, choose
from .parameters import FreeField, FreeLeaf, Parameters, TexelBlock, World


@dataclasses.dataclass(frozen=True, eq=False)
class Free:
    """A field to fit, with more to say about it than its path. `fit` checks it, and its errors name the field.

    Args:
        where: path, function of the scene, or several of them.
        lower, upper: bounds tighter than the specification's range; a number, or one a component.
        tied: True: all nodes that `where` means share one value, component by component; "all": all its numbers are
            one number (a grey colour). It begins at the first one's start and stays in the bounds of all. Rows of one
            node that is placed several times (USE) are so tied in any case: it has one value.
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
    catalogue = Catalogue(world)
    numbers = _Numbers(dtype)
    whole: list[tuple[int, Free, paths.Leaf]] = []
    for place, given in enumerate(requests):
        with _about(place):
            request = _checked(given)
            chosen, textures = choose(catalogue, request.where, view_names, blocks=blocks and not request.tied)
            whole += [(place, request, leaf) for leaf in textures]
            if request.tied:
                chosen = _as_named(catalogue, request, chosen, view_names)
            if chosen:
                _check_options(request, chosen)
                _add_numbers(numbers, catalogue, request, chosen, place)
    columns, made = numbers.columns(), []
    for place, request, leaf in whole:
        with _about(place):
            if numbers.has(leaf) or any(block.texture == leaf.row for block in made):
                raise ValueError(f"free: Texture[{leaf.row}].image is named twice")
            block, own = _texel_block(world, request, leaf, len(columns[0]), dtype)
        made.append(block)
        columns = [np.concatenate(pair) for pair in zip(columns, own, strict=True)]
    arrays = (array_of(column, dtype) for column in columns)
    return Parameters(*arrays, leaves=numbers.leaves(catalogue, world), blocks=tuple(made)), numbers.fields()


class RequestError(ValueError):
    """What is wrong with one of the requests of a fit, by its place among them."""

    def __init__(self, message: str, place: int = 0) -> None:
        super().__init__(message)
        self.place = place


@contextlib.contextmanager
def _about(place: int) -> Iterator[None]:
    """Errors of the block are about the request at this place."""
    try:
        yield
    except ValueError as error:
        raise RequestError(str(error), place) from error.__cause__


class _Prior(NamedTuple):
    """The prior of a number, and of which of those that are tied it was said."""

    mean: float
    deviation: float
    label: str

    def __str__(self) -> str:
        return f"{self.mean:g} +- {self.deviation:g}"


class _Numbers:
    """The numbers that are free, as they are found: start, bounds and prior of each, and what each sets."""

    def __init__(self, dtype: Any) -> None:
        self._dtype = dtype
        self._start: list[float] = []
        self._lower: list[float] = []
        self._upper: list[float] = []
        self._mean: list[float] = []
        self._precision: list[float] = []
        self._found: list[float] = []
        """Where the first one of each tie stands."""
        self._priors: dict[int, _Prior] = {}
        self._of_tie: dict[tuple[Any, ...], int] = {}
        self._members: dict[str, list[tuple[Chosen, int]]] = {}
        self._sets: dict[paths.Leaf | None, dict[int, int]] = {}
        """Of each leaf which number sets an element."""

    def has(self, leaf: paths.Leaf | None, element: int | None = None) -> bool:
        """Whether an element of a leaf, or any of its elements, is set by a number."""
        return leaf in self._sets and (element is None or element in self._sets[leaf])

    def add(
        self,
        one: Chosen,
        tie: tuple[Any, ...],
        value: float,
        bounds: tuple[float, float],
        prior: tuple[float | None, float | None],
    ) -> None:
        """One more that is free; those of the same tie are one number, which begins at the first one's start.

        Raises:
            ValueError: the number's start is outside these bounds, or it has another prior.
        """
        low, high = bounds
        if tie in self._of_tie:
            number = self._of_tie[tie]
            _check_inside(f"{one.label}, which is tied,", self._start[number], low, high)
            low, high = max(self._lower[number], low), min(self._upper[number], high)
            self._lower[number], self._upper[number] = low, high
            self._start[number] = min(max(self._start[number], low), high)
        else:
            number = self._of_tie[tie] = len(self._start)
            self._start.append(min(max(value, low), high))
            self._lower.append(low)
            self._upper.append(high)
            self._found.append(value)
            self._mean.append(value)
            self._precision.append(0.0)
        self._add_prior(one, number, *prior)
        self._sets.setdefault(one.leaf, {})[one.element] = number
        self._members.setdefault(one.path, []).append((one, number))

    def _add_prior(self, one: Chosen, number: int, mean: float | None, deviation: float | None) -> None:
        """What one of a tie says of its number; `mean` None: as it is."""
        if deviation is None or np.isinf(deviation):
            return
        own = _Prior(self._found[number] if mean is None else mean, deviation, one.label)
        earlier = self._priors.setdefault(number, own)
        if earlier[:2] != own[:2]:
            raise ValueError(
                f"free: {earlier.label} and {own.label} are one number, with two priors: {earlier} and {own}"
            )
        self._mean[number], self._precision[number] = own.mean, _precision_of(deviation)
        _check_priors(one.label, self._start[number], own.mean, self._precision[number], self._dtype)

    def columns(self) -> list[np.ndarray]:
        """The first fields of `Parameters`, from `start` to `prior_precision`."""
        return [np.array(column) for column in (self._start, self._lower, self._upper, self._mean, self._precision)]

    def leaves(self, catalogue: Catalogue, world: World) -> tuple[FreeLeaf, ...]:
        """Where the numbers go: of a node that is placed several times (USE) to all its rows, whichever is meant."""
        leaves = []
        for leaf, numbers in self._sets.items():
            source = np.full(world.array(leaf).size, -1, np.int32)
            source[list(numbers)] = list(numbers.values())
            if leaf is not None and leaf.row < 0:
                source = _at_every_place(source, catalogue.first_rows(leaf.kind))
            leaves.append(FreeLeaf(array_of(source, np.int32), leaf))
        return tuple(leaves)

    def fields(self) -> list[FreeField]:
        """The description by field."""
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
            for path, parts in self._members.items()
        ]


def _at_every_place(source: np.ndarray, first: list[int]) -> np.ndarray:
    """Which number sets an element (-1: none), rows of one node, of which `first` is the first row, alike."""
    rows = source.reshape(len(first), -1)
    of_node = rows.copy()
    for row, node in enumerate(first):
        of_node[node] = np.maximum(of_node[node], rows[row])
    return np.where(rows < 0, of_node[first], rows).reshape(-1)


def _add_numbers(numbers: _Numbers, catalogue: Catalogue, request: Free, chosen: list[Chosen], place: int) -> None:
    """Add what a request, by its place among all, means."""
    seen: Counter[str] = Counter()
    for one in chosen:
        component = seen[one.path]
        seen[one.path] += 1
        tie: tuple[Any, ...] = (one.leaf, catalogue.first_row(one), one.component)  # one number of one node
        if request.tied:
            tie = (place, 0 if request.tied == "all" else component)
        if numbers.has(one.leaf, one.element):
            raise ValueError(f"free: {one.label} is named twice")
        value = catalogue.value(one)
        bounds = _bounds(request, one, component, value)
        numbers.add(one, tie, value, bounds, _prior(request, one, component))


def _as_named(catalogue: Catalogue, request: Free, chosen: list[Chosen], view_names: Sequence[str]) -> list[Chosen]:
    """What a request means, the fields in the order in which it names them."""
    each = [one.path for path in several(request.where) for one in choose(catalogue, path, view_names, blocks=False)[0]]
    place = {path: number for number, path in reversed(list(enumerate(each)))}
    return sorted(chosen, key=lambda one: place[one.path])


def _check_options(request: Free, chosen: list[Chosen]) -> None:
    """What is said about numbers must fit them, those of textures as a whole apart."""
    path = chosen[0].path
    if request.smoothness is not None or request.total_variation is not None:
        kind = f"whole textures of at least {MIN_BLOCK} colours" + (" that are not tied" if request.tied else "")
        raise ValueError(f"{path}: smoothness and total_variation are for {kind}")
    _check_lengths(request, chosen)
    if request.tied is True:
        _check_tie(chosen)
    if request.tied == "all":
        _check_one_prior(request, path)


def _texel_block(
    world: World, request: Free, leaf: paths.Leaf, offset: int, dtype: Any
) -> tuple[TexelBlock, list[np.ndarray]]:
    """The block of a whole texture, and its start, bounds and prior, flat."""
    image = np.asarray(leaf.get(world.scene), np.float64)
    path = next(field.path for field in paths.fields(world.scene) if field.leaf == leaf)
    shape = (image.shape[0], image.shape[1], 1 if image.shape[2] <= 2 else 3)
    start = image[..., : shape[2]]

    def spread(option: str, given: Any, default: Any) -> np.ndarray:
        allowed = f"one number, one a component, or an image of shape {list(shape)}"
        numbers = known_numbers(f"{path}: {option}", default if given is None else given, allowed).astype(np.float64)
        try:
            if np.any(np.isnan(numbers)):
                raise ValueError
            return np.broadcast_to(numbers, shape).reshape(-1)
        except ValueError:
            raise ValueError(f"{path}: {option}: expected {allowed}, got {given!r:.60}") from None

    low, high = (
        spread("lower", request.lower, leaf.range.lower),
        spread("upper", request.upper, leaf.range.upper),
    )
    if np.any(low > high):
        raise ValueError(f"{path}: {np.count_nonzero(low > high)} texels have a lower bound above their upper bound")
    outside = (start.reshape(-1) < low - 1e-6) | (start.reshape(-1) > high + 1e-6)
    if np.any(outside):
        raise ValueError(f"{path}: {np.count_nonzero(outside)} texels start outside their bounds")
    if request.mean is not None and request.deviation is None:
        raise ValueError(f"{path}: a prior mean needs a deviation")
    deviation = spread("deviation", request.deviation, np.inf)
    if not np.all(deviation > 0):
        raise ValueError(f"{path}: deviation: expected a number > 0, got {request.deviation!r:.40}")
    mean = spread("mean", request.mean, start)
    if not np.all(np.isfinite(mean)):
        raise ValueError(f"{path}: mean: expected finite numbers, got {request.mean!r:.60}")
    smoothness, variation = (
        0.0 if given is None else 1 / number(f"{path}: {option}", given, above=0.0, infinite=True)
        for option, given in (("smoothness", request.smoothness), ("total_variation", request.total_variation))
    )
    precision = smoothness * smoothness  # a power of floats raises where it is too large
    if max(precision, variation) > largest_of(dtype):
        raise ValueError(f"{path}: smoothness and total_variation: too small for what {np.dtype(dtype)} holds")
    block = TexelBlock(
        smoothness=jnp.asarray(precision, dtype),
        total_variation=jnp.asarray(variation, dtype),
        texture=leaf.row,
        offset=offset,
        shape=shape,
        path=path,
    )
    values, precisions = np.clip(start.reshape(-1), low, high), _precision_of(deviation)
    _check_priors(path, values, mean, precisions, dtype)
    return block, [values, low, high, mean, precisions]


def _requests(free: Any) -> list[Free]:
    if isinstance(free, Mapping):
        return [_with_options(path, options) for path, options in free.items()]
    requests = []
    for one in several(free):
        if not (isinstance(one, (str, Free)) or callable(one)):
            raise ValueError(f"free: expected a field path, a function of the scene or a Free, got {one!r:.80}")
        requests.append(one if isinstance(one, Free) else Free(one))
    return requests


def _checked(request: Free) -> Free:
    """The request, with its paths as a list and `tied` as one of its values."""
    where, tied = several(request.where), plain(request.tied)
    if not where:
        raise ValueError(f"free: expected a path or several, got {request.where!r:.60}")
    if not isinstance(tied, bool | str) or tied not in (True, False, "all"):
        raise ValueError(f"{where[0]}: tied: expected True, False or 'all', got {tied!r:.60}")
    return dataclasses.replace(request, where=where, tied=tied)


def _with_options(path: Any, options: Any) -> Free:
    """An entry of a mapping from path to options."""
    known = [field.name for field in dataclasses.fields(Free) if field.name != "where"]
    options = {} if options is None else options
    if not isinstance(options, Mapping) or not set(options) <= set(known):
        raise ValueError(f"free: {path}: expected a mapping with some of {', '.join(known)}, got {options!r:.80}")
    return Free(path, **options)


def _check_tie(chosen: list[Chosen]) -> None:
    sizes = Counter(one.path for one in chosen)
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{path} ({size})" for path, size in sizes.items())
        raise ValueError(f"free: tied fields need the same number of components; got {listed}")


def _check_lengths(request: Free, chosen: list[Chosen]) -> None:
    sizes = Counter(one.path for one in chosen)
    for option in ("lower", "upper", "mean", "deviation"):
        given = getattr(request, option)
        refuse_masked(f"{chosen[0].path}: {option}", given)
        length = 1 if given is None else len(_flat(given))
        for path, size in sizes.items():
            if length not in (1, size):
                raise ValueError(f"{path}: {option}: expected one number or {size}, got {length}")


def _flat(given: Any) -> np.ndarray:
    """What was given as one number or one a component, unchecked."""
    return np.asarray(given, dtype=object).reshape(-1)


def _component(where: str, given: Any, component: int, **allowed: Any) -> float:
    each = _flat(given)
    return number(where, each[0 if len(each) == 1 else component], **allowed)


def _bounds(request: Free, one: Chosen, component: int, value: float) -> tuple[float, float]:
    allowed = one.range
    # An open end is no value one can reach: stop a little before it.
    low = 1e-3 * min(1.0, abs(value)) if allowed.open_below else allowed.lower
    high = allowed.upper
    if request.lower is not None:
        low = max(low, _component(f"{one.path}: lower", request.lower, component, infinite=True))
    if request.upper is not None:
        high = min(high, _component(f"{one.path}: upper", request.upper, component, infinite=True))
    if allowed.open_below and value <= allowed.lower:
        raise ValueError(f"{one.label} starts at {value:g}, but must be in {allowed}")
    if low > high:
        raise ValueError(f"{one.label}: the lower bound {low:g} is above the upper bound {high:g}")
    _check_inside(one.label, value, low, high)
    return low, high


def _check_inside(what: str, start: float, low: float, high: float) -> None:
    slack = 1e-6 * max(1.0, abs(start))
    if not low - slack <= start <= high + slack:
        raise ValueError(f"{what} starts at {start:g}, outside its bounds [{low:g}, {high:g}]")


def _precision_of(deviation: Any) -> Any:
    """1 / deviation^2; infinity where that is more than there are numbers."""
    with np.errstate(over="ignore"):
        return np.asarray(deviation, np.float64) ** -2.0


def _check_priors(path: str, start: Any, mean: Any, precision: Any, dtype: Any) -> None:
    """Raise ValueError for priors whose weight, or whose loss at the start, is more than the type holds."""
    with np.errstate(over="ignore", invalid="ignore"):
        loss = precision * np.square(np.subtract(start, mean))
    holds = f"more than {np.dtype(dtype)} holds"
    if np.any(precision > largest_of(dtype)):
        raise ValueError(f"{path}: deviation: a prior's deviation is too small: 1 / deviation^2 is {holds}")
    if np.any(loss > largest_of(dtype)):
        raise ValueError(f"{path}: mean: so many deviations from the start that the prior's loss is {holds}")


def _check_one_prior(request: Free, path: str) -> None:
    """Numbers that are all one have one prior."""
    for option in ("mean", "deviation"):
        given = getattr(request, option)
        if given is not None and len(set(_flat(given).tolist())) > 1:
            raise ValueError(f"{path}: {option}: expected one number where all are tied, got {given!r:.60}")


def _prior(request: Free, one: Chosen, component: int) -> tuple[float | None, float | None]:
    if request.deviation is None:
        if request.mean is not None:
            raise ValueError(f"{one.path}: a prior mean needs a deviation")
        return None, None
    deviation = _component(f"{one.path}: deviation", request.deviation, component, above=0.0, infinite=True)
    return (None if request.mean is None else _component(f"{one.path}: mean", request.mean, component)), deviation
