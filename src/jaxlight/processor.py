"""What programs are written for: a processor with caches, or one that works on very many numbers side by side.

What is computed is the same to the last operation. It differs in how it is divided: on the CPU into loops over planes
that stay in a core's cache, on a GPU into as few steps as memory allows, each of which costs the start of a program.
"""

from __future__ import annotations

from typing import NamedTuple

import jax


class Sizes(NamedTuple):
    """How much is evaluated at once."""

    tile: int
    """Samples a tile of images; a power of two."""
    group: int
    """Neighbouring tiles of one surface that lie in a block; a power of two."""
    padding: float
    """The share of all tiles that may be padding, so that blocks are large."""
    planes: int
    """Lights, and one more for what is of samples alone, times samples for which tiles are put together."""
    lights: int
    """Lights evaluated at once at most, where derivatives are taken."""
    largest_plane: int
    """Lights times samples up to which all lights are evaluated at once."""
    chunk: int
    """Lights times samples of a part, where all lights would be more than that."""
    clusters: int
    """Clusters of samples that work through their lists of lights side by side."""
    derived_clusters: int
    """The same, where derivatives are taken."""


# What some ten thousand numbers are computed from stays in a core's cache. Many lights leave it: parts of them are
# evaluated anew for derivatives.
CPU = Sizes(
    tile=1024,
    group=8,
    padding=1 / 16,
    planes=10_240,
    lights=2**17,
    largest_plane=2**17,
    chunk=2**16,
    clusters=64,
    derived_clusters=128,
)

GPU = Sizes(
    tile=2**18,
    group=16,
    padding=1 / 4,
    planes=2**25,
    lights=16,
    largest_plane=2**25,
    chunk=2**24,
    clusters=2**16,
    derived_clusters=2**14,
)


def for_cpu() -> bool:
    """Whether what is traced or stored now is for the CPU: JAX's default device, or its default backend, is one."""
    device = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]  # a setting of JAX
    if device is None:
        return jax.default_backend() == "cpu"
    return (device if isinstance(device, str) else device.platform) == "cpu"


def sizes() -> Sizes:
    """How much is evaluated at once where arrays go now."""
    return CPU if for_cpu() else GPU
