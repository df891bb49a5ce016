"""The one look of all figures: readable at column width, in print and by colour-blind readers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Width of one column and of a full page, inches.
COLUMN, PAGE = 3.4, 7.1

#: Okabe and Ito's palette, which keeps its order of lightness in grey.
LEFT, RIGHT, TRUNK = "#0072B2", "#D55E00", "#4d4d4d"
REAL = "#009E73"
INK, MUTED, FAINT = "#222222", "#666666", "#d9d9d9"

#: Colours of families of methods, told apart by colour-blind readers; green is kept for real performers.
_HUES = ("#0072B2", "#E69F00", "#CC79A7", "#56B4E9", "#D55E00", "#8C6D1F", "#5E4FA2", "#999933")
_MARKS = "osD^vPXp<>h"


@dataclass(frozen=True)
class Look:
    """How one method is drawn in every figure of a run."""

    colour: str
    marker: str


def looks(methods: Iterable[str], *, floor: str, real: str) -> dict[str, Look]:
    """A look for each method: a colour for each family, a marker for each variant; grey for the floor, green for real ones."""
    found: dict[str, Look] = {}
    members: dict[str, list[str]] = {}
    for method in methods:
        if method == floor:
            found[method] = Look(MUTED, "s")
        elif method == real:
            found[method] = Look(REAL, "*")
        else:
            name = method.partition("[")[0]
            members.setdefault(name, []).append(method)
            rank = list(members).index(name)
            # Families past the palette come round to the same colours, with the next marker.
            mark = len(members[name]) - 1 + rank // len(_HUES)
            found[method] = Look(_HUES[rank % len(_HUES)], _MARKS[mark % len(_MARKS)])
    return found


_RC: dict[Any, Any] = {
    "figure.dpi": 100,
    "savefig.dpi": 200,
    "font.size": 8,
    "font.family": "DejaVu Sans",
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    # TrueType: publishers refuse type 3.
    "pdf.fonttype": 42,
    "pdf.compression": 9,
    "svg.hashsalt": "motion-style-benchmark",
}


#: Width of a letter as a share of its size: no text of the house's font is wider on average, some capitals aside.
_LETTER = 0.62
#: Points of a name of two lines in a row.
_TWO_LINES = 5.5


def fitted(name: str, inches: float, size: float) -> tuple[str, float]:
    """A method's name for a margin so many ``inches`` wide: its variant on a second line, smaller, if need be.

    Returns
    -------
    tuple of str and float
        The text and its size in points, at most ``size``.
    """
    room = 72.0 * inches / _LETTER
    text = name if len(name) * size <= room else name.replace("[", "\n[", 1)
    return text, min(size, room / max(map(len, text.split("\n"))))


def name_rows(axes: Axes, at: Sequence[float], names: Sequence[str], inches: float, size: float = 7.0) -> None:
    """Name the rows of axes at heights ``at`` in a margin so many ``inches`` wide.

    All names are of one size on one line, where that is no smaller than two lines would be.
    """
    common = min(size, 72.0 * inches / _LETTER / max(map(len, names), default=1))
    texts = [(name, common) if common >= _TWO_LINES else fitted(name, inches, size) for name in names]
    axes.set_yticks(list(at), [text for text, _ in texts])
    for label, (text, points) in zip(axes.get_yticklabels(), texts, strict=True):
        # Two lines must not reach into the next row.
        label.set_fontsize(min(points, _TWO_LINES) if "\n" in text else points)
        label.set_linespacing(0.95)


@contextmanager
def style() -> Iterator[None]:
    """Draw in the house style, without a window, whatever the user's own settings are."""
    import matplotlib as mpl

    mpl.use("Agg", force=True)
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        yield


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of the given size in inches, unknown to pyplot and so freed with its last reference."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure
