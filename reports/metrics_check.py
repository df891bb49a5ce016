"""Which metric sees which fault: the check of the metrics as a table (CSV, Markdown, LaTeX) and a figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eval.meta.ordering import Ordering
from reports.drawing import Drawing, save
from reports.figures.style import INK, PAGE, new_figure, style
from reports.latex import fitted, latex_escape
from reports.markdown import markdown_escape
from reports.tables import arrow

if TYPE_CHECKING:
    import pandas as pd

    from eval.meta.study import Study

#: What stands in a cell, by what was observed.
MARKS = {"ordered": "●", "seen": "○", "fooled": "▽", "blind": "·", "no value": ""}
_LATEX_MARKS = {
    "ordered": r"$\bullet$",
    "seen": r"$\circ$",
    "fooled": r"$\triangledown$",
    "blind": "",
    "no value": "--",
}

LEGEND = (
    "● worse with every grade, ○ worse at the last grade but not in order, ▽ better although the motion is worse, "
    "· no difference, empty: no value. The number is the smallest grade from which on the fault is seen (95 % interval of the "
    "paired difference)."
)

#: Effects at which colours are saturated, in standard deviations between clips.
_SATURATED = 2.0
_WORSE, _BETTER, _SURPRISE = "#D55E00", "#0072B2", "#CC0077"

NAME = "metrics-check"


def cell(ordering: Ordering) -> str:
    """One cell in a sign and the smallest grade seen."""
    return MARKS[ordering.observed] + (str(ordering.first_seen) if ordering.first_seen else "")


def groups(study: Study) -> dict[str, list[str]]:
    """The metrics of each group, in the order in which groups first come."""
    found: dict[str, list[str]] = {}
    for metric in study.metrics:
        found.setdefault(metric.partition("/")[0], []).append(metric)
    return found


def summary(study: Study) -> pd.DataFrame:
    """One row for each metric and fault: what was expected, what was observed, and the numbers behind it."""
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for metric, info in study.metrics.items():
        for corruption in study.corruptions:
            found = study.orderings[metric, corruption.name]
            holds = study.holds(metric, corruption.name)
            row: dict[str, Any] = {
                "metric": metric,
                "unit": info.unit,
                "direction": info.direction,
                "target": info.target,
                "scope": info.scope,
                "version": info.version,
                "corruption": corruption.name,
                "expected": study.expectation(metric, corruption.name).word,
                "observed": found.observed,
                "as_expected": "" if holds is None else ("yes" if holds else "no"),
                "effect": found.effect,
                "tau": found.tau,
                "tau_low": found.tau_low,
                "tau_high": found.tau_high,
                "ordered_share": found.ordered_share,
                "first_seen": found.first_seen,
                "first_seen_amount": corruption.labels[found.first_seen] if found.first_seen else "",
                "clips": found.clips,
            }
            for grade, label in enumerate(corruption.labels):
                row |= {
                    f"amount_{grade}": label,
                    f"mean_{grade}": found.means[grade],
                    f"difference_low_{grade}": found.lows[grade],
                    f"difference_high_{grade}": found.highs[grade],
                }
            rows.append(row)
    return pd.DataFrame(rows)


def markdown(study: Study) -> str:
    """A Markdown table, metrics as rows and faults as columns; what is not as declared is in bold."""
    lines = [
        "| metric | " + " | ".join(entry.title for entry in study.corruptions) + " |",
        "| --- |" + " :---: |" * len(study.corruptions),
    ]
    for group, members in groups(study).items():
        lines.append(f"| **{group}** |" + " |" * len(study.corruptions))
        for metric in members:
            signs = []
            for entry in study.corruptions:
                sign = cell(study.orderings[metric, entry.name])
                signs.append(f"**{sign} !**" if study.holds(metric, entry.name) is False else sign)
            lines.append(f"| {markdown_escape(_label(study, metric))} | " + " | ".join(signs) + " |")
    good, bad = study.verdicts()
    grades = "; ".join(f"{entry.title}: {', '.join(entry.labels[1:])}" for entry in study.corruptions)
    lines += [
        "",
        LEGEND,
        "",
        f"{study.clips} true performances. Grades: {grades}.",
        "",
        f"{good} of {good + bad} declared expectations hold; those that do not are marked with an exclamation mark.",
    ]
    return "\n".join(lines) + "\n"


def latex(study: Study) -> str:
    """A booktabs table like :func:`markdown`, cells shaded by effect."""
    columns = len(study.corruptions)
    heads = " & ".join(rf"\rotatebox{{60}}{{{entry.title}}}" for entry in study.corruptions)
    tabular = [rf"\begin{{tabular}}{{l{'c' * columns}}}", r"\toprule", rf"metric & {heads} \\"]
    for group, members in groups(study).items():
        tabular += [r"\midrule", rf"\multicolumn{{{columns + 1}}}{{l}}{{\textbf{{{latex_escape(group)}}}}} \\"]
        for metric in members:
            cells = " & ".join(_latex_cell(study, metric, entry.name) for entry in study.corruptions)
            tabular.append(rf"{latex_escape(metric.partition('/')[2])} & {cells} \\")
    tabular += [r"\bottomrule", r"\end{tabular}"]
    lines = [
        "% needs: booktabs, graphicx, amssymb, xcolor with option table",
        r"\begin{table}",
        r"\centering\scriptsize\setlength{\tabcolsep}{2.5pt}",
        (
            rf"\caption{{Which metric sees which fault, on {study.clips} true performances in graded corruption. "
            r"$\bullet$ worse with every grade, $\circ$ worse at the last grade but not in order, $\triangledown$ better; "
            r"the number is the smallest grade that is seen. A frame: not as declared. Shade: effect at the last grade.}"
        ),
        r"\label{tab:metrics-check}",
        *fitted(tabular),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _latex_cell(study: Study, metric: str, corruption: str) -> str:
    found = study.orderings[metric, corruption]
    text = _LATEX_MARKS[found.observed] + (str(found.first_seen) if found.first_seen else "")
    if study.holds(metric, corruption) is False:
        text = rf"\fbox{{{text or '~'}}}"
    strength = _strength(found)
    if abs(strength) < 0.05:
        return text
    return rf"\cellcolor{{{'orange' if strength > 0.0 else 'cyan'}!{round(60 * abs(strength))}}}{text}"


def _strength(ordering: Ordering) -> float:
    """Effect from -1 to 1; 0 where nothing is beyond doubt."""
    if ordering.observed in ("blind", "no value"):
        return 0.0
    return float(np.clip(ordering.effect / _SATURATED, -1.0, 1.0))


def _label(study: Study, metric: str) -> str:
    info = study.metrics[metric]
    return f"{metric.partition('/')[2]} {arrow(info.direction, info.target)}".strip()


def drawing(study: Study) -> Drawing:
    """A heat map, metrics by group as rows and faults as columns."""
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.patches import Rectangle

    colours = LinearSegmentedColormap.from_list("effect", [_BETTER, "#ffffff", _WORSE])
    neutral = LinearSegmentedColormap.from_list("change", ["#ffffff", "#ffffff", "#777777"])
    lines: list[str | None] = []
    for members in groups(study).values():
        lines += [None, *members]
    titles = list(groups(study))
    row_height, head, foot = 0.148, 0.85, 0.62
    with style():
        height = row_height * len(lines) + head + foot
        figure = new_figure(PAGE, height)
        axes = figure.add_axes((0.25, foot / height, 0.68, row_height * len(lines) / height))
        for row, metric in enumerate(lines):
            if metric is None:
                axes.text(-0.6, row + 0.08, titles.pop(0), ha="right", va="center", fontsize=6.8, fontweight="bold")
                continue
            axes.text(-0.6, row, _label(study, metric), ha="right", va="center", fontsize=6.2)
            for column, entry in enumerate(study.corruptions):
                found = study.orderings[metric, entry.name]
                tints = neutral if study.metrics[metric].direction == "none" else colours
                face = tints(0.5 + 0.5 * _strength(found)) if found.observed != "no value" else "#f3f3f3"
                axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, facecolor=face, edgecolor="#ffffff", lw=0.6))
                axes.text(column, row, cell(found), ha="center", va="center", fontsize=5.8, color=INK)
                holds = study.holds(metric, entry.name)
                if holds is False or (holds and study.expectation(metric, entry.name).asks):
                    colour, width = (_SURPRISE, 1.3) if holds is False else (INK, 0.5)
                    axes.add_patch(
                        Rectangle((column - 0.44, row - 0.42), 0.88, 0.84, fill=False, edgecolor=colour, lw=width)
                    )
        axes.set_xlim(-0.5, len(study.corruptions) - 0.5)
        axes.set_ylim(len(lines) - 0.5, -0.5)
        axes.set_yticks([])
        axes.set_xticks(range(len(study.corruptions)), [entry.title for entry in study.corruptions])
        axes.xaxis.tick_top()
        axes.tick_params(axis="x", length=0, labelsize=6.6)
        for label in axes.get_xticklabels():
            label.set(rotation=50, ha="left", rotation_mode="anchor")
        for spine in axes.spines.values():
            spine.set_visible(False)
        bar = figure.add_axes((0.06, 0.3 / height, 0.15, 0.08 / height))
        bar.imshow(np.linspace(0, 1, 256)[None], aspect="auto", cmap=colours, extent=(-_SATURATED, _SATURATED, 0, 1))
        bar.set_yticks([])
        bar.set_xticks([-_SATURATED, 0, _SATURATED], ["2 SD better", "0", "2 SD worse"])
        bar.tick_params(axis="x", length=1.5, labelsize=5.8)
        key = (
            "● worse with every grade   ○ worse at the last grade, not in order   ▽ better although the motion is worse   "
            "· no difference\n"
            "number: smallest grade seen   grey cell: a metric that only describes has moved   pale, without sign: no value\n"
            "thin frame: declared to be seen   thick frame: not as declared"
        )
        figure.text(0.25, 0.47 / height, key, fontsize=5.6, va="top", linespacing=1.5)
    good, bad = study.verdicts()
    return Drawing(
        name=NAME,
        figure=figure,
        caption=(
            f"Which metric sees which fault. {study.clips} true performances of the generated data set are spoiled in grades; "
            "colour: change at the last grade in standard deviations between clips (orange worse, blue better, where the 95 % "
            f"interval of the paired difference excludes 0). {LEGEND} {good} of {good + bad} declared expectations hold."
        ),
        data=summary(study),
    )


def write_metrics_check(study: Study, folder: Path) -> list[Path]:
    """Write tables, figure and every single value into ``folder``; return the paths."""
    import pandas as pd

    folder.mkdir(parents=True, exist_ok=True)
    made = drawing(study)
    saved = save(made, folder)
    tables = {folder / f"{NAME}.md": markdown(study), folder / f"{NAME}.tex": latex(study)}
    for path, text in tables.items():
        path.write_text(text, encoding="utf-8")
    values = folder / "values.csv"
    pd.DataFrame([vars(value) for value in study.values]).to_csv(values, index=False)
    return [saved.png, saved.pdf, saved.csv, *tables, values]
