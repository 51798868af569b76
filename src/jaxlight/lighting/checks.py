"""Do a scene and a sample buffer fit each other?"""

from __future__ import annotations

import math
import warnings
from weakref import WeakValueDictionary

import jax
import numpy as np

from ..raster.samples import SampleBuffer
from ..scene import Scene
from ..scene.checks import check_scene
from ..tracing import is_traced

_within: WeakValueDictionary[tuple, jax.Array] = WeakValueDictionary()
"""Texel indices that are right, by identity, runs and sizes of textures: they never change, and are read again."""


def check_samples(scene: Scene, samples: SampleBuffer) -> None:
    """Raise ValueError if one of the two is something else, or they do not fit each other."""
    check_scene(scene)
    if not isinstance(samples, SampleBuffer):
        raise ValueError(f"samples: expected a SampleBuffer, got {type(samples).__name__}")
    _check_shapes(samples)
    if scene.directional is not None and scene.directional.headlight and samples.camera_to_world is None:
        said = "samples: no camera_to_world: the headlight of a scene without lights shines along the world's -z"
        warnings.warn(said, stacklevel=3)
    surfaces, components = scene.surfaces, 0 if samples.color_planes is None else samples.color_planes.shape[1]
    has_texels = samples.texel_index is not None
    for row, _, _ in samples.runs:
        if row >= len(surfaces):
            raise ValueError(f"samples: surface {row} asked for, but the scene has {len(surfaces)} surfaces")
        surface = surfaces[row]
        if surface.color_components > components:
            raise ValueError(
                f"samples: surface {row} has {surface.color_components}-component vertex colours, "
                f"the buffer holds {components}"
            )
        if surface.textured and not has_texels:
            raise ValueError(
                f"samples: surface {row} has a texture, but the buffer has no texel_index and texel_weight"
            )
    _check_texels(scene, samples)


def _check_shapes(samples: SampleBuffer) -> None:
    """Several buffers stacked, as `jax.vmap` takes them, are no buffer."""
    tiles = samples.runs[-1][2] if samples.runs else 0
    slots, block = tiles * samples.tile, samples.group * samples.tile
    expected = {
        "position_planes": (tiles // samples.group, 3, block),
        "normal_planes": (tiles // samples.group, 3, block),
        "eye": (3,),
        "tile_surface": (tiles,),
        "tile_low": (3, tiles),
        "tile_high": (3, tiles),
        "cluster_low": (3, slots // samples.cluster),
        "cluster_high": (3, slots // samples.cluster),
    }
    for name, shape in expected.items():
        own = np.shape(getattr(samples, name))
        if own != shape:
            raise ValueError(
                f"samples: {name}: expected shape {list(shape)}, got {list(own)}: "
                "the leaves are not those of one buffer; shade several with jax.vmap"
            )


def _check_texels(scene: Scene, samples: SampleBuffer) -> None:
    """Every texel is one of its surface's texture, as far as indices are known."""
    index = samples.texel_index
    if index is None or is_traced(index):
        return
    sizes = tuple(math.prod(texture.image.shape[:2]) for texture in scene.textures)
    key = (id(index), samples.runs, samples.tile, sizes, tuple(surface.texture for surface in scene.surfaces))
    if _within.get(key) is index:
        return
    for row, start, stop in samples.runs:
        texture = scene.surfaces[row].texture
        if texture < 0:
            continue
        highest = int(np.max(np.asarray(index)[..., start * samples.tile : stop * samples.tile], initial=0))
        if highest >= sizes[texture]:
            height, width = scene.textures[texture].image.shape[:2]
            raise ValueError(
                f"samples: texel_index: texel {highest} of surface {row} asked for, but its texture has "
                f"{height} x {width} texels"
            )
    _within[key] = index
