"""Files that a scene names (textures, material libraries): only from the scene's own folder, never from a network."""

from __future__ import annotations

import os
import urllib.parse
from pathlib import Path, PurePosixPath, PureWindowsPath


class ResourceFolder:
    """The folder of a scene file, from which alone the files that it names are read."""

    def __init__(self, scene_path: Path) -> None:
        self.path = scene_path.parent.resolve()

    def find(self, reference: str) -> Path:
        """The file that a relative reference names.

        Raises:
            ValueError: it points to a network or outside the folder, or there is no such file; says which.
        """
        if len(urllib.parse.urlsplit(reference).scheme) > 1:
            raise ValueError(f"{_shown(reference)} is an address; only files beside the scene are read")
        for name in dict.fromkeys((reference, urllib.parse.unquote(reference), reference.replace("\\", "/"))):
            found = self._inside(name)
            if found is not None:
                return found
        raise ValueError(f"{_shown(reference)}: no such file beside the scene")

    def _inside(self, name: str) -> Path | None:
        if PurePosixPath(name).is_absolute() or PureWindowsPath(name).anchor:
            raise ValueError(f"{_shown(name)} is outside the scene's folder")
        try:
            path = (self.path / name).resolve()
        except (OSError, RuntimeError, ValueError):  # a name that no file can have, a loop of links
            return None
        if not path.is_relative_to(self.path):
            raise ValueError(f"{_shown(name)} is outside the scene's folder")
        return path if os.path.isfile(path) else None


def _shown(reference: str) -> str:
    return repr(reference if len(reference) <= 60 else f"{reference[:57]}...")
