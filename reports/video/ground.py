"""What the figure stands on: a plane with a grid that scrolls as the figure walks, and the figure's soft shadow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from reports.video.camera import Camera
from reports.video.canvas import BLACK, SPAN, Bytes, to_luma

Array = NDArray[np.float64]

#: Brightness of the backdrop at the top and at the horizon, of the ground, and of a grid line on it.
_SKY_TOP, _SKY_LOW, _FLOOR, _LINE = 236.0, 246.0, 226.0, 184.0

#: Half the width of a line, metres; metres around the figure at which the ground has faded by half.
_HALF_LINE = 0.011

#: Direction of the light that casts the shadow, from the ground.
LIGHT = np.array([-0.28, 1.0, 0.10])

#: Share of the light that the shadow takes, and the radius of its blur in pixels of the half-size mask.
_SHADOW, _BLUR = 0.42, 2.2


class Ground:
    """The ground of a panel, from one camera.

    Parameters
    ----------
    camera
        Where it is seen from.
    level
        Height of the ground in metres.
    cell
        Metres between lines.
    """

    def __init__(self, camera: Camera, level: float, *, cell: float = 1.0) -> None:
        self.camera, self.level, self.cell = camera, level, cell
        x, z = camera.ground(level)
        with np.errstate(invalid="ignore"):
            reach = np.hypot(x, z)
        depth = camera.depth(np.stack([x, np.full_like(x, level), z], axis=-1))
        #: (H, W) nearness of the ground to the camera in pixels, as of capsules; far below all in the sky.
        self.near = np.nan_to_num(-depth * camera.focal / (camera.distance + depth), nan=-1e9).astype(np.float32)
        radius = camera.distance * 0.9
        fade = np.nan_to_num(np.exp(-((reach / radius) ** 2)), nan=0.0)
        share = np.linspace(0.0, 1.0, camera.height)[:, None]
        backdrop = _SKY_TOP + (_SKY_LOW - _SKY_TOP) * np.minimum(share / 0.55, 1.0)
        base = backdrop + (_FLOOR - backdrop) * fade
        seen = np.flatnonzero(fade.max(axis=1) > 0.01)
        #: First row in which lines can be seen; above it nothing changes.
        self.top = int(seen[0]) if len(seen) else camera.height
        self.base = to_luma(base) + np.float32(0.5)
        self._x, self._wx = _cells(x[self.top :], cell)
        self._z, self._wz = _cells(z[self.top :], cell)
        self._depth = np.float32(SPAN / 255.0 * (_FLOOR - _LINE)) * fade[self.top :].astype(np.float32)
        self._still = self.base.astype(np.uint8)

    def draw(self, luma: Bytes, at: Array) -> None:
        """Paint backdrop and ground over a picture (H, W) for a figure over ``at`` (x, ., z)."""
        tone = _lines(self._x, self._wx, at[0] / self.cell)
        np.maximum(tone, _lines(self._z, self._wz, at[2] / self.cell), out=tone)
        tone *= self._depth
        np.subtract(self.base[self.top :], tone, out=tone)
        luma[: self.top] = self._still[: self.top]
        luma[self.top :] = tone

    def cast(self, points: Array) -> Array:
        """Where the shadows of points (..., 3) fall on the ground (..., 3)."""
        above = points[..., 1:2] - self.level
        return points - above * LIGHT


def _cells(where: Array, cell: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """World coordinates in cells, and cells per pixel, floored so that lines keep a pixel's width."""
    units = np.nan_to_num(where / cell, nan=0.0)
    if min(units.shape) < 2:
        return units.astype(np.float32), np.ones_like(units, dtype=np.float32)
    steps = np.hypot(*np.gradient(units))
    return units.astype(np.float32), (1.0 / np.maximum(steps, 1e-4)).astype(np.float32)


def _lines(units: NDArray[np.float32], per_cell: NDArray[np.float32], shift: float) -> NDArray[np.float32]:
    """How much of each pixel the lines between cells cover, 0 to 1."""
    phase = units + np.float32(shift - np.floor(shift))
    phase -= np.rint(phase)
    np.abs(phase, out=phase)
    np.subtract(np.float32(_HALF_LINE), phase, out=phase)
    phase *= per_cell
    phase += np.float32(0.5)
    np.maximum(phase, np.float32(0.0), out=phase)
    return np.minimum(phase, np.float32(1.0), out=phase)


def paint_shadow(luma: Bytes, strokes: list[tuple[float, float, float, float, float]]) -> None:
    """Darken a picture (H, W), in place, under strokes: x, y of both ends and width, in pixels."""
    from PIL import Image, ImageDraw, ImageFilter

    height, width = luma.shape
    reach = max(stroke[4] for stroke in strokes) + 12
    x0 = max(int(min(min(s[0], s[2]) for s in strokes) - reach) & ~1, 0)
    x1 = min(int(max(max(s[0], s[2]) for s in strokes) + reach + 2) & ~1, width)
    y0 = max(int(min(min(s[1], s[3]) for s in strokes) - reach) & ~1, 0)
    y1 = min(int(max(max(s[1], s[3]) for s in strokes) + reach + 2) & ~1, height)
    if x1 - x0 < 4 or y1 - y0 < 4:
        return
    mask = Image.new("L", ((x1 - x0) // 2, (y1 - y0) // 2), 0)
    draw = ImageDraw.Draw(mask)
    for ax, ay, bx, by, thick in strokes:
        ends = [(0.5 * (ax - x0), 0.5 * (ay - y0)), (0.5 * (bx - x0), 0.5 * (by - y0))]
        half = 0.25 * thick
        draw.line(ends, fill=255, width=max(round(0.5 * thick), 1))
        for x, y in ends:
            draw.ellipse((x - half, y - half, x + half, y + half), fill=255)
    mask = mask.filter(ImageFilter.GaussianBlur(_BLUR)).resize(
        ((x1 - x0) // 2 * 2, (y1 - y0) // 2 * 2), Image.Resampling.BILINEAR
    )
    dark = np.asarray(mask).astype(np.uint16)
    dark *= round(_SHADOW * 256)
    dark >>= 8
    keep = np.uint16(256) - dark
    patch = luma[y0 : y0 + keep.shape[0], x0 : x0 + keep.shape[1]]
    tone = (patch - np.uint8(BLACK)) * keep
    tone >>= 8
    tone += np.uint16(BLACK)
    patch[...] = tone
