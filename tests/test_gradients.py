"""Derivatives of every field in forward and reverse mode against central differences of the float64 oracle."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

from answers import Mode, by_path, groups, inputs, stacked
from oracle import equation
from oracle.case import Case, Fog, Light, Material, Options, Sample
from oracle.paths import Path, get, put

CASES = {
    "all kinds of light, uneven frames, exponential fog, a texture that scales a vertex colour": Case(
        sample=Sample(
            position=(0.25, -0.5, 0.125),
            normal=(0.25, 0.5, 1.5),
            eye=(0.5, 1.0, 6.0),
            color=(0.25, 0.75, 0.5),
            texel=(0.5, 0.75),
        ),
        material=Material(0.25, (0.75, 0.5, 0.25), (0.0625, 0.03125, 0.125), 0.125, (0.5, 0.625, 0.375), 0.25),
        lights=(
            Light(
                kind="point",
                ambient_intensity=0.5,
                attenuation=(0.5, 0.25, 0.0625),
                color=(1.0, 0.75, 0.5),
                intensity=0.75,
                location=(1.5, 1.0, 3.0),
                frame=((1.5, 0.25, 0.0, 0.5), (0.0, -0.75, 0.5, 0.25), (0.25, 0.0, 2.0, -0.5)),
            ),
            Light(
                kind="spot",
                ambient_intensity=0.125,
                attenuation=(0.75, 0.25, 0.125),
                beam_width=0.125,
                cut_off_angle=0.75,
                direction=(-0.75, -0.75, -1.0),
                location=(1.5, 1.0, 3.0),
            ),
            Light(kind="directional", ambient_intensity=0.25, color=(0.5, 1.0, 0.75), direction=(-1.0, 0.5, -2.0)),
        ),
        fog=Fog(color=(0.5, 0.625, 0.75), fog_type="EXPONENTIAL", visibility_range=12.0),
        options=Options(texture_mode="modulate"),
    ),
    "one point light, linear fog, a texture that replaces": Case(
        sample=Sample(
            position=(0.0, 0.5, -0.25), normal=(-0.5, 0.25, 1.0), eye=(1.0, 0.0, 5.0), texel=(0.5, 0.25, 0.75)
        ),
        material=Material(0.5, (0.5, 0.5, 0.5), (0.0, 0.125, 0.0), 0.0625, (0.5, 0.25, 0.125), 0.5),
        lights=(Light(kind="point", ambient_intensity=0.25, attenuation=(0.75, 0.0, 0.25), location=(0.5, 1.0, 2.0)),),
        fog=Fog(color=(0.25, 0.5, 0.5), fog_type="LINEAR", visibility_range=9.0),
    ),
    "unlit, fogged": Case(
        sample=Sample(position=(0.0, 0.5, -0.25), eye=(1.0, 0.0, 5.0), color=(0.25, 0.5, 0.75, 0.5), texel=(0.5,)),
        material=None,
        fog=Fog(color=(0.25, 0.5, 0.5), fog_type="LINEAR", visibility_range=9.0),
    ),
}
TOLERANCE = 1e-7


def central_difference(case: Case, path: Path) -> np.ndarray:
    """d rgba / d number at the path, [4]: two steps, extrapolated to order h^4."""

    def slope(h: float) -> np.ndarray:
        value = float(get(case, path))
        high, low = (
            np.array([*rgb, a]) for rgb, a in map(equation.shade, (put(case, path, value + s * h) for s in (1, -1)))
        )
        return (high - low) / (2 * h)

    h = 1e-4
    return (4 * slope(h / 2) - slope(h)) / 3


@pytest.mark.parametrize("mode", ["forward", "reverse"])
@pytest.mark.parametrize("name", CASES)
def test_every_field(name: str, mode: Mode) -> None:
    case = CASES[name]
    with jax.enable_x64(True):
        (group,) = groups([case])
        scene, samples = inputs(group, np.float64, chunk=1)
        (got,) = by_path(stacked(mode, scene, samples, group.plan), group, scene, mode)
    wanted = np.stack([central_difference(case, path) for path in group.paths])
    np.testing.assert_allclose(got, wanted, rtol=TOLERANCE, atol=TOLERANCE)
    # Every field but the radius matters, so that a derivative of 0 is no answer.
    dead = [path for path, row in zip(group.paths, wanted, strict=True) if not np.any(np.abs(row) > 1e-6)]
    assert {path[-1] for path in dead if isinstance(path[-1], str)} <= {"radius", "transparency"}
    assert len(group.paths) > (60 if case.lights[1:] else 5)


def test_a_wrong_derivative_is_found() -> None:
    """The comparison is sharp: one part in a hundred thousand of one field is seen."""
    case = CASES["one point light, linear fog, a texture that replaces"]
    path: Path = ("material", "shininess")
    moved = dataclasses.replace(case, material=dataclasses.replace(case.material, shininess=0.0625 * (1 + 1e-5)))
    right, wrong = central_difference(case, path), central_difference(moved, path)
    assert not np.allclose(right, wrong, rtol=TOLERANCE, atol=TOLERANCE)
