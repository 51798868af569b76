"""What recipe 02 needs before there is a scene: photographs, light directions from chrome spheres, normals.

Everything here is plain NumPy and Lambert's law. Axes as in the data: x right, y up, z to the viewer, who is far away.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

SHADOW = 0.08
"""Photographs darker than this show a shadow, attached or cast, and say nothing about the normal."""


def read_photographs(folder: Path) -> np.ndarray:
    """The photographs Objects/Image_*.png as [photographs, height, width] in [0, 1], linear, row 0 at the top."""
    files = sorted((folder / "Objects").glob("Image_*.png"))
    return np.stack([np.asarray(Image.open(file), float) / 255 for file in files])


def object_mask(photographs: np.ndarray) -> np.ndarray:
    """[height, width]: where the object is, since there most lights reach it."""
    return np.median(photographs, axis=0) > 0.1


def highlight(picture: np.ndarray, circle: np.ndarray) -> np.ndarray:
    """Where the lamp is mirrored: x right, y up, in radii from the sphere's centre.

    The highlight is the largest patch at (nearly) the picture's greatest value; the streaks around it are flare.

    Args:
        picture: [height, width], row 0 at the top.
        circle: centre x, centre y from the bottom row, radius; pixels.
    """
    x, y, radius = circle
    rows, columns = np.indices(picture.shape)
    right, up = (columns - x) / radius, (picture.shape[0] - 1 - rows - y) / radius
    inside = right**2 + up**2 < 0.9**2
    patches, _ = ndimage.label(inside & (picture >= 0.98 * picture[inside].max()))
    patch = patches == np.argmax(np.bincount(patches.ravel())[1:]) + 1
    return np.array([right[patch].mean(), up[patch].mean()])


def mirrored_direction(spot: np.ndarray) -> np.ndarray:
    """Unit vector to the lamp that a chrome sphere shows at `spot`: the view direction (0, 0, 1) mirrored there."""
    normal = np.append(spot, np.sqrt(1 - spot @ spot))
    return 2 * normal[2] * normal - [0.0, 0.0, 1.0]


def chrome_directions(folder: Path) -> np.ndarray:
    """Unit vectors to the lamps, [spheres, photographs, 3], from the photographs of the chrome spheres."""
    directions = []
    for sphere in sorted(folder.glob("LightProbe-*")):
        circle = np.loadtxt(sphere / "circle_data.txt")
        pictures = [np.asarray(Image.open(file).convert("L"), float) for file in sorted(sphere.glob("Image_*.JPG"))]
        directions.append([mirrored_direction(highlight(picture, circle)) for picture in pictures])
    return np.array(directions)


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles in degrees between the vectors [..., 3]."""
    cosine = np.sum(a * b, axis=-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def chrome_report(folder: Path, each: np.ndarray, directions: np.ndarray) -> str:
    """How the two spheres agree with each other and with the directions that come with the data."""
    given = np.loadtxt(folder / "light_directions.txt").T
    first, second = (angles(sphere, given).mean() for sphere in each)
    return (
        "Lamps from the chrome spheres, mean angle in degrees to the directions that come with the data:\n"
        f"sphere 1 {first:.2f}, sphere 2 {second:.2f}, mean of both {angles(directions, given).mean():.2f}; "
        f"between the spheres {angles(*each).mean():.2f}\n"
    )


def strengths_of_lights(photographs: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Relative strengths (mean 1) of lights of known direction, with no knowledge of the surface.

    Where all lights reach a Lambertian surface the photographs have rank 3, I = diag(s) L B. Their column space U then
    fulfils U A = diag(s) L for some A [3, 3]: linear and homogeneous in (A, s).

    Args:
        photographs: [photographs, pixels].
        directions: [photographs, 3], unit vectors to the lights.
    """
    count = len(directions)
    lit = np.all(photographs > SHADOW, axis=0)
    column_space = np.linalg.svd(photographs[:, lit], full_matrices=False)[0][:, :3]
    equations = np.zeros((count, 3, 9 + count))
    for axis in range(3):
        equations[:, axis, axis:9:3] = column_space
        equations[np.arange(count), axis, 9 + np.arange(count)] = -directions[:, axis]
    strengths = np.linalg.svd(equations.reshape(3 * count, -1))[2][-1, 9:]
    return strengths / strengths.mean()


def lambert_normals(photographs: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Normal times albedo of every pixel, [pixels, 3], by least squares over the photographs where it is lit.

    Args:
        photographs: [photographs, pixels].
        light: vector to the light times its strength, [photographs, 3], or [photographs, pixels, 3].
    """
    if light.ndim == 2:
        light = light[:, None, :] + np.zeros((1, photographs.shape[1], 1))
    light = light * (photographs > SHADOW)[..., None]
    square = np.einsum("kpi,kpj->pij", light, light) + 1e-9 * np.eye(3)
    return np.linalg.solve(square, np.einsum("kpi,kp->pi", light, photographs)[..., None])[..., 0]


def lambert_prediction(photographs: np.ndarray, light: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """What Lambert's law with a normal and an albedo per pixel says a lamp of strength 1 shows, [pixels].

    Args:
        photographs, light: as in `lambert_normals`.
        direction: unit vector to the lamp.
    """
    return np.maximum(lambert_normals(photographs, light) @ direction, 0)


def scaled(prediction: np.ndarray, photograph: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The prediction times the strength that fits the chosen pixels of the photograph best."""
    known = prediction[chosen]
    return prediction * (known @ photograph[chosen]) / (known @ known)


def falloff(photograph: np.ndarray, lambert: np.ndarray, position: np.ndarray) -> tuple[float, np.ndarray]:
    """The plane level (1 + slope . position) that Lambert's picture must be multiplied with to give the photograph.

    Args:
        photograph, lambert: [pixels].
        position: [pixels, 3].

    Returns:
        level and slope [3], the latter with no part along z.
    """
    lit = (photograph > SHADOW) & (lambert > SHADOW)
    plane = lambert[lit, None] * np.column_stack([np.ones(np.count_nonzero(lit)), position[lit, :2]])
    level, *slope = np.linalg.lstsq(plane, photograph[lit], rcond=None)[0]
    return level, np.append(slope, 0.0) / level
