"""Words in the picture: titles above panels, the footer below, and the card between two showings."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from reports.video.canvas import Bytes, to_luma

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

#: Greys, from 0 to 255, of words and of the bands that they stand on.
INK, FAINT, BAND = 34, 96, 250

REPEAT = "Repeat"


@lru_cache(maxsize=32)
def font(size: int) -> FreeTypeFont:
    """DejaVu Sans, which comes with matplotlib and has most scripts of Europe."""
    import matplotlib as mpl
    from PIL import ImageFont

    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size)


def band(text: str, width: int, height: int, *, size: int, ink: int = INK) -> Bytes:
    """A band (height, width) with one centred line; a line too wide is set smaller, then cut with an ellipsis."""
    from PIL import Image, ImageDraw

    image = Image.new("L", (width, height), BAND)
    room = width - 8
    while size > 7 and font(size).getlength(text) > room:
        size -= 1
    if font(size).getlength(text) > room:
        while text and font(size).getlength(text + "\u2026") > room:
            text = text[:-1]
        text = text.rstrip() + "\u2026"
    ImageDraw.Draw(image).text((width / 2, height / 2), text, font=font(size), fill=ink, anchor="mm")
    return to_luma(np.asarray(image)).round().astype(np.uint8)


def card(text: str, size: tuple[int, int]) -> Bytes:
    """A card (H, W) with a word in its middle."""
    from PIL import Image, ImageDraw

    width, height = size
    image = Image.new("L", size, BAND)
    letters = font(max(min(width, height) // 10, 8))
    ImageDraw.Draw(image).text((width / 2, height / 2), text, font=letters, fill=INK, anchor="mm")
    return to_luma(np.asarray(image)).round().astype(np.uint8)
