"""The JSON header of a binary glTF file: what trimesh is to read of it, and the source of exact factors.

trimesh rounds material colours to 8 bits and drops names that repeat, so materials are given their number as name. It
cuts colours of vertices without a material to 8 bits, so what has none is given one. It reads neither samplers nor
KHR_texture_transform, and of texture coordinates only the first set.
"""

from __future__ import annotations

import dataclasses
import json
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .errors import SceneFileError
from .gltf_checks import FLOAT, TRANSFORM, UNLIT, check_header, check_rows
from .mesh_materials import SPECULAR_GLOSSINESS, GltfFactors
from .notes import ReadNotes

_JSON_CHUNK = 0x4E4F534A
_UNUSED_TEXTURES = ("normalTexture", "occlusionTexture", "emissiveTexture")
_WEBP = "EXT_texture_webp"
_CLAMP, _MIRROR = 33071, 33648


@dataclasses.dataclass(frozen=True)
class GltfMaterial:
    """A material as it stands in the header, and how its texture of the base colour lies on a mesh."""

    description: dict[str, Any]
    repeat_s: bool = True
    repeat_t: bool = True
    is_stand_in: bool = False
    """True for that of primitives without a material."""
    image: str = ""
    """What the image of the texture is called, if it has one."""
    texture_transform: dict[str, Any] | None = None
    """The KHR_texture_transform of the texture."""

    @property
    def is_unlit(self) -> bool:
        """True if the material takes no light."""
        return UNLIT in self.description.get("extensions", {})

    @property
    def is_opaque(self) -> bool:
        """True if alpha, whatever it comes from, is not to be read."""
        return self.description.get("alphaMode", "OPAQUE") == "OPAQUE"

    @property
    def is_double_sided(self) -> bool:
        """True if the back of its faces is to be seen too."""
        return bool(self.description.get("doubleSided", False))

    def base(self) -> np.ndarray:
        """The base colour and alpha [4] that the material states."""
        if self.is_unlit:  # another description of the surface has no say then
            return GltfFactors.of({**self.description, "extensions": {}}).base
        return GltfFactors.of(self.description).base

    def painted(self, colors: np.ndarray) -> np.ndarray:
        """What is shaded of the colours of vertices [n, 3 or 4], which scale the base colour and its alpha."""
        scaled = colors * self.base()[: colors.shape[1]]
        if not self.is_unlit:
            scaled[:, :3] = GltfFactors.of(self.description).diffuse(scaled[:, :3])
        return np.clip(scaled, 0.0, 1.0)

    def texcoord(self, uv: np.ndarray) -> np.ndarray:
        """Texture coordinates [n, 2] (t up) after KHR_texture_transform, which is stated for t down: T R S, S first.

        X3D's TextureTransform has the other order, and does not hold a rotation of what was scaled unevenly.
        """
        if self.texture_transform is None:
            return uv
        turn = float(self.texture_transform.get("rotation", 0.0))
        scale = np.asarray(self.texture_transform.get("scale", (1.0, 1.0)), dtype=np.float64)
        offset = np.asarray(self.texture_transform.get("offset", (0.0, 0.0)), dtype=np.float64)
        down = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1) * scale
        # Counter-clockwise as seen, where t points down.
        rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        s, t = (down @ rotation.T + offset).T
        return np.stack([s, 1.0 - t], axis=1)


def numbered_materials(path: Path, data: bytes, notes: ReadNotes) -> tuple[bytes, list[GltfMaterial]]:
    """The file with each material named by its number, and the materials as they stand in the header.

    In the file the texture of a base colour is where trimesh looks for it, with its coordinates in the first set.

    Raises:
        SceneFileError: the header cannot be read, announces more numbers than a file can hold, or needs an extension
            that is not read.
    """
    if len(data) < 20:
        raise SceneFileError(path, None, "truncated glb: no header")
    _, version, _, length, kind = struct.unpack_from("<5I", data)
    if version != 2 or kind != _JSON_CHUNK or 20 + length > len(data):
        raise SceneFileError(path, None, "not a glTF 2 binary file, or truncated in its header")
    try:
        header = json.loads(data[20 : 20 + length])
        check_header(path, header, len(data), max(len(data) - 28 - length, 0), notes)
        materials = _simplified_materials(path, header, notes)
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError) as error:
        if isinstance(error, SceneFileError):
            raise
        raise SceneFileError(path, None, f"malformed glTF header: {type(error).__name__}: {error}") from None
    chunk = json.dumps(header).encode()
    chunk += b" " * (-len(chunk) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4s4I", b"glTF", 2, 20 + len(chunk) + len(rest), len(chunk), _JSON_CHUNK)
    return head + chunk + rest, materials


def _simplified_materials(path: Path, header: dict[str, Any], notes: ReadNotes) -> list[GltfMaterial]:
    """The materials; what stands in their place in the header has only what trimesh is to read."""
    materials: list[GltfMaterial] = []
    for row, description in enumerate(list(header.get("materials", []))):
        pbr = description.get("pbrMetallicRoughness", {})
        glossy = description.get("extensions", {}).get(SPECULAR_GLOSSINESS, {})
        for texture in (*_UNUSED_TEXTURES, "metallicRoughnessTexture", "specularGlossinessTexture"):
            if texture in description or texture in pbr or texture in glossy:
                notes.unused[f"glTF {texture}"] += 1
        material = GltfMaterial(description)
        use = pbr.get("baseColorTexture")
        if SPECULAR_GLOSSINESS in description.get("extensions", {}) and not material.is_unlit:
            use = glossy.get("diffuseTexture")
        header["materials"][row] = {"name": str(row)}
        if use is not None:
            header["materials"][row]["pbrMetallicRoughness"] = {"baseColorTexture": {"index": use["index"]}}
            materials.append(_textured(path, header, row, material, use, notes))
        else:
            materials.append(material)
            _leave_integers_out(header, row)
    bare = [
        primitive
        for mesh in header.get("meshes", [])
        for primitive in mesh["primitives"]
        if "material" not in primitive
    ]
    if bare:
        row = len(materials)
        header.setdefault("materials", []).append({"name": str(row)})
        materials.append(GltfMaterial({}, is_stand_in=True))
        for primitive in bare:
            primitive["material"] = row
        _leave_integers_out(header, row)
    return materials


def _primitives_of(header: dict[str, Any], row: int) -> Iterator[dict[str, Any]]:
    """The primitives that have the material of this number."""
    return (p for mesh in header.get("meshes", []) for p in mesh["primitives"] if p.get("material") == row)


def _leave_integers_out(header: dict[str, Any], row: int) -> None:
    """Leave out texture coordinates of integers, of which trimesh makes no fractions, where no texture needs them."""
    for primitive in _primitives_of(header, row):
        accessor = primitive["attributes"].get("TEXCOORD_0")
        if accessor is not None and header["accessors"][accessor]["componentType"] != FLOAT:
            del primitive["attributes"]["TEXCOORD_0"]


def _textured(
    path: Path, header: dict[str, Any], row: int, material: GltfMaterial, use: dict[str, Any], notes: ReadNotes
) -> GltfMaterial:
    """The material with what its use of a texture says; its set of coordinates becomes the first of its meshes."""
    transform = use.get("extensions", {}).get(TRANSFORM)
    which = int((transform or {}).get("texCoord", use.get("texCoord", 0)))
    name = f"TEXCOORD_{which}"
    for primitive in _primitives_of(header, row):
        attributes = primitive["attributes"]
        if name not in attributes:
            if which == 0:
                continue
            raise SceneFileError(path, None, f"glTF material {row} needs {name}, which a mesh has not")
        if header["accessors"][attributes[name]]["componentType"] != FLOAT:
            raise SceneFileError(path, None, f"glTF material {row} has a {name} of integers; jaxlight reads floats")
        primitive["attributes"] = {**attributes, "TEXCOORD_0": attributes[name]}
    check_rows(path, f"material {row}", [use["index"]], header, "textures")
    sampler = header["textures"][use["index"]].get("sampler")
    check_rows(path, f"texture {use['index']}", [] if sampler is None else [sampler], header, "samplers")
    wraps = header["samplers"][sampler] if sampler is not None else {}
    for wrap in ("wrapS", "wrapT"):
        if wraps.get(wrap) == _MIRROR:
            notes.unused[f"glTF {wrap} MIRRORED_REPEAT (read as REPEAT)"] += 1
    return dataclasses.replace(
        material,
        repeat_s=wraps.get("wrapS") != _CLAMP,
        repeat_t=wraps.get("wrapT") != _CLAMP,
        image=_name_of_image(path, header, use["index"]),
        texture_transform=transform,
    )


def _name_of_image(path: Path, header: dict[str, Any], texture: int) -> str:
    """Of a texture: its file, or its number where it stands in this one."""
    description = header["textures"][texture]
    source = description.get("source")
    if source is None:
        source = description.get("extensions", {}).get(_WEBP, {}).get("source")
    check_rows(path, f"texture {texture}", [] if source is None else [source], header, "images")
    file = "" if source is None else str(header["images"][source].get("uri", ""))
    return file if file and not file.startswith("data:") else f"glTF image {source}"
