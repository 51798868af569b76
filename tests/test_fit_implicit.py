"""Derivatives through a fit: those of the answer, not of the steps."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit_scenes import key_light, material, precision, sphere_picture, sphere_points, sphere_samples, sphere_scene
from jaxlight import Free, SampleBuffer, View, fit, fitted_values, nodes
from jaxlight.fit.problem import Problem, make_problem

FREE = [Free("Material[body].diffuse_color.g", upper=0.3), "Material[body].diffuse_color.r", "Material[body].shininess"]
"""The truth of the first is 0.35: its bound holds it."""
SUN = nodes.DirectionalLight(direction=(-1.2, -1.8, -3.2))
STEPS = {"strength": 1e-4, "ambient": 1e-5}
"""Of the differences. An ambient intensity of 0 is left out of the equation that is fitted: its derivative is that
to one side."""


def moved(problem: Problem, moves: jax.Array) -> Problem:
    """The problem with fields that are not free moved, the first with a picture that is brighter on one side."""
    light, target = problem.world.scene.directional, problem.views[0].target
    strength, ambient = moves
    side = jnp.linspace(0.0, 0.1, target.shape[-1]).astype(target.dtype)
    return eqx.tree_at(
        lambda p: (
            p.world.scene.directional.intensity,
            p.world.scene.directional.ambient_intensity,
            p.views[0].target,
        ),
        problem,
        (light.intensity * (1 + strength), light.ambient_intensity + ambient, target + strength * side),
    )


def test_forward_and_reverse_mode_are_the_differences_of_fits() -> None:
    """And a changed number compiles nothing anew."""
    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, *_, **__: compiled.append(name) if "backend_compile" in name else None
    )
    with precision("float64") as dtype:
        start = sphere_scene(SUN, body=material(shininess=0.25), dtype=dtype)
        picture = sphere_picture(20, SUN, body=material(diffuse_color=(0.6, 0.35, 0.2)), noise=0.01)
        result = fit(start, View(sphere_samples(20, dtype=dtype), picture), FREE)

        def answer(moves: jax.Array) -> Any:
            found = fitted_values(moved(result.problem, moves))
            return found, found

        forward_at = jax.jacfwd(answer, has_aux=True)
        compiled.clear()
        forward, here = forward_at(jnp.zeros(2))
        assert compiled
        np.testing.assert_allclose(here, result.values, rtol=1e-7)
        for column, (name, step) in enumerate(STEPS.items()):
            there = step * jnp.eye(2)[column]
            compiled.clear()
            beyond = forward_at(there)[1]
            assert not compiled
            before, between = (forward_at(-there)[1], 2 * step) if name == "strength" else (here, step)
            expected = (beyond - before) / between
            assert abs(float(expected[0])) < 1e-12 and np.all(np.abs(expected[1:]) > 1e-3)
            np.testing.assert_allclose(forward[:, column], expected, rtol=1e-4, atol=1e-12)
        reverse, _ = jax.jit(jax.jacrev(answer, has_aux=True))(jnp.zeros(2))
        np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-12)


@pytest.mark.thorough
def test_derivatives_do_not_depend_on_the_unit_of_length() -> None:
    """In single precision too: with the light's place in millimetres, columns of J are a thousandth."""
    free = ["Material[body].shininess", "PointLight[key].location"]
    picture, (points, pixel) = sphere_picture(16, noise=0.01, seed=5), sphere_points(16)
    found = []

    @jax.jit
    @jax.jacrev
    def slopes_at(intensity: jax.Array, problem: Problem) -> jax.Array:
        return fitted_values(eqx.tree_at(lambda p: p.world.scene.point.intensity, problem, intensity))

    with precision("float32") as dtype:
        for scale in (1.0, 1000.0):
            samples = SampleBuffer.create(
                scale * points, points, (0, 0, 4 * scale), pixel=pixel, width=16, height=16, dtype=dtype
            )
            light = key_light(location=tuple(scale * x for x in key_light().location), radius=1e9)
            problem, _ = make_problem(sphere_scene(light, dtype=dtype), View(samples, picture), free)
            slopes = slopes_at(problem.world.scene.point.intensity, problem)[:, 0]
            found.append(np.asarray(slopes) / [1, scale, scale, scale])
    assert np.all(np.abs(found[0]) > 0.1)
    np.testing.assert_allclose(found[1], found[0], rtol=0.02)


def test_single_precision_tells_what_only_a_prior_tells() -> None:
    """Strength against albedo. And the answer is where the fit ended: three evaluations do not lead there from afar."""
    body = material(specular_color=(0.2, 0.2, 0.2), shininess=0.1)
    strength = Free("PointLight[key].intensity", mean=0.9, deviation=0.2)
    picture = sphere_picture(16, noise=0.01, body=material(specular_color=(0.2, 0.2, 0.2)))
    with precision("float32") as dtype:
        view = View(sphere_samples(16, dtype=dtype), picture, noise=0.01)
        fields = ["Material[body].diffuse_color", "Material[body].specular_color", "Material[body].shininess"]
        result = fit(sphere_scene(body=body, dtype=dtype), view, [*fields, strength])

        def answer(mean: jax.Array) -> Any:
            found = fitted_values(eqx.tree_at(lambda p: p.parameters.prior_mean, result.problem, mean), max_steps=3)
            return found, found

        slopes, values = jax.jacfwd(answer, has_aux=True)(result.problem.parameters.prior_mean)
    np.testing.assert_allclose(values, result.values, rtol=1e-3)
    colors, light = result.values[:6], result.values[7]
    np.testing.assert_allclose(slopes[:, 7], [*(-colors / light), 0, 1], atol=0.05)


def test_what_is_held_does_not_move_where_the_picture_fits_exactly() -> None:
    """Red is pinned, green lies on its bound, and neither has a slope. A warning says where no minimum was reached."""
    glow = {"diffuse_color": (0, 0, 0), "specular_color": (0, 0, 0), "emissive_color": (0.5, 0.25, 0.75)}
    free = Free("Material[body].emissive_color", lower=(0.5, 0.25, 0), upper=(0.5, 1, 1))
    with precision("float64") as dtype:
        scene = sphere_scene(body=material(**glow), dtype=dtype)
        samples = sphere_samples(4, dtype=dtype)

        def slope(glow: tuple[float, ...], max_steps: int) -> jax.Array:
            problem, _ = make_problem(scene, View(samples, np.broadcast_to(glow, (4, 4, 3)), saturated=0.9), free)

            def answer(brighter: jax.Array) -> jax.Array:
                target = problem.views[0].target + brighter
                return fitted_values(eqx.tree_at(lambda p: p.views[0].target, problem, target), max_steps=max_steps)

            found = jax.jacfwd(answer)(jnp.zeros(()))
            jax.effects_barrier()
            return found

        np.testing.assert_allclose(slope(glow["emissive_color"], 1), [0, 0, 1], atol=1e-12)
        with pytest.warns(UserWarning, match="did not end at a smooth minimum"):
            slope((0.5, 0.5, 0.95), 1)
