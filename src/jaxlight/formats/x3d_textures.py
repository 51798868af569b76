"""Textures that an X3D file names: read from the file's folder, once each, within a limit for the whole scene."""

from __future__ import annotations

import base64
import binascii
import urllib.parse
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from .folder import ResourceFolder
from .images import decode_image, read_image
from .limits import MAX_PIXELS


class TextureReader:
    """Reads the images behind ImageTexture urls; row 0 of an image is its bottom row."""

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

    def _image(self, url: str) -> tuple[np.ndarray, Path | None]:
        key = url if url.startswith("data:") else self.folder.find(url)
        if key not in self._read:
            image = np.flipud(_decode_data_url(key) if isinstance(key, str) else read_image(key))
            self._pixels_left -= image.shape[0] * image.shape[1]
            if self._pixels_left < 0:
                raise ValueError(f"the scene's textures have more than {MAX_PIXELS} pixels together")
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
