"""Where the images of ImageTexture nodes go when a scene is written: beside it, under names that start with its own.

A file that the scene was read from, or that one of its urls names, is never written to, and neither is any other file
that was there, unless the scene file that is being replaced names it.
"""

from __future__ import annotations

import dataclasses
import functools
import urllib.parse
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..scene import nodes
from .errors import SceneFileError
from .folder import ResourceFolder
from .images import read_image, write_image
from .limits import read_bounded
from .quantize import quantize
from .safe_write import written_whole
from .x3d_values import MFString
from .xml_elements import parse_xml


@dataclasses.dataclass
class TexturePlan:
    """The image files that a scene file written to `path` needs beside it."""

    path: Path
    inputs: set[Path]
    """Files never written to, resolved."""
    _copies: dict[Path, Path] = dataclasses.field(default_factory=dict)
    _images: dict[Path, np.ndarray] = dataclasses.field(default_factory=dict)

    def copied(self, origin: Path, folder: Path) -> str | None:
        """Plan for a texture that did not change and came from a file below `folder`: the same place beside `path`.

        Returns:
            The new url, or None if the old one stays true.
        """
        wanted = self.path.parent / origin.relative_to(folder)
        if wanted.exists() and (wanted.samefile(origin) or read_bounded(wanted) == read_bounded(origin)):
            return None
        if not wanted.exists() and wanted not in self._images and self._copies.get(wanted, origin) == origin:
            self._copies[wanted] = origin
            return None
        target = self._free_name(origin.stem, origin.suffix)
        self._copies[target] = origin
        return urllib.parse.quote(target.name)

    def written(self, image: np.ndarray, urls: tuple[str, ...], label: str) -> str | None:
        """Plan for an image that no file holds yet: its first url if that is free or holds the same, or a new name.

        Args:
            image: [height, width, components], row 0 at the bottom.
            urls: the node's urls; empty for an image that changed.
            label: part of a new name.

        Returns:
            The new url, or None if the old one stays true.
        """
        for url in urls[:1]:
            name = Path(urllib.parse.unquote(url))
            target = self.path.parent / name
            if _holds(self.path, url, image):
                return None
            is_free = _is_free(target) and target not in self._copies and target not in self._images
            if is_free and name.name == str(name) and name.suffix.lower() == ".png":
                self._images[target] = image
                return None
        target = self._free_name(label, ".png")
        self._images[target] = image
        return urllib.parse.quote(target.name)

    def carry_out(self) -> None:
        """Write and copy the files; each is whole or not there."""
        for target, origin in self._copies.items():
            target.parent.mkdir(parents=True, exist_ok=True)
            with written_whole(target) as draft:
                draft.write_bytes(read_bounded(origin))
        for target, image in self._images.items():
            write_image(target, np.flipud(image))

    def _free_name(self, label: str, suffix: str) -> Path:
        """A name that starts with the scene's own and that no input, nothing in this plan and no stranger has."""
        stem = f"{self.path.stem}_{''.join(c if c.isalnum() or c in '-_' else '_' for c in label)[:40]}"
        number, target = 1, self.path.parent / f"{stem}{suffix}"
        while target.resolve() in self.inputs or target in self._copies or target in self._images or self._lost(target):
            number += 1
            target = self.path.parent / f"{stem}_{number}{suffix}"
        return target

    def _lost(self, target: Path) -> bool:
        """True if writing `target` would destroy a file that is not the replaced scene's."""
        return (target.is_symlink() or target.exists()) and target.resolve() not in self._replaced

    @functools.cached_property
    def _replaced(self) -> set[Path]:
        """The files that the textures of the scene file at `path` name; empty if there is none that can be read."""
        try:
            stack, textures = [parse_xml(self.path, read_bounded(self.path))], []
            while stack:
                element = stack.pop()
                stack.extend(element.children)
                if element.tag == "ImageTexture":
                    textures.append(nodes.ImageTexture(url=MFString.parse(element.attributes.get("url", ""))))
        except ValueError:  # as all errors of files
            return set()
        return named_files(self.path, textures)


def _holds(scene_path: Path, url: str, image: np.ndarray) -> bool:
    """True if the url already names a file beside the scene with these texels, to 8 bits."""
    try:
        found = np.flipud(read_image(ResourceFolder(scene_path).find(url)))
    except (SceneFileError, ValueError, ImportError):
        return False
    return found.shape == image.shape and np.array_equal(quantize(found), quantize(image))


def named_files(scene_path: Path, everything: Iterable[nodes.Node]) -> set[Path]:
    """The files that the urls of textures name, seen from where the scene is written."""
    urls = {url for node in everything if isinstance(node, nodes.ImageTexture) for url in node.url if len(url) < 1000}
    files = (_resolved(scene_path.parent / urllib.parse.unquote(url)) for url in urls)
    return {file for file in files if file is not None}


def _resolved(path: Path) -> Path | None:
    """The file behind all links; None for a name that no file can have, and for links in a circle."""
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):
        return None


def _is_free(path: Path) -> bool:
    """True if nothing has this name and a file can have it: it is not too long, and of characters that names hold."""
    try:
        path.lstat()
    except FileNotFoundError:
        return True
    except (OSError, ValueError):
        return False
    return False


def texture_url(
    plan: TexturePlan, node: nodes.ImageTexture, new: nodes.ImageTexture, origin: Path | None, folder: Path | None
) -> str | None:
    """The url that a texture gets, or None if it keeps its own.

    Args:
        plan: takes up what has to be written.
        node: the texture as it was read or built.
        new: the same with the texels that it has now.
        origin: the file that it was read from, if any, and `folder`, the folder of its scene.
    """
    if new.image is None:
        return None
    if new.image is not node.image:
        return plan.written(new.image, (), node.name or "texture")
    if origin is not None and folder is not None:
        return plan.copied(origin, folder)
    if node.url and node.url[0].startswith("data:"):
        return None
    return plan.written(new.image, node.url, node.name or "texture")
