"""Many lights: tiles that compute only the lights that reach them give what all lights give."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from colored_bodies import colored_bodies
from fit_scenes import precision
from jaxlight import Scene, nodes, processor
from jaxlight.lighting import culling, make_plan, shade
from jaxlight.lighting.plan import LightPlan
from jaxlight.lighting.vectors import Vector
from jaxlight.lighting.world import lights_in_world
from jaxlight.raster import SampleBuffer, rasterize
from jaxlight.raster.samples import MANY_LIGHTS
from jaxlight.raster.tile_layout import CLUSTER
from leaves import assert_leaves_close

LIGHTS = 300


def lights(kind: str, random: np.random.Generator, radius: float) -> list[Any]:
    common = [
        {
            "ambient_intensity": 0.2,
            "attenuation": (0.5, 0.2, 0.1),
            "color": random.uniform(0.2, 1, 3),
            "location": (*random.uniform(-2, 2, 2), 0.4),
            "radius": radius,
        }
        for _ in range(LIGHTS)
    ]
    if kind == "point":
        return [nodes.PointLight(**fields) for fields in common]
    return [
        nodes.SpotLight(**fields, direction=random.normal(size=3), beam_width=0.2, cut_off_angle=0.7)
        for fields in common
    ]


def many_lights(
    kind: str, radius: float, *, moved: bool = False, dtype: Any = np.float32
) -> tuple[Scene, SampleBuffer]:
    """A bumpy sheet of 64 x 64 samples, stored by place, under small lights."""
    random = np.random.default_rng(5)
    x, y = np.meshgrid(np.linspace(-2, 2, 64), np.linspace(-2, 2, 64))
    position = np.stack([x.ravel(), y.ravel(), 0.2 * np.sin(3 * x.ravel())], axis=1)
    normal = np.stack([-0.6 * np.cos(3 * x.ravel()), 0 * x.ravel(), np.ones(x.size)], axis=1)
    body = nodes.Material(specular_color=(0.4, 0.5, 0.6), shininess=0.1)
    shape = nodes.Shape(appearance=nodes.Appearance(material=body))
    own: Any = lights(kind, random, radius)
    if moved:
        own = [nodes.Transform(translation=(0.5, 0, 0), scale=(0.5, 0.5, 0.5), children=own)]
    return Scene.from_nodes([shape, *own], dtype=dtype), SampleBuffer.create(
        position, normal, [0.3, 0.2, 6], tile=128, by_place=True, dtype=dtype
    )


def plans(scene: Scene, samples: SampleBuffer) -> tuple[Any, Any]:
    """What would be done, which is to cull point lights and spots, and the same without culling."""
    plan = brute = make_plan(scene, samples, free=True)
    for kind in ("point", "spot"):
        own = getattr(plan, kind)
        if own is not None:
            assert own.culled
            brute = brute._replace(**{kind: own._replace(culled=False)})
    return plan, brute


@pytest.mark.parametrize(
    ("kind", "radius", "moved", "by_samples", "bits", "tolerance"),
    [("point", 0.6, True, True, "float32", 2e-5), ("spot", 100.0, False, False, "float64", 1e-13)],
)
def test_culling_changes_no_value_and_no_derivative(
    kind: str, radius: float, moved: bool, by_samples: bool, bits: str, tolerance: float
) -> None:
    """By the samples' places neither: lists are drawn by them, which has no derivative; what the lights send has."""
    with precision(bits) as dtype:
        scene, samples = many_lights(kind, radius, moved=moved, dtype=dtype)
        scene = dataclasses.replace(scene, document=None)
        culled, brute = plans(scene, samples)
        weights = jnp.asarray(np.random.default_rng(1).normal(size=(samples.count, 4)), dtype)

        def total(scene: Scene, planes: jax.Array, plan: Any) -> tuple[jax.Array, jax.Array]:
            colors = shade(scene, dataclasses.replace(samples, position_planes=planes), plan=plan)
            return jnp.sum(weights * colors), colors

        slope = jax.jit(jax.grad(total, (0, 1) if by_samples else 0, has_aux=True), static_argnums=2)
        found, wanted = (slope(scene, samples.position_planes, plan) for plan in (culled, brute))
        assert_leaves_close(found, wanted, tolerance)


@pytest.mark.parametrize(
    ("unit", "origin", "place", "direction", "beam", "other"),
    [
        (1e19, 0.0, (6.0, 0.0, 20.0), (0.0, 0.0, -1.0), 0.5, (0.0, 0.0, 0.1)),
        (0.0625, 1e6 + 0.0625, (7.0, -7.0, 0.0), (-1.0, 1.0, 0.0), 0.02, (-1.0, -1.0, -1.0)),
        (1e-19, 0.0, (1.0, -1.0, 0.0), (-1.0, 1.0, 0.0), 0.15, (-2.0, -2.0, 0.0)),
    ],
    ids=["far", "large frame", "tiny"],
)
def test_no_cone_is_missed_for_want_of_range_or_digits(
    unit: float, origin: float, place: tuple, direction: tuple, beam: float, other: tuple
) -> None:
    """Of two samples the one at the origin lies within every cone."""
    at = np.array(place) * unit
    spots = [
        nodes.SpotLight(
            location=at + origin,
            direction=direction,
            beam_width=0.9 * beam,
            cut_off_angle=beam,
            radius=1e30,
            intensity=0.02,
        )
        for _ in range(MANY_LIGHTS)
    ]
    shape = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material(specular_color=(0, 0, 0))))
    scene = Scene.from_nodes([shape, *spots], dtype=np.float32)
    position = np.array([other, (0, 0, 0)]) * unit + origin
    buffer = SampleBuffer.create(position, [at] * 2, position[0] + 3 * unit, dtype=np.float32)
    culled, brute = plans(dataclasses.replace(scene, document=None), buffer)
    got, wanted = (shade(scene, buffer, plan=plan) for plan in (culled, brute))
    np.testing.assert_allclose(got, wanted, atol=1e-5)
    assert np.all(wanted[1, :3] > 0.3)


@pytest.mark.thorough
def test_more_lights_than_a_tile_collects_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are worked through in batches: the same picture, the same derivatives."""
    scene, samples = many_lights("point", 1.0)
    scene = dataclasses.replace(scene, document=None)
    culled, brute = plans(scene, samples)
    assert reaching(scene, samples, 1.0).max() > 2 * culling.WORD

    def total(scene: Scene, plan: Any) -> tuple[jax.Array, jax.Array]:
        colors = shade(scene, samples, plan=plan)
        return jnp.sum(jnp.sin(3 * colors)), colors

    slope = jax.jit(jax.grad(total, has_aux=True), static_argnums=1)
    wanted = slope(scene, brute)
    monkeypatch.setattr(culling, "BATCH", culling.WORD)
    jax.clear_caches()
    got = slope(scene, culled)
    assert_leaves_close(got, wanted, 2e-5)
    jax.clear_caches()


@pytest.fixture
def few_at_once(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """So few clusters side by side that small tiles have to put theirs into an order."""
    monkeypatch.setattr(processor, "CPU", processor.CPU._replace(clusters=8, derived_clusters=8))
    jax.clear_caches()
    yield
    jax.clear_caches()


def test_clusters_are_shaded_in_any_order(few_at_once: None) -> None:
    """In the order of how many lights reach them, and all that belongs to a sample goes with it."""
    scene, samples = colored_bodies(points=40, spots=0)
    culled, brute = plans(scene, samples)
    weights = jnp.asarray(np.random.default_rng(1).normal(size=(samples.count, 4)), np.float32)

    def total(moving: tuple[jax.Array, jax.Array], plan: Any) -> tuple[jax.Array, jax.Array]:
        position, color = moving
        colors = shade(scene, samples.with_rows(position=position, color=color), plan=plan)
        return jnp.sum(weights * colors), colors

    assert samples.color is not None
    slope = jax.jit(jax.grad(total, has_aux=True), static_argnums=1)
    (found, got), (expected, wanted) = (slope((samples.position, samples.color), plan) for plan in (culled, brute))
    assert np.std(wanted[:, 3]) > 0.05
    np.testing.assert_allclose(got, wanted, atol=2e-5)
    assert_leaves_close(found, expected, 3e-5)


@pytest.mark.thorough
def test_clusters_are_ordered_by_lights_of_both_kinds(few_at_once: None) -> None:
    scene, samples = colored_bodies(points=40, textures=False)
    culled, brute = plans(scene, samples)
    assert culled.point is not None and culled.spot is not None
    np.testing.assert_allclose(shade(scene, samples, plan=culled), shade(scene, samples, plan=brute), atol=2e-5)


def test_tiles_smaller_than_a_cluster() -> None:
    scene, samples = many_lights("point", 0.3)
    scene = dataclasses.replace(scene, document=None)
    samples = SampleBuffer.create(samples.position[:40], samples.normal[:40], samples.eye, tile=4)
    culled, brute = plans(scene, samples)
    slope = jax.jit(jax.grad(lambda scene, plan: jnp.sum(shade(scene, samples, plan=plan) ** 2)), static_argnums=1)
    assert_leaves_close(slope(scene, culled), slope(scene, brute), 2e-5)


def test_lists_are_short_whatever_the_order_of_the_samples(few_at_once: None) -> None:
    """A buffer of rows of pixels, none stored by place: each cluster is a piece of a row."""
    scene, by_place = many_lights("point", 0.3)
    by_row = SampleBuffer.create(by_place.position, by_place.normal, by_place.eye, tile=512)
    plan, brute = plans(scene, by_row)
    np.testing.assert_allclose(shade(scene, by_row, plan=plan), shade(scene, by_row, plan=brute), atol=2e-5)
    assert scene.point is not None
    places = np.asarray(scene.point.location)

    def mean_length(samples: SampleBuffer) -> float:
        low, high = np.asarray(samples.cluster_low).T[:, None], np.asarray(samples.cluster_high).T[:, None]
        outside = np.maximum(0, np.maximum(low - places, places - high))
        return float(np.mean(np.sum(np.linalg.norm(outside, axis=2) <= 0.3, axis=1)))

    assert mean_length(by_row) < 2.5 * mean_length(by_place)


def test_lights_out_of_scope_are_in_no_list() -> None:
    """Two bodies side by side, each with lights of its own."""
    random = np.random.default_rng(6)
    bodies = [
        nodes.Transform(
            translation=(2.5 * side, 0, 0),
            children=[
                nodes.Shape(
                    appearance=nodes.Appearance(material=nodes.Material(specular_color=(0.3, 0.2, 0.1))),
                    geometry=nodes.Sphere(),
                ),
                *[
                    nodes.PointLight(
                        location=random.uniform(-2, 2, 3), radius=1.5, color=random.uniform(size=3), global_=False
                    )
                    for _ in range(40)
                ],
            ],
        )
        for side in (-1, 1)
    ]
    scene = Scene.from_nodes(bodies)
    samples = rasterize(scene, width=96, height=48)
    plan, brute = plans(scene, samples)
    assert plan.point.scoped
    np.testing.assert_allclose(shade(scene, samples, plan=plan), shade(scene, samples, plan=brute), atol=2e-5)


def reaching(scene: Scene, samples: SampleBuffer, radius: float) -> np.ndarray:
    """How many lights reach each tile."""
    assert scene.point is not None
    places, low, high = np.asarray(scene.point.location), np.asarray(samples.tile_low), np.asarray(samples.tile_high)
    outside = np.maximum(0, np.maximum(low.T[:, None] - places, places - high.T[:, None]))
    return np.sum(np.linalg.norm(outside, axis=2) <= radius, axis=1)


def test_a_plan_made_outside_is_right_for_other_numbers() -> None:
    """Of all lights, evaluated without lists: inside jit they may go anywhere."""
    scene, samples = many_lights("point", 30.0)
    scene = dataclasses.replace(scene, document=None)
    plan = make_plan(scene, samples, free=True)
    assert plan.point is not None and not plan.point.culled
    assert scene.point is not None
    moved = eqx.tree_at(
        lambda scene: (scene.point.radius, scene.point.location),
        scene,
        (jnp.full(LIGHTS, 0.4, np.float32), scene.point.location[::-1] * 0.9),
    )
    got = jax.jit(lambda scene: shade(scene, samples, plan=plan))(moved)
    np.testing.assert_allclose(got, shade(moved, samples), atol=2e-5)


def test_few_lights_reach_a_tile() -> None:
    """The tests above would pass if nothing were left out: most lights are."""
    scene, samples = many_lights("point", 0.3)
    assert reaching(scene, samples, 0.3).max() < LIGHTS / 4


@pytest.mark.parametrize("count", [32, 128])
@pytest.mark.parametrize("share", [0.0, 0.03, 0.4, 1.0])
def test_lists_name_the_lights_whose_flags_are_set(count: int, share: float) -> None:
    clusters, entries = 40, 5
    flags = np.random.default_rng(count).random((count, clusters)) < share
    words = jnp.concatenate([culling._packed(jnp.asarray(some)) for some in np.split(flags, count // culling.WORD)])
    for first in range(0, count, entries):
        entry = first + np.arange(entries)
        rows = np.asarray(culling._listed_rows(words, culling._lengths(words), jnp.asarray(entry)[:, None], count))
        for cluster in range(clusters):
            listed = np.flatnonzero(flags[:, cluster])[first : first + entries]
            np.testing.assert_array_equal(rows[: len(listed), cluster], listed)
            np.testing.assert_array_equal(rows[len(listed) :, cluster], count)


def test_clusters_go_by_the_length_of_all_their_lists() -> None:
    """Each once; of equal length, as they lie."""
    flags = [np.random.default_rng(seed).random((culling.WORD, 70)) < 0.3 for seed in (1, 2)]
    lists = [culling._packed(jnp.asarray(some)) for some in flags]
    length = sum(some.sum(axis=0) for some in flags)
    np.testing.assert_array_equal(culling.by_length(lists), np.argsort(length, kind="stable"))


def test_a_cone_that_touches_a_corner_meets_its_box() -> None:
    """Seen from close by, the half angle of the sphere around a box is much more than radius / distance."""
    corner = np.ones(3)
    place = corner + np.array([1, -1, 0]) / np.sqrt(2)  # from where the ray to the corner touches the sphere
    to_corner, to_center = corner - place, -place / np.linalg.norm(place)
    aside = to_corner - (to_corner @ to_center) * to_center
    angle = np.arccos(to_corner @ to_center) + 0.19
    axis = np.cos(angle) * to_center + np.sin(angle) * aside / np.linalg.norm(aside)
    bounds = culling.Bounds(*(Vector(*jnp.full((3, 1), end)) for end in (-1.0, 1.0)), jnp.float32(1))
    one_light = (Vector(*jnp.asarray(own, jnp.float32)[:, None, None]) for own in (place, axis))
    assert np.all(culling._in_cone(*one_light, jnp.full((1, 1), 0.2), bounds, 1e-5))


def test_a_cone_that_points_away_misses_a_single_sample() -> None:
    point = Vector(*jnp.zeros((3, 1)))
    place, axis = (Vector(*jnp.float32([[[0]], [[0]], [[z]]])) for z in (5, 1))
    assert not np.any(culling._in_cone(place, axis, jnp.full((1, 1), 0.2), culling.Bounds(point, point, 0.0), 1e-5))


@pytest.mark.parametrize("count", [1, 32, 33, 250])
@pytest.mark.parametrize("share", [0.0, 0.03, 0.4, 1.0])
def test_batches_hold_every_light_whose_flag_is_set_once(count: int, share: float) -> None:
    flags = np.random.default_rng(count).random(count) < share
    words = culling._packed(jnp.asarray(flags))
    ends = jnp.cumsum(culling._count_of_flags(words))
    assert ends[-1] == np.sum(flags)
    rows = np.asarray(culling._rows_of_flags(words, ends, jnp.arange(count + 40), count))
    assert rows.min() >= 0 and rows.max() < count
    np.testing.assert_array_equal(np.sort(rows[: np.sum(flags)]), np.flatnonzero(flags))


@pytest.mark.parametrize("size", [1e-30, 1e-22, 1e-19, 1.0, 1e17, 1e19, 1e30])
def test_no_light_that_reaches_is_missed_however_large_the_scene(size: float) -> None:
    """Squares of the distance may leave the range of float32."""
    random = np.random.default_rng(11)
    place = (size * random.uniform(-1, 1, (500, 3))).astype(np.float32)
    radius = (size * random.uniform(0, 0.6, 500)).astype(np.float32)
    low = (size * random.uniform(-0.5, 0.5, (3, 40))).astype(np.float32)
    high = np.nextafter(low + np.float32(0.2 * size), np.float32(np.inf))
    made = Scene.from_nodes([nodes.PointLight()] * 500).point
    assert made is not None
    lights = lights_in_world(
        dataclasses.replace(made, location=jnp.asarray(place), radius=jnp.asarray(radius)),
        LightPlan(
            rows=None,
            headlight=False,
            frame="identity",
            ambient=False,
            scoped=False,
            attenuation=None,
            radius=True,
            culled=True,
        ),
        jnp.dtype(jnp.float32),
        None,
    )
    largest = jnp.max(jnp.abs(jnp.stack([low, high])))
    bounds = culling.Bounds(Vector(*jnp.asarray(low)), Vector(*jnp.asarray(high)), largest)
    got = np.asarray(culling.may_reach(lights, bounds))
    exact = [np.float64(array) for array in (place, low.T, high.T, radius)]
    outside = np.maximum(0, np.maximum(exact[1] - exact[0][:, None], exact[0][:, None] - exact[2]))
    reaches = np.linalg.norm(outside, axis=2) <= exact[3][:, None]
    assert not np.any(reaches & ~got)
    if 1e-17 < size < 1e18:  # beyond, squares overflow or underflow, and lights are kept that do not reach
        assert np.mean(got != reaches) < 1e-3


def size_of_clusters(samples: SampleBuffer) -> np.ndarray:
    """[3, clusters]"""
    return np.asarray(samples.cluster_high - samples.cluster_low)


def test_the_samples_of_a_cluster_are_neighbours() -> None:
    """And rasterising a scene of many lights stores them so."""
    _, samples = many_lights("point", 0.3)
    planes = np.asarray(samples.position_planes)
    own = planes.swapaxes(0, 1).reshape(3, -1, CLUSTER)
    np.testing.assert_array_equal(samples.cluster_low, own.min(axis=2))
    np.testing.assert_array_equal(samples.cluster_high, own.max(axis=2))
    assert size_of_clusters(samples)[:2].max() < 4 * 4 / 63 + 1e-5  # four by four samples

    ball = nodes.Shape(appearance=nodes.Appearance(material=nodes.Material()), geometry=nodes.Sphere())
    few, many = (
        rasterize(Scene.from_nodes([ball, *[nodes.PointLight(radius=0.1)] * count]), width=128, height=128)
        for count in (1, MANY_LIGHTS)
    )
    np.testing.assert_array_equal(np.sort(few.pixel), np.sort(many.pixel))

    def spread(samples: SampleBuffer) -> float:
        return float(np.mean(np.linalg.norm(size_of_clusters(samples), axis=0)))

    assert spread(many) < 0.75 * spread(few)
