"""What pictures cannot tell: directions in which the free fields may move without any picture changing, in words.

The scaled Gauss-Newton matrix (unit diagonal) has an eigenvalue 0 for each such direction. Those that a prior tells are
known, however little it adds to the matrix beside precise pictures. The others are given in as few fields as possible,
and told by what is kept: a product, a ratio, a sum, or a vector's direction.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from .parameters import FreeField

Kept = Literal["product", "ratio", "sum", "difference", "direction", "combination"]

NULL = 1e-10
"""Eigenvalue of the scaled matrix, computed in float64, below which a direction counts as not seen."""
_UNSEEN = 1e-14
"""Change of all pictures with a number, of its size and relative to the greatest such, that is rounding."""
ZERO = 1e-4
"""Share of the largest component below which a component of a direction counts as 0."""
_MAX_SUBSETS = 20_000


class Ambiguity(NamedTuple):
    """One direction in which fields can be traded for each other."""

    fields: tuple[str, ...]
    """The fields (or components, where not all of a field takes part) in the order of the text."""
    direction: np.ndarray
    """Change of every free number along the direction, largest 1 in absolute value."""
    kept: Kept
    """What the pictures do see of them."""
    text: str


class Seen(NamedTuple):
    """The free numbers sorted by what the pictures say of them."""

    unseen: np.ndarray
    """True where no picture depends on the number at all."""
    null: np.ndarray
    """[directions, numbers]: an orthonormal basis, in scaled variables, of what cannot be told."""
    by_priors: np.ndarray
    """The same of what priors tell, and pictures do not."""
    eigenvalues: np.ndarray
    """Of the scaled matrix over the numbers that are seen and not held, ascending."""
    scale: np.ndarray
    """Length of each column of the Jacobian."""


class Partner(NamedTuple):
    """A texture whose texels answer to the numbers: what they do along a direction of the numbers."""

    path: str
    answers: np.ndarray
    """[texels, numbers]: change of each texel when a number moves and the texels make up for it."""
    texels: np.ndarray


def analyse(
    curvature: np.ndarray, precision: np.ndarray, held: np.ndarray, scale: np.ndarray, size: np.ndarray
) -> Seen:
    """Sort the numbers by what a Gauss-Newton matrix says of them.

    Args:
        curvature: J^T J in float64, priors included, texels eliminated.
        precision: of the numbers' priors; 0: none.
        held: True for numbers that press against a bound: they are taken as known.
        scale: length of each column of the Jacobian, before texels were eliminated.
        size: of each number, in its own unit: what a change of it is to be measured by.
    """
    change = scale * size
    unseen = ~(change > _UNSEEN * np.max(change, initial=0)) & ~held
    use = np.flatnonzero(~unseen & ~held)
    eigenvalues, vectors = scaled_eigen(curvature, use, scale)
    null = np.zeros((int(np.count_nonzero(eigenvalues < NULL)), len(curvature)))
    null[:, use] = vectors[:, eigenvalues < NULL].T
    # Beside precise pictures a prior may be less than rounding: what counts is that a direction moves what has one.
    turned, moved, _ = np.linalg.svd(np.where(precision > 0, null, 0), full_matrices=False)
    null, told = turned.T @ null, int(np.count_nonzero(moved > ZERO))
    return Seen(unseen, null[told:], null[:told], eigenvalues, scale)


def scaled_eigen(curvature: np.ndarray, use: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues, ascending, and eigenvectors of the scaled matrix over the numbers in use."""
    scaled = curvature[np.ix_(use, use)] / (scale[use][:, None] * scale[use][None, :])
    return np.linalg.eigh(scaled) if len(use) else (np.zeros(0), np.zeros((0, 0)))


def ambiguities(
    seen: Seen,
    values: np.ndarray,
    labels: Sequence[str],
    fields: Sequence[FreeField],
    partners: Sequence[Partner] = (),
) -> list[Ambiguity]:
    """The directions that cannot be told, each in as few numbers as possible, in words."""
    found = []
    for scaled in _sparse_basis(seen.null):
        direction = np.where(scaled == 0, 0, scaled / np.where(seen.scale > 0, seen.scale, 1))
        # The last number to move, a light's or an exposure's rather than a material's, moves up.
        direction *= np.sign(direction[np.flatnonzero(direction)[-1]]) / np.max(np.abs(direction))
        found.append(_told(direction, values, labels, fields, partners))
    return found


def _sparse_basis(null: np.ndarray) -> list[np.ndarray]:
    """Vectors that span the rows of `null`, the ones with fewest components first; small components set to 0."""
    count = len(null)
    if count == 0:
        return []
    taking_part = np.flatnonzero(np.max(np.abs(null), axis=0) > ZERO)
    candidates = []
    if count == 1:
        candidates = [null[0]]
    elif math.comb(len(taking_part), count - 1) <= _MAX_SUBSETS:
        # The sparsest vectors have their zeros wherever count - 1 of them can be had.
        subsets = np.array(list(itertools.combinations(taking_part, count - 1)))
        _, _, right = np.linalg.svd(null.T[subsets])
        candidates = list(right[:, -1] @ null)
    candidates += list(_echelon(null, taking_part))
    cleaned = [np.where(np.abs(c) > ZERO * np.max(np.abs(c)), c, 0) for c in candidates]
    cleaned.sort(key=np.count_nonzero)
    basis: list[np.ndarray] = []
    for candidate in cleaned:
        trial = np.array([*basis, candidate / np.linalg.norm(candidate)])
        if np.linalg.matrix_rank(trial, tol=1e-3) == len(trial):
            basis = list(trial)
        if len(basis) == count:
            break
    return basis


def _echelon(null: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Reduced row echelon form of `null` with its pivots among the first possible columns of `order`."""
    rows, pivot = null.copy(), 0
    for column in order:
        if pivot == len(rows):
            break
        best = pivot + int(np.argmax(np.abs(rows[pivot:, column])))
        if abs(rows[best, column]) < 1e-3:
            continue
        rows[[pivot, best]] = rows[[best, pivot]]
        rows[pivot] /= rows[pivot, column]
        others = np.arange(len(rows)) != pivot
        rows[others] -= rows[others, column][:, None] * rows[pivot]
        pivot += 1
    return rows


class _Part(NamedTuple):
    """A field, or one component of it, and how it changes along a direction."""

    name: str
    change: float
    relative: float
    """Change relative to its value; infinite at 0."""


def _told(
    direction: np.ndarray,
    values: np.ndarray,
    labels: Sequence[str],
    fields: Sequence[FreeField],
    partners: Sequence[Partner],
) -> Ambiguity:
    vector = _single_vector(direction, values, fields)
    if vector is not None:
        text = f"the length of {vector} is not seen: only where it points"
        return Ambiguity((vector,), direction, "direction", text)
    parts = [*_parts(direction, values, labels, fields), *_textures(direction, partners)]
    rising = [part for part in parts if part.change > 0]
    falling = [part for part in parts if part.change < 0]
    kept: Kept = "combination"
    relatives = np.array([part.relative for part in parts])
    changes = np.array([part.change for part in parts])
    # Of equal numbers both hold, but numbers of one field, of several lights for example, are never multiplied.
    add_up = len(parts) > 1 and len({_field_of(part.name) for part in parts}) == 1 and _alike(np.abs(changes))
    if _alike(np.abs(relatives)) and not add_up:
        kept = "product" if rising and falling else "ratio"
    elif _alike(np.abs(changes)):
        kept = "sum" if rising and falling else "difference"
    if kept == "ratio" or (kept == "combination" and not (rising and falling)):
        rising, falling = parts[:1], parts[1:]
    kept_words = "only one combination of them is seen" if kept == "combination" else f"only their {kept} is seen"
    if not falling:
        text = f"{_listed(rising)}: its components can be traded for each other, {kept_words}"
    else:
        text = f"{_listed(rising)} can be traded for {_listed(falling)}: {kept_words}"
    return Ambiguity(tuple(part.name for part in [*rising, *falling]), direction, kept, text)


def _field_of(path: str) -> tuple[str, ...]:
    """What the path is of, without which row or component: a material, a light of any kind, a view or a texture."""
    owner, field = (re.sub(r"\[.*", "", part) for part in re.split(r"\.(?![^\[]*\])", path)[:2])
    return ("Light" if owner.endswith("Light") else owner, field)


def _single_vector(direction: np.ndarray, values: np.ndarray, fields: Sequence[FreeField]) -> str | None:
    """The field that only changes its length, if the direction is that and nothing else."""
    moving = set(np.flatnonzero(direction).tolist())
    for field in fields:
        own = field.numbers
        if len(own) > 1 and moving <= set(own.tolist()) and field.leaf is not None and field.leaf.field == "direction":
            cosine = abs(direction[own] @ values[own]) / (np.linalg.norm(direction[own]) * np.linalg.norm(values[own]))
            return field.path if cosine > 1 - 1e-4 else None
    return None


def _parts(
    direction: np.ndarray, values: np.ndarray, labels: Sequence[str], fields: Sequence[FreeField]
) -> list[_Part]:
    """What moves: whole fields where all their components change alike, else components; tied numbers once."""
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(direction == 0, 0, direction / values)
    parts, told = [], set()
    for field in fields:
        own = [n for n in dict.fromkeys(field.numbers.tolist()) if direction[n] != 0 and n not in told]
        told.update(own)
        if not own:
            continue
        whole = len(own) == len(set(field.numbers.tolist())) and (
            _alike(relative[own], signed=True) or _alike(direction[own], signed=True)
        )
        if whole and len(own) > 1:
            parts.append(_Part(field.path, float(np.mean(direction[own])), float(np.mean(relative[own]))))
        elif whole:
            parts.append(_Part(field.path, float(direction[own[0]]), float(relative[own[0]])))
        else:
            parts += [_Part(str(labels[n]), float(direction[n]), float(relative[n])) for n in own]
    return parts


def _textures(direction: np.ndarray, partners: Sequence[Partner]) -> list[_Part]:
    """The textures that answer to a direction, each with its typical change."""
    parts = []
    for partner in partners:
        change = partner.answers @ direction
        moving = np.abs(change) > 1e-6 * np.max(np.abs(change), initial=1e-300)
        if np.max(np.abs(change), initial=0) > 1e-6 and np.any(moving):
            relative = np.median(change[moving] / np.where(partner.texels[moving] != 0, partner.texels[moving], np.inf))
            parts.append(_Part(partner.path, float(np.median(change[moving])), float(relative)))
    return parts


def _alike(numbers: np.ndarray, *, signed: bool = False) -> bool:
    """True if all numbers are finite and equal to a thousandth."""
    numbers = np.asarray(numbers)
    if not np.all(np.isfinite(numbers)) or not np.any(numbers):
        return False
    if signed and np.min(numbers) < 0 < np.max(numbers):
        return False
    return bool(np.ptp(numbers) <= 1e-3 * np.max(np.abs(numbers)))


def _listed(parts: Sequence[_Part]) -> str:
    names = [part.name for part in parts]
    if len(names) > 4:
        names = [*names[:3], f"{len(names) - 3} more"]
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
