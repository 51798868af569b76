"""The files that a mesh names: material libraries of an obj, textures and buffers, for trimesh to ask for."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from trimesh.resolvers import Resolver

from .folder import ResourceFolder
from .limits import MAX_FILE_BYTES, read_bounded
from .mtl_text import joined_libraries
from .notes import ReadNotes
from .obj_text import LIBRARY, ObjText


class MeshFolder(Resolver):
    """Gives trimesh the files that a mesh names, from the mesh's folder only; what cannot be had is noted."""

    def __init__(self, path: Path, notes: ReadNotes) -> None:
        self._folder = ResourceFolder(path)
        self._notes = notes
        self._library = b""
        self.textures: dict[str, str] = {}
        """By the names of the materials of an obj, their files."""
        self.refused: set[str] = set()
        """What could not be had."""
        self.stand_ins: set[str] = set()
        """Names of materials of an obj that stand for none."""

    def read_libraries(self, text: ObjText) -> None:
        """Read all material files that an obj names, and note the materials that none of them has."""
        found = list(self._all_to_be_had(text.libraries))
        library = joined_libraries(found, self._notes)
        self._library, self.textures = library.data, library.textures
        missing = [name for name in text.materials if name not in library.names]
        if found:
            self._notes.remarks += [f"no material file has the material {name!r}" for name in missing]
        if text.colored:
            self.stand_ins = {text.bare, *missing}
            self._library = b"\n".join([library.data, *(f"newmtl {name}".encode() for name in self.stand_ins)])

    def get(self, name: str) -> bytes:
        if name == LIBRARY:
            return self._library
        try:
            return read_bounded(self._folder.find(name))
        except ValueError as error:
            self.refused.add(name)
            self._notes.missing.append(str(error))
            raise FileNotFoundError(str(error)) from None

    def _all_to_be_had(self, names: list[str]) -> Iterator[bytes]:
        left = MAX_FILE_BYTES
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                library = self.get(name)
                left -= len(library)
                if left < 0:
                    self._notes.missing.append(f"{name}: material files of more than {MAX_FILE_BYTES // 2**20} MiB")
                    return
                yield library

    def write(self, name: str, data: Any) -> None:
        raise PermissionError("reading a mesh writes nothing")

    def namespaced(self, namespace: str) -> MeshFolder:
        raise FileNotFoundError(namespace)

    def keys(self) -> list[str]:
        return []
