"""Start values instead of those in the scene: `PointLight[key].location=1 2 3`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .problem import Numbers

if TYPE_CHECKING:
    import numpy as np

    from jaxlight import Scene
    from jaxlight.scene.paths import Leaf


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
        hint = "" if equals else "; quotes hold several numbers together: 'PointLight[key].location=1 2 3'"
        raise ValueError(f"expected PATH=NUMBERS such as 'Material[0].shininess=0.5', got {text!r}{hint}")
    return path, values


def _components(leaf: Leaf, mask: np.ndarray) -> list[int]:
    """How many components of each row are meant: of a node, of the fog, or of a texture's texels."""
    import numpy as np

    rows = mask.reshape(-1, mask.shape[-1]) if leaf.kind == "Texture" else mask
    rows = rows.reshape(1 if leaf.kind == "Fog" else len(rows), -1)
    return [size for size in np.count_nonzero(rows, axis=1).tolist() if size]


def with_start_values(scene: Scene, path: str, given: Numbers) -> Scene:
    """The scene with the numbers that a path means set: one for all, or one a component.

    Raises:
        ValueError: no such field, the wrong count, or out of the range of the field or of its type.
    """
    import jax.numpy as jnp
    import numpy as np

    from jaxlight.scene.fields import largest_of
    from jaxlight.scene.paths import select

    values = np.atleast_1d(np.asarray(given, dtype=np.float64))
    for leaf, mask in select(scene, path):
        numbers = np.array(leaf.get(scene))
        count = int(np.count_nonzero(mask))
        for components in _components(leaf, mask):
            if len(values) not in (1, components):
                allowed = "1 number" if components == 1 else f"1 or {components} numbers"
                raise ValueError(f"expected {allowed}, got {len(values)}")
        allowed = leaf.range
        low = values <= allowed.lower if allowed.open_below else values < allowed.lower
        if not np.all(np.isfinite(values)) or np.any(low | (values > allowed.upper)):
            came = " ".join(f"{value:g}" for value in values.tolist())
            raise ValueError(f"expected numbers in {allowed}, got {came}")
        largest = largest_of(numbers.dtype)
        if np.any(np.abs(values) > largest):
            came = values[np.argmax(np.abs(values))]
            raise ValueError(f"{came:g} is larger than {largest:.3g}, the most that the type holds")
        numbers[mask] = np.tile(values, count // len(values))
        scene = leaf.set(scene, jnp.asarray(numbers))
    return scene
