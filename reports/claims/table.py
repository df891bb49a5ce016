"""The table of claims in CSV, Markdown and LaTeX."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reports.claims.evidence import claim_verdicts
from reports.latex import latex_escape
from reports.markdown import markdown_escape
from reports.tables import number

if TYPE_CHECKING:
    import pandas as pd

#: Files, in the run folder.
CSV, MARKDOWN, LATEX = "stats/claims.csv", "tables/claims.md", "tables/claims.tex"


def write_claims(table: pd.DataFrame, folder: Path) -> list[Path]:
    """Write the table of :func:`reports.claims.evidence.judge` into a run folder; return the paths."""
    texts = {CSV: table.to_csv(index=False, lineterminator="\n"), MARKDOWN: markdown(table), LATEX: latex(table)}
    paths = []
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        paths.append(path)
    return paths


def effect(row: Any) -> str:
    """The effect with its interval; positive is as stated."""
    if not np.isfinite(row.effect):
        return "–"
    if not np.isfinite(row.low):
        return ""
    return f"{number_signed(row.effect)} [{number_signed(row.low)}, {number_signed(row.high)}]"


def number_signed(value: float) -> str:
    """A number with its sign."""
    return f"+{number(value)}" if value > 0 else number(value).replace("-", "−")


def p_value(p: float) -> str:
    """A p value as papers print it."""
    if not np.isfinite(p):
        return "–"
    return "< .001" if p < 0.001 else f"{p:.3f}".removeprefix("0")


def markdown(table: pd.DataFrame) -> str:
    """One section for each paper: claims with their verdicts, and under each its tests."""
    verdicts = claim_verdicts(table)
    lines = [
        "Effects are differences on the same clips (or within raters), positive as the paper states them, with 95 % intervals; "
        "p after Holm's correction over the whole table.",
        "",
    ]
    row: Any
    for paper, group in table.groupby("paper", sort=False):
        lines += [
            f"### {paper}",
            "",
            "| claim | test | effect | p | n | verdict | |",
            "| --- | --- | ---: | ---: | --- | --- | --- |",
        ]
        for name, rows in group.groupby("claim", sort=False):
            for place, row in enumerate(rows.itertuples()):
                said = f"{row.statement} ({row.where})" if place == 0 else ""
                verdict = (
                    row.verdict
                    if len(rows) == 1
                    else f"{row.verdict}" + (f" (claim: {verdicts[str(name)]})" if place == 0 else "")
                )
                values = [said, row.test, effect(row), p_value(row.p_holm), row.n, verdict, row.why]
                cells = [markdown_escape(str(value)) for value in values]
                cells[5] = f"**{cells[5]}**"
                lines.append("| " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)


def latex(table: pd.DataFrame) -> str:
    """A booktabs table, one test a row."""
    simulated = table["why"].str.contains("simulated observers").any()
    caption = (
        "Claims of the papers, tested. Effects are positive as stated, with 95\\,\\% intervals; "
        "$p$ after Holm's correction."
    )
    if simulated:
        caption += " Rows on ratings: simulated observers, not people."
    lines = [
        "% needs: booktabs, longtable, array",
        r"{\footnotesize\setlength{\tabcolsep}{3pt}\setlength{\LTcapwidth}{\linewidth}",
        r"\begin{longtable}{@{}*{2}{>{\raggedright\arraybackslash}p{0.245\linewidth}}rrl@{}}",
        rf"\caption{{{caption}}}\label{{tab:claims}}\\",
        r"\toprule",
        r"claim & test & effect & $p$ & verdict \\",
        r"\midrule\endhead",
    ]
    row: Any
    for paper, group in table.groupby("paper", sort=False):
        lines.append(rf"\multicolumn{{5}}{{l}}{{\emph{{{latex_escape(str(paper))}}}}} \\")
        previous = ""
        for row in group.itertuples():
            said = latex_escape(str(row.statement)) if row.claim != previous else ""
            previous = str(row.claim)
            shown = latex_escape(effect(row))
            cells = [
                said,
                latex_escape(str(row.test)),
                shown,
                latex_escape(p_value(row.p_holm)),
                str(row.verdict),
            ]
            lines.append(" & ".join(cells) + r" \\")
        lines.append(r"\addlinespace")
    return "\n".join([*lines, r"\bottomrule", r"\end{longtable}", "}"]) + "\n"
