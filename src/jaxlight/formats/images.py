"""Image files <-> arrays of numbers as they stand in the file; what they mean (linear, sRGB) is the image stage's.

PNG, JPEG, BMP, GIF, TIFF and WebP through Pillow; EXR, and colour PNG and TIFF with 16 bits, of which Pillow keeps 8,
through OpenImageIO (extra `exr`).
"""

from __future__ import annotations

import io
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from PIL import Image, ImageOps
from PIL.TiffImagePlugin import (
    BITSPERSAMPLE,
    EXTRASAMPLES,
    PHOTOMETRIC_INTERPRETATION,
    PLANAR_CONFIGURATION,
    SAMPLESPERPIXEL,
    TiffImageFile,
)

from ..arrays import known_numbers
from ..scene.fields import whole
from ..tracing import refuse_traced
from .errors import SceneFileError
from .levels import refuse_levels
from .limits import MAX_PIXELS, as_path, read_bounded
from .quantize import quantize
from .safe_write import written_whole

_Read = TypeVar("_Read")
_PILLOW_FORMATS = ("PNG", "JPEG", "BMP", "GIF", "TIFF", "WEBP")
_MODES = {1: "L", 2: "LA", 3: "RGB", 4: "RGBA"}
MAX_JPEG_SIDE = 65500
"""Pixels that libjpeg writes in a row or a column."""
_CUT_MODES = ("RGB", "RGBA", "RGBX", "LA", "CMYK")
"""Of which Pillow keeps 8 bits of 16."""
_TURNED: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    1: lambda pixels: pixels,
    2: lambda pixels: pixels[:, ::-1],
    3: lambda pixels: pixels[::-1, ::-1],
    4: lambda pixels: pixels[::-1],
    5: lambda pixels: pixels.swapaxes(0, 1),
    6: lambda pixels: np.rot90(pixels, -1),
    7: lambda pixels: pixels[::-1, ::-1].swapaxes(0, 1),
    8: np.rot90,
}
"""By a camera's rotation mark (Exif 4.6.4, Orientation), the picture upright."""
_PNG = b"\x89PNG\r\n\x1a\n"
_EXR = b"\x76\x2f\x31\x01"


def read_image(path: str | Path) -> np.ndarray:
    """The pixels of an image file.

    Args:
        path: PNG, JPEG, BMP, GIF, TIFF or WebP, 8 bits a component; PNG and TIFF with 16; EXR.

    Returns:
        float64 [height, width, 1 to 4 components], row 0 at the top. Integers are divided by the largest one of their
        size, so lie in [0, 1]; the numbers of an EXR file stand as they are. A camera's rotation mark is obeyed.

    Raises:
        ValueError: no path.
        SceneFileError: no such file, not an image, damaged, or more than MAX_PIXELS pixels.
        ImportError: the file needs OpenImageIO, which is not installed.
    """
    path = as_path("read_image: path", path)
    return decode_image(read_bounded(path), path)


def is_exr(path: Path) -> bool:
    """Whether a file that can be read is an EXR, by its content."""
    with path.open("rb") as file:
        return file.read(len(_EXR)) == _EXR


def holds_levels(path: Path) -> bool:
    """Whether a file that can be read holds whole numbers, which end at 1 when they are read: not floats."""
    return not is_exr(path) and _read_with_pillow(read_bounded(path), path, lambda image: image.mode != "F")


def decode_image(data: bytes, path: Path) -> np.ndarray:
    """As `read_image`, from the content of a file; `path` names it in messages."""
    if data.startswith(_EXR):
        return _read_with_openimageio(data, path, "EXR", ".exr")
    if data.startswith(_PNG) and data[24:25] == b"\x10" and data[25:26] in (b"\x02", b"\x04", b"\x06"):
        return _read_with_openimageio(data, path, "16-bit colour PNG", ".png")

    def read(image: Image.Image) -> np.ndarray:
        if isinstance(image, TiffImageFile) and image.mode in _CUT_MODES and _bits(image) > 8:
            _check_pixels(image, path)
            pixels = _read_with_openimageio(data, path, f"{_bits(image)}-bit colour TIFF", ".tif")
            return _divided_by_alpha(pixels) if _is_multiplied_by_alpha(image) else pixels
        if data.startswith(_PNG) and image.mode == "L" and isinstance(image.info.get("transparency"), int):
            # Of 2 or 4 bits Pillow scales the pixels to 8, but not the level that is transparent.
            image.info["transparency"] *= 255 // (2 ** min(data[24], 8) - 1)
        return pixels_of(image, path)

    return _read_with_pillow(data, path, read)


def read_levels(path: Path) -> np.ndarray:
    """The whole numbers [height, width] of a PNG or TIFF that holds one a pixel: grey levels or palette indices.

    Raises:
        SceneFileError: as `read_image`, or another picture.
    """
    data = read_bounded(path)

    def read(image: Image.Image) -> np.ndarray:
        bits = _bits(image) if isinstance(image, TiffImageFile) else data[24] if data.startswith(_PNG) else 0
        # Grey levels of fewer bits are scaled by Pillow.
        if bits == 0 or not (image.mode == "P" or (image.mode, bits) == ("L", 8) or (image.mode[0], bits) == ("I", 16)):
            expected = "expected a PNG or TIFF of grey levels of 8 or 16 bits, or of palette indices"
            raise SceneFileError(path, None, f"{expected}, got a {image.format} of mode {image.mode}")
        _check_pixels(image, path)
        return np.asarray(ImageOps.exif_transpose(image) or image)

    return _read_with_pillow(data, path, read)


def _read_with_pillow(data: bytes, path: Path, read: Callable[[Image.Image], _Read]) -> _Read:
    """What `read` makes of the image; whatever a decoder says of its content is a SceneFileError."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow's own word on large images; the limit here is ours
        try:
            with Image.open(io.BytesIO(data), formats=_PILLOW_FORMATS) as image:
                return read(image)
        except SceneFileError:
            raise
        except (OSError, SyntaxError, ValueError, EOFError, MemoryError, Image.DecompressionBombError) as error:
            raise SceneFileError(path, None, f"not an image that can be read: {_reason(error)}") from None
        except Exception as error:  # a decoder stumbling over a damaged file, in whatever way
            raise SceneFileError(path, None, f"damaged image: {type(error).__name__}: {error}") from None


def pixels_of(image: Image.Image, path: Path) -> np.ndarray:
    """The pixels of an opened Pillow image, as `read_image` returns them."""
    _check_pixels(image, path)
    # Pillow's mode for whole numbers of 32 bits, of which nothing says how large they may be.
    if image.mode == "I" and image.format != "PNG":
        raise SceneFileError(path, None, "whole numbers of 32 bits; 8 or 16 bits a component are read")
    image.load()
    image_file = image
    clear = image.info.get("transparency")
    image = ImageOps.exif_transpose(image) or image
    if image.mode.startswith("I"):
        pixels, largest = np.array(image, dtype=np.float64), 65535.0
        if isinstance(image_file, TiffImageFile) and image_file.tag_v2.get(PHOTOMETRIC_INTERPRETATION) == 0:
            pixels = largest - pixels  # 0 is white, which Pillow obeys for 8 bits only
        if clear is not None:  # the level of what is transparent
            pixels = np.stack([pixels, np.where(pixels == clear, 0.0, largest)], axis=-1)
    elif image.mode == "F":
        pixels, largest = np.array(image, dtype=np.float64), 1.0
    else:
        pixels, largest = np.array(image.convert(_plain_mode(image)), dtype=np.float64), 255.0
    pixels = np.atleast_3d(pixels)
    pixels /= largest  # in place: a large image is held once
    return pixels


def _check_pixels(image: Image.Image, path: Path) -> None:
    if image.width * image.height > MAX_PIXELS:
        raise SceneFileError(path, None, f"{image.width} x {image.height} pixels; at most {MAX_PIXELS} are read")
    if isinstance(image, TiffImageFile) and image.tile:
        _check_covered(image, path)


def _check_covered(image: TiffImageFile, path: Path) -> None:
    """Whether strips or tiles cover a TIFF that is not loaded yet; Pillow leaves black what none does."""
    tiles: list[Any] = image.tile
    is_planar = image.tag_v2.get(PLANAR_CONFIGURATION) == 2 and tiles[0][0] != "libtiff"
    planes = image.tag_v2.get(SAMPLESPERPIXEL, 1) if is_planar else 1
    areas = [(right - left) * (bottom - top) for _, (left, top, right, bottom), *_ in tiles]
    if sum(areas) < image.width * image.height * planes:
        message = f"damaged image: its {len(areas)} strips or tiles do not cover {image.width} x {image.height} pixels"
        raise SceneFileError(path, None, message)


def _bits(image: TiffImageFile) -> int:
    """The most bits that a component has."""
    return max(image.tag_v2.get(BITSPERSAMPLE, (1,)))


def _is_multiplied_by_alpha(image: TiffImageFile) -> bool:
    """Whether alpha is "associated" (TIFF 6.0, ExtraSamples)."""
    return tuple(image.tag_v2.get(EXTRASAMPLES, ())) == (1,)


def _divided_by_alpha(pixels: np.ndarray) -> np.ndarray:
    """What Pillow does with 8 bits: colours as they are where all is covered; 0 where nothing is."""
    color, alpha = pixels[..., :-1], pixels[..., -1:]
    color[...] = np.minimum(np.divide(color, alpha, out=np.zeros_like(color), where=alpha > 0), 1.0)
    return pixels


def _plain_mode(image: Image.Image) -> str:
    gray = image.mode in ("1", "L", "LA", "La")
    alpha = "transparency" in image.info or image.mode in ("LA", "La", "RGBA", "RGBa", "PA")
    return _MODES[(1 if gray else 3) + alpha]


def write_image(path: str | Path, image: Any, *, bits: int = 8) -> None:
    """Write an image file whole: a reader sees the old file or the new one.

    Args:
        path: .png, .jpg, .jpeg or .exr says the format.
        image: [height, width] or [height, width, 1 to 4 components], row 0 at the top. Integer formats hold [0, 1]:
            smaller and larger numbers are clamped, then rounded; EXR (32-bit float) holds them as they are.
        bits: 8 or 16 a component, of a PNG.

    Raises:
        ValueError: a shape, a suffix or a number (NaN, or too large for EXR) that cannot be written; integers above 1
            (levels) for numbers; traced arrays.
        ImportError: it needs OpenImageIO, which is not installed.
        OSError: the folder does not exist, or the system refuses.
    """
    path = as_path("write_image: path", path)
    refuse_traced("write_image", image)
    numbers = known_numbers(str(path), image, "[height, width, 1 to 4 components]")
    refuse_levels(str(path), numbers)
    pixels = numbers.astype(np.float64)
    pixels = pixels[:, :, None] if pixels.ndim == 2 else pixels
    if pixels.ndim != 3 or pixels.shape[2] not in _MODES or pixels.size == 0:
        raise ValueError(f"{path}: expected [height, width, 1 to 4 components], got shape {list(pixels.shape)}")
    if np.isnan(pixels).any():
        raise ValueError(f"{path}: the image holds NaN in {int(np.isnan(pixels).any(axis=2).sum())} pixels")
    suffix = path.suffix.lower()
    if suffix not in (".png", ".jpg", ".jpeg", ".exr"):
        raise ValueError(f"{path}: expected a name that ends in .png, .jpg, .jpeg or .exr")
    bits = whole(f"{path}: bits", bits, at_least=1)
    if bits not in (8, 16) or (bits == 16 and suffix != ".png"):
        raise ValueError(f"{path}: expected 8 bits, or 16 for a .png, got bits={bits}")
    if suffix in (".jpg", ".jpeg"):
        _check_jpeg(path, *pixels.shape)
    if suffix == ".exr":
        _check_exr(path, pixels)
    with written_whole(path) as draft:
        if suffix == ".exr":
            _write_with_openimageio(draft, pixels.astype(np.float32), "float", path)
        elif bits == 16:
            _write_16_bit_png(draft, quantize(pixels, 16), path)
        else:
            levels = quantize(pixels)
            squeezed = levels[:, :, 0] if levels.shape[2] == 1 else levels
            options: dict[str, Any] = {} if suffix == ".png" else {"quality": 95, "subsampling": 0}
            Image.fromarray(squeezed, _MODES[levels.shape[2]]).save(draft, **options)


def _check_jpeg(path: Path, height: int, width: int, components: int) -> None:
    if components in (2, 4):
        raise ValueError(f"{path}: JPEG has no alpha; got {components} components")
    if max(height, width) > MAX_JPEG_SIDE:
        raise ValueError(f"{path}: {width} x {height} pixels; JPEG holds at most {MAX_JPEG_SIDE} a side")


def _check_exr(path: Path, pixels: np.ndarray) -> None:
    largest = float(np.finfo(np.float32).max)
    too_large = pixels[np.isfinite(pixels) & (np.abs(pixels) > largest)]
    if too_large.size:
        raise ValueError(f"{path}: {too_large[0]:g} is larger than EXR's float32 holds, {largest:g}")


def _write_16_bit_png(draft: Path, levels: np.ndarray, path: Path) -> None:
    if levels.shape[2] == 1:
        Image.fromarray(levels[:, :, 0]).save(draft)
    else:
        _write_with_openimageio(draft, levels, "uint16", path)


def _openimageio(what: str) -> Any:
    try:
        import OpenImageIO
    except ImportError:
        raise ImportError(f"{what} needs OpenImageIO: pip install 'jaxlight[exr]'") from None
    return OpenImageIO


def _read_with_openimageio(data: bytes, path: Path, what: str, suffix: str) -> np.ndarray:
    library = _openimageio(f"{path}: reading {what}")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / f"image{suffix}"
        copy.write_bytes(data)  # the library opens files only
        as_stored = library.ImageSpec()
        as_stored.attribute("oiio:UnassociatedAlpha", 1)  # no multiplication of colour by alpha
        file = library.ImageInput.open(str(copy), as_stored)
        if file is None:
            said = _said_by(library).replace(str(copy), path.name)
            raise SceneFileError(path, None, f"not an image that can be read: {said}")
        try:
            upright = _TURNED.get(file.spec().get_int_attribute("Orientation", 1), _TURNED[1])
            return upright(_pixels_of_file(library, file, path))
        finally:
            file.close()


def _pixels_of_file(library: Any, file: Any, path: Path) -> np.ndarray:
    """The picture in its whole window: what the file does not hold of it is 0."""
    spec = file.spec()
    height, width = spec.full_height, spec.full_width
    channels = _color_channels(list(spec.channelnames))
    first, last = min(channels), max(channels) + 1
    pixels = max(spec.width * spec.height, width * height)
    if pixels > MAX_PIXELS or pixels * (last - first) > 4 * MAX_PIXELS:
        raise SceneFileError(path, None, f"{width} x {height} pixels; at most {MAX_PIXELS} are read")
    held = file.read_image(0, 0, first, last, library.FLOAT)
    if held is None:
        raise SceneFileError(path, None, f"damaged image: {_said_by(file)}")
    with np.errstate(invalid="ignore"):  # NaN of other kinds than NumPy's
        held = np.asarray(held, dtype=np.float64)
    held = np.atleast_3d(held)[:, :, [channel - first for channel in channels]]
    top, left = spec.y - spec.full_y, spec.x - spec.full_x
    if (top, left, *held.shape[:2]) == (0, 0, height, width):
        return held
    whole = np.zeros((height, width, held.shape[2]))
    place = whole[max(top, 0) : max(top + spec.height, 0), max(left, 0) : max(left + spec.width, 0)]
    inside = held[max(-top, 0) :, max(-left, 0) :]
    place[...] = inside[: place.shape[0], : place.shape[1]]
    return whole


def _said_by(source: Any) -> str:
    """The first line of what OpenImageIO, or one of its files, says; a damaged file can bring bytes of its own in."""
    try:
        said = source.geterror()
    except UnicodeDecodeError as error:
        said = error.object.decode("utf-8", errors="replace")
    return said.strip().partition("\n")[0] or "OpenImageIO does not say why"


def _color_channels(names: list[str]) -> list[int]:
    """Which channels are the picture: R, G, B (and A) by name, of the first layer that has them; otherwise the first
    four of the first layer."""
    layers = list(dict.fromkeys(["", *(name.rpartition(".")[0] for name in names)]))
    for layer in layers:
        prefix = f"{layer}." if layer else ""
        if all(f"{prefix}{color}" in names for color in "RGB"):
            return [names.index(f"{prefix}{color}") for color in "RGBA" if f"{prefix}{color}" in names]
    own = [row for row, name in enumerate(names) if name.rpartition(".")[0] == names[0].rpartition(".")[0]]
    return own[:4]


def _write_with_openimageio(draft: Path, pixels: np.ndarray, kind: str, path: Path) -> None:
    """Write `draft`; messages name `path`, whose place it takes."""
    library = _openimageio(f"{path}: writing {'EXR' if kind == 'float' else '16-bit colour PNG'}")
    height, width, components = pixels.shape
    file = library.ImageOutput.create(str(draft))
    if file is None:
        raise ValueError(f"{path}: {_said_by(library)}")
    spec = library.ImageSpec(width, height, components, kind)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    if components == 2:
        spec.channelnames = ("Y", "A")
    if not (file.open(str(draft), spec) and file.write_image(pixels)):
        raise ValueError(f"{path}: {_said_by(file)}")
    file.close()


def _reason(error: Exception) -> str:
    return str(error).partition("<_io")[0].strip() or type(error).__name__
