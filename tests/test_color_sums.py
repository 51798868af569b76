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
@pytest.mark.parametrize("lights", [1, 2, 16, 17, 24, 71])
def test_sums_and_their_derivatives(lights: int, forward: bool) -> None:
    random = np.random.default_rng(lights)
    with jax.enable_x64(True):
        colors, *weights = (
            jnp.asarray(random.normal(size=shape))
            for shape in ((3, lights, 1, LANES), (lights, ROWS, LANES), (lights, ROWS, LANES))
        )
        changes = jax.tree.map(lambda plane: jnp.sin(7 * plane), (colors, weights))

        def found(colors: Any, weights: Any) -> Any:
            return stored(sums_of_colors(Stage(jnp.asarray(True), forward=forward), colors, weights))

        sums = [jnp.einsum("ckol,krl->crl", colors, own) for own in weights]
        _close(jax.jit(found)(colors, weights), sums)
        moved = [
            jnp.einsum("ckol,krl->crl", changes[0], own) + jnp.einsum("ckol,krl->crl", colors, change)
            for own, change in zip(weights, changes[1], strict=True)
        ]
        _close(jax.jit(lambda *own: jax.jvp(found, own, changes)[1])(colors, weights), moved)
        back = [jnp.cos(5 * one) for one in sums]
        by_colors = jnp.add(*(jnp.einsum("crl,krl->ckl", one, own) for one, own in zip(back, weights, strict=True)))
        by_weights = [jnp.einsum("crl,ckol->krl", one, colors) for one in back]
        _close(
            jax.jit(lambda *own: jax.vjp(found, *own)[1](back))(colors, weights), (by_colors[:, :, None], by_weights)
        )


def _close(found: Any, expected: Any) -> None:
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12), found, expected)
