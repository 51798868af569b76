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

import photometric_stereo as stereo
from jaxlight import Free, Scene, View, fit, save
from photographed_scene import (
    NOISE,
    Cat,
    aim_limits,
    aimed_lamp,
    direction_seen,
    lights_at,
    make_scene,
    matt,
    photographs_of,
)
from pictures import save_grid, signed, table

DATA = Path(__file__).parent / "data" / "psbox_cat"
MEAN_ALBEDO = 0.5
"""Photographs show albedo times strength only; this splits them."""


class Errors(NamedTuple):
    """Mean and median absolute error of a prediction of the held-out photograph, in the photograph's range [0, 1]."""

    mean: float
    median: float


class HeldOut(NamedTuple):
    """What came of holding one photograph out."""

    scene: Scene
    """Fitted to the other photographs."""
    lit: Scene
    """The same cat in the light of the held-out lamp."""
    predictions: dict[str, np.ndarray]
    """Pictures of the held-out photograph [pixels], by method."""
    errors: dict[str, Errors]
    direction: float
    """Angle in degrees between the lamp's direction as the photograph tells it and as the chrome spheres do."""


def fit_lamps(
    cat: Cat,
    scene: Scene,
    normals: np.ndarray,
    photographs: dict[str, np.ndarray],
    chosen: np.ndarray,
    *extra: Any,
    tolerance: float = 1e-3,
) -> Scene:
    """The scene with the strength and aim of the named lamps, and the `extra` fields, fitted to the chosen pixels."""
    samples = cat.samples(normals, chosen)
    views = [
        View(
            samples,
            cat.image(photograph),
            mask=cat.image(photograph > stereo.SHADOW),
            noise=NOISE,
            lights=[f"SpotLight[{lamp}]"],
            name=lamp,
        )
        for lamp, photograph in photographs.items()
    ]
    strengths = [f"SpotLight[{lamp}].intensity" for lamp in photographs]
    # A lamp whose beam hardly falls off does not tell its aim: the prior does.
    aims = [
        Free(
            [f"SpotLight[{lamp}].direction.{axis}" for axis in "xy"],
            lower=-limit,
            upper=limit,
            mean=0,
            deviation=limit / 2,
        )
        for lamp, limit in aim_limits(scene).items()
        if lamp in photographs
    ]
    # Cast shadows and light from surface to surface are outside the model: large residuals count less.
    found = fit(
        scene,
        views,
        [*strengths, *aims, *extra],
        loss="huber",
        loss_scale=2.0,
        rtol=tolerance,
        atol=tolerance,
        max_steps=200,
    )
    print(f"  {len(views)} photograph{'s' * (len(views) > 1)}, {len(found.values)} numbers: {found.message}")
    return found.scene


def train(
    cat: Cat, photographs: dict[str, np.ndarray], directions: np.ndarray, chosen: np.ndarray, rounds: int
) -> tuple[Scene, np.ndarray]:
    """The scene fitted to the training photographs, and normal times albedo [pixels, 3]."""
    names, pictures = list(photographs), np.stack(list(photographs.values()))
    strengths = stereo.strengths_of_lights(pictures, directions)
    normals = stereo.lambert_normals(pictures, strengths[:, None] * directions)
    normals *= MEAN_ALBEDO / np.linalg.norm(normals, axis=1).mean()
    lamps = [
        aimed_lamp(cat, name, direction, picture, np.maximum(normals @ direction, 0))
        for name, direction, picture in zip(names, directions, pictures, strict=True)
    ]
    scene = make_scene(cat, np.linalg.norm(normals, axis=1), lamps)
    gloss = Free("Material[plaster].shininess", mean=0.2, deviation=0.2)  # without a highlight nothing else tells it
    for left in reversed(range(rounds)):
        free = ("Material[plaster].specular_color", gloss)
        scene = fit_lamps(cat, scene, normals, photographs, chosen, *free, tolerance=1e-2 if left else 1e-3)
        samples = cat.samples(normals)
        highlights = photographs_of(cat, scene, samples) - photographs_of(cat, matt(scene), samples)
        normals = stereo.lambert_normals(pictures - highlights, lights_at(cat, scene))
        texture = cat.texture(np.linalg.norm(normals, axis=1))
        scene = eqx.tree_at(lambda s: s.textures[0].image, scene, texture.astype(scene.textures[0].image.dtype))
    return scene, normals


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
) -> HeldOut:
    """Fit all photographs but one, predict that one, by jaxlight and by Lambert's law alone."""
    chosen = np.random.default_rng(0).random(len(cat.position)) < 1 / every
    seen, direction = photographs[name], directions[name]
    others = {other: picture for other, picture in photographs.items() if other != name}
    pictures, to_lamps = np.stack(list(others.values())), np.stack([directions[other] for other in others])
    scene, normals = train(cat, others, to_lamps, chosen, rounds)
    lit, ours = predict(cat, scene, normals, name, direction, seen, chosen)
    unit = stereo.lambert_prediction(pictures, to_lamps, direction)
    strengths = stereo.strengths_of_lights(pictures, to_lamps)
    fitted = stereo.lambert_prediction(pictures, strengths[:, None] * to_lamps, direction)
    predictions = {
        "Lambert, unit strengths": unit,
        "Lambert, unit, scaled": stereo.scaled(unit, seen, chosen),
        "Lambert, fitted strengths": stereo.scaled(fitted, seen, chosen),
        "jaxlight": ours,
    }
    wrong = {label: np.abs(picture - seen)[~chosen] for label, picture in predictions.items()}
    errors = {label: Errors(float(e.mean()), float(np.median(e))) for label, e in wrong.items()}
    off = stereo.angles(direction_seen(cat, normals, seen, chosen), direction)
    return HeldOut(scene, lit, predictions, errors, float(off))


def error_table(found: dict[int, HeldOut]) -> str:
    """A row a photograph held out, a column a method; and how well the photograph tells its lamp's direction."""
    methods = list(next(iter(found.values())).errors)

    def row(head: str, errors: Iterable[Sequence[float]], off: float) -> list[str]:
        return [head, *(f"{mean:.4f} ({median:.4f})" for mean, median in errors), f"{off:.2f}"]

    rows = [row(str(number), each.errors.values(), each.direction) for number, each in found.items()]
    if len(rows) > 1:
        directions = [each.direction for each in found.values()]
        for head, middle in (("mean", np.mean), ("median", np.median)):
            errors = [middle([each.errors[method] for each in found.values()], axis=0) for method in methods]
            rows.append(row(head, errors, float(middle(directions))))
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
    output: Path = Path("output/02_photographs"),
    held_out: tuple[int, ...] = (1,),
    rounds: int = 2,
    every: int = 20,
    all: bool = False,
) -> dict[int, HeldOut]:
    """Fit eleven photographs and predict the twelfth, for each that is held out; print and write the figures.

    Args:
        output: folder for what is written (scenes and picture: of the first photograph held out).
        held_out: numbers of the photographs to hold out in turn, 1 to 12.
        rounds: how often lamps and material, then normals and albedo, are solved.
        every: the lamps are fitted to one pixel in so many.
        all: hold out each of the twelve in turn.
    """
    held_out = tuple(range(1, 13)) if all else held_out
    pictures = stereo.read_photographs(DATA)
    cat = Cat(stereo.object_mask(pictures))
    each = stereo.chrome_directions(DATA)
    mean = each.mean(axis=0) / np.linalg.norm(each.mean(axis=0), axis=1, keepdims=True)
    if not set(held_out) <= set(range(1, len(pictures) + 1)):
        raise ValueError(f"held_out: expected numbers from 1 to {len(pictures)}, got {held_out}")
    names = [f"lamp{number + 1:02d}" for number in range(len(pictures))]
    photographs = dict(zip(names, pictures[:, cat.mask], strict=True))
    directions = dict(zip(names, mean, strict=True))
    print(stereo.chrome_report(DATA, each, mean))
    output.mkdir(parents=True, exist_ok=True)
    found = {}
    for number in held_out:
        name = names[number - 1]
        print(f"Photograph {number} held out")
        found[number] = hold_out(cat, name, photographs, directions, every, rounds)
        if number == held_out[0]:
            save(found[number].scene, output / "cat.x3d")
            save(found[number].lit, output / "held_out.x3d")
            save_prediction(output / "prediction.png", cat, number, photographs[name], found[number].predictions)
    print("\n" + error_table(found))
    (output / "report.txt").write_text(stereo.chrome_report(DATA, each, mean) + "\n" + error_table(found) + "\n")
    return found


if __name__ == "__main__":
    tyro.cli(main)
