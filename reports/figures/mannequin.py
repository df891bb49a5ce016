"""Bodies with volume on a page: parts as hulls of spheres, seen in perspective, shaded, sorted by depth, with a soft shadow.

Bodies are flat polygons, so that figures stay vector graphics: a part is its outline and a few smaller and lighter copies of
itself towards the light. A shadow is the parts thrown on the floor in a few sizes; a PDF holds it as a picture.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.clip import MotionClip
from benchmark.motion.kinematics import end_site_positions
from benchmark.motion.skeleton import SIDES, Skeleton
from reports.figures.bodies import project, segments
from reports.figures.style import LEFT, RIGHT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

#: Radii in leg lengths at the upper and lower end of each segment, of a slim figure.
_ARM = {"shoulder": 0.062, "elbow": 0.047, "wrist": 0.038, "hand": 0.036}
_LEG = {"hip": 0.092, "knee": 0.064, "ankle": 0.045, "toe": 0.034}
_TRUNK = {"pelvis": 0.105, "waist": 0.118, "chest": 0.092, "neck": 0.05}
#: Where the skeleton says nothing of roles, every bone has this one.
_PLAIN = 0.04
#: Heads vary less with age than legs do: metres, and a share of the leg's length.
_HEAD = (0.055, 0.07)

#: Size of each tone of a part, how far it moves towards the light (in radii), and how it is mixed with white (black below 0).
_TONES = ((1.0, 0.0, -0.5), (0.87, 0.0, -0.12), (0.66, 0.13, 0.1), (0.4, 0.27, 0.3))
_LIGHT = np.array([-0.5, 0.86])
#: How much of the paper a limb at one leg's length behind the hips takes on.
_HAZE = 0.3

#: Sizes and greys of a shadow's rings, the widest first; where the sun throws a point of height 1 on the floor: left, back.
_SHADOW = ((1.7, "#ebebea"), (1.0, "#d6d6d5"))
_SUN = (0.30, -0.12)

#: Corners of a circle; an arc of a limb has half as many.
_CIRCLE, _LIMB = 24, 5
#: Points of print to which corners are rounded; a printer's dot at 600 an inch is 0.12 points wide.
_GRID = 0.1
_ARC = np.linspace(-1.0, 1.0, _LIMB)
_ANGLES = np.linspace(0.0, 2.0 * np.pi, _CIRCLE, endpoint=False)
_RIM = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)


@dataclass(frozen=True)
class Camera:
    """Where a figure is seen from.

    Attributes
    ----------
    turn, tilt
        Radians to the figure's left of its front, and above the horizon.
    distance
        Metres from the figure's place; it is this near that perspective shows.
    """

    turn: float = np.deg2rad(-58.0)
    tilt: float = np.deg2rad(11.0)
    distance: float = 6.0

    def page(self, points: Array) -> Array:
        """Points (..., 3) about the figure's place on the floor: x and y on the page, true to scale there, and depth."""
        seen = project(points, turn=self.turn, tilt=self.tilt)
        near = self.distance / (self.distance - seen[..., 2:])
        return np.concatenate([seen[..., :2] * near, seen[..., 2:]], axis=-1)

    def turned(self, by: float) -> Camera:
        """The same view of a figure that faces ``by`` radians from +Z."""
        return Camera(self.turn + by, self.tilt, self.distance)


@dataclass(frozen=True)
class Part:
    """The hull of spheres about points of the body, by index; radii in metres."""

    points: tuple[int, ...]
    radii: tuple[float, ...]
    side: str


def body_points(clip: MotionClip) -> Array:
    """(T, P, 3): the joints of a clip, then the tips of its chains, then the middle of its head."""
    world, positions = clip.world
    tips = end_site_positions(clip.skeleton, world, positions)
    head = positions[:, clip.skeleton.roles.get("head", 0)]
    tip = _head_tip(clip.skeleton)
    centre = head if tip is None else 0.5 * (head + tips[:, tip])
    return np.concatenate([positions, tips, centre[:, None]], axis=1)


def _head_tip(skeleton: Skeleton) -> int | None:
    """The end site on top of the head; captures without one hold the head's middle as a joint."""
    for index, end in enumerate(skeleton.end_sites):
        if end.parent == skeleton.roles.get("head") and np.linalg.norm(end.offset) > 0.1 * skeleton.leg_length:
            return index
    return None


@lru_cache(maxsize=64)
def parts(skeleton: Skeleton) -> tuple[Part, ...]:
    """The parts of a body by the roles of its joints, in terms of :func:`body_points`; plain bones without the roles."""
    joints = len(skeleton)
    leg = skeleton.leg_length
    roles = skeleton.roles
    centre = joints + len(skeleton.end_sites)
    if not skeleton.has("hips", "head", *(f"{side}_{part}" for side in SIDES for part in ("shoulder", "hip"))):
        return tuple(Part((a, b), (_PLAIN * leg, _PLAIN * leg), side) for a, b, side in segments(skeleton))
    found = []

    def add(side: str, *spheres: tuple[int, float]) -> None:
        found.append(Part(tuple(p for p, _ in spheres), tuple(r * leg for _, r in spheres), side))

    for side in SIDES:
        for radii in (_ARM, _LEG):
            chain = [(roles[f"{side}_{part}"], radius) for part, radius in radii.items() if f"{side}_{part}" in roles]
            tip = _tip_below(skeleton, chain[-1][0])
            if tip is not None:
                chain.append((joints + tip, 0.85 * chain[-1][1]))
            for upper, lower in itertools.pairwise(chain):
                add(side, upper, lower)
    middle = next((roles[name] for name in ("spine", "chest") if name in roles), roles["hips"])
    waist = (_spine_middle(skeleton, middle), _TRUNK["waist"])
    hips = [(roles[f"{side}_hip"], _TRUNK["pelvis"]) for side in SIDES]
    shoulders = [(roles[f"{side}_shoulder"], 0.8 * _TRUNK["chest"]) for side in SIDES]
    add("trunk", *hips, waist)
    add("trunk", waist, *shoulders)
    collar = next((roles[name] for name in ("neck", "chest", "spine") if name in roles), roles["hips"])
    add("trunk", (collar, 1.15 * _TRUNK["neck"]), (centre, _TRUNK["neck"]))
    radius = _HEAD[0] + _HEAD[1] * leg
    found.append(Part((centre,), (radius,), "head"))
    return tuple(found)


def _tip_below(skeleton: Skeleton, joint: int) -> int | None:
    return next((i for i, end in enumerate(skeleton.end_sites) if end.parent == joint and any(end.offset)), None)


def _spine_middle(skeleton: Skeleton, joint: int) -> int:
    """The joint in the middle of the trunk: halfway up the chain from the hips to the chest, or the one given."""
    top = skeleton.roles.get("chest", joint)
    chain = [top]
    while skeleton.parents[chain[-1]] > 0:
        chain.append(int(skeleton.parents[chain[-1]]))
    return chain[len(chain) // 2]


def outline(centres: Array, radii: Array) -> Array:
    """Corners of the convex hull of circles on a page, centres (K, 2) and radii (K,)."""
    if len(centres) == 2:
        return capsules(centres[None], radii[None])[0]
    cloud = (centres[:, None] + radii[:, None, None] * _RIM).reshape(-1, 2)
    if len(centres) == 1:
        return cloud
    from scipy.spatial import ConvexHull

    return cloud[ConvexHull(cloud).vertices]


def capsules(centres: Array, radii: Array) -> Array:
    """Hulls (N, C, 2) of pairs of circles, centres (N, 2, 2) and radii (N, 2): two arcs and their common tangents.

    The larger circle alone, where it holds the other.
    """
    span = centres[:, 1] - centres[:, 0]
    length = np.hypot(span[:, 0], span[:, 1])
    drop = radii[:, 0] - radii[:, 1]
    inside = length <= np.abs(drop) + 1e-9
    if inside.any():
        larger = np.where(drop >= 0.0, 0, 1)[:, None]
        whole = np.take_along_axis(centres, larger[:, :, None], axis=1)
        centres = np.where(inside[:, None, None], whole, centres)
        radii = np.where(inside[:, None], np.take_along_axis(radii, larger, axis=1), radii)
    axis = np.arctan2(span[:, 1], span[:, 0])[:, None]
    half = np.where(inside, 0.5 * np.pi, np.arccos(np.clip(drop / np.maximum(length, 1e-9), -1.0, 1.0)))[:, None]
    far = axis + half * _ARC
    near = axis + np.pi + (np.pi - half) * _ARC
    angles = np.stack([near, far], axis=1)
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return (centres[:, :, None] + radii[:, :, None, None] * rim).reshape(len(centres), -1, 2)


def hulls(centres: Sequence[Array], radii: Sequence[Array]) -> list[Array]:
    """:func:`outline` of many parts at once."""
    pairs = [index for index, part in enumerate(centres) if len(part) == 2]
    found: dict[int, Array] = {}
    if pairs:
        stacked = capsules(np.stack([centres[i] for i in pairs]), np.stack([radii[i] for i in pairs]))
        found = dict(zip(pairs, stacked, strict=True))
    return [found[i] if i in found else outline(centres[i], radii[i]) for i in range(len(centres))]


@dataclass(frozen=True, eq=False)
class Seen:
    """One pose as a camera sees it, with the figure's place on the floor at the page's origin.

    Attributes
    ----------
    bodies, shadows
        Polygons (K, 2) with their colours, those behind first.
    extent
        Left, right, bottom and top of the body.
    """

    bodies: tuple[tuple[Array, tuple[float, float, float]], ...]
    shadows: tuple[tuple[Array, str], ...]
    extent: tuple[float, float, float, float]


def see(skeleton: Skeleton, points: Array, camera: Camera) -> Seen:
    """One pose (P, 3) of :func:`body_points` as ``camera`` sees it.

    The point of the floor under the hips is the page's origin, so how far the figure has walked does not matter.
    """
    from matplotlib.colors import to_rgb

    points = points - points[skeleton.roles.get("hips", 0)] * [1.0, 0.0, 1.0]
    page = camera.page(points)
    near = camera.distance / (camera.distance - page[:, 2])
    colours = {"left": LEFT, "right": RIGHT, "trunk": "#8a8f96", "head": "#a9adb3"}
    ranked = sorted(parts(skeleton), key=lambda part: float(page[list(part.points), 2].mean()) + _bias(part, skeleton))
    places, sizes, inks = [], [], []
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for part in ranked:
        index = list(part.points)
        centres, radii = page[index, :2], np.array(part.radii) * near[index]
        haze = float(np.clip(-page[index, 2].mean() / skeleton.leg_length, 0.0, 1.0)) * _HAZE
        base = np.array(to_rgb(colours[part.side]))
        for size, towards, mix in _TONES:
            shade = base + (1.0 - base) * mix if mix > 0 else base * (1.0 + mix)
            colour = shade + (1.0 - shade) * haze
            places.append(centres + towards * radii[:, None] * _LIGHT)
            sizes.append(size * radii)
            inks.append((float(colour[0]), float(colour[1]), float(colour[2])))
        low = np.minimum(low, (centres - radii[:, None]).min(axis=0))
        high = np.maximum(high, (centres + radii[:, None]).max(axis=0))
    bodies = tuple(zip(hulls(places, sizes), inks, strict=True))
    extent = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    return Seen(bodies, _shadows(skeleton, points, camera), extent)


def _bias(part: Part, skeleton: Skeleton) -> float:
    """The trunk's middle lies far behind its skin: limbs in front of it, and the head before the neck, win ties."""
    return 0.06 * skeleton.leg_length if part.side in ("left", "right", "head") else 0.0


def _shadows(skeleton: Skeleton, points: Array, camera: Camera) -> tuple[tuple[Array, str], ...]:
    # The sun stands still with regard to the eye, whichever way the figure faces.
    turn = -camera.turn
    across = np.array([np.cos(turn), np.sin(turn)])
    away = np.array([-np.sin(turn), np.cos(turn)])
    thrown = _SUN[0] * across + _SUN[1] * away
    floor = points[:, [0, 2]] + points[:, 1:2] * thrown
    own = parts(skeleton)
    found = []
    for size, grey in _SHADOW:
        flats = hulls([floor[list(part.points)] for part in own], [size * np.array(part.radii) for part in own])
        for flat in flats:
            spread = np.stack([flat[:, 0], np.zeros(len(flat)), flat[:, 1]], axis=-1)
            found.append((camera.page(spread)[:, :2], grey))
    return tuple(found)


def draw(axes: Axes, poses: Sequence[tuple[Seen, float]]) -> None:
    """Draw poses with their places at ``x`` of the page: all shadows, then bodies from left to right.

    The limits and the place of the axes must be settled: corners are rounded on the page, without which a strip's PDF would be
    several times as large.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.transforms import Affine2D

    figure = axes.figure
    grid = figure.dpi / 72.0 * _GRID
    from_grid = Affine2D().scale(_GRID / 72.0) + figure.dpi_scale_trans

    shadows = [
        (shape + [at, 0.0], grey)
        for ring in range(len(_SHADOW))
        for seen, at in poses
        for shape, grey in seen.shadows
        if grey == _SHADOW[ring][1]
    ]
    bodies = [(shape + [at, 0.0], colour) for seen, at in poses for shape, colour in seen.bodies]
    for shapes, order in ((shadows, 1), (bodies, 2)):
        if shapes:
            corners = np.round(axes.transData.transform(np.concatenate([shape for shape, _ in shapes])) / grid)
            ends = np.cumsum([len(shape) for shape, _ in shapes])[:-1]
            axes.add_collection(
                PolyCollection(
                    np.split(corners, ends),
                    facecolors=[colour for _, colour in shapes],
                    linewidths=0,
                    zorder=order,
                    transform=from_grid,
                    rasterized=order == 1,
                ),
                autolim=False,
            )


def floor(axes: Axes, left: float, right: float, camera: Camera, *, depth: float) -> None:
    """A band of floor from ``left`` to ``right``, ``depth`` metres behind the figures to as much before them."""
    slope = np.sin(camera.tilt)
    back, front = (
        sign * depth * slope * camera.distance / (camera.distance + sign * depth * np.cos(camera.tilt))
        for sign in (1.0, -1.0)
    )
    axes.fill_between([left, right], front, back, color="#f7f7f5", linewidth=0, zorder=0)
    axes.plot([left, right], [back, back], color="#dddddd", linewidth=0.5, zorder=0)
