"""Start values written on the command line: `PointLight[key].location=1 2 3`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxlight import Scene


def with_start_values(scene: Scene, assignments: Sequence[str]) -> Scene:
    """The scene with the numbers that `PATH=VALUE` texts give: one for all, or one a component.

    Raises:
        ValueError: no such field, not numbers, the wrong count, or out of the field's range.
    """
    import jax.numpy as jnp
    import numpy as np

    from jaxlight.scene.paths import select

    for assignment in assignments:
        path, equals, text = assignment.partition("=")
        try:
            values = np.array([float(word) for word in text.replace(",", " ").split()])
        except ValueError:
            values = np.zeros(0)
        if not equals or not len(values):
            raise ValueError(f"--start: expected PATH=NUMBERS such as 'Material[0].shininess=0.5', got {assignment!r}")
        for leaf, mask in select(scene, path):
            numbers = np.array(leaf.get(scene))
            count = int(np.count_nonzero(mask))
            if count % len(values):
                raise ValueError(f"--start: {path}: expected 1 or {count} numbers, got {len(values)}")
            allowed = leaf.range
            low = values <= allowed.lower if allowed.open_below else values < allowed.lower
            if not np.all(np.isfinite(values)) or np.any(low | (values > allowed.upper)):
                raise ValueError(f"--start: {path}: expected numbers in {allowed}, got {text.strip()}")
            numbers[mask] = np.tile(values, count // len(values))
            scene = leaf.set(scene, jnp.asarray(numbers))
    return scene
