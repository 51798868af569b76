"""The two forms in which culled lights are read hold the same lights, and a black one; only one has derivatives."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlight.lighting.culled_lights import CulledLights, LightPlanes, LightTable, culled_lights
from jaxlight.lighting.vectors import Vector
from jaxlight.lighting.world import WorldLights

LIGHTS = 7


def world_lights() -> WorldLights:
    """Spotlights, every number another one."""
    numbers = iter(np.random.default_rng(3).normal(size=(17, LIGHTS, 1, 1)).astype(np.float32))

    def plane() -> jax.Array:
        return jnp.asarray(next(numbers))

    def vector() -> Vector:
        return Vector(plane(), plane(), plane())

    return WorldLights(
        color=jnp.stack(list(vector())),
        intensity=plane(),
        ambient=None,
        towards=None,
        place=vector(),
        to_local=None,
        local_place=None,
        unit_length=plane(),
        attenuation=(plane(), plane(), plane()),
        radius=plane(),
        axis=vector(),
        beam_width=plane(),
        cut_off_angle=plane(),
    )


def equal(got: Any, expected: Any) -> None:
    jax.tree.map(np.testing.assert_array_equal, got, expected)


def rows_of(lights: WorldLights, rows: Any) -> WorldLights:
    return jax.tree.map(lambda plane: plane[..., rows, :, :], lights)


@pytest.mark.parametrize("form", ["planes", "table"])
def test_a_form_holds_the_lights_and_a_black_one(form: str) -> None:
    lights = world_lights()
    culled = culled_lights(lights)
    own = getattr(culled, form)
    assert own.count == culled.count == LIGHTS
    equal(own.lights(0, LIGHTS), lights)
    equal(own.lights(jnp.asarray(2), 3), rows_of(lights, slice(2, 5)))
    some = own.of(jnp.asarray([4, 2, LIGHTS]))
    assert some.count == 2
    equal(some.lights(0, 2), rows_of(lights, [4, 2]))
    np.testing.assert_array_equal(some.lights(jnp.asarray(2), 1).color, 0)


def test_both_forms_read_the_same_numbers() -> None:
    """The table in whole vectors, its columns in the order of the planes."""
    row = jnp.asarray([[0, 1], [1, 1], [1, 0]])
    culled = culled_lights(world_lights())
    some = CulledLights(*(form.of(jnp.asarray([5, 3, LIGHTS])) for form in (culled.planes, culled.table)))
    planes, table = some.planes.read(row), some.table.read(row)
    assert table.shape == (3, 2, 32)
    columns = jnp.concatenate([plane.reshape(-1, *row.shape) for plane in planes])
    equal(jnp.moveaxis(table, -1, 0)[: len(columns)], columns)
    np.testing.assert_array_equal(table[..., len(columns) :], 0)


def test_derivatives_are_those_of_planes() -> None:
    def total(form: str, lights: WorldLights) -> Any:
        own: LightPlanes | LightTable = getattr(culled_lights(lights), form)
        return sum(jnp.sum(jnp.sin(leaf)) for leaf in jax.tree.leaves(own.read(jnp.arange(LIGHTS))))

    lights = world_lights()
    equal(jax.grad(total, argnums=1)("table", lights), jax.tree.map(jnp.zeros_like, lights))
    slope = jax.grad(total, argnums=1)("planes", lights)
    jax.tree.map(lambda got, plane: np.testing.assert_allclose(got, jnp.cos(plane), rtol=1e-6), slope, lights)


def test_what_does_not_move_is_not_differentiated() -> None:
    """Of lights whose intensities move, no other number is picked once more."""
    lights, row = world_lights(), jnp.arange(LIGHTS)

    def total(intensity: jax.Array) -> Any:
        own = culled_lights(dataclasses.replace(lights, intensity=intensity)).planes
        return sum(jnp.sum(leaf) for leaf in own.read(row))

    change = jax.make_jaxpr(lambda plane: jax.jvp(total, (plane,), (plane,))[1])(lights.intensity)
    picks = [len(equation.outvars) for equation in change.eqns if equation.primitive.name == "picked"]
    assert sorted(picks) == [1, len(jax.tree.leaves(lights))]
