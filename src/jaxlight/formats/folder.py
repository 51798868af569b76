"""Files that a scene names (textures, material libraries): only from the scene's own folder, never from a network."""

from __future__ import annotations

import os
import urllib.parse
from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath

_LONGEST = 4096
"""Characters of a name; no system opens longer ones."""


class ResourceFolder:
    """The folder of a scene file, from which alone the files that it names are read."""

    def __init__(self, scene_path: Path) -> None:
        self.path = scene_path.parent.resolve()

    def find(self, reference: str) -> Path:
        """The file that a relative reference names.

        Raises:
            ValueError: it is absolute, points to a network or outside the folder, or there is no such file; says which.
        """
        for place in self.places(reference):
            if os.path.isfile(place):
                return place
        raise ValueError(f"{_shown(reference)}: no such file beside the scene")

    def places(self, reference: str) -> Iterator[Path]:
        """Where a file of this reference is looked for, one place after the other.

        Raises:
            ValueError: it is absolute, or points to a network or outside the folder.
        """
        if len(urllib.parse.urlsplit(reference).scheme) > 1:
            raise ValueError(f"{_shown(reference)} is an address; only files beside the scene are read")
        yield from (place for name in spellings(reference) if (place := self.place(name)) is not None)

    def place(self, name: str) -> Path | None:
        """Where a file of this name is or would be, behind all links; None: no file can have it.

        Raises:
            ValueError: an absolute path, or outside the folder.
        """
        if PurePosixPath(name).is_absolute() or PureWindowsPath(name).anchor:
            raise ValueError(f"{_shown(name)} is an absolute path; only files beside the scene are read")
        if len(name) > _LONGEST:
            return None
        try:
            path = (self.path / name).resolve()
        except (OSError, RuntimeError, ValueError):  # a name that no file can have, a loop of links
            return None
        if not path.is_relative_to(self.path):
            raise ValueError(f"{_shown(name)} is outside the scene's folder")
        return path


def spellings(reference: str) -> tuple[str, ...]:
    """The names by which a reference is looked for, one after the other."""
    return tuple(dict.fromkeys((reference, urllib.parse.unquote(reference), reference.replace("\\", "/"))))


def _shown(reference: str) -> str:
    return repr(reference if len(reference) <= 60 else f"{reference[:57]}...")
