"""How well a fit knows what it found: standard errors, correlations, bounds, and what no picture tells.

With the residuals' variance s^2 (stated, or estimated from what is left) and the precision P of priors, the covariance
of the free numbers is H^-1 (s^2 J^T J + P) H^-1 with H = J^T J + P, over the numbers that no bound holds and the
directions that the pictures see: s^2 (J^T J)^-1 without priors.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..lighting.compiling import quick_jit
from ..promotion import usual_promotion
from . import normal
from .curvature import ArrowCurvature, as_curvature
from .held import SIGNIFICANT, held_by_bounds, inverse_of_priors, inverse_of_seen
from .identify import Ambiguity, Partner, ambiguities, analyse
from .leftover import Leftover, leftover
from .problem import Description, Problem
from .residuals import is_limit
from .unresolved import FAR, off_by_priors
from .widened import widened

ENOUGH = 10
"""Residuals within a robust loss's scale, or as many that tell as much, from which on its errors are stated; fewer if
they are half of all."""
MANY = 0.05
"""The share of a texture's colours from which on those that lie on a bound are told."""
NOISIER, SURELY = 1.1, 5.0
"""What is left of pictures is more than their stated noise: by this factor, and by so many standard deviations."""
QUIETER = 0.5
"""What is left is less than the stated noise by this factor."""


class Correlation(NamedTuple):
    """Two numbers whose errors are nearly the same error."""

    labels: tuple[str, str]
    value: float
    """In [-1, 1]."""


class UnseenTexels(NamedTuple):
    """Texels of a whole texture that neither pictures nor priors or neighbours determine."""

    path: str
    count: int
    total: int
    entirely: bool
    """Whether no colour of any of them is seen."""


@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """What a fit knows of each free number, in the order of its labels."""

    labels: tuple[str, ...]
    standard_error: np.ndarray
    """Infinite where the pictures do not determine the number; 0 where a bound holds it, against pictures that want it
    beyond by three standard errors and more, and where its bounds are one."""
    covariance: np.ndarray
    """[numbers, numbers] over the directions that are seen; 0 for held and unseen numbers, NaN if noise is unknown."""
    noise: float
    """Standard deviation of a residual of weight 1: stated, or estimated from what the fit left (of robust losses what
    least squares would need for the same errors); infinite, and unknown, where nothing is left to tell it."""
    rank: int
    """Number of directions that the pictures determine."""
    at_bound: tuple[tuple[str, str], ...]
    """(label, "lower" or "upper") of the numbers that lie on a bound, and have another."""
    unseen: tuple[str, ...]
    """Numbers that no picture depends on."""
    ambiguities: tuple[Ambiguity, ...]
    hardly_seen: tuple[tuple[str, float], ...]
    """(label, standard error) of the numbers whose error is half of their range or more; where that is endless, of
    their value at the start or the end, whichever is larger."""
    correlations: tuple[Correlation, ...]
    """Pairs above 0.99 in absolute value, the strongest first."""
    remarks: tuple[str, ...] = ()
    """What the errors rest on, where it may not be what was meant."""
    unseen_texels: tuple[UnseenTexels, ...] = ()
    """Of each whole texture that has some."""
    failure: str = ""
    """Why nothing is known; empty otherwise."""

    @property
    def well_posed(self) -> bool:
        """True if the pictures determine every free number."""
        return not self.failure and not self.unseen and not self.ambiguities and not self.unseen_texels

    def messages(self) -> list[str]:
        """What a person should know before believing the numbers, a sentence each; none if all is well."""
        lines = [f"nothing is known of the numbers: {self.failure}"] if self.failure else []
        lines += [f"{label} is not seen: the pictures do not change with it near its value" for label in self.unseen]
        lines += [
            f"{count} of {total} texels of {path} are seen in no view"
            f"{'' if entirely else ', or not in all their colours'}: what is not seen keeps its start"
            for path, count, total, entirely in self.unseen_texels
        ]
        lines += self.remarks
        lines += [ambiguity.text for ambiguity in self.ambiguities]
        held = {label for label, error in zip(self.labels, self.standard_error, strict=True) if error == 0}
        lines += [
            f"{label} lies on its {side} bound" + (", beyond which it would go: no error is given" * (label in held))
            for label, side in self.at_bound
        ]
        lines += [f"{label} is hardly seen: its standard error is {error:.2g}" for label, error in self.hardly_seen]
        lines += [
            f"{a} and {b} are hard to tell apart: the correlation of their errors is {value:+.4f}"
            for (a, b), value in self.correlations
        ]
        return lines

    def __str__(self) -> str:
        width = max((len(label) for label in self.labels), default=0)
        rows = [
            f"  {label:<{width}}  +- {error:.3g}" for label, error in zip(self.labels, self.standard_error, strict=True)
        ]
        lines = [*rows, *self.messages()]
        return "\n".join(lines) if lines else "the pictures determine every texel that is free"


def nothing_known(problem: Problem, description: Description, why: str) -> Uncertainty:
    """That of values which mean nothing."""
    count = problem.parameters.few
    fixed = np.asarray(problem.parameters.lower == problem.parameters.upper)[:count]
    return Uncertainty(
        labels=tuple(description.labels),
        standard_error=np.where(fixed, 0, np.inf),
        covariance=np.full((count, count), np.nan),
        noise=np.inf,
        rank=0,
        at_bound=(),
        unseen=(),
        ambiguities=(),
        hardly_seen=(),
        correlations=(),
        failure=why,
    )


@usual_promotion
def uncertainty(problem: Problem, description: Description, values: Any) -> Uncertainty:
    """Standard errors and what cannot be known at the given values; computed in float64 whatever the fit's precision.

    Texels of whole textures are eliminated: errors and ambiguities of the other numbers allow for every texel.

    Args:
        problem, description: the fit.
        values: all fitted numbers (`FitState.values`).
    """
    count = problem.parameters.few
    rounding = jnp.finfo(problem.parameters.start.dtype).eps
    with jax.enable_x64(True):
        wide = widened(problem)
        at = jnp.asarray(np.asarray(values), jnp.float64)
        known = jnp.asarray(description.noise_known)
        reduced = jax.tree.map(lambda a: np.asarray(a, np.float64), _reduced(wide, at, known, jnp.asarray(rounding)))
        if not all(np.isfinite(leaf).all() for leaf in reduced):
            return nothing_known(problem, description, "the loss or its derivative is not finite at them")
        squares_of_known_noise = description.noise_known and problem.loss_kind == "squares"
        left = None if squares_of_known_noise else Leftover(*map(float, leftover(wide, at)))
        limits = _limits(problem) if squares_of_known_noise else 0
    found = np.asarray(values, np.float64)
    lower, upper = (np.asarray(a, np.float64)[:count] for a in (problem.parameters.lower, problem.parameters.upper))
    texels, found = found[count:], found[:count]
    labels = description.labels
    fixed = lower == upper
    on_lower, on_upper = (found <= lower) & ~fixed, (found >= upper) & ~fixed
    curvature, lengths = reduced.curvature, reduced.lengths
    sizes = np.where(reduced.sizes > 0, reduced.sizes, 1)
    side = on_upper.astype(int) - on_lower
    held = held_by_bounds(
        curvature, reduced.precision, reduced.gradient, lengths, sizes, side, fixed, float(reduced.noise)
    )
    seen = analyse(curvature, reduced.precision, held, lengths, sizes)
    rank = int(np.count_nonzero(~held & ~seen.unseen)) - len(seen.null)
    inverse = inverse_of_seen(curvature, held, seen) + inverse_of_priors(reduced.precision, seen)
    off = off_by_priors(curvature, reduced.precision, reduced.gradient, side, held, seen, float(rounding))
    fitted = rank - float(np.sum(inverse * reduced.priors)) + float(reduced.texels)
    unknown = "" if left is None else _why_unknown(description, left, fitted)
    noise, variance = (np.inf, np.inf) if unknown else _noise(description, left, fitted)
    is_known = not unknown
    covariance = inverse
    if is_known:
        # Of what the pictures say, and of what priors do: written as a difference it would round to 0 where noise is.
        by_priors = inverse @ reduced.priors @ inverse
        covariance = variance * (inverse - by_priors) + by_priors
    traded = np.max(np.abs(seen.null), axis=0, initial=0) > 1e-4
    error = np.where(seen.unseen | traded, np.inf, np.sqrt(np.maximum(np.diagonal(covariance), 0)))
    error = np.where(held, 0, error if is_known else np.inf)
    # What is found to be 0 is seen well if its error is small beside what it might have been: its start.
    span = np.where(np.isfinite(upper - lower), upper - lower, np.maximum(reduced.sizes, np.abs(found)))
    hardly = np.isfinite(error) & (error > 0) & (error >= span / 2)
    partners = [
        Partner(block.path, reduced.answers[start : start + block.size], texels[start : start + block.size])
        for block, start in zip(problem.parameters.blocks, _offsets(problem), strict=True)
    ]
    return Uncertainty(
        labels=tuple(labels),
        standard_error=error,
        covariance=covariance if is_known else np.full_like(inverse, np.nan),
        noise=noise,
        rank=rank,
        at_bound=tuple(
            (labels[i], "lower" if on_lower[i] else "upper") for i in np.flatnonzero(on_lower | on_upper).tolist()
        ),
        unseen=tuple(labels[i] for i in np.flatnonzero(seen.unseen).tolist()),
        ambiguities=tuple(ambiguities(seen, found, labels, description.fields, partners)),
        hardly_seen=tuple((labels[i], float(error[i])) for i in np.flatnonzero(hardly).tolist()),
        correlations=tuple(_correlations(covariance, labels, traded)),
        remarks=(
            *filter(None, [unknown]),
            *_remarks(problem, description, float(reduced.loss), fitted, limits, off),
            *_against_priors(problem, description, found, error),
            *_texels_on_bounds(problem, texels, reduced.rows),
        ),
        unseen_texels=tuple(_unseen_texels(problem, reduced.rows)),
    )


class _Reduced(NamedTuple):
    """What the pictures say of the labelled numbers, texels eliminated."""

    loss: Any
    """Of the pictures alone."""
    noise: Any
    """Standard deviation of a residual: 1 if it is stated, else from what pictures leave; at least what is rounded."""
    gradient: Any
    curvature: Any
    answers: Any
    """[texels, numbers]: how the texels answer."""
    lengths: Any
    """Of the Jacobian's columns, before texels were eliminated."""
    precision: Any
    """Of the priors of the labelled numbers."""
    priors: Any
    """[numbers, numbers]: the curvature of all priors, those of texels as these answer to the numbers."""
    sizes: Any
    """See `Strides.sizes`; the larger one of those at the start and at the values."""
    rows: Any
    """[texels]: diagonal of the texels' curvature; 0 where nothing determines a texel."""
    texels: Any
    """How many texels the pictures determine: of one that a prior holds as well, the pictures' share of it."""


def _noise(description: Description, left: Leftover | None, fitted: float) -> tuple[float, float]:
    """The standard deviation of a residual, and the factor of the inverse curvature that it means (see `Leftover`).

    Of a robust loss that is the M-estimator's sum(psi^2) / sum(dpsi/dr)^2, times the weights that are in the curvature.
    """
    if left is None or left.count - fitted < 0.5:
        return 1.0, 1.0
    noise = float(np.sqrt(left.squares / (left.count - fitted))) * left.count / _slopes(left, fitted)
    return 1.0 if description.noise_known else noise, noise**2 * left.heard / left.count


def _slopes(left: Leftover, fitted: float) -> float:
    """The sum of dpsi/dr as it is at the truth: a fit draws residuals to where psi is steep (Huber 1981, 7.6)."""
    spread = left.squared_slopes - left.slopes**2 / left.count
    return left.slopes - fitted * spread / left.slopes if left.slopes > 0 else left.slopes


def _why_unknown(description: Description, left: Leftover, fitted: float) -> str:
    """Why residuals do not tell their noise, or a robust loss what it makes of it; empty if they do."""
    if left.count - fitted < 0.5 and not description.noise_known:
        return (
            f"the errors are not known: {left.count:.0f} residuals leave nothing to estimate their noise from; "
            f"state the views' `noise`"
        )
    slopes = _slopes(left, fitted)
    if slopes <= 0 or (slopes**2 < ENOUGH * left.squared_slopes and slopes < left.count / 2):
        return (
            f"the errors are not known: too few of {left.count:.0f} residuals lie within the scale of the loss; "
            f"take a larger `loss_scale`"
        )
    return ""


def _remarks(
    problem: Problem, description: Description, loss: float, fitted: float, limits: int, off: float
) -> list[str]:
    said = [
        f"{label} has no `background`: it is taken for a picture of its surfaces alone, though some are transparent"
        for label in description.alone
    ]
    if off > FAR:
        said.append(
            f"the values are {off:.2g} standard errors from the best, in what priors tell and no picture does: "
            f"{problem.parameters.start.dtype} does not resolve it beside pictures as precise as these"
        )
    if not description.noise_known:
        stated = "priors are weighed as if the noise of a picture were 1: state the views' `noise`"
        return [*said, stated] if problem.parameters.has_priors else said
    if description.weighted:
        said.append("a point of weight w is taken for one whose noise is noise / sqrt(w): weights change the errors")
    freedom = float(problem.count) - fitted
    if problem.loss_kind == "squares" and freedom > 0:
        left = 2 * loss / freedom
        if left > NOISIER**2 and left > 1 + SURELY * np.sqrt(2 / freedom):
            said.append(
                f"what is left is {np.sqrt(left):.3g} times the stated noise: something in the pictures is not in the "
                f"model, and the errors do not allow for it"
            )
        # Of limits of the sensor that are kept nothing is left.
        measured = freedom - limits
        quiet = 2 * loss / measured if measured > 0 else 1.0
        if quiet < QUIETER**2 and quiet < 1 - SURELY * np.sqrt(2 / measured):
            said.append(
                f"what is left is {np.sqrt(quiet):.3g} times the stated noise or less: the errors are as large as the "
                f"stated noise makes them"
            )
    return said


def _limits(problem: Problem) -> int:
    """Residuals that may be limits of the sensor instead of measurements."""
    limits = [jax.vmap(is_limit)(stack.target, stack.dark, stack.saturated) for stack in problem.views]
    heard = [stack.root_weight > 0 for stack in problem.views]
    return sum(int(np.count_nonzero(own & here)) for own, here in zip(limits, heard, strict=True))


def _against_priors(problem: Problem, description: Description, found: np.ndarray, error: np.ndarray) -> list[str]:
    """The numbers for which pictures and prior say what cannot both be true, if the noise of both is what is stated."""
    if not description.noise_known:
        return []
    count, parameters = problem.parameters.few, problem.parameters
    mean, precision = (np.asarray(a, np.float64)[:count] for a in (parameters.prior_mean, parameters.prior_precision))
    deviations = np.abs(found - mean) * np.sqrt(precision)
    # If both are right, a fit moves from the mean by as much as it came to know.
    learned = np.sqrt(np.maximum(1 - np.where(np.isfinite(error), error, 0) ** 2 * precision, 1e-4))
    return [
        f"{description.labels[i]} is {deviations[i]:.2g} deviations of its prior from the prior's mean, against which "
        f"the pictures are: one of the two is wrong, and the error of the number trusts both"
        for i in np.flatnonzero(deviations > SURELY * learned).tolist()
    ]


@quick_jit
def _reduced(problem: Problem, values: Any, noise_known: Any, eps: Any) -> _Reduced:
    parameters, count = problem.parameters, problem.parameters.few
    loss, gradient, matrix = normal.normal_equations(problem, values)
    of_pictures = jnp.maximum(loss - normal.prior_loss(problem, values), 0)
    curvature = as_curvature(matrix)
    diagonal = curvature.diagonal()
    left = jnp.where(noise_known, 1, jnp.sqrt(2 * of_pictures / problem.count))
    noise = jnp.maximum(left, eps * jnp.sqrt(2 * problem.signal / problem.count))
    lengths = jnp.sqrt(jnp.maximum(diagonal[:count], 0))
    precision = parameters.prior_precision
    sizes = jnp.maximum(problem.strides.sizes(values), problem.strides.sizes(parameters.start))[:count]
    rows = diagonal[count:]
    if not isinstance(curvature, ArrowCurvature):
        none = jnp.zeros((0, count))
        priors, no_texels = jnp.diag(precision), jnp.zeros(())
        return _Reduced(of_pictures, noise, gradient, matrix, none, lengths, precision, priors, sizes, rows, no_texels)
    # What presses a texel against its bound must be more than noise and the rounding of the values.
    size = jnp.abs(values)
    rounded = eps * (rows * size[count:] + jnp.matmul(jnp.abs(curvature.cross), size[:count]))
    pressing = jnp.abs(gradient[count:]) > SIGNIFICANT * noise * jnp.sqrt(rows) + 8 * rounded
    on_lower, on_upper = values <= parameters.lower, values >= parameters.upper
    held = pressing & ((on_lower & (gradient > 0)) | (on_upper & (gradient < 0)))[count:]
    reduced, answers = curvature.eliminated(problem.sampling, ~held)
    slope = gradient[:count] + jnp.matmul(gradient[count:], answers, precision="highest")
    smooth = [
        jnp.zeros(block.size) if neighbours is None else neighbours.degree().reshape(-1)
        for block, neighbours in zip(parameters.blocks, curvature.neighbours, strict=True)
    ]
    degree = jnp.concatenate(smooth)
    pictures = rows - precision[count:] - 2 * degree  # rounded, if priors are all there is
    said = (pictures > 1e-9 * rows) & ~held
    share = pictures / jnp.where(said, pictures + precision[count:] + degree, 1)
    texels = jnp.sum(jnp.where(said, share, 0))
    of_texels = precision[count:, None] * answers + jax.vmap(curvature.neighbours_product, 1, 1)(answers)
    priors = jnp.diag(precision[:count]) + jnp.matmul(answers.T, of_texels, precision="highest")
    return _Reduced(
        of_pictures, noise, slope, reduced, answers, lengths, precision[:count], priors, sizes, rows, texels
    )


def _unseen_texels(problem: Problem, rows: np.ndarray) -> list[UnseenTexels]:
    found = []
    for block, start in zip(problem.parameters.blocks, _offsets(problem), strict=True):
        dark = rows[start : start + block.size].reshape(-1, block.shape[2]) == 0
        partly, entirely = (int(np.count_nonzero(each)) for each in (dark.any(axis=1), dark.all(axis=1)))
        if partly:
            found.append(UnseenTexels(block.path, partly, len(dark), partly == entirely))
    return found


def _texels_on_bounds(problem: Problem, texels: np.ndarray, rows: np.ndarray) -> list[str]:
    """Of each texture, whether there are so many that they shift the other numbers."""
    count, said = problem.parameters.few, []
    lower, upper = (np.asarray(a, np.float64)[count:] for a in (problem.parameters.lower, problem.parameters.upper))
    pressed = (rows > 0) & ((texels <= lower) | (texels >= upper))
    for block, start in zip(problem.parameters.blocks, _offsets(problem), strict=True):
        own = slice(start, start + block.size)
        on, seen = np.count_nonzero(pressed[own]), np.count_nonzero(rows[own])
        if count and on > MANY * seen:
            said.append(
                f"{on} of the {seen} colours of {block.path} that are seen lie on a bound: where noise put them there, "
                f"the other numbers may be off by more than their errors"
            )
    return said


def _offsets(problem: Problem) -> list[int]:
    return [block.offset - problem.parameters.few for block in problem.parameters.blocks]


def _correlations(covariance: np.ndarray, labels: list[str], traded: np.ndarray) -> list[Correlation]:
    deviation = np.sqrt(np.maximum(np.diagonal(covariance), 0))
    known = (deviation > 0) & ~traded
    safe = np.where(known, deviation, 1)
    correlation = np.where(known[:, None] & known[None, :], covariance / (safe[:, None] * safe[None, :]), 0)
    pairs = [
        Correlation((labels[i], labels[j]), float(correlation[i, j]))
        for i, j in np.argwhere(np.triu(np.abs(correlation), 1) > 0.99).tolist()
    ]
    return sorted(pairs, key=lambda pair: -abs(pair.value))[:10]
