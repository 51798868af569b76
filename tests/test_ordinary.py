"""Ordinary tiles: what is taken for one is one, and both forms of the equation give the same there."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import precision
from jaxlight import Scene, nodes
from jaxlight.lighting import make_plan, ordinary, prepared, shade, tile_inputs
from jaxlight.lighting.vectors import Vector
from jaxlight.lighting.world import WorldLights, lights_in_world
from jaxlight.raster import SampleBuffer
from leaves import assert_leaves_close

BOXES = 400


def world_lights(kind: str, where: np.ndarray) -> WorldLights:
    """Point lights at, or directional lights towards, these places [lights, 3]."""
    make = {
        "point": lambda place: nodes.PointLight(location=place),
        "directional": lambda place: nodes.DirectionalLight(direction=-place),
    }[kind]
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()))
    scene = Scene.from_nodes([shape, *map(make, where)], dtype=np.float64)
    lights, plan = getattr(scene, kind), getattr(make_plan(scene), kind)
    return lights_in_world(lights, plan, jnp.dtype("float64"), None)


def vector(rows: np.ndarray) -> Vector:
    return Vector(*jnp.asarray(rows.T))


@pytest.mark.parametrize("kind", ["point", "directional"])
def test_from_ordinary_tiles_lights_and_viewer_are_less_than_120_degrees_apart(kind: str) -> None:
    """All samples of them; and small tiles under lights much less apart are ordinary."""
    random = np.random.default_rng(11)
    with precision("float64"):
        where, viewer = random.normal(size=(12, 3)), np.array([0.5, -0.3, 1.5])
        low = random.normal(size=(BOXES, 3))
        high = low + random.uniform(size=(BOXES, 3)) * 10.0 ** random.uniform(-3, 0.5, (BOXES, 1))
        lights = world_lights(kind, where)
        found = np.asarray(ordinary.ordinary_lights(lights, vector(viewer[None]), vector(low), vector(high)))
        inside = low + random.uniform(size=(200, BOXES, 3)) * (high - low)
        to_viewer = viewer - inside
        to_light = where[:, None, None] - (inside if kind == "point" else 0)
        cosine = np.sum(to_viewer * to_light, axis=-1)
        cosine = cosine / (np.linalg.norm(to_viewer, axis=-1) * np.linalg.norm(to_light, axis=-1))
        least = cosine.min(axis=1)
        assert np.all(least[found] > -0.5)
        small = np.max(high - low, axis=1) < 0.02
        assert np.all(found[:, small][least[:, small] > 0])
        assert 0.2 < np.mean(found) < 0.95


def test_where_lights_are_seen_from_may_not_matter() -> None:
    """Without highlights only distances do."""
    with precision("float64"):
        lights = world_lights("point", np.array([[0, 0, -1.0], [0, 0, 1e-200], [0, 0, 1e200]]))
        low, high = vector(np.full((1, 3), -1e-210)), vector(np.full((1, 3), 1e-210))
        found = ordinary.ordinary_lights(lights, None, low, high)
        np.testing.assert_array_equal(found[:, 0], [True, False, False])


def lit_sheet(dtype: Any, kind: str) -> tuple[Scene, SampleBuffer]:
    """Lights of all kinds on the viewer's side."""
    random = np.random.default_rng(3)
    body = nodes.Material(specular_color=(0.5, 0.4, 0.3), shininess=0.2, ambient_intensity=0.3)
    own: list[Any] = [
        nodes.PointLight(location=(1.5, -1, 2), attenuation=(1, 0.1, 0.2), radius=9),
        nodes.SpotLight(location=(-1, 1, 2), direction=(1, -1, -2), beam_width=0.3, cut_off_angle=0.9),
        nodes.DirectionalLight(direction=(0.3, 0.4, -1)),
    ]
    if kind == "culled":
        own = [nodes.PointLight(location=(*random.uniform(-1, 1, 2), 0.4), radius=0.5) for _ in range(60)]
    position = np.concatenate([random.uniform(-1, 1, (600, 2)), np.zeros((600, 1))], axis=1)
    normal = random.normal(size=(600, 3)) * 0.2 + [0, 0, 1]
    shape = nodes.Shape(appearance=nodes.Appearance(material=body))
    scene = Scene.from_nodes([shape, *own, nodes.Fog(visibility_range=40)], dtype=dtype)
    return scene, SampleBuffer.create(position, normal, [0.2, 0.1, 5], tile=64, dtype=dtype, by_place=True)


def slopes_and_colors(scene: Scene, samples: SampleBuffer) -> tuple[Any, jax.Array]:
    """The derivatives of a function of all colours, by the fields and by the samples."""
    plan = make_plan(scene, samples, free=True)
    floats, rest = eqx.partition((dataclasses.replace(scene, document=None), samples), eqx.is_inexact_array)

    def total(floats: Any) -> tuple[jax.Array, jax.Array]:
        colors = shade(*eqx.combine(floats, rest), plan=plan)
        return jnp.sum(jnp.sin(3 * colors)), colors

    return jax.jit(jax.grad(total, has_aux=True))(floats)


@pytest.mark.parametrize(
    ("kind", "bits"), [("all kinds", "float32"), pytest.param("culled", "float64", marks=pytest.mark.thorough)]
)
def test_ordinary_tiles_have_the_colors_and_derivatives_of_the_form_with_care(
    kind: str, bits: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with precision(bits) as dtype:
        scene, samples = lit_sheet(dtype, kind)
        plan = make_plan(scene, samples)
        assert np.all(prepared.prepare(scene, samples, plan).ordinary)
        assert plan.culled == (kind == "culled")
        short_slopes, short = slopes_and_colors(scene, samples)
        monkeypatch.setattr(tile_inputs, "for_all_mapped", jnp.zeros_like)
        jax.clear_caches()
        careful_slopes, careful = slopes_and_colors(scene, samples)
        jax.clear_caches()
        np.testing.assert_array_max_ulp(np.asarray(short), np.asarray(careful), 4)
        pairs = zip(jax.tree.leaves(short_slopes), jax.tree.leaves(careful_slopes), strict=True)
        assert any(not np.array_equal(*pair) for pair in pairs)  # the forms differ
        assert_leaves_close(short_slopes, careful_slopes, 300 * float(jnp.finfo(dtype).eps), least=0.0)


def test_mapped_over_one_light_opposite_the_viewer_has_all_evaluated_with_care() -> None:
    """The same picture as of each alone; tiles that are not ordinary are so for a light behind the sheet."""
    scene, samples = lit_sheet(np.float32, "all kinds")
    assert scene.point is not None
    places = jnp.asarray([[[1.5, -1, 2]], [[0.1, 0, -3]]], scene.point.location.dtype)
    plan = make_plan(scene, samples, free=True)
    scene = dataclasses.replace(scene, document=None)

    def moved(place: jax.Array) -> Scene:
        return eqx.tree_at(lambda scene: scene.point.location, scene, place)

    behind = prepared.prepare(moved(places[1]), samples, plan).ordinary
    assert not np.any(behind)
    mapped = jax.jit(jax.vmap(lambda place: shade(moved(place), samples, plan=plan)))(places)
    for image, place in zip(mapped, places, strict=True):
        np.testing.assert_allclose(image, shade(moved(place), samples, plan=plan), atol=1e-6)
