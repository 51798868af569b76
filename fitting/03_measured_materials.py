"""Fifty measured materials, each approximated by one X3D Material.

In: data/merl_nbrdf, reflectances of the MERL database as small networks (SOURCE.md there says whose, and the citation).
Out (folder --output): materials.png, every material as measured and, below it, as fitted, on a sphere; report.txt, the
printed table: the fitted numbers, the relative error of the fit, and that of a brute-force search.

A sphere is lit from four directions in turn, the nearest beside the camera, the farthest nearly behind. Diffuse and
specular colour and shininess are fitted to the four pictures of the measured reflectance together. Brightness has no
unit here: each material's pictures are divided by their greatest value, so that all fields stay in [0, 1].
The brute-force search tries 1001 values of the shininess and solves for the colours, which are then a linear
least-squares problem; no Material with such a shininess is closer to the pictures.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import tyro

from jaxlight import Fit, Orthographic, SampleBuffer, Scene, View, encode, fit, nodes, samples_from_maps
from pictures import save_grid, table

DATA = Path(__file__).parent / "data" / "merl_nbrdf"
LIGHT_ANGLES = (10.0, 35.0, 60.0, 80.0)
"""Degrees between the directions to the camera and to the light."""
VIEWER = np.array([0.0, 0.0, 1.0])
STARTS = (0.3, 0.001)
"""Shininess to start from. The loss often has two valleys: a highlight, and a term that is nearly the same all over."""
SHOWN = 1
"""Which of the lights materials.png shows."""


class Figures(NamedTuple):
    """What was fitted to one material; errors are RMS differences divided by the RMS of the pictures."""

    name: str
    diffuse: np.ndarray
    specular: np.ndarray
    shininess: float
    error: float
    brute_force: float
    steps: int
    converged: bool


def sphere(size: int) -> np.ndarray:
    """Normals of a sphere that fills the picture, seen from afar: [size, size, 3], 0 outside."""
    across = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(across, -across)
    square = x**2 + y**2
    z = np.sqrt(np.maximum(1 - square, 0))
    return np.where((square < 0.98**2)[..., None], np.stack([x, y, z], axis=-1), 0.0)


def directions_to_lights() -> np.ndarray:
    """[lights, 3], from the right and a little from above."""
    angle = np.radians(LIGHT_ANGLES)
    side = np.array([np.cos(0.4), np.sin(0.4), 0.0])
    return np.sin(angle)[:, None] * side + np.cos(angle)[:, None] * VIEWER


def reflected(network: dict[str, np.ndarray], normal: np.ndarray, to_light: np.ndarray) -> np.ndarray:
    """The light that a material sends to the viewer under a directional light, pi x BRDF x N.L, [N, 3].

    The networks take the half vector and the difference vector in Rusinkiewicz's frames (SOURCE.md).

    Args:
        network: arrays fc1, b1, fc2, b2, fc3, b3 of one material.
        normal: [N, 3], unit vectors.
        to_light: [3], unit vector.
    """
    half = (to_light + VIEWER) / np.linalg.norm(to_light + VIEWER)
    cosine = np.clip(normal @ half, -1, 1)
    sine = np.sqrt(1 - cosine**2)
    steep = np.maximum(sine, 1e-9)[:, None]
    along, across = (cosine[:, None] * half - normal) / steep, np.cross(normal, half) / steep
    x = np.stack([sine, 0 * sine, cosine, along @ to_light, across @ to_light, 0 * sine + half @ to_light], axis=1)
    for layer in "12":
        x = np.maximum(x @ network[f"fc{layer}"] + network[f"b{layer}"], 0)
    reflectance = np.maximum(np.exp(x @ network["fc3"] + network["b3"]) - 1, 0)
    return np.pi * reflectance * np.maximum(normal @ to_light, 0)[:, None]


def make_scene() -> Scene:
    """One material, and the lights by the names light0, light1, ..."""
    lights = [
        nodes.DirectionalLight(name=f"light{i}", direction=tuple(-direction), global_=True)
        for i, direction in enumerate(directions_to_lights())
    ]
    material = nodes.Material(
        name="measured", diffuse_color=(0.3,) * 3, specular_color=(0.3,) * 3, shininess=0.3, ambient_intensity=0
    )
    return Scene.from_nodes(
        [*lights, nodes.Shape(appearance=nodes.Appearance(material=material), geometry=nodes.Sphere())]
    )


def brute_force(normal: np.ndarray, pictures: np.ndarray, lit: np.ndarray) -> float:
    """The least sum of squared differences that any shininess in 0, 0.001, ..., 1 allows.

    Args:
        normal: [N, 3]. pictures: [lights, N, 3]. lit: [lights, N], where to look.
    """
    lights = directions_to_lights()
    half = (lights + VIEWER) / np.linalg.norm(lights + VIEWER, axis=1, keepdims=True)
    cosine = np.maximum(lights @ normal.T, 0)[lit]
    base = np.maximum(half @ normal.T, 0)[lit]
    target = pictures[lit]
    return min(_least_squares(cosine, base ** (128 * s), target) for s in np.linspace(0, 1, 1001))


def _least_squares(diffuse: np.ndarray, specular: np.ndarray, target: np.ndarray) -> float:
    """Sum of squares left by the best colours >= 0: both terms, or one of them, or none."""
    terms = np.stack([diffuse, specular])
    square, product, whole = terms @ terms.T, terms @ target, np.sum(target**2, axis=0)
    both = np.linalg.lstsq(square, product, rcond=None)[0]
    left = [np.where(np.all(both >= 0, axis=0), whole - np.sum(both * product, axis=0), np.inf)]
    left += [whole - np.maximum(product[i], 0) ** 2 / square[i, i] for i in (0, 1)]
    return float(np.sum(np.minimum.reduce(left)))


def fit_material(name: str, scene: Scene, samples: SampleBuffer, pictures: np.ndarray, lit: np.ndarray) -> Fit:
    """Fit the material to the pictures [lights, height, width, 3] where they are `lit` [lights, height, width]."""
    views = [
        View(samples, picture, mask=mask, lights=[f"DirectionalLight[light{i}]"], name=f"{name} {i}")
        for i, (picture, mask) in enumerate(zip(pictures, lit, strict=True))
    ]
    free = [f"Material[measured].{field}" for field in ("diffuse_color", "specular_color", "shininess")]
    found = []
    for shininess in STARTS:
        start = eqx.tree_at(lambda s: s.materials.shininess, scene, jnp.full_like(scene.materials.shininess, shininess))
        found.append(fit(start, views, free))
    return min(found, key=lambda each: each.loss)


def report(figures: list[Figures]) -> str:
    """A row a material, and how often the fit is as good as the brute-force search."""
    rows = [
        [
            each.name,
            *(" ".join(f"{number:.3f}" for number in color) for color in (each.diffuse, each.specular)),
            f"{each.shininess:.3f}",
            f"{each.error:.4f}",
            f"{each.brute_force:.4f}",
            str(each.steps) + ("" if each.converged else " (not converged)"),
        ]
        for each in figures
    ]
    worst = max(each.error / each.brute_force for each in figures)
    return "\n".join(
        [
            table(["material", "diffuse", "specular", "shininess", "error", "brute force", "steps"], rows),
            "",
            f"{len(figures)} materials; error of the fit / brute force: at most {worst:.5f}; "
            f"median error {np.median([each.error for each in figures]):.3f}, "
            f"median steps {np.median([each.steps for each in figures]):.0f}",
        ]
    )


def save_spheres(path: Path, shown: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """Every material as measured and, below, as fitted; linear light shown in sRGB, pixels doubled."""
    names, rows = list(shown), []
    for first in range(0, len(names), 10):
        for kind, mark in enumerate(("", "X3D ")):
            pictures = {mark + name: encode(np.nan_to_num(shown[name][kind])) for name in names[first : first + 10]}
            rows.append({label: np.asarray(p).repeat(2, axis=0).repeat(2, axis=1) for label, p in pictures.items()})
    save_grid(path, rows)


def main(output: Path = Path("output/03_measured_materials"), size: int = 64, first: int = 50) -> list[Figures]:
    """Fit the materials, print the table and write materials.png and report.txt.

    Args:
        output: folder for what is written.
        size: side of the pictures of the sphere.
        first: only so many of the materials.
    """
    stored = dict(np.load(DATA / "nbrdf_weights.npz"))
    normal = sphere(size)
    seen = np.any(normal != 0, axis=-1)
    lit = (normal @ directions_to_lights().T > 0).transpose(2, 0, 1) & seen
    samples = samples_from_maps(normal, Orthographic(pixel_size=2 / size), depth=0.0)
    start = make_scene()
    figures, shown = [], {}
    for i, name in enumerate(stored["names"][:first].tolist()):
        network = {key: array[i].astype(float) for key, array in stored.items() if key != "names"}
        pictures = np.zeros((len(LIGHT_ANGLES), size, size, 3))
        pictures[:, seen] = [reflected(network, normal[seen], light) for light in directions_to_lights()]
        pictures /= pictures.max()
        found = fit_material(name, start, samples, pictures, lit)
        whole = float(np.sum(pictures[lit] ** 2))
        material = found.scene.materials
        figures.append(
            Figures(
                name=name,
                diffuse=np.asarray(material.diffuse_color[0]),
                specular=np.asarray(material.specular_color[0]),
                shininess=float(material.shininess[0]),
                error=float(np.sqrt(2 * found.loss / whole)),
                brute_force=float(np.sqrt(brute_force(normal[seen], pictures[:, seen], lit[:, seen]) / whole)),
                steps=found.accepted_steps,
                converged=found.converged,
            )
        )
        shown[name] = (pictures[SHOWN], pictures[SHOWN] + found.residual_image(SHOWN))
    output.mkdir(parents=True, exist_ok=True)
    print(report(figures))
    (output / "report.txt").write_text(report(figures) + "\n")
    save_spheres(output / "materials.png", shown)
    return figures


if __name__ == "__main__":
    tyro.cli(main)
