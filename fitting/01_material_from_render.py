"""Material and light from one picture that an independent program rendered.

In: data/spot/spot.x3d (geometry and camera; its material and light are what the program was given, here the truth to
compare with) and data/spot/spot_256.png, 8 bits a channel, made as data/spot/HOW_IT_WAS_MADE.txt says.
Out (folder --output): fitted.x3d, the scene with what was found; fitted.png, its picture; report.html, a page on what
the fit did; report.txt, the printed table: each free number, its truth, start, error, and the standard error that
independent noise of the size of rounding to 8 bits would leave it. Rounding is not independent in evenly lit areas:
errors may be up to twice as large.

Free are the diffuse and specular colour, the shininess and the place of the lamp, from a start that is wrong in all of
them. The lamp's colour and attenuation are known: only their product with the material's colours can be seen.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro

from jaxlight import Fit, Scene, View, fit, load, rasterize, read_image, render, save, write_image, write_report
from pictures import table

DATA = Path(__file__).parent / "data" / "spot"
FREE = [
    "Material[body].diffuse_color",
    "Material[body].specular_color",
    "Material[body].shininess",
    "PointLight[key].location",
]
START = [[0.4, 0.4, 0.4], [0.5, 0.5, 0.5], 0.6, [-1.0, 3.0, -3.0]]
ROUNDING = 1 / 255 / np.sqrt(12)
"""Standard deviation of what rounding to 8 bits does to a number: it is spread evenly over one level."""


class Figures(NamedTuple):
    """What the recipe found, in the order of the free numbers; `rms` and `largest` in 1/255 of the picture's range."""

    labels: tuple[str, ...]
    truth: np.ndarray
    start: np.ndarray
    fitted: np.ndarray
    standard_error: np.ndarray
    """Of each number, when every channel of the picture is rounded to 8 bits."""
    rms: float
    largest: float
    steps: int
    converged: bool


def free_leaves(scene: Scene) -> list[jax.Array]:
    """The arrays that FREE names."""
    materials = scene.materials
    return [materials.diffuse_color, materials.specular_color, materials.shininess, scene.point.location]


def numbers(scene: Scene) -> np.ndarray:
    """The free numbers of a scene in the order of FREE."""
    return np.concatenate([np.asarray(leaf, float).reshape(-1) for leaf in free_leaves(scene)])


def wrong_start(truth: Scene) -> Scene:
    """The scene with START in the place of what is to be found."""
    new = [
        jnp.full(leaf.shape, jnp.asarray(value), leaf.dtype)
        for leaf, value in zip(free_leaves(truth), START, strict=True)
    ]
    return eqx.tree_at(free_leaves, truth, new)


def report(found: Fit, figures: Figures, size: int) -> str:
    """The table of the fitted numbers, and how the pictures compare."""
    columns = (figures.truth, figures.start, figures.fitted, figures.fitted - figures.truth, figures.standard_error)
    rows = [
        [label, f"{true:.4f}", f"{start:.4f}", f"{value:.5f}", f"{error:+.5f}", f"{typical:.5f}"]
        for label, true, start, value, error, typical in zip(figures.labels, *columns, strict=True)
    ]
    return "\n".join(
        [
            f"Spot, {size} x {size}, rendered by view3dscene: {len(rows)} numbers from one 8-bit picture",
            found.message,
            *found.uncertainty.messages(),
            "",
            table(["field", "truth", "start", "fitted", "error", "standard error"], rows),
            "",
            f"Fit against picture, in levels of 255: RMS {figures.rms:.3f}, largest {figures.largest:.3f}"
            " (rounding to 8 bits alone: 0.289 and 0.5)",
        ]
    )


def main(output: Path = Path("output/01_material_from_render"), size: Literal[256, 512] = 256) -> Figures:
    """Fit the picture, print the table and write fitted.x3d, fitted.png, report.html and report.txt.

    Args:
        output: folder for what is written.
        size: which of the two pictures, 256 or 512 pixels a side.
    """
    truth = load(DATA / "spot.x3d")
    picture = read_image(DATA / f"spot_{size}.png")[..., :3]
    samples = rasterize(truth, width=size, height=size)
    start = wrong_start(truth)
    view = View(samples, picture, noise=ROUNDING, saturated=1.0, name=f"spot_{size}")
    found = fit(start, view, FREE)

    fitted = np.asarray(render(found.scene, samples), float)
    levels = 255 * np.abs(fitted - picture).reshape(-1, 3)[np.asarray(samples.pixel)]
    figures = Figures(
        labels=found.labels,
        truth=numbers(truth),
        start=numbers(start),
        fitted=numbers(found.scene),
        standard_error=found.uncertainty.standard_error,
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
    write_image(output / "fitted.png", fitted)
    write_report(output / "report.html", found, view, title="Spot: material and lamp from one 8-bit picture")
    return figures


if __name__ == "__main__":
    tyro.cli(main)
