"""The scene of recipe 02: photographed pixels as samples, lamps with uneven beams, an albedo texture.

Axes as in the data: x right, y up, z to the viewer; the unit is the height of the photograph, its centre the origin.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxlight import Orthographic, SampleBuffer, Scene, View, fit, nodes, render, samples_from_maps
from photometric_stereo import SHADOW, falloff

LAMP_DISTANCE = 60.0
"""Far, as the chrome spheres say; and far enough that a beam that hardly falls off has its axis beside the cat."""

NOISE = 0.005
"""What a pixel may differ from the model, in the photographs' range [0, 1]."""


class Cat:
    """The pixels that show the cat: where they lie, and the scene's samples there."""

    def __init__(self, mask: np.ndarray) -> None:
        self.mask = mask
        self.height, self.width = mask.shape
        row, column = np.nonzero(mask)
        x = (column + 0.5 - self.width / 2) / self.height
        y = (self.height / 2 - row - 0.5) / self.height
        self.position = np.stack([x, y, np.zeros_like(x)], axis=1)

    def image(self, values: np.ndarray) -> np.ndarray:
        """[height, width] with `values` [pixels] on the cat and 0 elsewhere."""
        picture = np.zeros(self.mask.shape)
        picture[self.mask] = values
        return picture

    def texture(self, albedo: np.ndarray) -> np.ndarray:
        """The albedo as a texture [height, width, 1], row 0 at the bottom."""
        return self.image(np.clip(albedo, 0, 1))[::-1, :, None]

    def samples(self, normals: np.ndarray, chosen: np.ndarray | None = None) -> SampleBuffer:
        """Samples of the pixels (of the `chosen` ones, a mask [pixels]), each with its own texel of the albedo."""
        mask = self.mask if chosen is None else self.image(chosen) != 0
        normal_map = np.zeros((*mask.shape, 3))
        normal_map[self.mask] = normals
        view = Orthographic(pixel_size=1 / self.height)
        return samples_from_maps(normal_map, view, depth=0.0, mask=mask, texel_per_pixel=True)


def make_scene(cat: Cat, albedo: np.ndarray, lamps: list[nodes.Node]) -> Scene:
    """The lamps and a card the size of the photograph, with the albedo as its texture."""
    x, y = cat.width / cat.height / 2, 0.5
    card = nodes.IndexedFaceSet(
        coord=nodes.Coordinate(point=[(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]),
        tex_coord=nodes.TextureCoordinate(point=[(0, 0), (1, 0), (1, 1), (0, 1)]),
        coord_index=[0, 1, 2, 3, -1],
    )
    plaster = nodes.Material(name="plaster", diffuse_color=(1, 1, 1), specular_color=(0.05,) * 3, ambient_intensity=0)
    texture = nodes.PixelTexture(name="albedo", image=cat.texture(albedo))
    shape = nodes.Shape(appearance=nodes.Appearance(material=plaster, texture=texture), geometry=card)
    return Scene.from_nodes([*lamps, shape])


def aimed_lamp(
    cat: Cat, name: str, direction: np.ndarray, photograph: np.ndarray, lambert: np.ndarray
) -> nodes.Transform:
    """A lamp whose beam falls off over the cat as the photograph does against Lambert's prediction.

    The intensity of a SpotLight with a narrow core falls linearly with the angle from its axis, so at a distance the
    ratio of the two pictures is a plane; its slope says how far to the side of the cat the axis points.

    Args:
        direction: unit vector to the lamp.
        photograph, lambert: [pixels].
    """
    level, slope = falloff(photograph, lambert, cat.position)
    steepness = max(np.linalg.norm(slope), 1e-6)
    off_axis = np.clip(np.pi / 2 - 1 / (steepness * LAMP_DISTANCE), 0.1, 1.53)
    across = slope - (slope @ direction) * direction
    axis = -np.cos(off_axis) * direction + np.sin(off_axis) * across / max(np.linalg.norm(across), 1e-12)
    turn = np.cross([0.0, 0.0, -1.0], axis)
    return nodes.Transform(
        translation=tuple(LAMP_DISTANCE * direction),
        rotation=(*turn, np.arccos(-axis[2])),
        children=nodes.SpotLight(
            name=name, intensity=level / (1 - off_axis / (np.pi / 2)), beam_width=0.01, cut_off_angle=np.pi / 2
        ),
    )


def aim_limits(scene: Scene) -> dict[str, float]:
    """How far direction.x and .y of each lamp may go, so that its axis, where the beam has a tip, stays off the cat."""
    turn, place = np.asarray(scene.spot.to_world, float)[..., :3], np.asarray(scene.spot.to_world, float)[..., 3]
    to_cat = np.einsum("lji,lj->li", turn, -place)
    limits = np.linalg.norm(to_cat[:, :2], axis=1) / np.abs(to_cat[:, 2]) / 2
    return dict(zip(scene.spot.names, limits.tolist(), strict=True))


def photographs_of(cat: Cat, scene: Scene, samples: SampleBuffer) -> np.ndarray:
    """What the camera sees in the light of each lamp of the scene alone, [lamps, pixels] (grey)."""
    return np.asarray(_one_lamp_at_a_time(scene, samples), float)[:, cat.mask]


@eqx.filter_jit
def _one_lamp_at_a_time(scene: Scene, samples: SampleBuffer) -> jax.Array:
    def photograph(intensity: jax.Array) -> jax.Array:
        return render(eqx.tree_at(lambda s: s.spot.intensity, scene, intensity), samples)[..., 0]

    return jax.lax.map(photograph, jnp.diag(scene.spot.intensity))


def matt(scene: Scene) -> Scene:
    """The scene without highlights."""
    return eqx.tree_at(lambda s: s.materials.specular_color, scene, replace_fn=jnp.zeros_like)


def lights_at(cat: Cat, scene: Scene) -> np.ndarray:
    """The vector to each lamp times its strength at every pixel, [lamps, pixels, 3].

    Three matt white surfaces, tilted so that all of them face the lamps, receive its products with their normals.
    """
    white = eqx.tree_at(lambda s: s.textures[0].image, matt(scene), replace_fn=jnp.ones_like)
    turns = np.arange(3) * 2 * np.pi / 3
    tilted = np.stack([np.cos(turns), np.sin(turns), np.ones(3)], axis=1) / np.sqrt(2)
    received = np.stack([photographs_of(cat, white, cat.samples(normal)) for normal in tilted], axis=-1)
    return np.linalg.solve(tilted, received[..., None])[..., 0]


def direction_seen(cat: Cat, normals: np.ndarray, seen: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The direction to the lamp that a photograph alone tells, from a start straight ahead: vector [3], any length."""
    sun = nodes.DirectionalLight(name="sun", direction=(0, 0, -1), ambient_intensity=0)
    scene = matt(make_scene(cat, np.linalg.norm(normals, axis=1), [sun]))
    view = View(cat.samples(normals, chosen), cat.image(seen), mask=cat.image(seen > SHADOW), noise=NOISE)
    free = [f"DirectionalLight[sun].{field}" for field in ("intensity", "direction.x", "direction.y")]
    found = fit(scene, view, free, loss="huber", loss_scale=2.0)
    return -np.asarray(found.scene.directional.direction[0], float)
