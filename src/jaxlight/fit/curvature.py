"""Second derivatives of a fit: a dense matrix for few numbers, an arrow for few numbers and the texels of textures.

dense   [few, few]
arrow   [[few, few], [cross, texels]]: the texels' part couples only texels that a sample sees together, and is
        applied through the samples instead of being formed
"""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .box import BoxMinimum, minimise_in_box, minimise_quadratic
from .sampling import TexelSampling

CONJUGATE_STEPS = 100
"""Of conjugate gradients at most, where texels are eliminated."""
TOLERANCE = 1e-4
"""Part of the slope that conjugate gradients may leave."""
ROUNDS = 16
"""In which the bounds that hold texels and numbers are found, at most; few steps need more than four."""


class NormalEquations(NamedTuple):
    """The quadratic model of a fit at one point."""

    loss: Float[Array, ""]
    gradient: Float[Array, " parameters"]
    curvature: Any
    """Gauss-Newton approximation of the second derivative: an array [parameters, parameters] or an `ArrowCurvature`."""


class Neighbours(eqx.Module):
    """Weights of the squared differences of neighbouring texels of one texture."""

    across: Float[Array, "height width-1 colors"]
    down: Float[Array, "height-1 width colors"]

    def product(self, image: Float[Array, "height width colors"]) -> Float[Array, "height width colors"]:
        """The second derivative applied to an image."""
        across = self.across * (image[:, 1:] - image[:, :-1])
        down = self.down * (image[1:] - image[:-1])
        result = jnp.pad(across, ((0, 0), (1, 0), (0, 0))) - jnp.pad(across, ((0, 0), (0, 1), (0, 0)))
        return result + jnp.pad(down, ((1, 0), (0, 0), (0, 0))) - jnp.pad(down, ((0, 1), (0, 0), (0, 0)))

    def degree(self) -> Float[Array, "height width colors"]:
        """The diagonal."""
        across = jnp.pad(self.across, ((0, 0), (1, 0), (0, 0))) + jnp.pad(self.across, ((0, 0), (0, 1), (0, 0)))
        return across + jnp.pad(self.down, ((1, 0), (0, 0), (0, 0))) + jnp.pad(self.down, ((0, 1), (0, 0), (0, 0)))


class Curvature(eqx.Module):
    """A symmetric positive semidefinite matrix, by what a solver needs of it."""

    @abc.abstractmethod
    def diagonal(self) -> Float[Array, " n"]:
        """The diagonal, or what bounds the rows where it is not known."""

    @abc.abstractmethod
    def product(self, vector: Float[Array, " n"], sampling: Any) -> Float[Array, " n"]:
        """The matrix applied to a vector."""

    @abc.abstractmethod
    def minimise(
        self, sampling: Any, gradient: Array, scale: Array, damping: Array, lower: Array, upper: Array
    ) -> BoxMinimum:
        """argmin of g^T d + 1/2 d^T (H + damping diag(scale^2)) d in the box; at least rounding's worth of damping."""


class DenseCurvature(Curvature):
    """The matrix itself."""

    matrix: Float[Array, "n n"]

    def diagonal(self) -> Array:
        return jnp.diagonal(self.matrix)

    def product(self, vector: Array, sampling: Any) -> Array:
        return jnp.matmul(self.matrix, vector, precision="highest")

    def minimise(
        self, sampling: Any, gradient: Array, scale: Array, damping: Array, lower: Array, upper: Array
    ) -> BoxMinimum:
        size = scale.shape[0]
        floor = size * jnp.finfo(scale.dtype).eps
        hessian = self.matrix / (scale[:, None] * scale[None, :])
        hessian = hessian + jnp.maximum(damping, floor) * jnp.eye(size, dtype=scale.dtype)
        found = minimise_in_box(hessian, gradient / scale, lower * scale, upper * scale)
        return BoxMinimum(found.point / scale, found.solved)


class ArrowCurvature(Curvature):
    """Few numbers dense, texels through the samples."""

    few: Float[Array, "few few"]
    cross: Float[Array, "texels few"]
    row_sum: Float[Array, " texels"]
    """Sum of the absolute values of each row of the texels' part: bounds its eigenvalues."""
    strengths: tuple[tuple[Float[Array, "views colors slots"] | None, ...], ...]
    """Per stack of views and run: what the squared change of a colour of a sample costs."""
    own: Float[Array, " texels"]
    """What belongs to each texel alone: priors, and everything where samples see single texels."""
    neighbours: tuple[Neighbours | None, ...]
    shapes: tuple[tuple[int, int, int], ...] = eqx.field(static=True)
    """Height, width and colours of each texture."""

    def diagonal(self) -> Array:
        return jnp.concatenate([jnp.diagonal(self.few), self.row_sum])

    def product(self, vector: Array, sampling: tuple[TexelSampling, ...]) -> Array:
        count = self.few.shape[0]
        few, texels = vector[:count], vector[count:]
        upper = jnp.matmul(self.few, few, precision="highest") + jnp.matmul(texels, self.cross, precision="highest")
        lower = jnp.matmul(self.cross, few, precision="highest") + self._texels(texels, sampling)
        return jnp.concatenate([upper, lower])

    def _texels(self, texels: Array, sampling: tuple[TexelSampling, ...]) -> Array:
        """The texels' part applied to texels."""
        images = self._images(texels)
        sums = self._images(self.own * texels + self.neighbours_product(texels))
        tables, totals = list(map(_planes, images)), list(map(_planes, sums))
        for stack, strengths in zip(sampling, self.strengths, strict=True):
            for (block, start, stop), strength in zip(stack.runs, strengths, strict=True):
                if strength is None:
                    continue
                index, weight = stack.index[:, :, start:stop], stack.weight[:, :, start:stop]

                def of_view(total: Array, view: Any, table: Array = tables[block]) -> tuple[Array, None]:
                    index, weight, strength = view
                    seen = jnp.sum(weight * table[:, index], axis=1) * strength
                    return total.at[:, index].add(weight * seen[:, None]), None

                totals[block], _ = jax.lax.scan(of_view, totals[block], (index, weight, strength))
        return jnp.concatenate([total.T.reshape(-1) for total in totals])

    def neighbours_product(self, texels: Float[Array, " texels"]) -> Float[Array, " texels"]:
        """What belongs to neighbours, applied to texels."""
        return jnp.concatenate(
            [
                jnp.zeros(image.size, texels.dtype) if neighbours is None else neighbours.product(image).reshape(-1)
                for image, neighbours in zip(self._images(texels), self.neighbours, strict=True)
            ]
        )

    def eliminated(self, sampling: tuple[TexelSampling, ...], free: Array) -> tuple[Array, Array]:
        """(few [few, few] with the free texels eliminated, [texels, few] how texels answer to the numbers).

        Args:
            sampling: which texels the samples see.
            free: [texels], False for texels that are held.
        """
        seen = free & (self.row_sum > 0)

        def answer(right: Array) -> Array:
            return _conjugate_gradients(
                lambda texels: self._texels(texels, sampling),
                lambda left: jnp.where(seen, left / jnp.where(seen, self.row_sum, 1), 0),
                right,
                seen,
                1e-8,
            )

        answers = jax.lax.map(answer, self.cross.T).T
        return self.few - jnp.matmul(self.cross.T, answers, precision="highest"), -answers

    def _images(self, texels: Array) -> list[Array]:
        images, start = [], 0
        for shape in self.shapes:
            size = shape[0] * shape[1] * shape[2]
            images.append(texels[start : start + size].reshape(shape))
            start += size
        return images

    def minimise(
        self, sampling: tuple[TexelSampling, ...], gradient: Array, scale: Array, damping: Array, lower: Array,
        upper: Array,
    ) -> BoxMinimum:  # fmt: skip
        count = self.few.shape[0]
        shift = jnp.maximum(damping, 4 * count * jnp.finfo(scale.dtype).eps)
        few = self.few / (scale[:count, None] * scale[None, :count]) + shift * jnp.eye(count, dtype=scale.dtype)
        cross = self.cross / (scale[count:, None] * scale[None, :count])
        rows = self.row_sum / scale[count:] ** 2 + shift

        def product(vector: Array) -> Array:
            return self.product(vector / scale, sampling) / scale + shift * vector

        def solve_free(right: Array, free: Array) -> Array:
            precondition = _arrow_inverse(few, cross, rows, free)
            return _conjugate_gradients(product, precondition, right, free, TOLERANCE)

        found = minimise_quadratic(
            lambda points: jax.lax.map(product, points), solve_free, gradient / scale, lower * scale, upper * scale,
            rounds=ROUNDS, fractions=(1.0, 0.25), tolerance=10 * TOLERANCE,
        )  # fmt: skip
        return BoxMinimum(found.point / scale, found.solved)


def _planes(image: Float[Array, "height width colors"]) -> Float[Array, "colors texels"]:
    """One plane a colour, which is quicker to gather from and to add to than rows of colours."""
    return image.reshape(-1, image.shape[2]).T


def as_curvature(matrix: Any) -> Curvature:
    """A Curvature from an array or a Curvature."""
    return matrix if isinstance(matrix, Curvature) else DenseCurvature(matrix)


def _arrow_inverse(few: Array, cross: Array, rows: Array, free: Array) -> Any:
    """The inverse of the arrow whose texels' part is the diagonal `rows`, over the free variables.

    The rows' sums bound the texels' part from above, so the Schur complement stays positive semidefinite.
    """
    count = few.shape[0]
    free_few, free_texels = free[:count], free[count:]
    both = free_few[:, None] & free_few[None, :]
    share = jnp.where(free_texels, 1 / rows, 0)
    eliminated = jnp.matmul(cross.T * share, cross, precision="highest")
    identity = jnp.eye(count, dtype=few.dtype)
    schur = jnp.linalg.cholesky(jnp.where(both, few - eliminated, identity))
    # Where strength and texture can be traded, rounding may leave the complement indefinite: do without it then.
    usable = jnp.all(jnp.isfinite(schur))
    factor = jnp.where(usable, schur, jnp.linalg.cholesky(jnp.where(both, few, identity)))
    coupling = jnp.where(usable, cross, 0)

    def apply(right: Array) -> Array:
        texels = share * right[count:]
        reduced = jnp.where(free_few, right[:count] - jnp.matmul(texels, coupling, precision="highest"), 0)
        upper = jax.scipy.linalg.cho_solve((factor, True), reduced)
        return jnp.concatenate([upper, texels - share * jnp.matmul(coupling, upper, precision="highest")])

    return apply


class _Iterate(NamedTuple):
    point: Array
    left: Array
    direction: Array
    size: Array
    step: Array


def _conjugate_gradients(product: Any, precondition: Any, right: Array, free: Array, tolerance: float) -> Array:
    """Preconditioned conjugate gradients on the free variables, to `tolerance` of where they began."""

    def improve(state: _Iterate) -> _Iterate:
        image = jnp.where(free, product(state.direction), 0)
        bend = jnp.vdot(state.direction, image, precision="highest")
        length = jnp.where(bend > 0, state.size / jnp.where(bend > 0, bend, 1), 0)
        left = state.left - length * image
        towards = precondition(left)
        size = jnp.vdot(left, towards, precision="highest")
        direction = towards + size / state.size * state.direction
        return _Iterate(state.point + length * state.direction, left, direction, size, state.step + 1)

    left = jnp.where(free, right, 0)
    towards = precondition(left)
    first = jnp.vdot(left, towards, precision="highest")
    start = _Iterate(jnp.zeros_like(right), left, towards, first, jnp.zeros((), jnp.int32))

    def unfinished(state: _Iterate) -> Array:
        return (state.size > tolerance**2 * first) & (state.step < CONJUGATE_STEPS)

    return jax.lax.while_loop(unfinished, improve, start).point
