"""What the recipes leave to look at: pictures side by side with captions, and a plain report."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jaxlight.formats.quantize import quantize

FONT = ImageFont.load_default()
LINE, MARGIN = 12, 4
"""Height of a line of a caption and the space around it, in pixels."""


def save_grid(path: Path, rows: Sequence[Mapping[str, np.ndarray]]) -> None:
    """Write pictures of one size as a grid, each under its caption.

    Args:
        rows: caption -> [height, width] or [height, width, 3], numbers in [0, 1] (clamped, then rounded). Captions that
            are wider than a picture take several lines.
    """
    height, width = next(iter(rows[0].values())).shape[:2]
    columns = max(len(row) for row in rows)
    captions = {caption: wrapped(caption, width - 2 * MARGIN) for row in rows for caption in row}
    above = max(map(len, captions.values())) * LINE + MARGIN
    sheet = Image.new("RGB", (columns * width, len(rows) * (above + height)), "white")
    for y, row in enumerate(rows):
        for x, (caption, picture) in enumerate(row.items()):
            corner = (x * width, y * (above + height))
            sheet.paste(Image.fromarray(quantize(picture)).convert("RGB"), (corner[0], corner[1] + above))
            label = Image.new("RGB", (width, above), "white")
            for i, line in enumerate(captions[caption]):
                ImageDraw.Draw(label).text((MARGIN, i * LINE + 2), line, fill="black", font=FONT)
            sheet.paste(label, corner)
    sheet.save(path)


def wrapped(caption: str, width: int) -> list[str]:
    """A caption in lines of at most so many pixels, broken after spaces and hyphens."""
    lines = [""]
    for word in re.findall(r"[^\s-]*[\s-]?", caption):
        if lines[-1] and FONT.getlength((lines[-1] + word).rstrip()) > width:
            lines.append("")
        lines[-1] += word
    return lines


def signed(difference: np.ndarray, full: float) -> np.ndarray:
    """A difference as colours: white where 0, blue where -`full` or less, red where `full` or more; [..., 3]."""
    amount = np.clip(difference / full, -1, 1)[..., None]
    red, blue = np.array([0.8, 0.1, 0.1]), np.array([0.1, 0.2, 0.8])
    return 1 - np.maximum(amount, 0) * (1 - red) - np.maximum(-amount, 0) * (1 - blue)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Text columns: the first to the left, the others to the right."""
    cells = [list(head), *map(list, rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(head))]
    lines = []
    for row in cells:
        first, *others = (cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        lines.append("  ".join([row[0].ljust(len(first)), *others]).rstrip())
    return "\n".join([lines[0], "-" * max(map(len, lines)), *lines[1:]])
