"""The camera: one direction for a whole clip, following the figure on a smoothed path, at a distance that shows all of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Seen from 40 degrees to the left of where the figure faces at first, and 11 degrees above: limbs, trunk and ground all show.
TURN, TILT = np.deg2rad(40.0), np.deg2rad(11.0)

#: Vertical field of view of a picture as high as it is wide or less; long enough a lens that near limbs are not swollen.
FIELD = np.deg2rad(26.0)

#: Seconds of the Gaussian that smooths the path followed: more than a step, so that the figure is seen to sway.
FOLLOW_SIGMA = 0.6

#: Free share of the picture beside, above and below what moves.
_SIDE, _TOP, _BOTTOM = 0.05, 0.06, 0.09


def smooth_path(root: Array, fps: float) -> Array:
    """The path (T, 3) that the camera follows: the root's over the ground, smoothed forwards and backwards alike; y = 0.

    Beyond its ends the path is taken to go on as it came, turned about its end, so that a walk that is cut off does not run out
    of the picture.
    """
    from scipy.ndimage import gaussian_filter1d

    reach = min(int(np.ceil(3 * FOLLOW_SIGMA * fps)), len(root) - 1)
    path = np.concatenate([2 * root[0] - root[reach:0:-1], root, 2 * root[-1] - root[-2 : -2 - reach : -1]])
    path = gaussian_filter1d(path, FOLLOW_SIGMA * fps, axis=0, mode="nearest", truncate=3.0)[reach : reach + len(root)]
    path[:, 1] = 0.0
    return path


@dataclass(frozen=True)
class Camera:
    """A pinhole camera of fixed direction and distance; the point it looks at moves with the figure.

    Attributes
    ----------
    width, height
        Of the picture in pixels.
    distance
        Metres from the camera to the point that it looks at.
    look
        Height of that point above the path followed, metres.
    focal
        Focal length in pixels.
    """

    width: int
    height: int
    distance: float
    look: float
    focal: float

    @property
    def axes(self) -> Array:
        """(3, 3) rows: right, up and forward of the picture in the world."""
        return _axes()

    def project(self, points: Array) -> tuple[Array, Array, Array]:
        """Points (..., 3), relative to the path followed: pixels x and y (to the right, down), and pixels per metre there."""
        right, up, away = _seen(points, self.look)
        scale = self.focal / np.maximum(self.distance + away, 0.05 * self.distance)
        return self.width / 2 + scale * right, self.height / 2 - scale * up, scale

    def depth(self, points: Array) -> Array:
        """Metres along the line of sight beyond the point looked at, of points (..., 3) relative to the path followed."""
        return _seen(points, self.look)[2]

    def ground(self, level: float) -> tuple[Array, Array]:
        """World x and z (height, width) of the ground at ``level`` seen in each pixel, relative to the path; NaN in the sky."""
        axes = self.axes
        eye = np.array([0.0, self.look, 0.0]) - self.distance * axes[2]
        column = (np.arange(self.width) + 0.5 - self.width / 2) / self.focal
        row = (self.height / 2 - np.arange(self.height) - 0.5) / self.focal
        ray = axes[2] + column[None, :, None] * axes[0] + row[:, None, None] * axes[1]
        with np.errstate(divide="ignore"):
            reach = np.where(ray[..., 1] < -1e-4, (eye[1] - level) / -ray[..., 1], np.nan)
        return eye[0] + reach * ray[..., 0], eye[2] + reach * ray[..., 2]


def frame_camera(clouds: list[Array], size: tuple[int, int], level: float) -> Camera:
    """The camera from which all points of all panels (each (..., 3), relative to its path) are seen, none nearer than others.

    Of each cloud the outermost thousandth is ignored: a depth camera's misses must not make the figure small.
    """
    width, height = size
    focal = 0.5 * min(height, width * 1.2) / np.tan(FIELD / 2)
    top = max(float(np.quantile(cloud[..., 1], 0.999)) for cloud in clouds)
    span = max(top - level, 1e-3)
    half_w = 0.5 * width * (1 - 2 * _SIDE) / focal
    # The point looked at is set so that free space above and below is as wanted.
    half_h = 0.5 * height * (1 - _TOP - _BOTTOM) / focal
    look = level + span * 0.5
    distance = 1.05 * span
    for cloud in clouds:
        right, up, away = _seen(cloud, look)
        for reach, half in ((np.abs(right), half_w), (np.abs(up), half_h)):
            distance = max(distance, float(np.quantile(reach / half - away, 0.999)))
    shift = 0.5 * (_BOTTOM - _TOP) * height * distance / focal
    return Camera(width, height, distance, look - shift, focal)


@cache
def _axes() -> Array:
    forward = -np.array([np.sin(TURN) * np.cos(TILT), np.sin(TILT), np.cos(TURN) * np.cos(TILT)])
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), forward])


def _seen(points: Array, look: float) -> tuple[Array, Array, Array]:
    seen = (points - [0.0, look, 0.0]) @ _axes().T
    return seen[..., 0], seen[..., 1], seen[..., 2]
