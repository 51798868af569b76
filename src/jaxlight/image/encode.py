"""What an image's numbers mean: linear light or sRGB, and how they become the integers of a file."""

from __future__ import annotations

from typing import Any, Literal

import jax.numpy as jnp
from jaxtyping import Array

Transfer = Literal["none", "srgb"]


def encode(image: Any, transfer: Transfer = "srgb") -> Array:
    """Numbers of the lighting equation -> numbers to show: as they are (as X3D browsers do), or sRGB of linear light.

    Differentiable. Nothing is clamped: that is for `quantize`.

    Args:
        image: any shape; colour only, since alpha is never encoded.
        transfer: "none", or "srgb" (IEC 61966-2-1).

    Raises:
        ValueError: an unknown transfer.
    """
    _check(transfer)
    return linear_to_srgb(image) if transfer == "srgb" else jnp.asarray(image)


def decode(image: Any, transfer: Transfer = "srgb") -> Array:
    """The inverse of `encode`: what a photograph's numbers in [0, 1] say about light."""
    _check(transfer)
    return srgb_to_linear(image) if transfer == "srgb" else jnp.asarray(image)


def linear_to_srgb(linear: Any) -> Array:
    """12.92 x up to 0.0031308, then 1.055 x^(1 / 2.4) - 0.055 (IEC 61966-2-1); the straight part goes on below 0."""
    x = jnp.asarray(linear)
    is_straight = x <= 0.0031308
    curved = 1.055 * jnp.where(is_straight, 1.0, x) ** (1 / 2.4) - 0.055
    return jnp.where(is_straight, 12.92 * x, curved)


def srgb_to_linear(srgb: Any) -> Array:
    """x / 12.92 up to 0.04045, then ((x + 0.055) / 1.055)^2.4 (IEC 61966-2-1); the straight part goes on below 0."""
    x = jnp.asarray(srgb)
    is_straight = x <= 0.04045
    curved = ((jnp.where(is_straight, 1.0, x) + 0.055) / 1.055) ** 2.4
    return jnp.where(is_straight, x / 12.92, curved)


def quantize(image: Any, bits: Literal[8, 16] = 8) -> Array:
    """Numbers clamped to [0, 1] and rounded to integers of 8 or 16 bits, halves upwards.

    Raises:
        ValueError: bits other than 8 or 16.
    """
    if bits not in (8, 16):
        raise ValueError(f"quantize: bits: expected 8 or 16, got {bits!r}")
    largest = 2**bits - 1
    levels = jnp.floor(jnp.clip(jnp.asarray(image), 0.0, 1.0) * largest + 0.5)
    return levels.astype(jnp.uint8 if bits == 8 else jnp.uint16)


def dequantize(levels: Any) -> Array:
    """uint8 or uint16 -> numbers in [0, 1].

    Raises:
        ValueError: another type of number.
    """
    array = jnp.asarray(levels)
    if array.dtype not in (jnp.uint8, jnp.uint16):
        raise ValueError(f"dequantize: expected uint8 or uint16, got {array.dtype}")
    return array / jnp.iinfo(array.dtype).max


def _check(transfer: str) -> None:
    if transfer not in ("none", "srgb"):
        raise ValueError(f"transfer: expected 'none' or 'srgb', got {transfer!r}")
