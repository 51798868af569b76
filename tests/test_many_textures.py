"""Textures of as many components are read by the same code: a program is not longer for each of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxlight import Camera, Scene, nodes, rasterize, shade
from jaxlight.lighting import shade_slots
from jaxlight.lighting.tile_inputs import textures_of_run
from jaxlight.lighting.tiles import surface_runs
from jaxlight.raster import SampleBuffer

COUNT = 700


def scene_of(components: Sequence[int]) -> Scene:
    """Shapes with a texture each, of several sizes and so many components, without lights."""
    random = np.random.default_rng(5)
    pictures = [random.uniform(0.1, 1, (3, 2 + number, own)) for number, own in enumerate(components)]
    textures = [nodes.PixelTexture(image=picture) for picture in pictures]
    return Scene.from_nodes([nodes.Shape(appearance=nodes.Appearance(texture=own)) for own in textures])


def samples_of(scene: Scene, count: int = COUNT) -> SampleBuffer:
    """Random samples of all shapes."""
    random = np.random.default_rng(6)
    surface = random.integers(0, len(scene.surfaces), count)
    texels = np.array([scene.textures[own.texture].image[..., 0].size for own in scene.surfaces])
    position = random.uniform(-1, 1, (count, 3))
    index = (random.uniform(size=(count, 4)) * texels[surface, None]).astype(int)
    weight = random.dirichlet(np.ones(4), count)
    return SampleBuffer.create(
        position,
        position + 2,
        [0, 0, 9],
        surface=surface,
        texel_index=index,
        texel_weight=weight,
        camera_to_world=np.eye(3),
    )


def test_textures_of_as_many_components_share_their_code() -> None:
    scene = scene_of((3, 3, 1, 3, 3, 3))
    samples = samples_of(scene)
    assert len(surface_runs(scene.surfaces, samples)) == 6
    runs = surface_runs(scene.surfaces, samples, scene.textures)
    assert [run.start for run in runs] == [0, *(run.stop for run in runs[:-1])]
    assert [len(textures_of_run(run, scene.surfaces, samples)) for run in runs] == [2, 1, 3]


def test_each_shape_has_its_own_texture_and_derivatives_too() -> None:
    scene = scene_of((3, 3))
    samples = samples_of(scene)
    is_sample = np.asarray(samples.is_sample)

    def total(images: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
        textures = tuple(dataclasses.replace(t, image=i) for t, i in zip(scene.textures, images, strict=True))
        colors = shade_slots(dataclasses.replace(scene, textures=textures), samples)[:, :3]
        return jnp.sum(jnp.where(is_sample[:, None], colors, 0) ** 2), colors

    images = [texture.image for texture in scene.textures]
    slopes, colors = jax.jit(jax.grad(total, has_aux=True))(images)
    surface = np.where(is_sample, np.repeat(np.asarray(samples.tile_surface), samples.tile), -1)
    texels, weight = np.asarray(samples.texel_index), np.asarray(samples.texel_weight, np.float64)
    for row, own in enumerate(scene.surfaces):
        mine = surface == row
        index, share = texels[:, mine], weight[:, mine, None]
        image = np.asarray(images[own.texture], np.float64)
        known = image.reshape(-1, image.shape[-1])
        color = np.sum(known[index] * share, axis=0)
        np.testing.assert_allclose(colors[mine], color, rtol=1e-6)
        slope = np.zeros_like(known)
        np.add.at(slope, index, share * 2 * color)
        np.testing.assert_allclose(slopes[own.texture], slope.reshape(image.shape), rtol=1e-5)


def test_shapes_of_several_kinds_in_turn_are_stored_kind_by_kind() -> None:
    """Their rows stay those of the scene."""
    picture = np.random.default_rng(7).uniform(0.1, 1, (2, 2, 3))
    shapes = []
    for number in range(6):
        own = nodes.PixelTexture(image=picture / (1 + number)) if number % 3 == 1 else None
        material = None if number % 3 == 2 else nodes.Material(diffuse_color=(0.1 * number, 0.5, 0.5))
        appearance = nodes.Appearance(material=material, texture=own)
        shape = nodes.Shape(appearance=appearance, geometry=nodes.Sphere())
        shapes.append(nodes.Transform(translation=(3.0 * number, 0.0, 0.0), children=[shape]))
    scene = Scene.from_nodes([*shapes, nodes.PointLight(location=(6.0, 0.0, 9.0))])
    samples = rasterize(scene, Camera.view_all(scene), 128, 64)
    runs = surface_runs(scene.surfaces, samples, scene.textures)
    assert len(samples.runs) == 5 and len(runs) == 3
    surface, position = np.asarray(samples.surface), np.asarray(samples.position)
    np.testing.assert_array_equal(surface, np.array([0, 1, 2, 3, 4, 2])[np.rint(position[:, 0] / 3).astype(int)])
    by_row = SampleBuffer.create(
        position,
        samples.normal,
        samples.eye,
        surface=surface,
        texel_index=samples.in_sample_order(samples.texel_index).T,
        texel_weight=samples.in_sample_order(samples.texel_weight).T,
    )
    assert len(surface_runs(scene.surfaces, by_row, scene.textures)) == 5
    np.testing.assert_allclose(shade(scene, samples), shade(scene, by_row), rtol=1e-6)
