"""Names beside the points of a plane, so that none lies over another name, a point, or the frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Text

#: Directions in which a name may stand from its point, the ones that read best first, and distances in points.
_DIRECTIONS = np.deg2rad([0, 45, -45, 180, 135, -135, 90, -90, 22, -22, 158, -158, 68, -68, 112, -112])
_DISTANCES = (5.0, 9.0, 14.0, 20.0, 27.0, 35.0, 45.0, 60.0, 80.0, 105.0)
#: Half the side of a marker, points.
_MARKER = 3.2
#: More points than this have smaller names.
_MANY = 10


@dataclass(frozen=True)
class Named:
    """A point with its name; ``low`` and ``high`` are the ends of its interval on each axis, where it has one."""

    x: float
    y: float
    name: str
    colour: str
    low: tuple[float, float] | None = None
    high: tuple[float, float] | None = None


def place(axes: Axes, points: Sequence[Named], *, size: float = 6.5) -> list[Text]:
    """Write the names; one that had to go far from its point gets a thin line to it, and points in one place share a name.

    Fixes the limits of the axes, whose size must be settled. Points are served from the outermost in, each taking the place
    that covers least.
    """
    axes.set_xlim(axes.get_xlim())
    axes.set_ylim(axes.get_ylim())
    points = _merged(axes, points)
    if len(points) > _MANY:
        # Smaller, so that more names find a place.
        size *= max(0.7, (_MANY / len(points)) ** 0.5)
    renderer = axes.figure.canvas.get_renderer()  # type: ignore[attr-defined]
    unit = axes.figure.dpi / 72.0
    frame = axes.get_window_extent(renderer)
    limits = np.array([frame.x0, frame.y0, frame.x1, frame.y1])
    at = axes.transData.transform([(point.x, point.y) for point in points])
    half = _MARKER * unit
    taken = [np.array([x - half, y - half, x + half, y + half]) for x, y in at]
    bars = [bar for point in points for bar in _bars(axes, point, unit)]
    centre = at.mean(axis=0)
    texts: list[Text] = []
    for index in sorted(range(len(points)), key=lambda i: -float(np.linalg.norm(at[i] - centre))):
        point = points[index]
        text = axes.text(point.x, point.y, point.name, fontsize=size, color=point.colour, zorder=5)
        box = text.get_window_extent(renderer)
        best = (np.inf, at[index], taken[index])
        for reach, distance in enumerate(_DISTANCES):
            for rank, angle in enumerate(_DIRECTIONS):
                where = _beside(at[index], angle, distance * unit, box.width, box.height)
                pad = np.array([-1.0, -1.0, 1.0, 1.0]) * unit
                cost = 50.0 * sum(_shared(where + pad, other) for other in taken)
                cost += 2.0 * sum(_shared(where, bar) for bar in bars) + 100.0 * _outside(where, limits)
                cost += (0.02 * rank + reach) * box.height * unit
                if cost < best[0]:
                    best = (cost, _corner(where), where)
        where = best[2]
        text.set_position(tuple(axes.transData.inverted().transform(where[:2])))
        taken.append(where)
        gap = _distance(at[index], where)
        if gap > 8.0 * unit:
            near = np.clip(at[index], where[:2], where[2:])
            line = axes.transData.inverted().transform([at[index], near])
            axes.plot(*line.T, color=point.colour, linewidth=0.4, alpha=0.7, zorder=1)
        texts.append(text)
    return texts


def _merged(axes: Axes, points: Sequence[Named]) -> list[Named]:
    """Points that lie within half a marker of one another as one, named after all."""
    near = 0.5 * _MARKER * axes.figure.dpi / 72.0
    found: list[Named] = []
    for point in points:
        here = axes.transData.transform((point.x, point.y))
        for index, other in enumerate(found):
            if np.linalg.norm(axes.transData.transform((other.x, other.y)) - here) < near:
                found[index] = replace(other, name=f"{other.name},\n{point.name}")
                break
        else:
            found.append(point)
    return found


def _bars(axes: Axes, point: Named, unit: float) -> list[NDArray[np.float64]]:
    if point.low is None or point.high is None:
        return []
    spans = [((point.low[0], point.y), (point.high[0], point.y)), ((point.x, point.low[1]), (point.x, point.high[1]))]
    boxes = []
    for start, end in spans:
        (x0, y0), (x1, y1) = axes.transData.transform([start, end])
        boxes.append(np.array([x0 - unit, y0 - unit, x1 + unit, y1 + unit]))
    return boxes


def _beside(
    point: NDArray[np.float64], angle: float, distance: float, width: float, height: float
) -> NDArray[np.float64]:
    """The box of a text whose edge is ``distance`` from the point in that direction."""
    direction = np.array([np.cos(angle), np.sin(angle)])
    middle = point + direction * distance + direction.round(1).clip(-1, 1) * [0.5 * width, 0.5 * height]
    return np.array(
        [middle[0] - 0.5 * width, middle[1] - 0.5 * height, middle[0] + 0.5 * width, middle[1] + 0.5 * height]
    )


def _corner(box: NDArray[np.float64]) -> NDArray[np.float64]:
    return box[:2]


def _shared(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Area that two boxes have in common."""
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    return float(width * height) if width > 0 and height > 0 else 0.0


def _outside(box: NDArray[np.float64], frame: NDArray[np.float64]) -> float:
    area = float((box[2] - box[0]) * (box[3] - box[1]))
    return area - _shared(box, frame)


def _distance(point: NDArray[np.float64], box: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(point - np.clip(point, box[:2], box[2:])))
