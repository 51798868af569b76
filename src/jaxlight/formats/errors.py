"""What goes wrong with files: errors and warnings that say which file, which line, what came and what is allowed."""

from __future__ import annotations

from pathlib import Path


class SceneFileError(ValueError):
    """A file that cannot be read; `str()` gives `path:line: what is wrong`."""

    def __init__(self, path: str | Path, line: int | None, message: str) -> None:
        super().__init__(path, line, message)
        self.path = Path(path)
        self.line = line
        self.message = message

    def __str__(self) -> str:
        place = self.path if self.line is None else f"{self.path}:{self.line}"
        return f"{place}: {self.message}"


class SceneFileWarning(UserWarning):
    """A file was read, but not all of it: nodes skipped, values clamped, textures that could not be had."""
