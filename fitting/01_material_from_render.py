"""Material and light from one picture that an independent program rendered.

In: data/spot/spot.x3d (geometry and camera; its material and light are what the program was given, here the truth to
compare with) and data/spot/spot_256.png, 8 bits a channel, made as data/spot/HOW_IT_WAS_MADE.txt says.
Out (folder --output): fitted.x3d, the scene with what was found; comparison.png, the picture beside start and fit;
report.txt, the table that is printed: each free number, its truth, start and error, and the error that 8 bits allow.

Free are the diffuse and specular colour, the shininess and the place of the lamp, from a start that is wrong in all of
them. The lamp's colour and attenuation are known: only their product with the material's colours can be seen.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
import tyro

from jaxlight import Fit, SampleBuffer, Scene, View, fit, load, rasterize, read_image, save, shade
from pictures import save_grid, signed, table

DATA = Path(__file__).parent / "data" / "spot"
FREE = [
    "Material[body].diffuse_color",
    "Material[body].specular_color",
    "Material[body].shininess",
    "PointLight[key].location",
]
START = np.array([0.4, 0.4, 0.4, 0.5, 0.5, 0.5, 0.6, -1.0, 3.0, -3.0])


class Figures(NamedTuple):
    """What the recipe found, in the order of the free numbers; `rms` and `largest` in 1/255 of the picture's range."""

    labels: tuple[str, ...]
    truth: np.ndarray
    fitted: np.ndarray
    allowed: np.ndarray
    """Standard error of each number when every channel is rounded to 8 bits."""
    rms: float
    largest: float
    steps: int
    converged: bool


def numbers(scene: Scene) -> np.ndarray:
    """The free numbers of a scene in the order of FREE."""
    leaves = free_leaves(scene)
    return np.concatenate([np.asarray(leaf, float).reshape(-1) for leaf in leaves])


def with_numbers(scene: Scene, values: jax.Array | np.ndarray) -> Scene:
    """The scene with its free numbers replaced."""
    diffuse, specular, shininess, location = values[:3], values[3:6], values[6:7], values[7:]
    new = [diffuse[None], specular[None], shininess, location[None]]
    old = free_leaves(scene)
    return eqx.tree_at(free_leaves, scene, [jax.numpy.asarray(a, b.dtype) for a, b in zip(new, old, strict=True)])


def free_leaves(scene: Scene) -> list[jax.Array]:
    """The arrays that FREE names."""
    materials, lamp = scene.materials, scene.point
    return [materials.diffuse_color, materials.specular_color, materials.shininess, lamp.location]


def errors_allowed(scene: Scene, samples: SampleBuffer) -> np.ndarray:
    """Standard errors of the free numbers when each channel of each pixel is rounded to 8 bits.

    Rounding errors are spread evenly over one level, so their variance is (1/255)^2 / 12.
    """

    def colors(values: jax.Array, scene: Scene, samples: SampleBuffer) -> jax.Array:
        return shade(with_numbers(scene, values), samples)[:, :3].reshape(-1)

    values = jax.numpy.asarray(numbers(scene), scene.point.location.dtype)
    jacobian = np.asarray(jax.jit(jax.jacfwd(colors))(values, scene, samples), float)
    return np.sqrt(np.diagonal(np.linalg.inv(jacobian.T @ jacobian))) / 255 / np.sqrt(12)


def picture_of(scene: Scene, samples: SampleBuffer) -> np.ndarray:
    """[height, width, 3] over a black background."""
    picture = np.zeros((samples.height * samples.width, 3))
    picture[np.asarray(samples.pixel)] = np.asarray(shade(scene, samples))[:, :3]
    return picture.reshape(samples.height, samples.width, 3)


def report(found: Fit, figures: Figures, size: int) -> str:
    """The table of the fitted numbers, and how the pictures compare."""
    rows = [
        [label, f"{true:.4f}", f"{start:.4f}", f"{value:.5f}", f"{value - true:+.5f}", f"{allowed:.5f}"]
        for label, true, start, value, allowed in zip(
            figures.labels, figures.truth, START, figures.fitted, figures.allowed, strict=True
        )
    ]
    return "\n".join(
        [
            f"Spot, {size} x {size}, rendered by view3dscene: {len(rows)} numbers from one 8-bit picture",
            found.message,
            "",
            table(["field", "truth", "start", "fitted", "error", "8 bits allow"], rows),
            "",
            f"Picture against fit, in levels of 255: RMS {figures.rms:.3f}, largest {figures.largest:.3f}"
            " (rounding to 8 bits alone: 0.289 and 0.5)",
        ]
    )


def main(output: Path = Path("output/01_material_from_render"), size: Literal[256, 512] = 256) -> Figures:
    """Fit the picture, print the table and write fitted.x3d, comparison.png and report.txt.

    Args:
        output: folder for what is written.
        size: which of the two pictures, 256 or 512 pixels a side.
    """
    truth = load(DATA / "spot.x3d")
    picture = read_image(DATA / f"spot_{size}.png")[..., :3]
    samples = rasterize(truth, width=size, height=size)
    start = with_numbers(truth, START)
    found = fit(start, View(samples, picture, saturated=1.0), FREE)

    fitted = picture_of(found.scene, samples)
    levels = 255 * np.abs(fitted - picture).reshape(-1, 3)[np.asarray(samples.pixel)]
    figures = Figures(
        labels=found.labels,
        truth=numbers(truth),
        fitted=numbers(found.scene),
        allowed=errors_allowed(found.scene, samples),
        rms=float(np.sqrt(np.mean(levels**2))),
        largest=float(levels.max()),
        steps=found.accepted_steps,
        converged=found.converged,
    )
    output.mkdir(parents=True, exist_ok=True)
    text = report(found, figures, size)
    print(text)
    (output / "report.txt").write_text(text + "\n")
    save(found.scene, output / "fitted.x3d")
    difference = np.mean(fitted - picture, axis=2) * 255
    save_grid(
        output / "comparison.png",
        [
            {"start": picture_of(start, samples), "fitted": fitted},
            {"view3dscene, 8 bits": picture, "fit - picture, 1/255 full": signed(difference, 1.0)},
        ],
    )
    return figures


if __name__ == "__main__":
    tyro.cli(main)
