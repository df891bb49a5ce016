"""Forest plot of ablations: how far each variant ``name[...]`` of a method is from ``name`` itself, metric by metric."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark.api import NotApplicableError
from benchmark.runner.views import read_leaderboard
from reports.comparison import COMPARISON
from reports.drawing import Drawing
from reports.figures.headline import headline_metrics
from reports.figures.style import FAINT, INK, PAGE, REAL, RIGHT, new_figure, style
from reports.figures.values import statistics_table
from reports.run import RunView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Beside one metric of each group: what the papers' ablations are said to change.
_ABLATED = (
    "physics/jerk-ratio",
    "physics/bone-length-error",
    "content/trajectory-deviation",
    "physics/floor-penetration",
    "physics/pose-jump",
)

_PANELS, _COLUMNS = 9, 3
_ROW, _TITLE, _AXIS = 0.145, 0.34, 0.25


def variants_of(methods: Iterable[str]) -> dict[str, list[str]]:
    """Methods that are there with further settings: ``name`` to all ``name[...]``, ``name[a]`` to ``name[a,...]``, in order.

    A variant of several belongs to the one that it shares most settings with.
    """
    names = list(dict.fromkeys(methods))
    found: dict[str, list[str]] = {base: [] for base in names}
    for name in names:
        bases = [base for base in names if name.startswith(f"{base[:-1]}," if base.endswith("]") else f"{base}[")]
        if bases and name.endswith("]"):
            found[max(bases, key=len)].append(name)
    return {base: variants for base, variants in found.items() if variants}


def differences(comparison: pd.DataFrame, bases: dict[str, list[str]]) -> pd.DataFrame:
    """Variant minus its base, from the stored pairs of methods.

    Parameters
    ----------
    comparison
        Rows of ``metrics-comparison.csv`` of one task and variant of results.
    bases
        As :func:`variants_of` gives them.

    Returns
    -------
    DataFrame
        ``metric, base, variant, diff, low, high, p, p_holm, reject, family, family_size, n_clips``.
    """
    import pandas as pd

    of = {variant: base for base, variants in bases.items() for variant in variants}
    rows = []
    row: Any
    for row in comparison.itertuples():
        for variant, base, sign in ((row.a, row.b, 1.0), (row.b, row.a, -1.0)):
            if of.get(variant) == base:
                bounds = sorted((sign * row.low, sign * row.high))
                rows.append(
                    {
                        "metric": row.metric,
                        "base": base,
                        "variant": variant,
                        "diff": sign * row.diff,
                        "low": bounds[0],
                        "high": bounds[1],
                        "p": row.p,
                        "p_holm": row.p_holm,
                        "reject": bool(row.reject),
                        "family": row.family,
                        "family_size": int(row.family_size),
                        "n_clips": int(row.n_clips),
                    }
                )
    return pd.DataFrame(rows)


def forest(table: pd.DataFrame, meanings: dict[str, tuple[str, str]]) -> Figure:
    """One panel a metric, one row a variant, grouped under the method that they are variants of.

    Parameters
    ----------
    table
        As :func:`differences` gives it.
    meanings
        Metric to its unit and direction.
    """
    metrics = list(dict.fromkeys(table["metric"]))
    lines: list[tuple[str, str | None]] = []
    for base, part in table.groupby("base", sort=False):
        lines += [(str(base), None), *((str(base), str(name)) for name in dict.fromkeys(part["variant"]))]
    columns = min(_COLUMNS, len(metrics))
    rows = -(-len(metrics) // columns)
    names = [name[len(base.removesuffix("]")) + 1 : -1] if name else base for base, name in lines]
    margin = 0.1 + 0.06 * max(map(len, names))
    panel = _TITLE + _ROW * len(lines) + _AXIS
    gap = 0.16
    each = (PAGE - margin - 0.05 - gap * (columns - 1)) / columns
    with style():
        height = rows * panel
        figure = new_figure(PAGE, height)
        for index, metric in enumerate(metrics):
            row, column = divmod(index, columns)
            axes = figure.add_axes(
                (
                    (margin + column * (each + gap)) / PAGE,
                    1.0 - (row * panel + _TITLE + _ROW * len(lines)) / height,
                    each / PAGE,
                    _ROW * len(lines) / height,
                )
            )
            _panel(axes, table[table["metric"] == metric], lines, meanings.get(metric, ("", "none")))
            unit, direction = meanings.get(metric, ("", "none"))
            axes.set_title(f"{metric}{'' if unit in ('', '1') else f' ({unit})'}", loc="left", fontsize=6.8, pad=11)
            better = {"lower": "← better", "higher": "better →"}.get(direction, "")
            axes.text(
                0.0 if direction == "lower" else 1.0,
                1.0,
                better,
                transform=axes.transAxes,
                fontsize=5.8,
                color="#666666",
                va="bottom",
                ha="left" if direction == "lower" else "right",
            )
            if column:
                axes.set_yticks([])
                continue
            axes.set_yticks(range(len(lines)), names)
            for label, (_, name) in zip(axes.get_yticklabels(), lines, strict=True):
                label.set(fontsize=6.5, fontweight="normal" if name else "bold")
    return figure


def _panel(axes: Axes, table: pd.DataFrame, lines: list[tuple[str, str | None]], meaning: tuple[str, str]) -> None:
    sign = {"lower": -1.0, "higher": 1.0}.get(meaning[1], 0.0)
    entries = {str(row["variant"]): row for row in table.to_dict("records")}
    axes.axvline(0.0, color=INK, linewidth=0.6)
    for place, (_, name) in enumerate(lines):
        if name is None:
            continue
        axes.axhline(place, color=FAINT, linewidth=0.5, zorder=0)
        entry = entries.get(name)
        if entry is None or not np.isfinite(entry["diff"]):
            axes.text(
                *(0.02, place, "no value"),
                transform=axes.get_yaxis_transform(),
                fontsize=5.5,
                va="center",
                color="#777777",
            )
            continue
        low, high = float(entry["low"]), float(entry["high"])
        good = sign * float(entry["diff"])
        sure = low > 0.0 or high < 0.0
        colour = INK if not (sure and sign) else REAL if good > 0 else RIGHT
        axes.plot([low, high], [place, place], color=colour, linewidth=1.1, solid_capstyle="butt")
        face = colour if entry["reject"] else "#ffffff"
        axes.plot(entry["diff"], place, "o", color=colour, markersize=3.6, markerfacecolor=face, markeredgewidth=0.9)
    axes.set_ylim(len(lines) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", labelsize=5.8, pad=1.5, length=2)
    axes.locator_params(axis="x", nbins=4)
    axes.margins(x=0.08)
    axes.spines["left"].set_visible(False)


def ablation_forest(run: RunView) -> list[Drawing]:
    """What each ablation changes: differences of variants from their method with intervals."""
    import pandas as pd

    stored = statistics_table(run, COMPARISON)
    drawings = []
    for task in run.tasks:
        part = stored[(stored["task"] == task) & (stored["variant"] == "raw")]
        table = differences(part, variants_of(run.methods(task)))
        if table.empty:
            continue
        moved = table[(table["low"] != 0.0) | (table["high"] != 0.0)]
        chosen = headline_metrics(moved["metric"], also=_ABLATED)[:_PANELS]
        table = table[table["metric"].isin(chosen)].copy()
        if table.empty:
            continue
        table["metric"] = pd.Categorical(table["metric"], categories=chosen)
        table = table.sort_values("metric", kind="stable").astype({"metric": str})
        meanings = {
            row["metric"]: (row["unit"], row["direction"])
            for row in read_leaderboard(run.folder)
            if row["task"] == task
        }
        rows = run.results
        rows = rows[(rows["task"] == task) & (rows["status"] == "ok") & (rows["clip_id"] != "")]
        trainings = int(rows[rows["method"].isin(table["base"])]["repetition"].nunique())
        sizes = sorted(set(table["family_size"]))
        tests = str(sizes[0]) if len(sizes) == 1 else f"{sizes[0]} to {sizes[-1]}"
        drawings.append(
            Drawing(
                name=f"ablation-forest-{task.replace(':', '-to-')}",
                figure=forest(table, meanings),
                caption=(
                    f"{run.dataset_title}, {task.replace(':', ' to ')}, raw results: each variant minus the method (bold) that "
                    f"it is a variant of, paired over {int(table['n_clips'].max())} test clips of {rows['actor'].nunique()} "
                    f"actors, {'one training' if trainings == 1 else f'{trainings} trainings'} each. Lines: 95 % intervals of "
                    "a hierarchical bootstrap (actors, their clips, trainings crossed with both). Green: better, orange: "
                    "worse, where the interval excludes 0 and the metric has a better side. Filled: p < .05 after Holm's "
                    f"correction within the metric's group over all pairs of methods ({tests} tests); open: not."
                ),
                data=table,
            )
        )
    if not drawings:
        raise NotApplicableError("no method was run beside variants of it, such as cyclegan and cyclegan[coherence=0]")
    return drawings
