"""Is a scene fit to be read: are its leaves what the classes of `scene.py` state?

`equinox.tree_at` and `jax.tree.map` put anything in their place, and arrays of other shapes would be read all the same.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, get_type_hints
from weakref import WeakValueDictionary

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from .fields import with_article
from .flags import Flags
from .paths import ATTRIBUTES, LIGHT_KINDS
from .scene import DirectionalLights, Fog, Materials, PointLights, Scene, SpotLights, Surface, Texture

_CLASSES = {
    "materials": Materials, "directional": DirectionalLights, "point": PointLights, "spot": SpotLights, "fog": Fog,
}  # fmt: skip
_ROWS = ("materials", "lights")
"""Dimensions that count nodes; other names stand for any size."""
_MAY_BE_INFINITE = ("radius", "attenuation", "beam_width", "visibility_range")
"""Fields whose limit the equation has: no end, no light, no ramp, no fog."""
_checked: WeakValueDictionary[int, Scene] = WeakValueDictionary()
"""Scenes that are right, by identity: they never change, and are shaded again and again."""
_right_frames: WeakValueDictionary[tuple[int, str], Any] = WeakValueDictionary()
"""Matrices that are of the kind that `frame` states, by identity and kind: most scenes share them."""
_right_images: WeakValueDictionary[int, Any] = WeakValueDictionary()
"""Of textures that are right, by identity."""
_UNEVEN = 0.02
"""How far from even the scale of a "similarity" may be: its numbers may be rounded to 8 bits."""


def check_has_nodes(where: str, scene: Any) -> None:
    """Raise ValueError for what is no Scene, and for one without the nodes that it was made of."""
    if not isinstance(scene, Scene):
        raise ValueError(f"{where}: expected a Scene, got {type(scene).__name__}")
    if scene.document is None:
        raise ValueError(f"{where}: expected a Scene of load or Scene.from_nodes, got one whose document is None")


def check_scene(scene: Scene) -> None:
    """Raise ValueError for what is no Scene, and for leaves that are not what its classes state."""
    if not isinstance(scene, Scene):
        raise ValueError(f"scene: expected a Scene, got {type(scene).__name__}")
    if _checked.get(id(scene)) is scene:
        return
    if not isinstance(scene.surfaces, tuple) or not all(map(_is_surface, scene.surfaces)):
        raise ValueError(f"scene: surfaces: expected a tuple of Surface, got {scene.surfaces!r:.60}")
    for kind, attribute in ATTRIBUTES.items():
        owner = getattr(scene, attribute)
        if attribute == "textures":
            if not isinstance(owner, tuple) or not all(isinstance(one, Texture) for one in owner):
                raise ValueError(f"scene: textures: expected a tuple of Texture, got {owner!r:.60}")
            for row, one in enumerate(owner):
                _check_leaves(f"{kind}[{row}]", one)
                _check_texels(f"{kind}[{row}]", one)
        elif owner is not None:
            if not isinstance(owner, _CLASSES[attribute]):
                wanted = _CLASSES[attribute].__name__
                raise ValueError(f"scene: {attribute}: expected {wanted} or None, got {type(owner).__name__}")
            _check_leaves(kind, owner)
            _check_frame(kind, owner)
            if kind in LIGHT_KINDS:
                _check_flags(kind, owner, len(scene.surfaces))
            _check_numbers(kind, owner)
    if scene.fog is not None and scene.fog.fog_type not in ("LINEAR", "EXPONENTIAL"):
        raise ValueError(f"Fog.fog_type: expected 'LINEAR' or 'EXPONENTIAL', got {scene.fog.fog_type!r:.60}")
    _check_surfaces(scene.surfaces, 0 if scene.materials is None else len(scene.materials.names), len(scene.textures))
    _checked[id(scene)] = scene


def _check_frame(name: str, owner: Any) -> None:
    """A matrix that is changed alone would be read as what `frame` still states."""
    frame = getattr(owner, "frame", "general")
    field = "to_world" if hasattr(owner, "to_world") else "to_local"
    matrices = getattr(owner, field, None)
    if frame == "general" or isinstance(matrices, Tracer) or _right_frames.get((id(matrices), frame)) is matrices:
        return
    affine = np.asarray(matrices, dtype=np.float64)
    if frame == "identity":
        holds = np.array_equal(affine, np.broadcast_to(np.eye(*affine.shape[-2:]), affine.shape))
    else:
        gram = np.swapaxes(affine[..., :3], -1, -2) @ affine[..., :3]
        size = np.trace(gram, axis1=-2, axis2=-1)[..., None, None] / 3
        holds = bool(np.all(np.abs(gram - size * np.eye(3)) <= _UNEVEN * size))
    if not holds:
        raise ValueError(
            f"{name}.{field}: `frame` states that it is of the kind {frame!r}, and it is not; "
            f"give `frame='general'` with it (`dataclasses.replace`)"
        )
    if matrices is not None:
        _right_frames[id(matrices), frame] = matrices


def _check_leaves(name: str, owner: Any) -> None:
    size = getattr(owner, "size", None)  # of a texture
    known: dict[int | str, int] = {} if size is None else {"height": size[0], "width": size[1]}
    for field, dimensions in _dimensions(type(owner)).items():
        leaf = getattr(owner, field)
        expected = [len(owner.names) if size in _ROWS else known.get(size, size) for size in dimensions]
        if not _is_float(getattr(leaf, "dtype", None)) or not _is_of_shape(leaf.shape, expected):
            wanted = ", ".join(map(str, expected))
            raise ValueError(f"{name}.{field}: expected floating-point numbers of shape [{wanted}], got {_told(leaf)}")


def _check_numbers(kind: str, owner: Any) -> None:
    """No number that is known is NaN or infinite, but of lights that are off or in no scope: they are not read."""
    names = getattr(owner, "names", None)
    for field in _dimensions(type(owner)):
        leaf = getattr(owner, field)
        if isinstance(leaf, Tracer):
            continue
        known = np.asarray(leaf).reshape(1 if names is None else len(names), -1)
        bad = np.isnan(known) if field in _MAY_BE_INFINITE else ~np.isfinite(known)
        if kind in LIGHT_KINDS:
            bad &= (owner.on.array & owner.in_scope.array.any(axis=0))[:, None]
        if np.any(bad):
            row = int(np.argmax(bad.any(axis=1)))
            label = kind if names is None else f"{kind}[{names[row] or row}]"
            raise ValueError(f"{label}.{field}: every number must be finite, got {known[bad][0]}")


def _check_texels(name: str, texture: Texture) -> None:
    """No number of a texture that is known is NaN or infinite."""
    image: Any = texture.image
    if isinstance(image, Tracer) or _right_images.get(id(image)) is image:
        return
    known = np.asarray(image)
    for extreme in (np.min(known, initial=0), np.max(known, initial=0)):
        if not np.isfinite(extreme):
            raise ValueError(f"{name}.image: every number must be finite, got {extreme}")
    _right_images[id(image)] = image


def _check_flags(name: str, owner: Any, surfaces: int) -> None:
    """`on` and `in_scope` of lights."""
    count = len(owner.names)
    for field, shape in (("on", (count,)), ("in_scope", (surfaces, count))):
        flags = getattr(owner, field)
        if not isinstance(flags, Flags) or flags.array.shape != shape:
            told = (
                f"shape {list(flags.array.shape)}" if isinstance(flags, Flags) else with_article(type(flags).__name__)
            )
            raise ValueError(f"{name}.{field}: expected Flags of shape {list(shape)}, got {told}")


def _is_surface(given: Any) -> bool:
    """Whether it is a Surface of a word and numbers, which can be static."""
    return isinstance(given, Surface) and all(isinstance(field, str | int | np.integer) for field in given)


@functools.lru_cache(maxsize=64)
def _check_surfaces(surfaces: tuple[Surface, ...], materials: int, textures: int) -> None:
    """They are of a known kind, and the rows that they name exist."""
    for row, surface in enumerate(surfaces):
        if surface.lighting == "unlit":  # table 17.2 has no material
            has_its_material, allowed_materials = surface.material == -1, "-1"
        else:
            has_its_material, allowed_materials = 0 <= surface.material < materials, f"a row in [0, {materials})"
        for field, is_right, allowed in (
            ("lighting", surface.lighting in ("lit", "unlit", "emissive"), "'lit', 'unlit' or 'emissive'"),
            ("material", has_its_material, allowed_materials),
            ("texture", -1 <= surface.texture < textures, f"a row in [-1, {textures})"),
            ("color_components", surface.color_components in (0, 3, 4), "0, 3 or 4"),
        ):
            if not is_right:
                got = getattr(surface, field)
                raise ValueError(f"scene: surfaces[{row}].{field}: expected {allowed}, got {got!r:.60}")


@functools.cache
def _dimensions(owner: type) -> dict[str, tuple[int | str, ...]]:
    """Of every field that holds numbers the dimensions that its annotation states: `Float[Array, "lights 3"]`."""
    hints, fields = get_type_hints(owner), dataclasses.fields(owner)
    return {
        field.name: tuple(int(size) if size.isdigit() else size for size in hints[field.name].dim_str.split())
        for field in fields
        if not field.metadata.get("static", False)
    }


@functools.cache
def _is_float(dtype: Any) -> bool:
    return dtype is not None and jnp.issubdtype(dtype, jnp.floating) and dtype.isnative


def _is_of_shape(shape: tuple[int, ...], expected: list[int | str]) -> bool:
    return len(shape) == len(expected) and all(
        isinstance(wanted, str) or size == wanted for size, wanted in zip(shape, expected, strict=True)
    )


def _told(leaf: Any) -> str:
    if hasattr(leaf, "dtype"):
        return f"{leaf.dtype} of shape {list(leaf.shape)}"
    return with_article(type(leaf).__name__)
