"""Are the derivatives right? Every field in forward and reverse mode against central differences in float64."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..lighting import LightingOptions, shade_planes
from ..lighting.checks import check_samples
from ..lighting.compiling import quick_jit
from ..lighting.prepared import compute_dtype
from ..promotion import usual_promotion
from ..raster.samples import SampleBuffer
from ..scene import paths
from ..scene.fields import positive, whole
from ..scene.paths import Path
from ..scene.scene import Scene
from ..tracing import refuse_inside
from .free import free_parameters
from .parameters import Parameters, World
from .widened import widened

MAX_NUMBERS = 12
"""Numbers of one field that are checked; of a texture, this many texels drawn at random."""


class GradientRow(NamedTuple):
    """One field: its derivative's size and the errors of both modes.

    Errors are relative to the field's largest derivative, or to what differences can resolve where that is larger.
    """

    path: str
    largest: float
    """Largest derivative of a colour or alpha of a sample by a number of the field (central differences); 0 where that
    is no more than rounding makes of them."""
    forward_error: float
    reverse_error: float
    kinks: int
    """Samples left out because the differences themselves do not settle there: the equation has a kink or a jump."""


@dataclasses.dataclass(frozen=True)
class GradientCheck:
    """The rows of all fields that were checked, and the fields that have no derivative to check."""

    rows: tuple[GradientRow, ...]
    skipped: tuple[str, ...]
    """Fields at a value where they switch something off (no fog, endless radius)."""
    tolerance: float
    dtype: str

    @property
    def worst(self) -> float:
        """The largest error of any row, in either mode."""
        return max((max(row.forward_error, row.reverse_error) for row in self.rows), default=0.0)

    @property
    def passed(self) -> bool:
        """True if every error is below the tolerance (and a number); also where nothing was checked."""
        return all(max(row.forward_error, row.reverse_error) <= self.tolerance for row in self.rows)

    def __str__(self) -> str:
        width = max(map(len, ["field", *(row.path for row in self.rows), *self.skipped]))
        off = [f"{path:<{width}}  not checked: it is switched off" for path in self.skipped]
        if not self.rows:
            return "\n".join([*off, "nothing was checked: no field has a derivative here"])
        lines = [f"{'field':<{width}}  {'largest':>10}  {'forward':>9}  {'reverse':>9}  {'kinks':>6}"]
        for row in self.rows:
            flag = "" if max(row.forward_error, row.reverse_error) <= self.tolerance else "  WRONG"
            lines.append(
                f"{row.path:<{width}}  {row.largest:>10.3g}  {row.forward_error:>9.1e}  {row.reverse_error:>9.1e}  "
                f"{row.kinks:>6}{flag}"
            )
        lines += off
        verdict = "all within" if self.passed else "NOT all within"
        lines.append(f"worst error {self.worst:.1e}, {verdict} {self.tolerance:g} ({self.dtype})")
        return "\n".join(lines)


@usual_promotion
def check_gradients(
    scene: Scene,
    samples: SampleBuffer,
    fields: Path | Iterable[Path] | None = None,
    *,
    tolerance: float | None = None,
    seed: int = 0,
    options: LightingOptions | None = None,
) -> GradientCheck:
    """Compare forward and reverse derivatives of `shade` with central differences, a row a field.

    The derivatives are taken in the precision in which `shade` computes, that of the samples, the differences always in
    float64 (64-bit numbers are switched on for their computation only), with a second, halved step that tells kinks
    from errors.

    Args:
        scene, samples: where to check.
        fields: paths or functions of the scene (default: all fields).
        tolerance: error that passes (default: 1e-6 in float64, 1e-3 in float32).
        options: readings of the specification, as for `shade`.
        seed: of the texels and of the reverse mode's random weights.

    Returns:
        A row for each field that has a derivative; fields that are switched off are named, not checked.

    Raises:
        ValueError: no such field, or not a number in the scene; a scene or samples that `shade` would refuse; no
            sample; a tolerance that is not above 0; a call inside `jax.jit` or another transformation.
    """
    refuse_inside("check_gradients")
    check_samples(scene, samples)
    if samples.count == 0:
        raise ValueError("samples: there is nothing to check: the buffer holds no sample")
    if tolerance is not None:
        tolerance = positive("tolerance", tolerance)
    seed = whole("seed", seed, at_least=0)
    chosen, switched_off = _checkable(scene, fields)
    skipped = tuple(field.path for field in switched_off)
    dtype = compute_dtype(samples)
    scene = jax.tree.map(lambda leaf: leaf.astype(dtype), scene)
    single = dtype != np.float64
    limit = tolerance if tolerance is not None else (1e-3 if single else 1e-6)
    if not chosen:
        return GradientCheck((), skipped, limit, "float32" if single else "float64")
    random = np.random.default_rng(seed)
    # Without its document every row is checked by itself, also where one node is placed several times.
    world = World(dataclasses.replace(scene, document=None), jnp.ones(0, dtype))
    parameters, described = free_parameters(world, [field.path for field in chosen], [], dtype, blocks=False)
    numbers = [
        np.sort(random.permutation(field.numbers)[:MAX_NUMBERS]) if len(field.numbers) > MAX_NUMBERS else field.numbers
        for field in described
    ]
    tangents = {
        int(k): np.asarray(_forward(parameters, world, samples, options, jnp.asarray(k)), np.float64)
        for k in np.concatenate(numbers)
    }
    with jax.enable_x64(True):
        wide_parameters, wide_world, wide_samples = widened((parameters, world, samples))
        slopes = {k: _slopes(wide_parameters, wide_world, wide_samples, k, options) for k in tangents}

    rows = []
    for field, own in zip(described, numbers, strict=True):
        smooth = np.all([slopes[k].smooth for k in own.tolist()], axis=0)
        largest = max(slopes[k].largest for k in own.tolist())
        scale = max(largest, *(1e5 * slopes[k].noise for k in own.tolist()))
        forward = reverse = 0.0
        for k in own.tolist():
            forward = _worst(forward, float(np.max(slopes[k].distance(tangents[k]))) / scale)
            # Weights of the derivative's own sign: terms that cancelled would hide an error. Where the difference is
            # only rounding its sign is too, and following it would add the rounding of all samples up.
            seen = np.abs(slopes[k].value) > slopes[k].noise
            sign = np.where(seen, np.sign(slopes[k].value), random.choice([-1.0, 1.0], smooth.shape))
            weights = sign * random.uniform(0.5, 1.5, smooth.shape) * smooth
            pulled = _reverse(parameters, world, samples, options, jnp.asarray(weights, dtype))
            total = float(np.sum(weights * slopes[k].value))
            error = abs(float(np.asarray(pulled, np.float64)[k]) - total)
            reverse = _worst(reverse, error / max(total, scale * float(np.sqrt(smooth.size))))
        kinks = int(np.count_nonzero(~np.all(smooth, axis=0)))
        rows.append(GradientRow(field.path, largest, forward, reverse, kinks))
    return GradientCheck(tuple(rows), skipped, limit, "float32" if single else "float64")


def _checkable(scene: Scene, wanted: Path | Iterable[Path] | None) -> tuple[list[paths.Field], list[paths.Field]]:
    """Fields to check, and those whose present value switches them off."""
    every = paths.fields(scene)
    if wanted is not None:
        masks = {selection.leaf: selection.mask for selection in paths.select(scene, wanted)}
        every = [field for field in every if field.leaf in masks and np.any(masks[field.leaf][field.index])]
        if not every:
            raise ValueError("fields: none is named; leave it out to check all of them")
    chosen, skipped = [], []
    for field in every:
        value = field.value(scene)
        off = not np.all(np.isfinite(value)) or (field.leaf.range.open_below and np.any(value <= 0))
        (skipped if off else chosen).append(field)
    return chosen, skipped


def _worst(a: float, b: float) -> float:
    """The larger; NaN if either is NaN."""
    return b if b > a or np.isnan(b) else a


def _image(parameters: Parameters, world: World, samples: SampleBuffer, values: Any, options: Any) -> Any:
    return samples.in_sample_order(shade_planes(parameters.world(world, values).scene, samples, options))


@quick_jit
def _forward(parameters: Parameters, world: World, samples: SampleBuffer, options: Any, number: Any) -> Any:
    values = parameters.start
    direction = jnp.zeros_like(values).at[number].set(1)
    return jax.jvp(lambda v: _image(parameters, world, samples, v, options), (values,), (direction,))[1]


@quick_jit
def _reverse(parameters: Parameters, world: World, samples: SampleBuffer, options: Any, weights: Any) -> Any:
    _, pull = jax.vjp(lambda v: _image(parameters, world, samples, v, options), parameters.start)
    return pull(weights)[0]


@quick_jit
def _images_at(parameters: Parameters, world: World, samples: SampleBuffer, options: Any, number: Any, at: Any) -> Any:
    return jax.lax.map(lambda x: _image(parameters, world, samples, parameters.start.at[number].set(x), options), at)


class _Slopes(NamedTuple):
    """Differences of the image by one number, [4, samples]: from below, from above, and where the two agree."""

    below: np.ndarray
    above: np.ndarray
    smooth: np.ndarray
    noise: float
    """What rounding alone can make of a difference."""

    @property
    def value(self) -> np.ndarray:
        """The central difference."""
        return (self.below + self.above) / 2

    @property
    def largest(self) -> float:
        """The largest difference of a sample; 0 where all are rounding."""
        largest = float(np.max(np.abs(self.value)))
        return largest if largest > self.noise else 0.0

    def distance(self, derivative: np.ndarray) -> np.ndarray:
        """How far a derivative is off: from the difference, or at a kink from all values between both sides and 0."""
        low = np.where(self.smooth, self.value, np.minimum(np.minimum(self.below, self.above), 0))
        high = np.where(self.smooth, self.value, np.maximum(np.maximum(self.below, self.above), 0))
        return np.maximum(np.maximum(low - derivative, derivative - high), 0) + np.where(
            np.isnan(derivative), np.nan, 0
        )


def _slopes(parameters: Parameters, world: World, samples: SampleBuffer, number: int, options: Any) -> _Slopes:
    """Second-order differences from below and from above; where the equation ends on one side, the other side's."""
    value = float(parameters.start[number])
    step = 2.0 ** np.round(np.log2(np.cbrt(np.finfo(np.float64).eps) * max(abs(value), 0.1)))
    points = jnp.asarray(value + step * np.array([-2.0, -1.0, 0.0, 1.0, 2.0]))
    images = np.asarray(_images_at(parameters, world, samples, options, jnp.asarray(number), points))
    below = (images[0] - 4 * images[1] + 3 * images[2]) / (2 * step)
    above = (-3 * images[2] + 4 * images[3] - images[4]) / (2 * step)
    below, above = np.where(np.isfinite(below), below, above), np.where(np.isfinite(above), above, below)
    # Rounding moves a difference by about eps / step; a kink moves one side of it by far more.
    noise = 64 * np.finfo(np.float64).eps * np.max(np.abs(images[2])) / step
    size = np.maximum(np.maximum(np.abs(below), np.abs(above)), 1e-3 * np.max(np.abs(above)))
    return _Slopes(below, above, np.abs(below - above) <= 1e-6 * size + noise, float(noise))
