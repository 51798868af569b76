"""Textures that a scene file names or holds: read from its folder, once each, within a limit for the whole scene."""

from __future__ import annotations

import base64
import binascii
import urllib.parse
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image

from .folder import ResourceFolder
from .images import decode_image, pixels_of, read_image
from .limits import MAX_PIXELS


class TextureReader:
    """Reads the images of a scene; row 0 of an image is its bottom row."""

    def __init__(self, folder: ResourceFolder) -> None:
        self.folder = folder
        self._pixels_left = MAX_PIXELS
        self._read: dict[Path | str, np.ndarray] = {}

    def first(self, urls: Iterable[str]) -> tuple[np.ndarray, Path | None]:
        """The first of the alternatives that can be had, and the file that it came from.

        Raises:
            ValueError: none of them can; says why.
        """
        reasons = []
        for url in urls:
            try:
                return self._image(url)
            except (ValueError, ImportError) as error:
                reasons.append(str(error))
        raise ValueError(" / ".join(reasons))

    def opened(self, image: Image.Image, path: Path) -> np.ndarray:
        """The pixels of an image that stands in the scene's own file, at `path`, and was opened by Pillow.

        Raises:
            ValueError: it cannot be decoded, or the scene has too many pixels; says why.
        """
        self._take(image.width * image.height)
        return np.flipud(pixels_of(image, path))

    def _take(self, pixels: int) -> None:
        """Take pixels from those that the scene may have; an error from the moment on that there are not enough."""
        self._pixels_left -= pixels
        if self._pixels_left < 0:
            raise ValueError(f"the scene's textures have more than {MAX_PIXELS} pixels together")

    def _image(self, url: str) -> tuple[np.ndarray, Path | None]:
        key = url if url.startswith("data:") else self.folder.find(url)
        if key not in self._read:
            self._take(0)
            image = np.flipud(_decode_data_url(key) if isinstance(key, str) else read_image(key))
            self._take(image.shape[0] * image.shape[1])
            image.setflags(write=False)
            self._read[key] = image
        return self._read[key], key if isinstance(key, Path) else None


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
