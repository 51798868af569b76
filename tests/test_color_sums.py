"""Sums over lights are the same however they are divided, and so are their derivatives in both modes."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight.lighting.color_sums import sums_of_colors
from jaxlight.lighting.stages import Stage
from jaxlight.lighting.unstored import stored

ROWS, LANES = 2, 8


@pytest.mark.parametrize("forward", [False, True])
@pytest.mark.parametrize("lights", [1, 16, 71])
def test_sums_and_their_derivatives(lights: int, forward: bool) -> None:
    random = np.random.default_rng(lights)
    with jax.enable_x64(True):
        # Colours and numbers of lights, planes of lights and samples, a plane of samples.
        shapes = ((3, lights, 1, LANES), (lights, 1, LANES), (lights, ROWS, LANES), (ROWS, LANES))
        given = tuple(jnp.asarray(random.normal(size=shape)) for shape in shapes)
        changes = tuple(jnp.sin(7 * plane) for plane in given)

        def found(*given: Any) -> Any:
            colors, *operands = given
            stage = Stage(jnp.asarray(True), forward=forward)
            return stored(sums_of_colors(stage, colors, _weights, *operands, wide=(0, 2)))

        sums = _sums(*given)
        _close(jax.jit(found)(*given), sums)
        moved = jax.jit(lambda changes: jax.jvp(found, given, changes)[1])
        _close(moved(changes), jax.jvp(_sums, given, changes)[1])
        for number, change in enumerate(changes):
            alone = tuple(change if n == number else jnp.zeros_like(other) for n, other in enumerate(changes))
            _close(moved(alone), jax.jvp(_sums, given, alone)[1])
        back = jax.tree.map(lambda one: jnp.cos(5 * one), sums)
        _close(jax.jit(lambda *own: jax.vjp(found, *own)[1](back))(*given), jax.vjp(_sums, *given)[1](back))


@pytest.mark.parametrize("lights", [3, 35])
def test_second_derivatives_of_sums(lights: int) -> None:
    random = np.random.default_rng(lights)
    with jax.enable_x64(True):
        shapes = ((3, lights, 1, LANES), (lights, 1, LANES), (lights, ROWS, LANES), (ROWS, LANES))
        given = tuple(jnp.asarray(random.normal(size=shape)) for shape in shapes)
        changes = tuple(jnp.sin(7 * plane) for plane in given)

        def squares(of: Any) -> Any:
            return lambda *given: sum(jnp.sum(plane**2) for plane in stored(of(*given)))

        def found(colors: Any, *operands: Any) -> Any:
            return sums_of_colors(Stage(jnp.asarray(True)), colors, _weights, *operands, wide=(0, 2))

        def curvature(of: Any) -> Any:
            return jax.jit(lambda *own: jax.jvp(jax.grad(squares(of), argnums=(0, 1, 2, 3)), own, changes)[1])(*given)

        _close(curvature(found), curvature(_sums))


def _weights(of_light: Any, of_both: Any, of_sample: Any) -> tuple[Any, Any]:
    return of_light * of_both + of_sample, jnp.sin(of_light) * of_sample * of_both**2


def _sums(colors: Any, *operands: Any) -> Any:
    return tuple(jnp.einsum("ckl,krl->crl", colors[:, :, 0], own) for own in _weights(*operands))


def _close(found: Any, expected: Any) -> None:
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12), found, expected)
