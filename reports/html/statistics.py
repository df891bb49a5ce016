"""Statistics in words: methods compared on the metrics, ratings, and the papers' claims, from what the run stored of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from reports.claims.table import CSV, effect, number_signed, p_value
from reports.comparison import COMPARISON, RANKS
from reports.run import FLOOR, RunView
from reports.tables import by_group

if TYPE_CHECKING:
    import pandas as pd

#: More sentences than this under one heading are folded away.
_LONG = 12


@dataclass(frozen=True)
class Verdict:
    """How the methods rank on one metric, in words."""

    metric: str
    words: str


def comparison(run: RunView) -> list[dict[str, Any]]:
    """For each task, sentences on every metric that judges, by group, from the stored comparison of raw results.

    Empty where the run has none.
    """
    import pandas as pd

    stats = run.folder / "stats"
    if not (stats / COMPARISON).is_file() or not (stats / RANKS).is_file():
        return []
    differences, ranks = pd.read_csv(stats / COMPARISON), pd.read_csv(stats / RANKS, dtype={"groups": "string"})
    if differences.empty or ranks.empty:
        return []
    found = []
    for task in run.tasks:
        ranked = ranks[(ranks["task"] == task) & (ranks["variant"] == "raw")]
        pairs = differences[(differences["task"] == task) & (differences["variant"] == "raw")]
        if ranked.empty:
            continue
        groups = [
            {
                "group": group,
                "verdicts": [
                    _verdict(str(metric), rows, pairs[pairs["metric"] == metric])
                    for metric, rows in part.groupby("metric", sort=False)
                ],
                "against": _against(run, pairs[pairs["metric"].isin(part["metric"])], task),
            }
            for group, part in by_group(ranked).items()
        ]
        found.append({"task": task.replace(":", " to "), "groups": groups, "n": int(ranked["n"].max())})
    return found


def _verdict(metric: str, ranks: pd.DataFrame, pairs: pd.DataFrame) -> Verdict:
    rows: list[Any] = list(ranks.sort_values("mean_rank", kind="stable").itertuples())
    first = rows[0]
    bars = set(str(first.groups).split()) if isinstance(first.groups, str) else set()
    tied = [row.method for row in rows[1:] if isinstance(row.groups, str) and bars & set(row.groups.split())]
    differ = f"{int(pairs['reject'].sum())} of {len(pairs)} pairs of rows differ"
    if not np.isfinite(first.p):
        return Verdict(metric, f"all methods have the same values; {differ}.")
    if first.p >= 0.05:
        return Verdict(
            metric, f"no method ranks above the others (Friedman p = {first.p:.2f}, {first.n} clips); {differ}."
        )
    best = f"{first.method} ranks first (mean rank {first.mean_rank:.1f} of {first.k} over {first.n} clips)"
    rest = f"not told apart from it: {', '.join(tied)}" if tied else "every other method ranks clearly lower"
    return Verdict(metric, f"{best}; {rest}; last is {rows[-1].method} ({rows[-1].mean_rank:.1f}). {differ}.")


def _against(run: RunView, pairs: pd.DataFrame, task: str) -> list[dict[str, str]]:
    """The differences of each method from the floor, where the run has one."""
    rows = []
    pair: Any
    for pair in pairs[pairs["a"].eq(FLOOR) | pairs["b"].eq(FLOOR)].itertuples():
        # Stored as a - b; here the floor is taken away from the method.
        sign = -1.0 if pair.a == FLOOR else 1.0
        low, high = sorted((sign * pair.low, sign * pair.high))
        rows.append(
            {
                "metric": pair.metric,
                "method": run.label(pair.b if pair.a == FLOOR else pair.a),
                "difference": number_signed(sign * pair.diff),
                "interval": f"[{number_signed(low)}, {number_signed(high)}]",
                "p": p_value(pair.p_holm),
                "clear": "yes" if pair.reject else "no",
            }
        )
    return rows


@dataclass
class Section:
    """A heading of the ratings' text and the HTML below it."""

    title: str
    html: str = ""
    folded: bool = False


@dataclass
class Ratings:
    """What was found on ratings.

    Attributes
    ----------
    task
        Which task's results were rated; empty where the run has one task.
    kind
        Who rated, as the analysis says it, for example ``simulated observers, not people``.
    simulated
        Whether nobody rated.
    warning
        What the analysis says of that first, as HTML.
    sections
        The text by headings; the first has no heading.
    """

    task: str
    kind: str
    simulated: bool
    warning: str = ""
    sections: list[Section] = field(default_factory=list)


def ratings(run: RunView) -> list[Ratings]:
    """What is stored on ratings of each task; none where nothing was rated."""
    found = []
    for place, task in enumerate(run.tasks):
        stem = "ratings" if place == 0 else f"ratings-{task.replace(':', '-to-')}"
        path = run.folder / "stats" / f"{stem}.md"
        if path.is_file():
            name = task.replace(":", " to ") if len(run.tasks) > 1 else ""
            found.append(read_ratings_text(path.read_text(encoding="utf-8"), name))
    return found


def read_ratings_text(text: str, task: str = "") -> Ratings:
    """The text of an analysis of ratings, in Markdown, as HTML in which nothing but its own words stands."""
    from markdown_it import MarkdownIt
    from markupsafe import Markup

    # Names of methods and clips stand in the text: no tag, link or picture may come of them.
    reader = MarkdownIt("commonmark", {"html": False}).disable(["link", "image", "autolink", "reference", "html_block"])
    tokens = reader.parse(text)
    kind, sections, start = "", [Section("")], 0

    def close(end: int) -> None:
        sections[-1].html = Markup(reader.renderer.render(tokens[start:end], reader.options, {}))
        sections[-1].folded = sum(token.type == "list_item_open" for token in tokens[start:end]) > _LONG

    for place, token in enumerate(tokens):
        if token.type == "heading_open":
            close(place)
            title = tokens[place + 1].content
            name, _, who = title.partition(" (")
            kind = kind or who.rstrip(")")
            start = place + 3
            sections.append(Section("" if token.tag == "h1" else name))
    close(len(tokens))
    warning = ""
    if len(sections) > 1 and "simulated" in kind and sections[1].html.startswith("<p>"):
        first, end, rest = sections[1].html.partition("</p>")
        warning, sections[1].html = Markup(first + end), Markup(rest)
    return Ratings(task, kind, "simulated" in kind, warning, [section for section in sections if section.html.strip()])


def claims(run: RunView) -> dict[str, Any] | None:
    """``stats/claims.csv`` by paper: the claims tested on this run, and those that cannot be; ``None`` where there is none."""
    import pandas as pd

    from reports.claims.evidence import UNTESTED, claim_verdicts

    path = run.folder / CSV
    if not path.is_file():
        return None
    table = pd.read_csv(
        path, keep_default_na=False, na_values={c: [""] for c in ("effect", "low", "high", "p_holm", "p")}
    )
    verdicts = claim_verdicts(table)
    tested, untested = [], []
    for claim, rows in table.groupby("claim", sort=False):
        first: Any = next(rows.itertuples())
        verdict = verdicts[str(claim)]
        entry = {"statement": first.statement, "where": f"{first.paper}, {first.where}", "verdict": verdict}
        if verdict == UNTESTED:
            untested.append({**entry, "reasons": list(dict.fromkeys(rows.loc[rows["verdict"] == UNTESTED, "why"]))})
            continue
        records: list[Any] = list(rows.itertuples())
        tests = [
            {
                "test": row.test,
                "effect": effect(row),
                "p": p_value(row.p_holm),
                "n": row.n,
                "verdict": row.verdict,
                "why": row.why,
            }
            for row in records
        ]
        tested.append({**entry, "tests": tests})
    simulated = bool(table["why"].str.contains("simulated observers").any())
    return {"tested": tested, "untested": untested, "counts": _counts(verdicts.values()), "simulated": simulated}


def _counts(verdicts: Iterable[str]) -> str:
    names = list(verdicts)
    return ", ".join(f"{names.count(name)} {name}" for name in dict.fromkeys(names))
