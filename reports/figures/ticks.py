"""Ticks of axes of logarithms that hold few decades: enough of them, as plain numbers, apart from one another."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Ticks within a decade, by the number of decades above which fewer do.
_WITHIN: tuple[tuple[float, tuple[float, ...]], ...] = (
    (2.0, (1.0,)),
    (0.7, (1.0, 2.0, 5.0)),
    (0.0, (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)),
)
#: No two neighbours of the finest ticks are further apart than 5 / 3, so an axis of this factor holds two of them.
_LEAST = 3.0
#: Above so many decades numbers are powers of ten.
_POWERS = 6.0


def log_ticks(axes: Axes, which: Literal["x", "y"], *, span: float = _LEAST) -> None:
    """Set limits and ticks of an axis of logarithms whose data are drawn.

    Left alone, an axis of less than a decade gets evenly spaced ticks with as many digits as it takes to tell them apart, which
    lie over one another or leave the page.

    Parameters
    ----------
    axes
        Axes of which one axis has a scale of logarithms.
    which
        That axis.
    span
        A narrower axis is widened about its middle until its ends differ by this factor, 3 or more: differences too small to
        mean anything should not fill the page.

    Raises
    ------
    ValueError
        For a span below 3.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    if span < _LEAST:
        raise ValueError(f"span is {span:g}: an axis of a factor below {_LEAST:g} may be without ticks")
    axis = {"x": axes.xaxis, "y": axes.yaxis}[which]
    low, high = getattr(axes, f"get_{which}lim")()
    if high < span * low:
        middle = np.sqrt(low * high)
        low, high = middle / np.sqrt(span), middle * np.sqrt(span)
        getattr(axes, f"set_{which}lim")(low, high)
    decades = float(np.log10(high / low))
    axis.set_major_locator(LogLocator(subs=next(subs for least, subs in _WITHIN if decades >= least), numticks=9))
    if decades < _POWERS:
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
