"""Start values instead of those in the scene: `PointLight[key].location=1 2 3`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .problem import Numbers

if TYPE_CHECKING:
    from jaxlight import Scene


def parse_assignment(text: str) -> tuple[str, Numbers]:
    """(path, numbers) of `PATH=NUMBERS`.

    Raises:
        ValueError: no such form.
    """
    path, equals, words = text.partition("=")
    try:
        values = tuple(float(word) for word in words.replace(",", " ").split())
    except ValueError:
        values = ()
    if not equals or not values:
        raise ValueError(f"expected PATH=NUMBERS such as 'Material[0].shininess=0.5', got {text!r}")
    return path, values


def with_start_values(scene: Scene, path: str, given: Numbers) -> Scene:
    """The scene with the numbers that a path means set: one for all, or one a component.

    Raises:
        ValueError: no such field, the wrong count, or out of the field's range.
    """
    import jax.numpy as jnp
    import numpy as np

    from jaxlight.scene.paths import select

    values = np.atleast_1d(np.asarray(given, dtype=np.float64))
    for leaf, mask in select(scene, path):
        numbers = np.array(leaf.get(scene))
        count = int(np.count_nonzero(mask))
        if not len(values) or count % len(values):
            raise ValueError(f"expected 1 or {count} numbers, got {len(values)}")
        allowed = leaf.range
        low = values <= allowed.lower if allowed.open_below else values < allowed.lower
        if not np.all(np.isfinite(values)) or np.any(low | (values > allowed.upper)):
            came = " ".join(f"{value:g}" for value in values.tolist())
            raise ValueError(f"expected numbers in {allowed}, got {came}")
        numbers[mask] = np.tile(values, count // len(values))
        scene = leaf.set(scene, jnp.asarray(numbers))
    return scene
