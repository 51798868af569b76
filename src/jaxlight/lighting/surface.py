"""Tables 17.2 and 17.3 (VRML97 4.5, 4.6): the colour and alpha of a surface before light and fog."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..scene import Surface
from .options import LightingOptions


class MaterialRow(NamedTuple):
    """One material's fields on all lanes: colours [3, 1, lanes], scalars [1, lanes] (see WorldLights)."""

    ambient_intensity: Array
    diffuse_color: Array
    emissive_color: Array
    shininess: Array
    specular_color: Array
    transparency: Array


def sampled_texture(
    image: Float[Array, "height width components"], index: Int[Array, "4 ..."], weight: Float[Array, "4 ..."]
) -> Float[Array, "components ..."]:
    """The texture at each sample from four texels and their weights."""
    planes = image.reshape(-1, image.shape[2]).T
    return jnp.sum(weight * planes[:, index].astype(weight.dtype), axis=1)


def base_color(
    surface: Surface,
    options: LightingOptions,
    material: MaterialRow | None,
    vertex_color: Float[Array, "components rows lanes"] | None,
    texel: Float[Array, "components rows lanes"] | None,
) -> Float[Array, "3 #rows #lanes"]:
    """O_D of table 17.3 for lit surfaces, I of table 17.2 for the others (emissiveColor for lines and points).

    One- and two-component textures scale what is there; three- and four-component textures replace it, or scale it
    too with `texture_mode="modulate"`.
    """
    if vertex_color is not None:
        own = vertex_color[:3]
    elif material is None:
        own = jnp.ones((3, 1, 1), dtype=jnp.float32 if texel is None else texel.dtype)
    else:
        own = material.emissive_color if surface.lighting == "emissive" else material.diffuse_color
    if texel is None:
        return own
    if texel.shape[0] <= 2:
        return texel[:1] * own
    return texel[:3] * own if options.texture_mode == "modulate" else texel[:3]


def alpha(
    options: LightingOptions,
    material: MaterialRow | None,
    vertex_color: Float[Array, "components rows lanes"] | None,
    texel: Float[Array, "components rows lanes"] | None,
) -> Float[Array, "#rows #lanes"] | None:
    """A of tables 17.2 and 17.3; None: 1. A vertex colour's alpha takes the place of 1 - transparency.

    Of a material alone it is one number, [1, 1].
    """
    own = None
    if vertex_color is not None and vertex_color.shape[0] == 4:
        own = vertex_color[3]
    elif material is not None:
        own = 1.0 - material.transparency[:, :1]
    if texel is None or texel.shape[0] not in (2, 4):
        return own
    return texel[-1] * own if options.texture_mode == "modulate" and own is not None else texel[-1]
