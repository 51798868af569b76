"""Mesh files (glb, obj + mtl, ply, stl) -> Shape nodes, read by trimesh from memory and the file's own folder only."""

from __future__ import annotations

import contextlib
import io
import logging
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial

from ..scene import nodes
from .encodings import Format
from .errors import SceneFileError
from .folder import ResourceFolder
from .gltf_header import GltfMaterial, numbered_materials
from .mesh_faces import face_set
from .mesh_folder import MeshFolder
from .mesh_graph import nested_transforms
from .mesh_materials import material_from_gltf, material_from_mtl, unlit_material_from_gltf
from .notes import ReadNotes
from .obj_text import checked_obj
from .ply_rows import checked_ply
from .stl_facets import checked_stl
from .x3d_textures import TextureReader

_FACES_TEXCOORD = re.compile(rb"^property[ \t]+list[ \t]+\S+[ \t]+\S+[ \t]+texcoord\b", re.MULTILINE)
"""What ply calls texture coordinates that stand with faces."""
_UNDER_TEXTURE = "under a texture, but with texture_mode='modulate'"
"""Where X3D does not use colours that glTF multiplies with those of the texture."""


def read_mesh(path: Path, data: bytes, file_format: Format) -> tuple[tuple[nodes.Node, ...], ReadNotes]:
    """The shapes of a mesh file, in the hierarchy that it has.

    Raises:
        SceneFileError: the file cannot be read, holds no triangles, or has indices or numbers out of range.
    """
    notes = ReadNotes()
    materials: list[GltfMaterial] = []
    folder = MeshFolder(path, notes)
    options: dict[str, Any] = {"file_type": file_format, "resolver": folder, "process": False}
    try:
        if file_format == "glb":
            data, materials = numbered_materials(path, data, notes)
        elif file_format == "obj":
            text = checked_obj(path, data, notes)
            data = text.data
            folder.read_libraries(text)
        elif file_format == "stl":
            data = checked_stl(path, data)
        elif file_format == "ply":
            data = checked_ply(path, data)
            # Vertices need to be repeated only for what stands with faces; repeated ones lose colours and normals.
            options["fix_texture"] = bool(_FACES_TEXCOORD.search(data))
        with _heard(notes):
            loaded = trimesh.load_scene(io.BytesIO(data), **options)
            builder = _MeshBuilder(path, notes, loaded, materials, folder, is_gltf=file_format == "glb")
            children = nested_transforms(str(loaded.graph.base_frame), loaded.graph.to_edgelist(), builder.shape)
    except SceneFileError:
        raise
    except Exception as error:  # trimesh says in many ways that a file is damaged
        raise SceneFileError(path, None, f"not a {file_format} file that can be read: {_sentence(error)}") from None
    if not children:
        raise SceneFileError(path, None, "holds no triangles")
    return children, notes


class _MeshBuilder:
    """Makes one Shape a geometry of a trimesh scene; materials and textures that several use are one node."""

    def __init__(
        self,
        path: Path,
        notes: ReadNotes,
        scene: Any,
        gltf_materials: list[GltfMaterial],
        folder: MeshFolder,
        *,
        is_gltf: bool,
    ) -> None:
        self._path = path
        self._notes = notes
        self._geometry = scene.geometry
        self._gltf = is_gltf
        self._gltf_materials = gltf_materials
        self._folder = folder
        self._textures = TextureReader(ResourceFolder(path))
        self._shapes: dict[str, nodes.Shape | None] = {}
        self._appearances: dict[tuple[int, bool], nodes.Appearance] = {}
        """By identity of the material, and whether it is unlit on a mesh with colours: then it must not hide them."""
        self._pixels: dict[int, np.ndarray | None] = {}
        """By identity of the image; None if it cannot be had."""
        self._image_nodes: dict[tuple[int, bool, bool, bool], nodes.ImageTexture] = {}
        """By identity of the image, whether its alpha is left out, and whether it repeats along s and t."""

    def shape(self, name: str) -> nodes.Shape | None:
        """The Shape of the geometry with this name; None (and a note) for what has no triangles."""
        if name not in self._shapes:
            mesh: Any = self._geometry[name]
            if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
                described = self._gltf_material(mesh)
                solid = self._gltf and not (described is not None and described.is_double_sided)
                geometry = face_set(mesh, described, self._notes, solid=solid)
                appearance = self._appearance(mesh, colored=geometry.color is not None)
                label = name if self._gltf else ""  # of other formats the name is made up
                self._shapes[name] = nodes.Shape(appearance=appearance, geometry=geometry, name=label)
            else:
                self._notes.skipped[f"{type(mesh).__name__} without triangles"] += 1
                self._shapes[name] = None
        return self._shapes[name]

    def _appearance(self, mesh: Any, *, colored: bool) -> nodes.Appearance:
        """The appearance of a mesh that has colours, or that has none."""
        material = _material_of(mesh)
        described = self._gltf_material(mesh)
        if described is not None and described.is_stand_in:  # one of its own for each shape
            return nodes.Appearance(material=material_from_gltf("", {}, see_through=False))
        if material is None or self._is_stand_in(material):
            return nodes.Appearance(material=nodes.Material())
        hidden = described is not None and described.is_unlit and colored
        key = (id(material), hidden)
        if key not in self._appearances:
            self._appearances[key] = (
                self._from_mtl(material)
                if described is None
                else self._from_gltf(material, described, without_material=hidden)
            )
        appearance = self._appearances[key]
        if described is not None and colored and _replaced_components(appearance.texture):
            self._notes.unused[f"glTF COLOR_0 {_UNDER_TEXTURE}"] += 1
        return appearance

    def _is_stand_in(self, material: Any) -> bool:
        """True for what an obj is given where it has no material, and for the gray one that trimesh makes up for
        texture coordinates without a material: no file is behind its image."""
        image = getattr(material, "image", None)
        return material.name in self._folder.stand_ins or (image is not None and image.format is None)

    def _gltf_material(self, mesh: Any) -> GltfMaterial | None:
        """What the header says about the material of a mesh; None for other formats, and without a material."""
        material = _material_of(mesh)
        return self._gltf_materials[int(material.name or 0)] if isinstance(material, PBRMaterial) else None

    def _from_mtl(self, material: Any) -> nodes.Appearance:
        for key in material.kwargs:
            if key.startswith("map_") or key == "bump":
                self._notes.unused[f"mtl {key}"] += 1
        node = material_from_mtl(material.name, material.kwargs, material.glossiness)
        self._note_unread(material.image, self._folder.textures.get(material.name, ""))
        return nodes.Appearance(material=node, texture=self._texture(material.image))

    def _from_gltf(self, material: Any, described: GltfMaterial, *, without_material: bool) -> nodes.Appearance:
        description = described.description
        name = str(description.get("name", ""))
        repeats = (described.repeat_s, described.repeat_t)
        self._note_unread(material.baseColorTexture, described.image)
        texture = self._texture(material.baseColorTexture, opaque=described.is_opaque, repeats=repeats)
        self._note_base_color(described, texture, in_colors=without_material)
        node: nodes.Material | None = material_from_gltf(name, description, see_through=not described.is_opaque)
        if described.is_unlit:
            replaced = without_material or texture is not None
            node = None if replaced else unlit_material_from_gltf(name, description)
        return nodes.Appearance(material=node, texture=texture)

    def _note_base_color(self, described: GltfMaterial, texture: nodes.Node | None, *, in_colors: bool) -> None:
        """Note a base colour that scales the texture in glTF only."""
        replaced, where = _replaced_components(texture), _UNDER_TEXTURE
        if described.is_unlit and texture is not None and not in_colors:  # there is no material to hold it
            replaced, where = 3 if described.is_opaque else 4, "under the texture of an unlit material"
        if np.any(described.base()[:replaced] != 1.0):
            self._notes.unused[f"glTF baseColorFactor {where}"] += 1

    def _note_unread(self, image: Image.Image | None, name: str) -> None:
        """Note a file that is there, but that trimesh could not open as an image."""
        if image is None and name and name not in self._folder.refused:
            self._notes.missing.append(f"{name!r}: no image that can be read")

    def _texture(
        self, image: Image.Image | None, *, opaque: bool = False, repeats: tuple[bool, bool] = (True, True)
    ) -> nodes.ImageTexture | None:
        """The texture of an image that trimesh opened; None (and a note) if it cannot be decoded."""
        pixels = None if image is None else self._pixels_of(image)
        if image is None or pixels is None:
            return None
        key = (id(image), opaque, *repeats)
        if key not in self._image_nodes:
            shown = pixels[:, :, : pixels.shape[2] - 1] if opaque and pixels.shape[2] in (2, 4) else pixels
            url = _url_of(image)
            self._image_nodes[key] = nodes.ImageTexture(
                image=shown, url=(url,) if url else (), repeat_s=repeats[0], repeat_t=repeats[1]
            )
        return self._image_nodes[key]

    def _pixels_of(self, image: Image.Image) -> np.ndarray | None:
        """The pixels of an image, row 0 at the bottom; decoded once, however many materials use it."""
        if id(image) not in self._pixels:
            url = _url_of(image)
            try:
                pixels = self._textures.first([url]).pixels if url else self._textures.opened(image, self._path)
            except Exception as error:  # Pillow says in many ways that an image is damaged
                self._notes.missing.append(_sentence(error))
                pixels = None
            self._pixels[id(image)] = pixels
        return self._pixels[id(image)]


def _material_of(mesh: Any) -> Any:
    return getattr(mesh.visual, "material", None) if mesh.visual.kind == "texture" else None


def _replaced_components(texture: Any) -> int:
    """How many of red, green, blue and alpha a texture with colours of its own replaces (X3D table 17.3)."""
    components = 0 if texture is None or texture.image is None else texture.image.shape[2]
    return components if components >= 3 else 0


def _url_of(image: Image.Image) -> str:
    """The file that an mtl names; empty for an image that stands in the mesh file."""
    return str(image.info.get("file_path", ""))


@contextlib.contextmanager
def _heard(notes: ReadNotes) -> Iterator[None]:
    """What trimesh and NumPy say about a file while they read it becomes part of the one warning about the file."""
    logger = logging.getLogger("trimesh")
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: notes.remarks.append(record.getMessage().partition("\n")[0])
    propagated, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagated


def _sentence(error: Exception) -> str:
    if isinstance(error, ImportError):  # of what guesses an encoding: bytes that are no text, and not whole
        return "neither text nor complete"
    text = str(error).strip().partition("\n")[0]
    if text == "PLY is unexpected length!":
        return "its length is not that of what it announces with faces of one size; of several an ascii ply may be"
    text = f"an index is out of range: {text}" if isinstance(error, IndexError) else text
    return text[:200] if text else type(error).__name__
