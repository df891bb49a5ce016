"""A picture as video stores it: brightness for every pixel, colour for every four, in the range of television.

Everything but bodies is grey. So most of a picture is a single plane that goes to the encoder as it is, and nobody converts
between colour spaces.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]
Bytes = NDArray[np.uint8]

#: Black, and the steps from black to white and from no colour to most, of ITU-R BT.709 in 8 bits.
BLACK, SPAN, CHROMA = 16.0, 219.0, 224.0

_RED, _BLUE = 0.2126, 0.0722
_GREEN = 1.0 - _RED - _BLUE


def to_luma(grey: NDArray) -> NDArray[np.float32]:
    """Brightness in code values of greys from 0 to 255."""
    return (BLACK + SPAN / 255.0 * np.asarray(grey, dtype=np.float64)).astype(np.float32)


def to_ycc(colours: NDArray) -> NDArray[np.float32]:
    """Colours (..., 3), red, green, blue from 0 to 255, as brightness above black and two colour differences, code values."""
    red, green, blue = np.moveaxis(np.asarray(colours, dtype=np.float64) / 255.0, -1, 0)
    luma = _RED * red + _GREEN * green + _BLUE * blue
    cb, cr = (blue - luma) / (2 * (1 - _BLUE)), (red - luma) / (2 * (1 - _RED))
    return np.stack([SPAN * luma, CHROMA * cb, CHROMA * cr], axis=-1).astype(np.float32)


class Canvas:
    """A picture in the making.

    Attributes
    ----------
    luma
        (H, W) brightness.
    cb, cr
        (H / 2, W / 2) colour, 128 for grey.
    """

    def __init__(self, luma: Bytes) -> None:
        self.luma = luma
        half = (luma.shape[0] // 2, luma.shape[1] // 2)
        self.cb = np.full(half, 128, dtype=np.uint8)
        self.cr = np.full(half, 128, dtype=np.uint8)

    def blend(self, planes: Plane, colours: Plane, top: int, left: int) -> None:
        """Lay lit bodies over the picture, at an even place.

        Parameters
        ----------
        planes
            (1 + C, h, w), h and w even: how much of the picture shows through, and the light from each colour; 0 to 1.
        colours
            (C, 3) from :func:`to_ycc`.
        """
        height, width = planes.shape[1:]
        patch = self.luma[top : top + height, left : left + width]
        luma = (patch - np.float32(BLACK)) * planes[0]
        rows, columns = slice(top // 2, (top + height) // 2), slice(left // 2, (left + width) // 2)
        cb, cr = (plane[rows, columns] - np.float32(127.5) for plane in (self.cb, self.cr))
        for light, (y, blue, red) in zip(planes[1:], colours, strict=True):
            luma += light * y
            if blue or red:
                pair = light[::2] + light[1::2]
                small = pair[:, ::2] + pair[:, 1::2]
                cb += small * (np.float32(0.25) * blue)
                cr += small * (np.float32(0.25) * red)
        luma += np.float32(BLACK + 0.5)
        patch[...] = np.minimum(luma, np.float32(BLACK + SPAN), out=luma)
        cb += np.float32(128.0)
        cr += np.float32(128.0)
        self.cb[rows, columns] = cb
        self.cr[rows, columns] = cr

    def rgb(self) -> Bytes:
        """The picture (H, W, 3), red, green, blue."""
        luma = (self.luma.astype(np.float32) - np.float32(BLACK)) * np.float32(255.0 / SPAN)
        cb, cr = (
            (np.repeat(np.repeat(p, 2, 0), 2, 1).astype(np.float32) - 128) * np.float32(255 / CHROMA)
            for p in (self.cb, self.cr)
        )
        red = luma + np.float32(2 * (1 - _RED)) * cr
        blue = luma + np.float32(2 * (1 - _BLUE)) * cb
        green = (luma - np.float32(_RED) * red - np.float32(_BLUE) * blue) / np.float32(_GREEN)
        picture = np.stack([red, green, blue], axis=-1)
        picture += np.float32(0.5)
        return np.clip(picture, 0.0, 255.0, out=picture).astype(np.uint8)
