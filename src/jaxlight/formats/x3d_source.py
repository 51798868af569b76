"""What is kept of an X3D file beside its nodes, so that the scene can be written back into the same text."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path
from typing import NamedTuple

from ..scene import nodes
from .errors import SceneFileError
from .limits import read_bounded


class TextureFile(NamedTuple):
    """A texture's file, and by what it is told cheaply whether it is still the one that was read."""

    path: Path
    size: int
    mtime_ns: int

    @classmethod
    def of(cls, path: Path) -> TextureFile:
        """As it is now.

        Raises:
            OSError: there is none.
        """
        status = path.stat()
        return cls(path, status.st_size, status.st_mtime_ns)

    @property
    def is_as_read(self) -> bool:
        """False if the file is gone, or was written since."""
        try:
            return TextureFile.of(self.path) == self
        except OSError:
            return False


@dataclasses.dataclass(frozen=True, eq=False)
class X3DSource:
    """The bytes of an X3D file in its XML encoding and where each node stands in them."""

    path: Path
    data: bytes = dataclasses.field(repr=False)
    element_numbers: dict[nodes.Node, int] = dataclasses.field(repr=False)
    """How many start tags stand before the node's own in the file."""
    texture_files: dict[nodes.Node, TextureFile] = dataclasses.field(repr=False)
    """The file behind each ImageTexture that was read."""
    angle_unit: float
    """Radians in one angle unit of the file."""
    _saved: set[bytes] = dataclasses.field(default_factory=set, init=False, repr=False)
    """Digests of what was written at `path` since."""

    def check_unchanged(self, path: Path) -> None:
        """Refuse to replace the file that was read by what it gave, once somebody else wrote something else there.

        Raises:
            SceneFileError: `path` is that file, and what stands there was neither read nor saved.
        """
        if not self._is_at(path) or not path.exists():
            return
        found = read_bounded(path)
        if found != self.data and hashlib.sha256(found).digest() not in self._saved:
            message = "was changed since it was read, and would be replaced; save under another name, or load it again"
            raise SceneFileError(path, None, message)

    def note_saved(self, path: Path, data: bytes) -> None:
        """Remember what was written, if that was at the place of the file that was read."""
        if self._is_at(path):
            self._saved.add(hashlib.sha256(data).digest())

    def _is_at(self, path: Path) -> bool:
        return path.parent.resolve() / path.name == self.path
