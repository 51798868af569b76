"""Known numbers become arrays without a program that converts or stacks them, to be compiled first."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight import SampleBuffer, Scene, View, nodes
from jaxlight.arrays import array_of
from jaxlight.fit.problem import make_problem


@pytest.fixture
def compiled() -> list[Any]:
    """The programs that convert or stack which are compiled from here on."""
    names: list[Any] = []

    def listen(event: str, *_: Any, **how: Any) -> None:
        name = str(how.get("fun_name"))
        if "backend_compile" in event and ("convert_element_type" in name or "stack" in name):
            names.append(name)

    jax.monitoring.register_event_duration_secs_listener(listen)
    return names


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.bfloat16, jnp.int32])
def test_numbers_are_rounded_as_by_jax_but_nothing_is_compiled(compiled: list[Any], dtype: Any) -> None:
    values = np.random.default_rng(5).uniform(-100, 100, (7, 31))
    found = array_of(values, dtype)
    assert not compiled
    expected = jnp.asarray(values, dtype)
    assert compiled  # what is listened to is heard
    assert found.dtype == dtype and np.array_equal(found, expected)


def test_what_is_too_large_is_infinite_without_a_warning() -> None:
    assert np.array_equal(array_of([1e300, -1e300], jnp.float32), [np.inf, -np.inf])


def test_nor_for_scene_samples_and_views(compiled: list[Any]) -> None:
    """Of shapes that no other test has."""
    lamps = [nodes.PointLight(location=(x, 0, 4)) for x in np.linspace(-1, 1, 13)]
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()), geometry=nodes.Sphere())
    scene = Scene.from_nodes([shape, *lamps])
    points = np.random.default_rng(3).normal(size=(713, 3))
    samples = SampleBuffer.create(points, points, [0, 0, 6])
    problem, _ = make_problem(scene, View(samples, np.full((713, 3), 0.5)), ["PointLight[*].intensity"])
    assert problem.parameters.few == 13
    assert not compiled
    jnp.stack([jnp.ones((713, 17))])
    assert compiled  # what is listened to is heard
