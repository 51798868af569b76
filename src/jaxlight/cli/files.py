"""Input files that exist, and output files that never destroy an input."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxlight import Scene


def existing(*paths: Path) -> None:
    """Raise ValueError for the first path that is not a file."""
    for path in paths:
        if path.is_dir():
            raise ValueError(f"{path}: expected a file, got a folder")
        if not path.is_file():
            from ..formats.limits import what_it_is

            raise ValueError(f"{path}: {what_it_is(path)}")


def spare(inputs: Iterable[Path], outputs: Iterable[Path]) -> None:
    """Raise ValueError if writing one of `outputs` would destroy one of `inputs` (also through a link) or has no place.

    Folders of outputs that are not there yet will be made.
    """
    from ..formats.limits import resolved

    inputs = [path for path in inputs if path.exists()]
    for output in outputs:
        place = resolved(output)  # a/../b is b, even before there is an a
        for path in inputs:
            if place.exists() and place.samefile(path):
                raise ValueError(f"{output}: is an input of this command; choose another output")


def files_of_scene(path: Path, scene: Scene) -> set[Path]:
    """A scene's file and those that its textures name."""
    from jaxlight.formats.texture_files import named_files
    from jaxlight.formats.x3d_writer import all_nodes

    return {path, *named_files(path, all_nodes(scene.document.children))}


def picture_path(path: Path) -> None:
    """Raise ValueError if no picture can be written under this name: said before the work, not after it."""
    if path.is_dir():
        raise ValueError(f"{path}: expected a file, got a folder")
    for folder in path.parents:
        if folder.exists() and not folder.is_dir():
            raise ValueError(f"{folder}: expected a folder, got a file")
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg", ".exr"):
        raise ValueError(f"{path}: expected a name that ends in .png, .jpg, .jpeg or .exr")
