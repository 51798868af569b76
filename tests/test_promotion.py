"""Programs that make JAX stricter for their own code, of shapes and of types, can use this library all the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlight as jl
from jaxlight import nodes as n

SCENE = jl.Scene.from_nodes(
    [
        n.Viewpoint(position=(0, 0, 6)),
        n.Shape(
            appearance=n.Appearance(material=n.Material(name="ball", specular_color=(0.5, 0.5, 0.5))),
            geometry=n.Sphere(),
        ),
        n.PointLight(location=(2, 3, 4), attenuation=(1, 0.1, 0)),
        n.Fog(visibility_range=30.0, color=(0.2, 0.3, 0.4)),
    ]
)
SAMPLES = jl.rasterize(SCENE, width=24, height=24)
PICTURE = jl.render(SCENE, SAMPLES)
START = eqx.tree_at(lambda scene: scene.materials.diffuse_color, SCENE, jnp.full((1, 3), 0.4))


Loss = Callable[[jl.Scene], jax.Array]


@pytest.fixture
def strict() -> Iterator[None]:
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        yield


def loss(scene: jl.Scene) -> jax.Array:
    return jnp.sum(jnp.square(jl.shade(scene, SAMPLES)))


def loss_by_tiles(scene: jl.Scene) -> jax.Array:
    return jl.sum_over_samples(lambda color: jnp.sum(jnp.square(color), 0), scene, SAMPLES)


def slopes(function: Loss) -> np.ndarray:
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(jax.jit(jax.grad(function))(SCENE))])


def test_strict_rules_are_strict(strict: None) -> None:
    with pytest.raises(ValueError, match="rank_promotion"):
        jnp.add(jnp.ones((2, 3)), jnp.ones(3))
    with pytest.raises(Exception, match="dtype_promotion"):
        jnp.add(jnp.ones(3), jnp.ones(3, jnp.int32))


@pytest.mark.parametrize("function", [loss, loss_by_tiles])
def test_gradients_are_the_same_under_strict_rules(function: Loss, request: pytest.FixtureRequest) -> None:
    usual = slopes(function)
    request.getfixturevalue("strict")
    assert np.array_equal(slopes(function), usual)
    assert np.abs(usual).max() > 1


def test_pictures_checks_and_fits_under_strict_rules(strict: None, tmp_path: Path) -> None:
    assert np.array_equal(jl.render(SCENE, SAMPLES), PICTURE)
    assert np.allclose(jl.decode(jl.encode(PICTURE)), PICTURE, atol=1e-6)
    assert jl.check_gradients(SCENE, SAMPLES, "Material[ball].shininess").passed
    views = [jl.View(SAMPLES, PICTURE)]
    found = jl.fit(START, views, ["Material[ball].diffuse_color", "Material[ball].shininess"])
    assert found.converged
    assert found.value("Material[ball].diffuse_color") == pytest.approx([0.8] * 3, abs=1e-4)
    assert found.uncertainty.well_posed
    jl.write_report(tmp_path / "report.html", found, views)
    assert "Converged" in (tmp_path / "report.html").read_text()
