"""The Scene pytree: what the lighting equation reads, every number a leaf, every field as the user wrote it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float

from .flags import Flags

if TYPE_CHECKING:
    from . import nodes
    from .document import Document


FrameKind = Literal["identity", "similarity", "general"]
"""What is known of the frames of lights or fog: all the world's own, lengths scaled evenly, or nothing."""


class Surface(NamedTuple):
    """How the samples of a kind of shape get their colour: one row of tables 17.2 / 17.3 (static)."""

    lighting: Literal["lit", "unlit", "emissive"]
    """`lit`: table 17.3 and the equation; `unlit`: table 17.2; `emissive`: lines and points that have a Material."""
    material: int = -1
    """Row in `Scene.materials`; -1: none."""
    texture: int = -1
    """Row in `Scene.textures`; -1: none."""
    color_components: int = 0
    """Components of the shape's per-vertex or per-face colours: 0 (none), 3 or 4."""

    @property
    def textured(self) -> bool:
        """Whether a texture decides on the colour; emissive lines and points have none."""
        return self.texture >= 0 and self.lighting != "emissive"

    def code(self, textures: Sequence[Texture] | None) -> tuple[str, bool, int, int]:
        """What decides on the code that colours its samples: not which material, nor which texture of as many
        components (None: which texture does)."""
        alike = self.texture if textures is None or self.texture < 0 else textures[self.texture].image.shape[-1]
        return self.lighting, self.material < 0, alike, self.color_components


class Materials(eqx.Module):
    """The scene's Material nodes, one row each (X3D 12.4.4, 17.2.2.4). Colours are RGB; all fields in [0, 1]."""

    ambient_intensity: Float[Array, " materials"]
    diffuse_color: Float[Array, "materials 3"]
    emissive_color: Float[Array, "materials 3"]
    shininess: Float[Array, " materials"]
    specular_color: Float[Array, "materials 3"]
    transparency: Float[Array, " materials"]
    names: tuple[str, ...] = eqx.field(static=True)


class DirectionalLights(eqx.Module):
    """The scene's DirectionalLight nodes, one row each (X3D 17.4.1); `direction` in the light's own frame, any length.

    RGB `color` and `ambient_intensity` in [0, 1], `intensity` from 0 on. `to_world` maps vectors of the light's frame
    to the world; `on` [lights] and `in_scope` [surfaces, lights] (which surfaces a light may reach) are static.
    """

    ambient_intensity: Float[Array, " lights"]
    color: Float[Array, "lights 3"]
    direction: Float[Array, "lights 3"]
    intensity: Float[Array, " lights"]
    to_world: Float[Array, "lights 3 4"]
    on: Flags = eqx.field(static=True)
    in_scope: Flags = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    frame: FrameKind = eqx.field(static=True, default="general")
    headlight: bool = eqx.field(static=True, default=False)
    """True: the last row is the browser's headlight, whose frame is the camera of the samples."""


class PointLights(eqx.Module):
    """The scene's PointLight nodes, one row each (X3D 17.4.2); lengths and places in the light's own frame.

    RGB `color` and `ambient_intensity` in [0, 1]; `intensity`, `radius` and `attenuation` from 0 on. At a distance d
    the light is divided by max(1, c0 + c1 d + c2 d^2), `attenuation` being (c0, c1, c2), and is 0 where d > `radius`,
    which has no derivative. `to_world` maps the light's frame to the world; `to_local` is the inverse of its linear
    part.
    """

    ambient_intensity: Float[Array, " lights"]
    attenuation: Float[Array, "lights 3"]
    color: Float[Array, "lights 3"]
    intensity: Float[Array, " lights"]
    location: Float[Array, "lights 3"]
    radius: Float[Array, " lights"]
    to_world: Float[Array, "lights 3 4"]
    to_local: Float[Array, "lights 3 3"]
    on: Flags = eqx.field(static=True)
    in_scope: Flags = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    frame: FrameKind = eqx.field(static=True, default="general")


class SpotLights(eqx.Module):
    """The scene's SpotLight nodes, one row each (X3D 17.4.3); otherwise as PointLights.

    `beam_width` and `cut_off_angle` in radians, in (0, pi / 2]: full strength within the one, nothing beyond the other;
    `direction` of any length.
    """

    ambient_intensity: Float[Array, " lights"]
    attenuation: Float[Array, "lights 3"]
    beam_width: Float[Array, " lights"]
    color: Float[Array, "lights 3"]
    cut_off_angle: Float[Array, " lights"]
    direction: Float[Array, "lights 3"]
    intensity: Float[Array, " lights"]
    location: Float[Array, "lights 3"]
    radius: Float[Array, " lights"]
    to_world: Float[Array, "lights 3 4"]
    to_local: Float[Array, "lights 3 3"]
    on: Flags = eqx.field(static=True)
    in_scope: Flags = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    frame: FrameKind = eqx.field(static=True, default="general")


class Fog(eqx.Module):
    """The bound Fog node (X3D table 17.5); `to_local` maps world vectors to the fog's coordinate system.

    RGB `color` in [0, 1]; from `visibility_range` on, a length in the fog's own coordinates, nothing else is seen; 0
    is no fog.
    """

    color: Float[Array, "3"]
    visibility_range: Float[Array, ""]
    to_local: Float[Array, "3 3"]
    fog_type: Literal["LINEAR", "EXPONENTIAL"] = eqx.field(static=True)
    name: str = eqx.field(static=True, default="")
    frame: FrameKind = eqx.field(static=True, default="general")


class Texture(eqx.Module):
    """One texture: values in [0, 1], row 0 at the bottom (t = 0), one to four components (X3D Texturing)."""

    image: Float[Array, "height width components"]
    name: str = eqx.field(static=True, default="")
    size: tuple[int, int] | None = eqx.field(static=True, default=None)
    """The image's height and width, by which sample buffers count texels; None: not known, and not checked."""


class Scene(eqx.Module):
    """A scene as the lighting equation reads it: a pytree whose every number is a leaf.

    A kind of light that the scene lacks is None. `document` holds what is not differentiated: the nodes the scene
    came from, the placed shapes, viewpoints and background. A user may leave it out (`dataclasses.replace` by None);
    what needs nodes refuses such a scene (`checks.check_has_nodes`).
    """

    materials: Materials | None
    directional: DirectionalLights | None
    point: PointLights | None
    spot: SpotLights | None
    fog: Fog | None
    textures: tuple[Texture, ...]
    surfaces: tuple[Surface, ...] = eqx.field(static=True)
    document: Document = eqx.field(static=True, repr=False)

    @classmethod
    def from_nodes(cls, children: nodes.Node | Sequence[nodes.Node], *, dtype: Any = None) -> Scene:
        """The scene that these X3D nodes describe: transforms flattened, scopes and repeated nodes resolved.

        Args:
            children: the scene's root nodes.
            dtype: type of the leaves, float64 (where x64 is enabled), float32, float16 or bfloat16; default: JAX's
                (float64 where x64 is enabled, otherwise float32).

        Raises:
            ValueError: nesting or size beyond the stated limits, a singular Transform, or another type.
        """
        from .flatten import scene_from_nodes

        return scene_from_nodes(children, dtype=dtype)
