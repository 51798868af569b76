"""What an image's numbers mean: linear light or sRGB."""

from __future__ import annotations

from typing import Any, Literal

import jax.numpy as jnp
from jaxtyping import Array

from ..arrays import real_array
from ..formats.levels import refuse_levels

Transfer = Literal["none", "srgb"]


def encode(image: Any, transfer: Transfer = "srgb") -> Array:
    """Numbers of the lighting equation -> numbers to show: as they are (as X3D browsers do), or sRGB of linear light.

    Differentiable. Nothing is clamped: that is for writing.

    Args:
        image: any shape; colour only, since alpha is never encoded.
        transfer: "none", or "srgb" (IEC 61966-2-1).

    Returns:
        sRGB numbers for "srgb", otherwise the image itself; the same shape.

    Raises:
        ValueError: an unknown transfer; no real numbers, or levels (integers above 1) for them.
    """
    numbers = _checked(image, transfer)
    return linear_to_srgb(numbers) if transfer == "srgb" else numbers


def decode(image: Any, transfer: Transfer = "srgb") -> Array:
    """The inverse of `encode`: what a photograph's numbers in [0, 1] say about light. Differentiable.

    Args:
        image: any shape; colour only, since alpha is never encoded.
        transfer: "none", or "srgb" (IEC 61966-2-1).

    Returns:
        Linear numbers for "srgb", otherwise the image itself; the same shape.

    Raises:
        ValueError: an unknown transfer; no real numbers, or levels (integers above 1) for them.
    """
    numbers = _checked(image, transfer)
    return srgb_to_linear(numbers) if transfer == "srgb" else numbers


def linear_to_srgb(linear: Any) -> Array:
    """sRGB of linear light, numbers of any shape of which 1 is the brightest, as JAX's float type.

    12.92 x up to 0.0031308, then 1.055 x^(1 / 2.4) - 0.055 (IEC 61966-2-1); the straight part goes on below 0.
    """
    x = jnp.asarray(linear)
    is_straight = x <= 0.0031308
    curved = 1.055 * jnp.where(is_straight, 1.0, x) ** (1 / 2.4) - 0.055
    return jnp.where(is_straight, 12.92 * x, curved)


def srgb_to_linear(srgb: Any) -> Array:
    """Linear light of sRGB, numbers of any shape of which 1 is the brightest, as JAX's float type.

    x / 12.92 up to 0.04045, then ((x + 0.055) / 1.055)^2.4 (IEC 61966-2-1); the straight part goes on below 0.
    """
    x = jnp.asarray(srgb)
    is_straight = x <= 0.04045
    curved = ((jnp.where(is_straight, 1.0, x) + 0.055) / 1.055) ** 2.4
    return jnp.where(is_straight, x / 12.92, curved)


def _checked(image: Any, transfer: Any) -> Array:
    if not isinstance(transfer, str) or transfer not in ("none", "srgb"):
        raise ValueError(f"transfer: expected 'none' or 'srgb', got {transfer!r:.60}")
    numbers = real_array("image", image)
    refuse_levels("image", image if hasattr(image, "dtype") else numbers)
    return numbers
