"""Real photographs: lamps and material fitted to eleven of them, the twelfth predicted.

In: data/psbox_cat, twelve photographs of a plaster cat, each lit by another lamp, and of two chrome spheres.
Out (folder --output): cat.x3d, the scene as fitted to eleven photographs; held_out.x3d, the same cat in the light of
the held-out lamp; prediction.png, the held-out photograph beside its predictions and their errors; report.txt, the
printed figures.

1. The highlights on the chrome spheres give the directions to the lamps.
2. Photometric stereo on the training photographs (least squares, Lambert) gives a normal and an albedo per pixel.
3. jaxlight fits what lamps and material do. Every lamp is a SpotLight of free strength and aim, because the photographs
   show uneven beams; the cat is one Material with a highlight under an albedo texture. Then normals and albedo are
   solved again in the light that was found, and lamps and material are fitted again.
4. Nobody knows the held-out lamp: its strength and aim are read from one pixel in twenty of its photograph, and the
   errors are counted on the others. Lambert's baselines get their one number, the strength, from the same pixels.
   The direction to the lamp can also be told from these pixels alone, and compared with the chrome spheres.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
import tyro

from jaxlight import Free, Scene, View, fit, nodes, save
from photographed_scene import Cat, aimed_lamp, lights_at, make_scene, matt, photographs_of
from photometric_stereo import (
    SHADOW,
    angles,
    chrome_directions,
    lambert_normals,
    lambert_prediction,
    object_mask,
    read_photographs,
    scaled,
    strengths_of_lights,
)
from pictures import save_grid, signed, table

DATA = Path(__file__).parent / "data" / "psbox_cat"
MEAN_ALBEDO = 0.5
"""Photographs show albedo times strength only; this splits them."""
NOISE = 0.005
"""What a pixel may differ from the model, in the photographs' range [0, 1]."""


class Errors(NamedTuple):
    """Mean and median absolute error of a prediction of the held-out photograph, in the photograph's range [0, 1]."""

    mean: float
    median: float


class Figures(NamedTuple):
    """What is known of one held-out photograph."""

    errors: dict[str, Errors]
    """By method."""
    direction: float
    """Angle in degrees between the lamp's direction as the photograph tells it and as the chrome spheres do."""


class HeldOut(NamedTuple):
    """What came of holding one photograph out."""

    scene: Scene
    """Fitted to the other photographs."""
    lit: Scene
    """The same cat in the light of the held-out lamp."""
    predictions: dict[str, np.ndarray]
    """Pictures of the held-out photograph [pixels], by method."""


def fit_lamps(
    cat: Cat, scene: Scene, normals: np.ndarray, photographs: dict[str, np.ndarray], chosen: np.ndarray, *extra: Any
) -> Scene:
    """The scene with the strength and aim of the named lamps, and the `extra` fields, fitted to the chosen pixels."""
    samples = cat.samples(normals, chosen)
    views = [
        View(
            samples,
            cat.image(photograph),
            mask=cat.image(photograph > SHADOW),
            noise=NOISE,
            lights=[f"SpotLight[{lamp}]"],
            name=lamp,
        )
        for lamp, photograph in photographs.items()
    ]
    fields = ("intensity", "direction.x", "direction.y")
    own = [f"SpotLight[{lamp}].{field}" for lamp in photographs for field in fields]
    # Cast shadows and light from surface to surface are outside the model: large residuals count less.
    found = fit(scene, views, [*own, *extra], loss="huber", loss_scale=2.0, rtol=1e-3, atol=1e-3, max_steps=200)
    print(f"  {len(views)} photographs, {len(found.values)} numbers: {found.message}")
    return found.scene


def train(
    cat: Cat, photographs: dict[str, np.ndarray], directions: np.ndarray, chosen: np.ndarray, rounds: int
) -> tuple[Scene, np.ndarray]:
    """The scene fitted to the training photographs, and normal times albedo [pixels, 3]."""
    names, pictures = list(photographs), np.stack(list(photographs.values()))
    strengths = strengths_of_lights(pictures, directions)
    normals = lambert_normals(pictures, strengths[:, None] * directions)
    normals *= MEAN_ALBEDO / np.linalg.norm(normals, axis=1).mean()
    lamps = [
        aimed_lamp(cat, name, direction, picture, np.maximum(normals @ direction, 0))
        for name, direction, picture in zip(names, directions, pictures, strict=True)
    ]
    scene = make_scene(cat, np.linalg.norm(normals, axis=1), lamps)
    gloss = Free("Material[plaster].shininess", mean=0.2, deviation=0.2)  # without a highlight nothing else tells it
    for _ in range(rounds):
        scene = fit_lamps(cat, scene, normals, photographs, chosen, "Material[plaster].specular_color", gloss)
        samples = cat.samples(normals)
        highlights = photographs_of(cat, scene, samples) - photographs_of(cat, matt(scene), samples)
        normals = lambert_normals(pictures - highlights, lights_at(cat, scene))
        texture = cat.texture(np.linalg.norm(normals, axis=1))
        scene = eqx.tree_at(lambda s: s.textures[0].image, scene, texture.astype(scene.textures[0].image.dtype))
    return scene, normals


def direction_seen(cat: Cat, normals: np.ndarray, seen: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The direction to the lamp that a photograph alone tells, from a start straight ahead: vector [3], any length."""
    sun = nodes.DirectionalLight(name="sun", direction=(0, 0, -1), ambient_intensity=0)
    scene = matt(make_scene(cat, np.linalg.norm(normals, axis=1), [sun]))
    view = View(cat.samples(normals, chosen), cat.image(seen), mask=cat.image(seen > SHADOW), noise=NOISE)
    free = [f"DirectionalLight[sun].{field}" for field in ("intensity", "direction.x", "direction.y")]
    found = fit(scene, view, free, loss="huber", loss_scale=2.0)
    return -np.asarray(found.scene.directional.direction[0], float)


def predict(
    cat: Cat, scene: Scene, normals: np.ndarray, name: str, direction: np.ndarray, seen: np.ndarray, chosen: np.ndarray
) -> tuple[Scene, np.ndarray]:
    """The cat in the light of a lamp that it was not fitted to, and its picture [pixels].

    Args:
        direction: unit vector to the lamp.
        seen: the lamp's photograph [pixels], of which only the `chosen` pixels are looked at.
    """
    lamp = aimed_lamp(cat, name, direction, np.where(chosen, seen, 0), np.maximum(normals @ direction, 0))
    lit = make_scene(cat, np.linalg.norm(normals, axis=1), [lamp])
    lit = eqx.tree_at(lambda s: s.materials, lit, scene.materials)
    lit = fit_lamps(cat, lit, normals, {name: seen}, chosen)
    return lit, photographs_of(cat, lit, cat.samples(normals))[0]


def hold_out(
    cat: Cat, name: str, photographs: dict[str, np.ndarray], directions: dict[str, np.ndarray], every: int, rounds: int
) -> tuple[HeldOut, Figures]:
    """Fit all photographs but one, predict that one, by jaxlight and by Lambert's law alone."""
    chosen = np.random.default_rng(0).random(len(cat.position)) < 1 / every
    seen, direction = photographs[name], directions[name]
    others = {other: picture for other, picture in photographs.items() if other != name}
    pictures, to_lamps = np.stack(list(others.values())), np.stack([directions[other] for other in others])
    scene, normals = train(cat, others, to_lamps, chosen, rounds)
    lit, ours = predict(cat, scene, normals, name, direction, seen, chosen)
    unit = lambert_prediction(pictures, to_lamps, direction)
    fitted = lambert_prediction(pictures, strengths_of_lights(pictures, to_lamps)[:, None] * to_lamps, direction)
    predictions = {
        "Lambert, unit strengths": unit,
        "Lambert, unit, scaled": scaled(unit, seen, chosen),
        "Lambert, fitted strengths": scaled(fitted, seen, chosen),
        "jaxlight": ours,
    }
    wrong = {label: np.abs(picture - seen)[~chosen] for label, picture in predictions.items()}
    errors = {label: Errors(float(e.mean()), float(np.median(e))) for label, e in wrong.items()}
    off = angles(direction_seen(cat, normals, seen, chosen), direction)
    return HeldOut(scene, lit, predictions), Figures(errors, float(off))


def chrome_report(each: np.ndarray, directions: np.ndarray) -> str:
    """How the two spheres agree with each other and with the directions that come with the data."""
    given = np.loadtxt(DATA / "light_directions.txt").T
    first, second = (angles(sphere, given).mean() for sphere in each)
    return (
        "Lamps from the chrome spheres, mean angle in degrees to the directions that come with the data:\n"
        f"sphere 1 {first:.2f}, sphere 2 {second:.2f}, mean of both {angles(directions, given).mean():.2f}; "
        f"between the spheres {angles(*each).mean():.2f}\n"
    )


def error_table(figures: dict[int, Figures]) -> str:
    """A row a photograph held out, a column a method; and how well the photograph tells its lamp's direction."""
    methods = list(next(iter(figures.values())).errors)

    def row(head: str, errors: Iterable[Sequence[float]], off: float) -> list[str]:
        return [head, *(f"{mean:.4f} ({median:.4f})" for mean, median in errors), f"{off:.2f}"]

    rows = [row(str(number), each.errors.values(), each.direction) for number, each in figures.items()]
    if len(rows) > 1:
        means = [np.mean([each.errors[method] for each in figures.values()], axis=0) for method in methods]
        rows.append(row("mean", means, float(np.mean([each.direction for each in figures.values()]))))
    return "\n".join(
        [
            "Mean (median) absolute error of the held-out photograph, of a range of 1; degrees between its lamp",
            "as the photograph tells it (normals and albedo from the others) and as the chrome spheres do:",
            table(["held out", *methods, "direction"], rows),
        ]
    )


def save_prediction(path: Path, cat: Cat, number: int, seen: np.ndarray, predictions: dict[str, np.ndarray]) -> None:
    """The photograph and its predictions; below, their errors."""
    errors = {f"{label}: error": signed(cat.image(picture - seen), 0.1) for label, picture in predictions.items()}
    pictures = {label: cat.image(picture) for label, picture in predictions.items()}
    blank = {"errors: blue -0.1, red 0.1": np.ones(cat.mask.shape)}
    save_grid(path, [{f"photograph {number}": cat.image(seen), **pictures}, blank | errors])


def main(
    output: Path = Path("output/02_photographs"), held_out: tuple[int, ...] = (1,), rounds: int = 2, every: int = 20
) -> dict[int, Figures]:
    """Fit eleven photographs and predict the twelfth, for each that is held out; print and write the figures.

    Args:
        output: folder for what is written (scenes and picture: of the first photograph held out).
        held_out: numbers of the photographs to hold out in turn, 1 to 12.
        rounds: how often lamps and material, then normals and albedo, are solved.
        every: the lamps are fitted to one pixel in so many.
    """
    pictures = read_photographs(DATA)
    cat = Cat(object_mask(pictures))
    each = chrome_directions(DATA)
    mean = each.mean(axis=0) / np.linalg.norm(each.mean(axis=0), axis=1, keepdims=True)
    names = [f"lamp{number + 1:02d}" for number in range(len(pictures))]
    photographs = dict(zip(names, pictures[:, cat.mask], strict=True))
    directions = dict(zip(names, mean, strict=True))
    print(chrome_report(each, mean))
    output.mkdir(parents=True, exist_ok=True)
    figures = {}
    for number in held_out:
        name = names[number - 1]
        print(f"Photograph {number} held out")
        result, figures[number] = hold_out(cat, name, photographs, directions, every, rounds)
        if number == held_out[0]:
            save(result.scene, output / "cat.x3d")
            save(result.lit, output / "held_out.x3d")
            save_prediction(output / "prediction.png", cat, number, photographs[name], result.predictions)
    print("\n" + error_table(figures))
    (output / "report.txt").write_text(chrome_report(each, mean) + "\n" + error_table(figures) + "\n")
    return figures


if __name__ == "__main__":
    tyro.cli(main)
