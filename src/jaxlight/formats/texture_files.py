"""Where the images of ImageTexture nodes go when a scene is written: beside it, under names that start with its own.

A file that the scene was read from, or that one of its urls names, is never written to, and neither is any other file
that was there, unless the scene file that is being replaced names it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import os
import urllib.parse
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import numpy as np

from ..scene import nodes
from .folder import ResourceFolder, spellings
from .images import read_image, write_image
from .limits import read_bounded
from .quantize import quantize
from .safe_write import written_whole
from .x3d_source import X3DSource
from .x3d_values import MFString
from .xml_elements import parse_xml, xml_text


@dataclasses.dataclass
class TexturePlan:
    """The image files that a scene file written to `path` needs beside it."""

    path: Path
    inputs: set[Path]
    """Files never written to, resolved."""
    _copies: dict[Path, Path] = dataclasses.field(default_factory=dict)
    """By where they go, resolved, as the keys of `_images`."""
    _images: dict[Path, np.ndarray] = dataclasses.field(default_factory=dict)
    _absent: set[Path] = dataclasses.field(default_factory=set)
    """Where urls look before they find what they should."""

    def __post_init__(self) -> None:
        self._folder = ResourceFolder(self.path)

    def copied(self, origin: Path, source: ResourceFolder, urls: tuple[str, ...]) -> tuple[str, ...] | None:
        """Plan for a texture that did not change: under the name by which a url finds it, if that is free here too.

        Args:
            origin: the file that it came from, found in `source` by one of its `urls`.

        Returns:
            The new urls, or None if the old ones find this picture beside `path`, and not another one.
        """
        for url in urls:
            found = self._found(url)
            if found is not None:
                if self._copies.get(found) == origin or (not self._is_planned(found) and _same_file(found, origin)):
                    self._settle(urls, found)
                    return None
                if self._is_shown(found):
                    break
            elif (name := _name_of(origin, source, url)) is not None:
                place = self._free_place(url, name)
                if place is None:
                    break
                self._copies[place] = origin
                self._settle(urls, place)
                return None
        target = self._free_name(origin.stem, origin.suffix)
        self._copies[target] = origin
        return (urllib.parse.quote(target.name),)

    def missing(self, source: ResourceFolder, urls: tuple[str, ...]) -> tuple[str, ...] | None:
        """The new urls of a texture whose urls found nothing in `source`; None if they find nothing beside `path`.

        In the folder that they come from they stay: what they name may have been put there meanwhile.
        """
        if source.path == self._folder.path:
            return None
        found = {url: place for url in urls if (place := self._found(url)) is not None}
        left = tuple(url for url in urls if url not in found or not self._is_shown(found[url]))
        self._settle(left, None)
        return None if left == urls else left

    def held(self, urls: tuple[str, ...]) -> tuple[str, ...] | None:
        """The new urls of a texture that did not change and stands in a url itself; None if no file comes before it."""
        before = tuple(itertools.takewhile(lambda url: not url.startswith("data:"), urls))
        for found in filter(None, map(self._found, before)):
            if self._is_shown(found):
                return tuple(url for url in urls if url.startswith("data:"))
        self._settle(before, None)
        return None

    def written(self, image: np.ndarray, urls: tuple[str, ...], label: str) -> tuple[str, ...] | None:
        """Plan for an image that no file holds yet: its first url if that is free or holds the same, or a new name.

        Args:
            image: [height, width, components], row 0 at the bottom.
            urls: the node's urls; empty for an image that changed.
            label: part of a new name.

        Returns:
            The new urls, or None if the old ones stay true.
        """
        url = urls[0] if urls else ""
        if url and xml_text(url) == url:
            name, place = urllib.parse.unquote(url), self._found(url)
            if place is not None:
                place = place if not self._is_planned(place) and _holds(place, image) else None
            elif Path(name).name == name and Path(name).suffix.lower() == ".png":
                place = self._free_place(url, name)
                if place is not None:
                    self._images[place] = image
            if place is not None:
                self._settle((url,), place)
                return None
        target = self._free_name(label, ".png")
        self._images[target] = image
        return (urllib.parse.quote(target.name),)

    @property
    def files(self) -> tuple[Path, ...]:
        """What `carry_out` writes, in the folder of `path`."""
        places = (*self._copies, *self._images)
        return tuple(self.path.parent / place.relative_to(self._folder.path) for place in places)

    def carry_out(self) -> None:
        """Write and copy the files; each is whole or not there."""
        for target, origin in self._copies.items():
            target.parent.mkdir(parents=True, exist_ok=True)
            with written_whole(target) as draft:
                draft.write_bytes(read_bounded(origin))
        for target, image in self._images.items():
            write_image(target, np.flipud(image), bits=_bits_of(image))

    def _is_shown(self, place: Path) -> bool:
        """Whether a reader of the scene would take what is or will be there, and look no further."""
        return self._is_planned(place) or _is_image(place)

    def _is_planned(self, place: Path) -> bool:
        return place in self._images or place in self._copies

    def _found(self, url: str) -> Path | None:
        """The file that the url names when everything planned is there, or None."""
        try:
            for place in self._folder.places(url):
                if self._is_planned(place) or os.path.isfile(place):
                    return place
        except ValueError:  # an address, or outside
            pass
        return None

    def _free_place(self, url: str, name: str) -> Path | None:
        """Where a new file of this name can be, one of the spellings of a url that finds nothing; None: it cannot."""
        try:
            place = self._folder.place(name) if any(self._folder.places(url)) else None
        except ValueError:  # an address, or outside
            return None
        # A link on the way would lead the file to where nobody looks for it.
        is_direct = place == Path(os.path.normpath(self._folder.path / name))
        return place if place is not None and is_direct and place not in self._absent and _is_free(place) else None

    def _settle(self, urls: tuple[str, ...], place: Path | None) -> None:
        """From now on nothing may come between the urls and the file that they find."""
        for url in urls:
            with contextlib.suppress(ValueError):
                for before in self._folder.places(url):
                    if before == place:
                        return
                    self._absent.add(before)

    def _free_name(self, label: str, suffix: str) -> Path:
        """A name that starts with the scene's own and that no input, nothing in this plan and no stranger has."""
        stem = f"{self.path.stem}_{''.join(c if c.isalnum() or c in '-_' else '_' for c in label)[:40]}"
        number, target = 1, self._folder.path / f"{stem}{suffix}"
        while not self._is_usable(target):
            number += 1
            target = self._folder.path / f"{stem}_{number}{suffix}"
        return target

    def _is_usable(self, target: Path) -> bool:
        """True if writing `target` destroys nothing but a file of the replaced scene, and its url leads to it."""
        for place in {target, target.with_name(urllib.parse.quote(target.name))}:
            if self._is_planned(place) or place in self._absent or _resolved(place) in self.inputs:
                return False
            if os.path.lexists(place) and (place != target or place.is_dir() or _resolved(place) not in self._replaced):
                return False
        return True

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


def _name_of(origin: Path, source: ResourceFolder, url: str) -> str | None:
    """The spelling of a url by which `source` finds this file; None: it does not."""
    try:
        if source.find(url) == origin:
            return next(name for name in spellings(url) if source.place(name) == origin)
    except ValueError:
        pass
    return None


def _same_file(found: Path, origin: Path) -> bool:
    return found.samefile(origin) or read_bounded(found) == read_bounded(origin)


def _is_image(path: Path) -> bool:
    """True if a reader of the scene would take this file, and look no further."""
    try:
        read_image(path)
    except (ValueError, ImportError):
        return False
    return True


def _holds(path: Path, image: np.ndarray) -> bool:
    """True if the file has these texels, to as many bits as they would be written with."""
    try:
        found = np.flipud(read_image(path))
    except (ValueError, ImportError):
        return False
    bits = _bits_of(image)
    return found.shape == image.shape and np.array_equal(quantize(found, bits), quantize(image, bits))


def _bits_of(image: np.ndarray) -> Literal[8, 16]:
    """16 for texels that are levels of 16 bits, as those of a file that had so many; 8 for all others."""
    if np.array_equal(quantize(image) / 255, image):
        return 8
    return 16 if np.array_equal(quantize(image, 16) / 65535, image) else 8


def named_files(scene_path: Path, everything: Iterable[nodes.Node]) -> set[Path]:
    """The files that the urls of textures name, seen from where the scene is written."""
    urls = {url for node in everything if isinstance(node, nodes.ImageTexture) for url in node.url if len(url) < 1000}
    files = (_resolved(scene_path.parent / name) for url in urls for name in spellings(url))
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
    plan: TexturePlan, node: nodes.ImageTexture, new: nodes.ImageTexture, source: X3DSource | None
) -> tuple[str, ...] | None:
    """The urls that a texture gets, or None if it keeps its own.

    Args:
        plan: takes up what has to be written.
        node: the texture as it was read or built.
        new: the same with the texels that it has now.
        source: the file that is written back into, if any.
    """
    if new.image is None:
        return None if source is None else plan.missing(ResourceFolder(source.path), node.url)
    if new.image is not node.image:
        return plan.written(new.image, (), node.name or "texture")
    if source is None:
        is_held = bool(node.url) and node.url[0].startswith("data:")
        return None if is_held else plan.written(new.image, node.url, node.name or "texture")
    origin = source.texture_files.get(node)
    if origin is None:
        return plan.held(node.url)
    if not origin.is_as_read and not _holds(origin.path, new.image):
        return plan.written(new.image, node.url, node.name or origin.path.stem)
    return plan.copied(origin.path, ResourceFolder(source.path), node.url)
