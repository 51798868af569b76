"""The flat vector of numbers that a solver moves: which element of which leaf each number sets."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..scene import paths
from ..scene.ranges import Range
from ..scene.scene import Scene


class World(eqx.Module):
    """All that a fit can change: the scene, and what belongs to the pictures."""

    scene: Scene
    exposure: Float[Array, " views"]

    def array(self, leaf: paths.Leaf | None) -> Array:
        """A leaf of the scene; None: the exposures."""
        return self.exposure if leaf is None else leaf.get(self.scene)


class FreeLeaf(eqx.Module):
    """A leaf some of whose elements are free."""

    source: Int[Array, " elements"]
    """Which parameter each element of the leaf is; -1: it is fixed."""
    leaf: paths.Leaf | None = eqx.field(static=True)
    """Leaf of the scene; None: the exposures."""

    def put(self, world: World, values: Float[Array, " parameters"]) -> World:
        """The world with this leaf's free elements set."""
        old = world.array(self.leaf)
        # One loop: to put numbers where they belong, XLA would take several.
        own = values.at[jnp.maximum(self.source, 0)].get(mode="promise_in_bounds", wrap_negative_indices=False)
        new = jnp.where(self.source < 0, old.reshape(-1), own.astype(old.dtype)).reshape(old.shape)
        if self.leaf is None:
            return eqx.tree_at(lambda w: w.exposure, world, new)
        return eqx.tree_at(lambda w: w.scene, world, self.leaf.set(world.scene, new))


class TexelBlock(eqx.Module):
    """The colours of one texture, all of them free: parameters `offset` to `offset + size`, texel by texel.

    Alpha stays as it is. Texels are too many for a dense matrix, but each meets few samples: they are eliminated.
    """

    smoothness: Float[Array, ""]
    """Weight of the squared difference of neighbouring texels (1 / deviation^2); 0: none."""
    total_variation: Float[Array, ""]
    """Weight of the absolute difference of neighbouring texels (1 / scale); 0: none."""
    texture: int = eqx.field(static=True)
    """Row in `Scene.textures`."""
    offset: int = eqx.field(static=True)
    shape: tuple[int, int, int] = eqx.field(static=True)
    """Height, width and colours (1 or 3)."""
    path: str = eqx.field(static=True)

    @property
    def size(self) -> int:
        """Number of free colours."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    def image(self, values: Float[Array, " parameters"]) -> Float[Array, "height width colors"]:
        """The texture's colours among the parameters."""
        return values[self.offset : self.offset + self.size].reshape(self.shape)

    def put(self, world: World, values: Float[Array, " parameters"]) -> World:
        """The world with this texture's colours set."""
        leaf = paths.Leaf("Texture", "image", self.texture)
        old = leaf.get(world.scene)
        new = self.image(values).astype(old.dtype)
        whole = new if old.shape == self.shape else old.at[..., : self.shape[2]].set(new)
        return eqx.tree_at(lambda w: w.scene, world, leaf.set(world.scene, whole))


class Parameters(eqx.Module):
    """The free numbers of a fit as one flat vector: start, bounds, prior, and where each goes.

    First come the numbers that have a label each (`few`), then the texels of whole textures.
    """

    start: Float[Array, " parameters"]
    lower: Float[Array, " parameters"]
    upper: Float[Array, " parameters"]
    prior_mean: Float[Array, " parameters"]
    prior_precision: Float[Array, " parameters"]
    """1 / variance of the Gaussian prior; 0: none."""
    leaves: tuple[FreeLeaf, ...]
    blocks: tuple[TexelBlock, ...] = ()

    @property
    def few(self) -> int:
        """Number of parameters that are no texels."""
        return self.start.shape[0] - sum(block.size for block in self.blocks)

    @property
    def has_priors(self) -> bool:
        """Whether the loss counts more than pictures; on the host."""
        smooth = any(float(block.smoothness) > 0 or float(block.total_variation) > 0 for block in self.blocks)
        return smooth or bool(np.any(np.asarray(self.prior_precision) > 0))

    def gaussian_loss(self, values: Float[Array, " parameters"]) -> Float[Array, ""]:
        """What the Gaussian priors add to the loss."""
        return jnp.sum(self.prior_precision * (values - self.prior_mean) ** 2) / 2

    def gaussian_slope(self, values: Float[Array, " parameters"]) -> Float[Array, " parameters"]:
        """Its gradient."""
        return self.prior_precision * (values - self.prior_mean)

    def world(self, world: World, values: Float[Array, " parameters"]) -> World:
        """The world with the free numbers set to `values`."""
        for part in (*self.leaves, *self.blocks):
            world = part.put(world, values)
        return world


class FreeField(NamedTuple):
    """One free field as messages and reports name it; parameter `numbers[k]` sets its component `components[k]`."""

    path: str
    leaf: paths.Leaf | None
    """None: an exposure."""
    row: int
    labels: tuple[str, ...]
    components: np.ndarray
    numbers: np.ndarray
    range: Range
