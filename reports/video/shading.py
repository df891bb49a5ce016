"""Lit capsules with smooth edges, painted from far to near into a picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.video.canvas import Canvas, Plane

#: Where the light is, in the picture's own axes: to the left, above, before it. Unit length.
_LIGHT = np.array([-0.42, 0.62, 0.66], dtype=np.float32) / np.float32(np.sqrt(0.42**2 + 0.62**2 + 0.66**2))

#: Brightness without light, its growth with light, and what is left of it at the rim, which sets limbs off from the trunk.
_AMBIENT, _DIFFUSE, _RIM = 0.36, 0.64, 0.6

#: Where two surfaces meet, one passes into the other over this share of the larger radius.
_BLEND = 0.12


_ZERO, _ONE = np.float32(0.0), np.float32(1.0)

Capsule = tuple[float, float, float, float, float, float, float, float, int]


def paint(
    canvas: Canvas,
    panel: tuple[int, int, int, int],
    capsules: Sequence[Capsule],
    colours: Plane,
    ground: Plane,
) -> None:
    """Paint capsules into a panel of a canvas, the first one farthest away.

    Parameters
    ----------
    panel
        Top, left, height and width of the panel in the canvas, all even.
    capsules
        Of one end and of the other, centre x, y, nearness and radius, all in pixels; and the row of ``colours``. Nearness
        grows towards the camera.
    colours
        (C, 3) colours of bodies in full light, see :func:`~reports.video.canvas.to_ycc`.
    ground
        (H, W) nearness of the ground, which hides what is below it.

    Notes
    -----
    A capsule's picture is taken as that of the spheres along its axis: for each pixel the nearest point of the axis, the
    radius there, and from both the sphere's normal and how near its surface is. The nearest surface wins; the outer edge is
    one pixel wide, for which the order matters.
    """
    top, left_edge, height, width = panel
    x0 = max(int(min(min(c[0] - c[3], c[4] - c[7]) for c in capsules)) - 2, 0) & ~1
    x1 = min((int(max(max(c[0] + c[3], c[4] + c[7]) for c in capsules)) + 4) & ~1, width)
    y0 = max(int(min(min(c[1] - c[3], c[5] - c[7]) for c in capsules)) - 2, 0) & ~1
    y1 = min((int(max(max(c[1] + c[3], c[5] + c[7]) for c in capsules)) + 4) & ~1, height)
    if x0 >= x1 or y0 >= y1:
        return
    # How much of what is behind still shows, and how much light each colour of body gives: one plane each.
    planes = np.zeros((1 + len(colours), y1 - y0, x1 - x0), dtype=np.float32)
    planes[0] = 1.0
    nearest = ground[y0:y1, x0:x1].copy()
    columns = np.arange(x0, x1, dtype=np.float32) + np.float32(0.5)
    rows = np.arange(y0, y1, dtype=np.float32) + np.float32(0.5)
    for capsule in capsules:
        ax, ay, _, ar, bx, by, _, br, _ = capsule
        left = max(int(min(ax - ar, bx - br)) - 1 - x0, 0)
        right = min(int(max(ax + ar, bx + br)) + 2 - x0, x1 - x0)
        low = max(int(min(ay - ar, by - br)) - 1 - y0, 0)
        high = min(int(max(ay + ar, by + br)) + 2 - y0, y1 - y0)
        if left < right and low < high:
            _paint_one(
                planes[:, low:high, left:right],
                nearest[low:high, left:right],
                columns[left:right] - np.float32(ax),
                rows[low:high] - np.float32(ay),
                capsule,
            )
    canvas.blend(planes, colours, top + y0, left_edge + x0)


def _limit(plane: Plane) -> None:
    """Clip to 0 to 1 in place; half as long as ``np.clip`` for the few pixels of a limb."""
    np.maximum(plane, _ZERO, out=plane)
    np.minimum(plane, _ONE, out=plane)


def _paint_one(
    planes: Plane,
    nearest: Plane,
    x: Plane,
    y: Plane,
    capsule: Capsule,
) -> None:
    """One capsule over planes (1 + C, h, w) and nearness (h, w); ``x`` (w,) and ``y`` (h,) are relative to its first end."""
    ax, ay, az, ar, bx, by, bz, br, colour = capsule
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy + 1e-6
    along = (x * np.float32(dx / length2))[None, :] + (y * np.float32(dy / length2))[:, None]
    _limit(along)
    nx = along * np.float32(-dx)
    nx += x[None, :]
    ny = along * np.float32(-dy)
    ny += y[:, None]
    near = along * np.float32(bz - az)
    near += np.float32(az)
    radius = along
    radius *= np.float32(br - ar)
    radius += np.float32(ar)
    square = nx * nx
    square += ny * ny
    cover = radius - np.sqrt(square)
    cover += np.float32(0.5)
    _limit(cover)
    inverse = _ONE / radius
    square *= inverse
    square *= inverse
    np.subtract(_ONE, square, out=square)
    np.maximum(square, _ZERO, out=square)
    nz = np.sqrt(square)
    near += nz * radius
    # Hidden by what is nearer already, softly where two surfaces meet.
    shown = near - nearest
    shown *= np.float32(1.0 / (_BLEND * max(ar, br) + 0.5))
    shown += np.float32(0.5)
    _limit(shown)
    # The outermost pixels, covered in part, hide nothing.
    np.subtract(cover, _ONE, out=square)
    square *= np.float32(1e6)
    near += square
    np.maximum(nearest, near, out=nearest)
    cover *= shown
    nx *= np.float32(_LIGHT[0])
    ny *= np.float32(_LIGHT[1])
    nx -= ny  # pixels run downwards
    nx *= inverse
    light = nx
    light += nz * np.float32(_LIGHT[2])
    np.maximum(light, _ZERO, out=light)
    light *= np.float32(_DIFFUSE)
    light += np.float32(_AMBIENT)
    nz *= np.float32(1.0 - _RIM)
    nz += np.float32(_RIM)
    light *= nz
    light *= cover
    np.subtract(_ONE, cover, out=cover)
    planes *= cover
    planes[1 + colour] += light
