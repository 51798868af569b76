"""Nodes made in Python: what a field does not take is refused; node, field, what came and what is allowed are named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jaxlight import Scene, nodes

IMAGE = r"expected an image of shape \[height, width, 1 to 4\] with values in \[0, 1\]"
INDICES = "expected a flat list of integers >= -1"
BLUES = [(0, 0, 1), (0, 0, 0.5), (0, 0, 0)]
POINTS = r"expected finite numbers of shape \[n, 3\]"


@pytest.mark.parametrize(("children", "came"), [(None, "None"), (3, "3"), ("a.x3d", "'a.x3d'")])
def test_a_scene_is_made_of_nodes(children: Any, came: str) -> None:
    with pytest.raises(ValueError, match=f"Scene.from_nodes: expected a node or a list of nodes, got {came}"):
        Scene.from_nodes(children)


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (nodes.PixelTexture, {"image": "abc"}, rf"{IMAGE}, got 'abc'"),
        (nodes.PixelTexture, {"image": [[[1], [1, 1]]]}, rf"{IMAGE}, got \[\[\[1\], \[1, 1\]\]\]"),
        (nodes.PixelTexture, {"image": [[1]]}, rf"{IMAGE}, got an array of shape \[1, 1\]"),
        (nodes.IndexedFaceSet, {"coord_index": [[0, 1, 2], [0, 1]]}, rf"{INDICES}, got \[\[0, 1, 2\]"),
        (nodes.IndexedFaceSet, {"coord_index": "abc"}, f"{INDICES}, got 'abc'"),
        (nodes.IndexedFaceSet, {"coord_index": [[0, 1, 2]]}, rf"{INDICES}, got \[\[0 1 2\]\]"),
        (nodes.Coordinate, {"point": [[0, 0, 0], [0, np.nan, 0]]}, rf"{POINTS}, got \[ ?0. nan  ?0.\] in row 1"),
        (nodes.Coordinate, {"point": [[0, 0]]}, rf"{POINTS}, got an array of shape \[1, 2\]"),
        (nodes.Coordinate, {"point": [[0, 0, 0], [1]]}, rf"{POINTS}, got \[\[0, 0, 0\], \[1\]\]"),
        (
            nodes.Color,
            {"color": [[0, 0, np.inf]]},
            r"colours of shape \[n, 3\] in \[0, 1\], got \[ ?0.  0. inf\] in row 0",
        ),
        (nodes.Background, {"sky_angle": (), "sky_color": BLUES[:2]}, "expected 1 angle, one for .*, got 0"),
        (nodes.Background, {"sky_angle": (1, 2), "sky_color": BLUES[:2]}, "expected 1 angle, one for .*, got 2"),
        (nodes.Background, {"sky_angle": (1,)}, "expected 0 angles, one for each colour after the first, got 1"),
        (nodes.Background, {"sky_angle": (1,), "sky_color": []}, "expected 0 angles, one for .*, got 1"),
        (nodes.Background, {"sky_angle": (2, 1), "sky_color": BLUES}, r"angles .* not decrease, got \(2, 1\)"),
        (nodes.Background, {"sky_angle": -1, "sky_color": BLUES[:2]}, "expected a finite number >= 0, got -1"),
        (nodes.Coordinate, {"point": np.full((1, 3), 1j)}, rf"{POINTS}, got array\(\[\["),
        (nodes.PixelTexture, {"image": np.full((1, 1, 3), 1j)}, rf"{IMAGE}, got array\(\[\[\["),
        (nodes.Material, {"diffuse_color": np.full(3, 1j)}, r"expected 3 numbers in \[0, 1\], got array"),
        (nodes.Material, {"shininess": np.array(1j)}, r"expected a finite number >= 0 and <= 1, got array"),
        (nodes.Sphere, {"radius": 10**400}, "expected a finite number > 0, got 10000"),
        (nodes.Background, {"sky_angle": None}, "expected numbers >= 0, got None"),
        (
            nodes.IndexedFaceSet,
            {"coord_index": np.array([0, 1, 2, 2**64 - 1], np.uint64)},
            rf"{INDICES} and below 9223372036854775808, got \[ +0 ",
        ),
        (
            nodes.Fog,
            {"fog_type": np.array(["LINEAR", "x"])},
            r"expected 'LINEAR' or 'EXPONENTIAL', got \['LINEAR' 'x'\]",
        ),
        (nodes.ImageTexture, {"url": 3}, "expected a string or a list of them, got 3"),
        (nodes.ImageTexture, {"url": ["a.png", 3]}, "expected a string, got 3"),
    ],
)
def test_errors_say_what_is_wrong(kind: Any, values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        kind(name="a", **values)
    assert str(caught.value).startswith(f"{kind.__name__}[a].{next(iter(values))}: ")


@pytest.mark.parametrize(("colors", "angles"), [([], ()), (BLUES[:1], ()), (BLUES[:2], 1.0), (BLUES, [1, 1])])
def test_a_sky_has_an_angle_for_each_colour_after_the_first(colors: Any, angles: Any) -> None:
    assert nodes.Background(sky_color=colors, sky_angle=angles).sky_angle == tuple(np.atleast_1d(angles))
