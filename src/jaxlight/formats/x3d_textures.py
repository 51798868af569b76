"""Textures that a scene file names or holds: read from its folder, once each, within a limit for the whole scene."""

from __future__ import annotations

import base64
import binascii
import urllib.parse
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from .folder import ResourceFolder
from .images import decode_image, pixels_of, read_image
from .limits import MAX_PIXELS
from .x3d_source import TextureFile

_MOST_URLS = 100
"""Of the alternatives of one texture so many are looked for."""


class TextureImage(NamedTuple):
    """A texture that could be had."""

    pixels: np.ndarray
    """[height, width, components], row 0 at the bottom, in [0, 1]."""
    was_clamped: bool
    """True if there were numbers outside."""
    file: TextureFile | None
    """Where it came from, as it was before it was read; None: it stood in the url."""


class TextureReader:
    """Reads the images of a scene; row 0 of an image is its bottom row."""

    def __init__(self, folder: ResourceFolder) -> None:
        self.folder = folder
        self._pixels_left = MAX_PIXELS
        self._read: dict[Path | str, TextureImage] = {}

    def first(self, urls: Iterable[str]) -> TextureImage:
        """The first of the alternatives that can be had.

        Raises:
            ValueError: none of them can; says why.
        """
        reasons, distinct = [], list(dict.fromkeys(urls))
        if len(distinct) > _MOST_URLS:
            reasons.append(f"only the first {_MOST_URLS} of {len(distinct)} urls are looked for")
        for url in distinct[:_MOST_URLS]:
            try:
                return self._image(url)
            except (OSError, ValueError, ImportError) as error:
                reasons.append(str(error))
        raise ValueError(" / ".join(reasons))

    def opened(self, image: Image.Image, path: Path) -> np.ndarray:
        """The pixels of an image that stands in the scene's own file, at `path`, and was opened by Pillow.

        Raises:
            ValueError: it cannot be decoded, or the scene has too many pixels; says why.
        """
        self._take(image.width * image.height)
        return _fixed(np.flipud(pixels_of(image, path)))

    def _take(self, pixels: int) -> None:
        """Take pixels from those that the scene may have; an error from the moment on that there are not enough."""
        self._pixels_left -= pixels
        if self._pixels_left < 0:
            raise ValueError(f"the scene's textures have more than {MAX_PIXELS} pixels together")

    def _image(self, url: str) -> TextureImage:
        key = url if url.startswith("data:") else self.folder.find(url)
        if key not in self._read:
            self._take(0)
            file = None if isinstance(key, str) else TextureFile.of(key)
            image = _fixed(np.flipud(_decode_data_url(key) if isinstance(key, str) else read_image(key)))
            self._take(image.shape[0] * image.shape[1])
            if not np.all(np.isfinite(image)):
                raise ValueError(f"{url[:60]!r} holds numbers that are not finite")
            was_clamped = bool(image.min() < 0 or image.max() > 1)
            pixels = _fixed(np.clip(image, 0, 1)) if was_clamped else image
            self._read[key] = TextureImage(pixels, was_clamped, file)
        return self._read[key]


def _fixed(pixels: np.ndarray) -> np.ndarray:
    """An array of their own, which nodes share."""
    own = pixels if pixels.flags.owndata else pixels.copy()
    own.setflags(write=False)
    return own


def _decode_data_url(url: str) -> np.ndarray:
    """The image that a `data:` address holds."""
    head, _, body = url.partition(",")
    try:
        data = urllib.parse.unquote_to_bytes(body)
        if head.endswith(";base64"):
            data = base64.b64decode(data, validate=False)
    except binascii.Error as error:
        raise ValueError(f"{head[:40]}: {error}") from None
    return decode_image(data, Path(f"{head[:40]},..."))
