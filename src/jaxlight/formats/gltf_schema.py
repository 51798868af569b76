"""The types and sizes of what is read of a glTF header: they are what the specification states, or it is refused."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..scene.fields import boolean, string, whole
from .errors import SceneFileError
from .mesh_materials import SPECULAR_GLOSSINESS

UNLIT, TRANSFORM, LIGHTS = "KHR_materials_unlit", "KHR_texture_transform", "KHR_lights_punctual"
COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
ANY = "*"
_NEEDED = {
    "accessors": ("componentType", "count", "type"),
    "baseColorTexture": ("index",),
    "bufferViews": ("buffer", "byteLength"),
    "buffers": ("byteLength",),
    "diffuseTexture": ("index",),
    "meshes": ("primitives",),
    "primitives": ("attributes",),
}
"""By the names of objects, or of lists of them, what they cannot be without."""


def _count(where: str, value: Any) -> int:
    return whole(where, _integer(value), at_least=0)


def _row(where: str, value: Any) -> Any:
    """An index; whether the file has what it means is seen where all of the header is known to be sound."""
    return _integer(value)


def _integer(value: Any) -> Any:
    """The integer that a number is, however it is written: glTF lets 4 be 4.0."""
    return int(value) if type(value) is float and value.is_integer() else value


def _finite(where: str, value: Any) -> float:
    if not _is_finite(value):
        raise ValueError(f"{where}: expected a finite number, got {value!r:.60}")
    return value


def _numbers(count: int | None = None) -> Callable[[str, Any], Any]:
    """A check for a list of so many numbers; None: of any number of them."""
    allowed = "finite numbers" if count is None else f"{count} finite numbers"

    def check(where: str, value: Any) -> Any:
        if not isinstance(value, list) or count not in (None, len(value)) or not all(map(_is_finite, value)):
            raise ValueError(f"{where}: expected {allowed}, got {value!r:.60}")
        return value

    return check


def _one_of(*values: Any) -> Callable[[str, Any], Any]:
    """A check for one of the given values."""

    def check(where: str, value: Any) -> Any:
        value = _integer(value)
        if value not in values:
            raise ValueError(f"{where}: expected {' or '.join(map(repr, values))}, got {value!r:.60}")
        return value

    return check


def _is_finite(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= sys.float_info.max


_TRANSFORM_FIELDS = {"offset": _numbers(2), "rotation": _finite, "scale": _numbers(2), "texCoord": _count}
_TEXTURE = {"index": _row, "texCoord": _count, "extensions": {TRANSFORM: _TRANSFORM_FIELDS}}
_SCHEMA = {
    "accessors": [
        {
            "bufferView": _row,
            "byteOffset": _count,
            "componentType": _one_of(*COMPONENT_BYTES),
            "count": _count,
            "type": _one_of(*COMPONENTS),
        }
    ],
    "animations": [{}],
    "asset": {"version": string, "minVersion": string},
    "bufferViews": [{"buffer": _row, "byteOffset": _count, "byteLength": _count, "byteStride": _count}],
    "buffers": [{"byteLength": _count, "uri": string}],
    "cameras": [{}],
    "extensions": {LIGHTS: {"lights": [{}]}},
    "extensionsRequired": [string],
    "extensionsUsed": [string],
    "images": [{"bufferView": _row, "mimeType": string, "uri": string}],
    "materials": [
        {
            "alphaMode": string,
            "doubleSided": boolean,
            "emissiveFactor": _numbers(3),
            "extensions": {
                SPECULAR_GLOSSINESS: {
                    "diffuseFactor": _numbers(4),
                    "diffuseTexture": _TEXTURE,
                    "glossinessFactor": _finite,
                    "specularFactor": _numbers(3),
                },
            },
            "name": string,
            "pbrMetallicRoughness": {
                "baseColorFactor": _numbers(4),
                "baseColorTexture": _TEXTURE,
                "metallicFactor": _finite,
                "roughnessFactor": _finite,
            },
        }
    ],
    "meshes": [
        {
            "name": string,
            "primitives": [
                {"attributes": {ANY: _row}, "indices": _row, "material": _row, "mode": _count, "targets": [{}]}
            ],
            "weights": _numbers(),
        }
    ],
    "nodes": [
        {
            "children": [_row],
            "matrix": _numbers(16),
            "mesh": _row,
            "name": string,
            "rotation": _numbers(4),
            "scale": _numbers(3),
            "translation": _numbers(3),
            "weights": _numbers(),
        }
    ],
    "samplers": [{"wrapS": _count, "wrapT": _count}],
    "scene": _row,
    "scenes": [{"nodes": [_row]}],
    "skins": [{}],
    "textures": [{"extensions": {}, "sampler": _row, "source": _row}],
}
"""Of an object by its fields (ANY: whatever their names), of a list by its one entry, otherwise a check as those of
`scene.fields`, whose result takes the place of the value."""


def check_types(path: Path, header: Any) -> None:
    """Check all that is read of a header; integers are integers then, however they are written.

    Raises:
        SceneFileError: a value is of another type or size than glTF states, or is not there; says which.
    """
    try:
        _check("", "header", header, _SCHEMA)
    except ValueError as error:
        raise SceneFileError(path, None, f"glTF {error}") from None


def _check(where: str, name: str, value: Any, schema: Any) -> Any:
    """The value as it is read."""
    if isinstance(schema, dict):
        _expect(where or name, "an object", value, dict)
        for needed in _NEEDED.get(name, ()):
            if needed not in value:
                raise ValueError(f"{where}: expected an object with {needed}, got {value!r:.60}")
        fields = dict.fromkeys(value, schema[ANY]) if ANY in schema else schema
        for field, inner in fields.items():
            if field in value:
                value[field] = _check(f"{where}.{field}".removeprefix("."), field, value[field], inner)
    elif isinstance(schema, list):
        _expect(where, "a list", value, list)
        value[:] = [_check(f"{where}[{row}]", name, entry, schema[0]) for row, entry in enumerate(value)]
    else:
        return schema(where, value)
    return value


def _expect(where: str, what: str, value: Any, kind: type) -> None:
    if not isinstance(value, kind):
        raise ValueError(f"{where}: expected {what}, got {value!r:.60}")
