"""Panels of one or several figures, frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import ConfigError
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import CORE_ROLES
from reports.video.bodies import Body, make_body, stature
from reports.video.camera import Camera, frame_camera, smooth_path
from reports.video.canvas import Canvas, to_luma, to_ycc
from reports.video.cards import BAND, FAINT, REPEAT, band, card
from reports.video.encoder import VideoFacts, check_size, encode
from reports.video.ground import Ground, paint_shadow
from reports.video.shading import paint
from reports.video.timeline import schedule

Array = NDArray[np.float64]
Frame = NDArray[np.uint8]

Normalise = Literal["none", "leg", "height"]

#: Size of every figure that is brought to one, metres: leg from hip to ankle, and legs and trunk to the head's joint.
LEG, HEIGHT = 0.8, 1.45

#: Bodies in full light: trunk, left, right; and of one colour, where sides must not be told.
_SIDES = to_ycc(1.12 * np.array([(180.0, 180.0, 180.0), (72.0, 150.0, 214.0), (236.0, 140.0, 62.0)]))
_NEUTRAL = to_ycc(1.15 * np.array([(168.0, 178.0, 192.0)]))

#: Pixels between panels.
_GAP = 2

#: Frames of a clip by which the picture is framed, at least where there are as many.
_FRAMED = 120


@dataclass(frozen=True)
class Panel:
    """One figure: a clip whose floor is at y = 0 and whose first frame faces +Z, and a title above it or none."""

    clip: MotionClip
    title: str = ""


@dataclass(frozen=True)
class Scene:
    """What a video shows.

    Attributes
    ----------
    panels
        The figures, on one clock, all at the same scale; one whose clip is over holds its last pose.
    size
        Width and height in pixels, even.
    fps
        Frames per second of the video; poses between a clip's frames are interpolated.
    seconds
        Length, or ``None`` for once through the longest clip; a longer clip is cut, a shorter one starts again.
    repeat_card
        Whether a card stands between two showings.
    footer
        A line below the picture: the data set and its licence.
    sides
        Whether left limbs are blue and right ones orange; else the body has one colour.
    normalise
        ``"none"``: bodies keep their size; ``"leg"`` or ``"height"``: all are brought to the same one, path and all, so that
        size does not tell who it is. Timing is left alone.
    camera
        Of a single panel: the camera that :func:`common_camera` set for several videos; by default it is set for this one.

    Notes
    -----
    Dong et al. (2020) do not say on which bodies their stimuli were shown. In a run every result is on the target's body, and
    the real performer on their own; so raters could tell real ones by size, unless ``normalise`` and one camera for
    each figure take that away. What remains are proportions.
    """

    panels: Sequence[Panel]
    size: tuple[int, int] = (640, 480)
    fps: float = 30
    seconds: float | None = None
    repeat_card: bool = True
    footer: str = ""
    sides: bool = True
    normalise: Normalise = "none"
    camera: Camera | None = None

    def __post_init__(self) -> None:
        check_size(self.size)
        if not self.panels:
            raise ConfigError("a video needs at least one clip")
        if not 1 <= self.fps <= 120:
            raise ConfigError(f"a video has 1 to 120 frames per second, not {self.fps:g}")
        if self.seconds is not None and not 0 < self.seconds <= 3600:
            raise ConfigError(f"a video lasts more than 0 and at most 3600 seconds, not {self.seconds:g}")
        if self.normalise not in ("none", "leg", "height"):
            raise ConfigError(f"bodies are normalised by none, leg or height, not {self.normalise!r}")
        if self.camera is not None and len(self.panels) > 1:
            raise ConfigError("a camera can be given for a single panel only")

    @cached_property
    def times(self) -> Array:
        """(N,) time in the clips of each frame; NaN where the card stands."""
        longest = max(panel.clip.duration for panel in self.panels)
        return schedule(longest, self.fps, self.seconds, card=self.repeat_card)

    def __len__(self) -> int:
        return len(self.times)

    def frames(self) -> Iterator[Canvas]:
        """The frames, in order, each by itself."""
        stage = _Stage(self)
        words = card(REPEAT, (self.size[0], stage.bottom))
        for time in self.times:
            if np.isnan(time):
                luma = stage.blank.copy()
                luma[: stage.bottom] = words
                yield Canvas(luma)
            else:
                yield stage.picture(time)

    def frame_at(self, seconds: float) -> Canvas:
        """The frame at a time in the clips."""
        longest = max(panel.clip.duration for panel in self.panels)
        if not 0 <= seconds <= longest:
            raise ConfigError(f"a picture is taken between 0 and {longest:.2f} s of the clip, not at {seconds:g} s")
        return _Stage(self).picture(seconds)


def render(
    panels: Sequence[Panel],
    *,
    size: tuple[int, int] = (640, 480),
    fps: float = 30,
    seconds: float | None = None,
    repeat_card: bool = True,
    footer: str = "",
    sides: bool = True,
    normalise: Normalise = "none",
) -> Iterator[Frame]:
    """The frames (H, W, 3) of a video; parameters as of :class:`Scene`."""
    scene = Scene(panels, size, fps, seconds, repeat_card, footer, sides, normalise)
    return (canvas.rgb() for canvas in scene.frames())


def write_video(
    panels: Sequence[Panel],
    path: Path,
    *,
    size: tuple[int, int] = (640, 480),
    fps: float = 30,
    seconds: float | None = None,
    repeat_card: bool = True,
    footer: str = "",
    sides: bool = True,
    normalise: Normalise = "none",
    camera: Camera | None = None,
    metadata: Mapping[str, str] | None = None,
    report: Callable[[float], None] | None = None,
) -> VideoFacts:
    """Write panels as MP4, whole or not at all; the same input gives the same bytes.

    Parameters
    ----------
    panels, size, fps, seconds, repeat_card, footer, sides, normalise, camera
        As of :class:`Scene`.
    path
        The file to write, ending in ``.mp4``; its folder is made.
    metadata
        Tags of the file, for example ``title``; none by default, so that a stimulus says nothing of its method.
    report
        Called with the share done, 0 to 1.

    Raises
    ------
    ConfigError
        If a setting is out of range or the file's name does not end in ``.mp4``.
    EncoderError
        If there is no ffmpeg, naming what to install, or it fails.
    """
    if path.suffix.lower() != ".mp4":
        raise ConfigError(f"{path} does not end in .mp4, which is what can be written")
    scene = Scene(panels, size, fps, seconds, repeat_card, footer, sides, normalise, camera)
    return encode(scene.frames(), len(scene), path, size=size, fps=fps, metadata=metadata, report=report)


def write_still(
    panels: Sequence[Panel],
    path: Path,
    *,
    at: float,
    size: tuple[int, int] = (640, 480),
    footer: str = "",
    sides: bool = True,
    normalise: Normalise = "none",
) -> None:
    """Write one moment of panels as PNG; ``at`` in seconds of the clips, other parameters as of :class:`Scene`."""
    import io

    from PIL import Image

    from benchmark.motion._atomic import atomic_write

    if path.suffix.lower() != ".png":
        raise ConfigError(f"{path} does not end in .png, which is what can be written")
    scene = Scene(panels, size, footer=footer, sides=sides, normalise=normalise)
    buffer = io.BytesIO()
    Image.fromarray(scene.frame_at(at).rgb()).save(buffer, "PNG", optimize=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, (buffer.getvalue(),))


def common_camera(
    clips: Iterable[MotionClip], *, size: tuple[int, int] = (640, 480), footer: str = "", normalise: Normalise = "none"
) -> Camera:
    """One camera for videos of single clips that are compared: figures of one size are then seen at one scale.

    Parameters
    ----------
    clips
        All that will be shown; each is looked at once.
    size, footer, normalise
        As of the videos.
    """
    level, clouds = 0.0, []
    for clip in clips:
        figure = _Figure(Panel(clip), normalise)
        level = min(level, -figure.body.sole)
        clouds.append(figure.cloud(level))
    return frame_camera(clouds, (size[0], _bottom(size, footer)), level)


def _bottom(size: tuple[int, int], footer: str) -> int:
    """Rows of the picture above the footer."""
    return size[1] - (_even(1.9 * _small(size)) if footer else 0)


def _small(size: tuple[int, int]) -> int:
    """Height of the footer's letters."""
    return max(min(size) // 44, 9)


class _Figure:
    """A panel's body, ready to be looked up by time."""

    def __init__(self, panel: Panel, normalise: Normalise) -> None:
        clip = panel.clip
        self.fps, self.last = clip.fps, len(clip) - 1
        self.body: Body = make_body(clip, scale=scale_of(clip, normalise))
        self.path = smooth_path(self.body.path, clip.fps)

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Path (3,), starts and ends (K, 3) at a time, interpolated between frames."""
        position = min(time * self.fps, float(self.last))
        low = int(position + 1e-9)
        share = max(position - low, 0.0)
        high = min(low + 1, self.last)
        path, starts, ends = (
            array[low] if share < 1e-9 else array[low] + share * (array[high] - array[low])
            for array in (self.path, self.body.starts, self.body.ends)
        )
        return path, starts, ends

    def cloud(self, level: float) -> Array:
        """What must be seen, (T, P, 3) relative to the path: outsides of all capsules, above the ground."""
        body = self.body
        some = slice(None, None, max(len(self.path) // _FRAMED, 1))
        points = np.concatenate([body.starts[some], body.ends[some]], axis=1) - self.path[some, None]
        radii = np.concatenate([body.radii[:, 0], body.radii[:, 1]])[:, None]
        outside = np.concatenate([points + radii * side for side in np.concatenate([np.eye(3), -np.eye(3)])], axis=1)
        outside[..., 1] = np.maximum(outside[..., 1], level)
        return outside


def scale_of(clip: MotionClip, normalise: Normalise) -> float:
    """By how much a clip is enlarged to bring its figure to the size asked for."""
    if normalise == "none":
        return 1.0
    skeleton = clip.skeleton
    skeleton.joints(*CORE_ROLES)  # says which role is missing
    return LEG / skeleton.leg_length if normalise == "leg" else HEIGHT / stature(skeleton)


class _Stage:
    """Everything of a scene that stays the same from frame to frame."""

    def __init__(self, scene: Scene) -> None:
        width, height = scene.size
        self.figures = [_Figure(panel, scene.normalise) for panel in scene.panels]
        self.colours = _SIDES if scene.sides else _NEUTRAL
        #: Row of ``colours`` for each side.
        self.paints = (0, 1, 2) if scene.sides else (0, 0, 0)
        small, self.bottom = _small(scene.size), _bottom(scene.size, scene.footer)
        titled = any(panel.title for panel in scene.panels)
        letters = max(min(width, height) // 34, 10)
        head = _even(1.8 * letters) if titled else 0
        self.level = min(-figure.body.sole for figure in self.figures)
        clouds = [figure.cloud(self.level) for figure in self.figures]
        columns, camera = _best_grid(clouds, width, self.bottom, head, self.level)
        camera = scene.camera or camera
        self.camera: Camera = camera
        self.ground = Ground(camera, self.level)
        self.blank = np.full((height, width), to_luma(np.array(BAND)), dtype=np.uint8)
        if scene.footer:
            self.blank[self.bottom :] = band(scene.footer, width, height - self.bottom, size=small, ink=FAINT)
        self.corners = []
        rows = -(-len(self.figures) // columns)
        for number, panel in enumerate(scene.panels):
            row, column = divmod(number, columns)
            x = _even(column * (width + _GAP) / columns)
            y = _even(row * (self.bottom + _GAP) / rows)
            if head:
                self.blank[y : y + head, x : x + camera.width] = band(panel.title, camera.width, head, size=letters)
            self.corners.append((x, y + head))

    def picture(self, time: float) -> Canvas:
        """The frame at a time in the clips."""
        canvas = Canvas(self.blank.copy())
        for figure, corner in zip(self.figures, self.corners, strict=True):
            self._draw(canvas, corner, figure, time)
        return canvas

    def _draw(self, canvas: Canvas, corner: tuple[int, int], figure: _Figure, time: float) -> None:
        camera, body, (left, top) = self.camera, figure.body, corner
        panel = canvas.luma[top : top + camera.height, left : left + camera.width]
        path, starts, ends = figure.at(time)
        self.ground.draw(panel, path)
        starts, ends = starts - path, ends - path
        both = np.concatenate([starts, ends])
        shade_x, shade_y, shade_scale = camera.project(self.ground.cast(both))
        count = len(starts)
        widths = 2.0 * body.radii.mean(axis=1) * shade_scale[:count] * 0.62
        paint_shadow(
            panel,
            np.column_stack([shade_x[:count], shade_y[:count], shade_x[count:], shade_y[count:], widths]).tolist(),
        )
        x, y, scale = camera.project(both)
        near = -camera.depth(both) * scale
        radii = np.concatenate([body.radii[:, 0], body.radii[:, 1]]) * scale
        ends_of = np.column_stack([x, y, near, radii])
        table = np.hstack([ends_of[:count], ends_of[count:]]).tolist()
        order = np.argsort(near[:count] + near[count:], kind="stable")
        place = (top, left, camera.height, camera.width)
        paint(
            canvas, place, [(*table[k], int(self.paints[body.sides[k]])) for k in order], self.colours, self.ground.near
        )


def _even(pixels: float) -> int:
    """The even number at or below: colour is stored for squares of four pixels."""
    return int(pixels) // 2 * 2


def _best_grid(clouds: list[Array], width: int, height: int, head: int, level: float) -> tuple[int, Camera]:
    """Columns of the grid of panels in which the figures are largest, and the camera of its panels."""
    best: tuple[float, int, Camera] | None = None
    for columns in range(1, len(clouds) + 1):
        rows = -(-len(clouds) // columns)
        wide = _even((width - _GAP * (columns - 1)) / columns)
        high = _even((height - _GAP * (rows - 1)) / rows) - head
        if wide < 24 or high < 24:
            continue
        camera = frame_camera(clouds, (wide, high), level)
        size = camera.focal / camera.distance
        if best is None or size > best[0] * 1.02:
            best = (size, columns, camera)
    if best is None:
        raise ConfigError(f"{len(clouds)} panels do not fit into {width} x {height} pixels: choose a larger size")
    return best[1], best[2]
