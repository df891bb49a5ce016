"""Loss curves of the methods that train, for each style (as in figures 7 to 9 of the 2021 paper)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.api import NotApplicableError
from reports.drawing import Drawing
from reports.figures.style import FAINT, INK, MUTED, PAGE, new_figure, style
from reports.figures.ticks import log_ticks
from reports.run import RunView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Columns of the stored curves that are no losses.
_CLOCKS = ("step", "epoch", "seconds")
#: What the short names of losses stand for; others are shown as they are called.
NAMES = {
    "loss": "training loss",
    "adversarial": "adversarial",
    "gan": "adversarial",
    "judge": "discriminator",
    "d_target": "discriminator (target)",
    "d_source": "discriminator (source)",
    "cycle": "cycle consistency",
    "coherence": "temporal coherence",
    "transition": "transition between words",
    "identity": "identity",
    "style": "style (Gram matrices)",
    "smooth": "smoothness",
    "bone": "bone lengths",
    "traj": "trajectory",
    "foot": "foot contact",
}
_HUES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#4d4d4d", "#8C6D1F", "#5E4FA2", "#999933")
_COLUMNS, _PANELS = 3, 12
#: The line is a median over this share of the steps.
_WINDOW = 0.04


def spelled(loss: str) -> str:
    """A loss as the legend names it."""
    if loss in NAMES:
        return NAMES[loss]
    group, _, name = loss.rpartition("/")
    return f"{NAMES.get(name, name).replace('_', ' ')}{f' ({group})' if group else ''}"


def curves(run: RunView, task: str) -> dict[str, list[tuple[int, pd.DataFrame]]]:
    """For each method that stored loss curves, its repetitions with their tables."""
    import pandas as pd

    found: dict[str, list[tuple[int, pd.DataFrame]]] = {}
    for cell in run.cells(task):
        path = cell.folder / "train.parquet"
        if path.is_file():
            table = pd.read_parquet(path)
            if losses(table):
                found.setdefault(cell.method, []).append((cell.repetition, table))
    return found


def losses(table: pd.DataFrame) -> list[str]:
    """The columns of a stored table that are losses with finite values."""
    return [
        name
        for name in table.columns
        if name not in _CLOCKS and not name.startswith("lr/") and np.isfinite(table[name].to_numpy(dtype=float)).any()
    ]


def smooth(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """(N,) running median over ``window`` values about each, fewer at the ends."""
    half = max(window // 2, 0)
    padded = np.pad(values, half, constant_values=np.nan)
    spans = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    keep = np.isfinite(spans).any(axis=1)
    out = np.full(len(values), np.nan)
    out[keep] = np.nanmedian(spans[keep], axis=1)
    return out


def long_table(found: dict[tuple[str, str], list[tuple[int, pd.DataFrame]]]) -> pd.DataFrame:
    """The numbers drawn: ``task, method, repetition, loss, epoch, value, smoothed``."""
    import pandas as pd

    parts = []
    for (task, method), repetitions in found.items():
        for repetition, table in repetitions:
            for loss in losses(table):
                values = table[loss].to_numpy(dtype=float)
                parts.append(
                    pd.DataFrame(
                        {
                            "task": task,
                            "method": method,
                            "repetition": repetition,
                            "loss": loss,
                            "epoch": _clock(table)[1],
                            "value": values,
                            "smoothed": smooth(values, round(_WINDOW * len(values))),
                        }
                    )
                )
    return pd.concat(parts, ignore_index=True)


def _clock(table: pd.DataFrame) -> tuple[str, NDArray[np.float64]]:
    for name in ("epoch", "step"):
        if name in table:
            return name, table[name].to_numpy(dtype=float)
    return "step", np.arange(len(table), dtype=float)


def panels(found: dict[tuple[str, str], list[tuple[int, pd.DataFrame]]], *, tasks: int) -> Figure:
    """Draw a panel for each task and method; every repetition is a line, panels of one method share the axis of losses."""
    # Two tasks make pages of two columns, so that the panels of one method stand side by side.
    columns = min(2 if tasks == 2 else _COLUMNS, len(found))
    rows = -(-len(found) // columns)
    names = {
        key: list(dict.fromkeys(loss for _, table in repetitions for loss in losses(table)))
        for key, repetitions in found.items()
    }
    with style():
        # Below each panel stands its legend, one loss a line, two columns.
        tall = [
            max(-(-len(names[key]) // 2) for key in list(found)[r * columns : (r + 1) * columns]) for r in range(rows)
        ]
        head = 0.2 if tasks == 1 else 0.33
        heights = [1.45 + head + 0.38 + 0.125 * lines for lines in tall]
        height = sum(heights)
        figure = new_figure(PAGE, height)
        top = height
        drawn: dict[str, list[Axes]] = {}
        for row in range(rows):
            for column, key in enumerate(list(found)[row * columns : (row + 1) * columns]):
                width = PAGE / columns
                axes = figure.add_axes(
                    ((column * width + 0.42) / PAGE, (top - head - 1.45) / height, (width - 0.5) / PAGE, 1.45 / height)
                )
                _panel(axes, found[key], names[key])
                task, method = key
                drawn.setdefault(method, []).append(axes)
                lines = [method] if tasks == 1 else [method, task.replace(":", " to ")]
                axes.set_title("\n".join(lines), loc="left", fontsize=_title_size(lines, width - 0.5))
                axes.legend(
                    loc="upper left",
                    bbox_to_anchor=(-0.26 / (width - 0.5), -0.24),
                    ncols=2,
                    frameon=False,
                    fontsize=5.8,
                    handlelength=1.0,
                    handletextpad=0.4,
                    columnspacing=0.8,
                    labelspacing=0.25,
                    borderaxespad=0.0,
                )
            top -= heights[row]
        for together in drawn.values():
            low, high = (pick(axes.get_ylim()[end] for axes in together) for pick, end in ((min, 0), (max, 1)))
            for axes in together:
                axes.set_ylim(low, high)
                log_ticks(axes, "y")
    return figure


def _title_size(lines: list[str], width: float) -> float:
    """Points at which the lines fit ``width`` inches: a letter is 0.62 of its size wide."""
    return min(7.5, 72.0 * width / (0.62 * max(map(len, lines))))


def _panel(axes: Axes, repetitions: list[tuple[int, pd.DataFrame]], names: list[str]) -> None:
    for rank, loss in enumerate(names):
        colour = _HUES[rank % len(_HUES)]
        dash = "-" if rank < len(_HUES) else (0, (3, 1.2))
        for index, (_, table) in enumerate(repetitions):
            if loss not in table:
                continue
            _, clock = _clock(table)
            values = table[loss].to_numpy(dtype=float)
            # On an axis of logarithms what is not positive has no place.
            shown = np.where(values > 0, values, np.nan)
            axes.plot(clock, shown, color=colour, linewidth=0.4, alpha=0.22, zorder=1, rasterized=len(values) > 2000)
            line = smooth(shown, round(_WINDOW * len(values)))
            label = spelled(loss) if index == 0 else None
            axes.plot(clock, line, color=colour, linewidth=1.1, linestyle=dash, zorder=2, label=label)
    axes.set_yscale("log")
    axes.yaxis.grid(True, color=FAINT, linewidth=0.4)
    axes.set_axisbelow(True)
    axes.tick_params(axis="y", which="minor", left=False)
    axes.locator_params(axis="x", nbins=5)
    axes.set_xlabel(_clock(repetitions[0][1])[0], fontsize=6.5, labelpad=1.0)
    axes.xaxis.label.set(color=MUTED)
    axes.tick_params(labelsize=6, colors=INK)
    axes.margins(x=0.01)


def loss_curves(run: RunView) -> list[Drawing]:
    """Every loss of every method that trains, for each style; several tasks share a figure while it fits a page."""
    found = {(task, method): reps for task in run.tasks for method, reps in curves(run, task).items()}
    if not found:
        raise NotApplicableError("no method of this run stored loss curves")
    tasks = list(dict.fromkeys(task for task, _ in found))
    groups = [tasks] if len(found) <= _PANELS else [[task] for task in tasks]
    drawings = []
    for group in groups:
        # Panels of one method stand side by side, a style each.
        methods = list(dict.fromkeys(method for task, method in found if task in group))
        part = {(task, m): found[task, m] for m in methods for task in group if (task, m) in found}
        counts = sorted({len(repetitions) for repetitions in part.values()})
        runs = f"n = {counts[0]}" if len(counts) == 1 else f"n = {counts[0]} to {counts[-1]}"
        drawings.append(
            Drawing(
                name="loss-curves" if len(groups) == 1 else f"loss-curves-{group[0].replace(':', '-to-')}",
                figure=panels(part, tasks=len(run.tasks)),
                caption=(
                    f"{run.dataset_title}, {', '.join(task.replace(':', ' to ') for task in group)}: losses in training, "
                    f"before weighting, on a log scale, {runs} training run{'' if counts[-1] == 1 else 's'} of each method. "
                    f"Faint: every step; line: running median over {100 * _WINDOW:g} % of the steps. Losses of different "
                    "methods are in units of their own; those of an adversarial game need not fall."
                ),
                data=long_table(part),
            )
        )
    return drawings
