"""What is seen where no shape is: the sky of the scene's Background node."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..lighting.compiling import quick_jit
from ..lighting.prepared import compute_dtype
from ..lighting.vectors import Vector, cross, dot, unit
from ..raster import SampleBuffer
from ..scene import Scene


def sky(scene: Scene, samples: SampleBuffer) -> Float[Array, "3"] | Float[Array, "height width 3"]:
    """The sky behind a picture (X3D 24.4.1): one colour, or colours that change with the angle from the zenith.

    The first colour stands at the zenith (+y, turned as the transforms above the node turn it), each further one at
    its `sky_angle`, the last from there to the nadir; between them colours are interpolated by angle. A buffer that
    does not know its rays shows the zenith's colour, a scene without Background black.

    Returns:
        [3], or [height, width, 3] where the colour depends on the pixel.
    """
    dtype = compute_dtype(samples)
    placed = scene.document.background if scene.document is not None else None
    if placed is None or len(placed.node.sky_color) == 0:
        return jnp.zeros(3, dtype)
    node, zenith = placed.node, placed.to_world[:, 1] / np.linalg.norm(placed.to_world[:, 1])
    if len(node.sky_color) == 1 or samples.pixel_to_world is None or samples.width is None or samples.height is None:
        return jnp.asarray(node.sky_color[0], dtype)
    angles = (0.0, *node.sky_angle)
    return _by_angle(samples, *(jnp.asarray(numbers, dtype) for numbers in (zenith, angles, node.sky_color)))


@quick_jit
def _by_angle(
    samples: SampleBuffer, zenith: Float[Array, "3"], angles: Float[Array, " stops"], colors: Float[Array, "stops 3"]
) -> Float[Array, "height width 3"]:
    """The colours between stops at so many radians from the zenith, along the rays of the pixels' centres."""
    assert samples.pixel_to_world is not None and samples.width is not None and samples.height is not None
    dtype = colors.dtype
    u, v = jnp.arange(samples.width, dtype=dtype) + 0.5, jnp.arange(samples.height, dtype=dtype)[:, None] + 0.5
    ray = Vector(*(row[0] * u + row[1] * v + row[2] for row in samples.pixel_to_world))
    up = Vector(*zenith)
    _, aside = unit(cross(ray, up))
    from_zenith = jnp.arctan2(aside, dot(ray, up))
    return jnp.stack([jnp.interp(from_zenith, angles, colors[:, i]) for i in range(3)], axis=-1)
