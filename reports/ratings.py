"""Ratings of a run's results: the stimuli, simulated observers where nobody was asked, and the analysis on disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark.errors import ConfigError, DataError
from eval.ratings.analysis import Analysis, Plan, analyse
from eval.ratings.observers import ObserverModel, observe
from eval.ratings.reading import PEOPLE, SIMULATED, Ratings, read_ratings, read_stimuli
from eval.ratings.writing import write_ratings, write_table
from reports.latex import latex_escape, latex_label
from reports.markdown import markdown_escape
from reports.run import FLOOR, RunView
from reports.tables import number

if TYPE_CHECKING:
    import pandas as pd

#: Stimuli of each condition, as in the 2020 study: 50 animations in five conditions.
CLIPS = 10

#: Folder of the statistics in a run folder, and the names of what is written there.
STATS, STIMULI, ANSWERS, EVIDENCE = "stats", "ratings-stimuli.csv", "ratings-answers.csv", "ratings-evidence.csv"

#: A LaTeX table of more rows runs on from page to page.
ROWS_OF_A_PAGE = 40

#: Which trainings of a method are shown: its first, or each in turn from clip to clip.
FIRST, SPREAD = "first", "spread"

#: A method with results for fewer of the clips than this share of the best is no condition: it would shrink every other.
_ENOUGH = 0.5


@dataclass(frozen=True)
class Written:
    """An analysis on disk.

    Attributes
    ----------
    analysis
        Its tables and sentences.
    files
        What was written.
    plan
        What was decided beforehand.
    notes
        How the stimuli and, for simulated observers, the answers came about.
    """

    analysis: Analysis
    files: tuple[Path, ...]
    plan: Plan
    notes: tuple[str, ...]


def choose_stimuli(
    run: RunView,
    task: str,
    *,
    rng: np.random.Generator,
    clips: int = CLIPS,
    methods: Sequence[str] | None = None,
    actions: Sequence[str] | None = None,
    repetition: int | str = FIRST,
) -> tuple[pd.DataFrame, pd.DataFrame, tuple[str, ...]]:
    """Choose what of a run would be shown: the same clips in every condition, balanced over actions and actors.

    Parameters
    ----------
    run
        The run.
    task
        ``source:target``.
    rng
        Decides among clips that are equally good, and shuffles the ids.
    clips
        Stimuli of each condition.
    methods
        The methods that are conditions; all of the run by default.
    actions
        The actions that are shown; all by default.
    repetition
        Of methods that were trained several times: the number of the training that is shown, :data:`FIRST`, or :data:`SPREAD`
        to take each training in turn from clip to clip, so that what is said of a method does not rest on one of them. A method
        that was run once is shown as it is.

    Returns
    -------
    stimuli : pandas.DataFrame
        In the columns of a stimuli file. The source itself is the condition named by the source style, real performers
        the one named by the target style; every other method is a condition of its own. Ids say nothing of the condition.
    scores : pandas.DataFrame
        ``stimulus``, ``repetition`` (the training shown) and a column for each metric of single clips, as the method returned
        them.
    notes : tuple of str
        What was left out, and why.

    Raises
    ------
    DataError
        If no two conditions have a clip in common.
    ConfigError
        If no method was trained that often.
    """
    import pandas as pd

    source, _, target = task.partition(":")
    rows = run.results
    rows = rows[
        (rows["task"] == task) & (rows["variant"] == "raw") & (rows["clip_id"] != "") & (rows["status"] == "ok")
    ]
    if actions is not None:
        rows = rows[rows["action"].isin(actions)]
    # Every transferred clip has this row, whatever its metrics say.
    done = rows[rows["metric"] == "cost/transfer_seconds"]
    shown = _trainings(done, repetition)
    of_method = {
        method: set.intersection(
            *(
                set(done.loc[(done["method"] == method) & (done["repetition"] == number), "clip_id"])
                for number in numbers
            )
        )
        if (numbers := shown.get(method))
        else set()
        for method in run.methods(task)
        if methods is None or method in methods
    }
    most = max((len(found) for found in of_method.values()), default=0)
    few = [method for method, found in of_method.items() if len(found) < _ENOUGH * most or not found]
    compared = [method for method in of_method if method not in few]
    common = set.intersection(*(of_method[method] for method in compared)) if compared else set()
    if len(compared) < 2 or not common:
        counts = ", ".join(f"{method} {len(found)}" for method, found in of_method.items())
        raise DataError(f"{run.folder}: no two methods have a result for the same clip of {task} ({counts})")
    chosen = _balanced(done, common, rng, clips)
    names = condition_names(run, task)
    pairs = [(method, clip) for method in compared for clip in chosen]
    turns = rng.permutation(len(chosen)).tolist() if repetition == SPREAD else range(len(chosen))
    turn = dict(zip(chosen, turns, strict=True))
    numbers = [shown[method][turn[clip] % len(shown[method])] for method, clip in pairs]
    ids = rng.permutation(len(pairs)) + 1
    facts = done.drop_duplicates("clip_id").set_index("clip_id")
    stimuli = pd.DataFrame(
        {
            "stimulus": [f"s{index:0{max(3, len(str(len(pairs))))}d}" for index in ids],
            "condition": [names[method] for method, _ in pairs],
            "clip_id": [clip for _, clip in pairs],
            "action": [str(facts.loc[clip, "action"]) for _, clip in pairs],
            "actor": [str(facts.loc[clip, "actor"]) for _, clip in pairs],
            "attention": True,
            "expected": [str(facts.loc[clip, "action"]) for _, clip in pairs],
        }
    )
    measured = rows[rows["clip_id"].isin(chosen) & ~rows["metric"].str.startswith("cost/")]
    wide = measured.pivot_table(
        index=["method", "clip_id", "repetition"], columns="metric", values="value", aggfunc="mean"
    )
    keys = [(*pair, number) for pair, number in zip(pairs, numbers, strict=True)]
    scores = wide.reindex(pd.MultiIndex.from_tuples(keys)).reset_index(drop=True)
    scores.insert(0, "stimulus", stimuli["stimulus"].to_numpy())
    scores.insert(1, "repetition", numbers)
    kinds = stimuli["action"].nunique()
    notes = [f"{len(stimuli)} stimuli: {len(chosen)} clips of {kinds} actions in {len(compared)} conditions."]
    if FLOOR in compared:
        notes.append(f"{source!r} is the source motion on the target's body, as the method {FLOOR} returns it.")
    if run.real_method in compared:
        notes.append(f"{target!r} is real motion of held-out performers doing the same actions.")
    times = int(done.groupby("method")["repetition"].nunique().max())
    if times > 1:
        which = {SPREAD: "each in turn from clip to clip", FIRST: "the first"}.get(
            str(repetition), f"number {repetition}"
        )
        notes.append(f"Of the up to {times} trainings of a method {which} is shown.")
    if len(chosen) < clips:
        notes.append(f"Only {len(chosen)} clips have a result in every condition, fewer than the {clips} asked for.")
    notes += [
        f"{method} is no condition: it has results for {len(of_method[method])} clips, others for {most}."
        for method in few
    ]
    return stimuli, scores, tuple(notes)


def condition_names(run: RunView, task: str) -> dict[str, str]:
    """Method to the name of its condition: real motion has the name of its style, and everything else its own."""
    source, _, target = task.partition(":")
    labels = {FLOOR: source, run.real_method: target}
    return {method: _condition(method, labels) for method in run.methods(task)}


def _trainings(done: pd.DataFrame, repetition: int | str) -> dict[str, list[int]]:
    """The repetitions of each method that are shown; none for one that lacks the one asked for."""
    there = {str(method): sorted(map(int, set(numbers))) for method, numbers in done.groupby("method")["repetition"]}
    if repetition == SPREAD:
        return there
    if repetition == FIRST:
        return {method: numbers[:1] for method, numbers in there.items()}
    known = sorted({number for numbers in there.values() for number in numbers})
    if repetition not in known:
        raise ConfigError(
            f"no method has repetition {repetition}; there are {', '.join(map(str, known))}, {FIRST!r} and {SPREAD!r}"
        )
    return {
        method: [int(repetition)] if repetition in numbers else numbers if len(numbers) == 1 else []
        for method, numbers in there.items()
    }


def _condition(method: str, labels: Mapping[str, str]) -> str:
    if method in labels:
        return labels[method]
    return f"{method} (method)" if method in labels.values() else method


def _balanced(done: pd.DataFrame, common: set[str], rng: np.random.Generator, count: int) -> list[str]:
    """``count`` clips of ``common``, or all: one action after the other, of each the clip whose actor was taken least."""
    facts = done[done["clip_id"].isin(common)].drop_duplicates("clip_id").sort_values("clip_id")
    left = {
        action: list(zip(group["clip_id"], group["actor"], strict=True)) for action, group in facts.groupby("action")
    }
    actions = [list(left)[index] for index in rng.permutation(len(left))]
    for clips in left.values():
        rng.shuffle(clips)
    taken: dict[str, int] = {}
    chosen: list[str] = []
    while len(chosen) < min(count, len(facts)):
        for action in actions:
            if left[action] and len(chosen) < count:
                best = min(left[action], key=lambda pair: taken.get(pair[1], 0))
                left[action].remove(best)
                taken[best[1]] = taken.get(best[1], 0) + 1
                chosen.append(best[0])
    return sorted(chosen)


def ratings_stem(run: RunView | None, task: str) -> str:
    """What files of a task's ratings are called: ``ratings`` for the first task, ``ratings-SOURCE-to-TARGET`` for others."""
    return "ratings" if run is None or task == run.tasks[0] else f"ratings-{task.replace(':', '-to-')}"


def simulate_ratings(
    run: RunView,
    task: str,
    out: Path,
    *,
    seed: int = 0,
    raters: int = 36,
    model: ObserverModel | None = None,
    repetition: int | str = FIRST,
) -> Written:
    """Let simulated observers rate a run, write their answers, and analyse them as people's would be.

    Parameters
    ----------
    run, task
        What they are shown.
    out
        Folder that gets ``stats`` and ``tables``; usually the run's own.
    seed
        Of the choice of clips and of every answer.
    raters
        Attentive observers; careless ones come on top.
    model
        The observer.
    repetition
        As in :func:`choose_stimuli`.

    Raises
    ------
    ConfigError
        If the folder holds an analysis of people's ratings, which simulated ones must not take the place of.
    """
    stem = ratings_stem(run, task)
    _keep_people(out, stem)
    source, _, target = task.partition(":")
    rng = np.random.default_rng(seed)
    stimuli, scores, notes = choose_stimuli(run, task, rng=rng, repetition=repetition)
    observed = observe(
        stimuli, scores, rng=rng, raters=raters, model=model, styles=(source, target), real=(source, target)
    )
    folder = out / STATS
    folder.mkdir(parents=True, exist_ok=True)
    key = stimuli.assign(attention=np.where(stimuli["attention"], "yes", "no"))
    names = [folder / _of_task(name, stem) for name in (STIMULI, ANSWERS, EVIDENCE)]
    key.to_csv(names[0], index=False, lineterminator="\n")
    write_ratings(names[1], observed.ratings, kind=SIMULATED, remarks=observed.notes)
    write_table(names[2], observed.evidence, kind=SIMULATED)
    # Read back from disk: what is analysed is what stands in the files, in the format of anybody's ratings.
    ratings = read_ratings(names[1], read_stimuli(names[0]), styles=(source, target))
    shown = f"What was shown: {run.dataset_title}, {source} to {target}."
    written = analyse_ratings(ratings, out, seed=seed, notes=(shown, *notes, *observed.notes), stem=stem)
    return Written(written.analysis, (*names, *written.files), written.plan, written.notes)


def _of_task(name: str, stem: str) -> str:
    """``ratings-answers.csv`` as it is called for the task with this stem."""
    return stem + name.removeprefix("ratings")


def _keep_people(out: Path, stem: str) -> None:
    import pandas as pd

    table = out / STATS / f"{stem}-conditions.csv"
    if table.is_file() and PEOPLE in set(pd.read_csv(table)["kind"]):
        raise ConfigError(
            f"{out / STATS} holds the analysis of ratings by people, and simulated observers must not take its place: give "
            "--ratings and --stimuli again, or another folder by --out"
        )


def analyse_ratings(
    ratings: Ratings, out: Path, *, seed: int = 0, notes: Sequence[str] = (), stem: str = "ratings"
) -> Written:
    """Analyse ratings and write ``stats/ratings-*.csv``, ``stats/ratings.md`` and two LaTeX tables into ``out/tables``.

    Parameters
    ----------
    ratings
        Of people or of simulated observers; of the latter every file says so.
    out
        The folder.
    seed
        Of the bootstrap.
    notes
        Sentences on how the ratings came about.
    stem
        What file names begin with, in place of ``ratings``; see :func:`ratings_stem`.

    Raises
    ------
    ConfigError
        As in :func:`simulate_ratings`.
    """
    if ratings.simulated:
        _keep_people(out, stem)
    plan = Plan(source=ratings.styles[0], target=ratings.styles[1], seed=seed)
    analysis = analyse(ratings, plan)
    stats, tables = out / STATS, out / "tables"
    stats.mkdir(parents=True, exist_ok=True)
    tables.mkdir(exist_ok=True)
    if not ratings.simulated:
        for name in (STIMULI, ANSWERS, EVIDENCE):
            (stats / _of_task(name, stem)).unlink(missing_ok=True)
    files = []
    for name, table in analysis.tables.items():
        files.append(stats / f"{stem}-{name}.csv")
        write_table(files[-1], table, kind=ratings.kind)
    files.append(stats / f"{stem}.md")
    files[-1].write_text(_markdown(analysis, plan, notes), encoding="utf-8")
    for name, text in (("anova", latex_anova(analysis, stem)), ("tukey", latex_tukey(analysis, stem))):
        files.append(tables / f"{stem}-{name}.tex")
        files[-1].write_text(text, encoding="utf-8")
    return Written(analysis, tuple(files), plan, tuple(notes))


def _markdown(analysis: Analysis, plan: Plan, notes: Sequence[str]) -> str:
    whose = "" if analysis.kind == PEOPLE else f" ({analysis.kind})"
    lines = [f"# Ratings{whose}", ""]
    if whose:
        lines += [
            f"**{analysis.kind[0].upper()}{analysis.kind[1:]}.** A model of an observer answered, driven by the objective "
            "scores. What follows rehearses the analysis; it is no finding about what people see.",
            "",
        ]
    lines += [f"- {markdown_escape(note)}" for note in notes] + [""] * bool(notes)
    lines += [
        "Decided before any rating was seen: each question is a family of all pairs of conditions, tested by paired t tests "
        f"with Holm's correction at {plan.alpha:g}; a difference carries over to other clips only where the rater x "
        f"clip interval agrees; equivalence with real {markdown_escape(plan.target)} motion within {100 * plan.margin:g} "
        f"points, or {plan.natural_margin:g} steps of naturalness; raters right on {100 * plan.attention:g} % or less of the "
        "checks are left out.",
        "",
    ]
    for heading, sentences in analysis.sections.items():
        lines += [f"## {heading}{whose}", "", *(f"- {markdown_escape(sentence)}" for sentence in sentences), ""]
    return "\n".join(lines)


def latex_anova(analysis: Analysis, stem: str = "ratings") -> str:
    """The repeated-measures analyses of variance as a booktabs table."""
    table = analysis.tables["anova"]
    rows = table[(table["sample"] == "attentive") & (table["design"] == "repeated measures")]
    body = []
    row: Any
    for row in rows.itertuples():
        cells = [
            _question(row.question),
            f"{row.df1:.0f}, {row.df2:.0f}",
            number(row.F),
            _latex_p(row.p),
            f"{row.eps_gg:.2f}" if np.isfinite(row.eps_gg) else "--",
            _latex_p(row.p_gg),
            f"{row.eta_p2:.2f} [{row.eta_p2_low:.2f}, {row.eta_p2_high:.2f}]" if np.isfinite(row.eta_p2) else "--",
        ]
        body.append(" & ".join(cells) + r" \\")
    head = r"question & df & $F$ & $p$ & $\varepsilon_{GG}$ & $p_{GG}$ & $\eta_p^2$ [90\,\%] \\"
    caption = f"Main effect of the condition, repeated-measures analysis of variance, {rows['n'].min()} raters."
    return _latex_table(analysis, f"{stem}-anova", "lrrrrrr", head, body, caption)


def latex_tukey(analysis: Analysis, stem: str = "ratings") -> str:
    """Tukey's test within and between raters, and the Holm-corrected contrasts, as a booktabs table."""
    tukey, contrasts = analysis.tables["tukey"], analysis.tables["contrasts"]
    contrasts = contrasts[contrasts["sample"] == "attentive"].set_index(["question", "a", "b"])
    naive = tukey[tukey["error_term"] != "within raters"].set_index(["question", "a", "b"])
    within = tukey[tukey["error_term"] == "within raters"]
    body = []
    row: Any
    for row in within.itertuples():
        key = (row.question, row.a, row.b)
        scale = 100 if row.question == "child" else 1
        cells = [
            _question(row.question),
            f"{latex_escape(row.a)} -- {latex_escape(row.b)}",
            f"{scale * row.diff:.{0 if scale == 100 else 2}f}",
            _latex_p(row.p),
            _latex_p(naive.loc[key, "p"]),
            _latex_p(contrasts.loc[key, "p_shaffer"]),
            _latex_p(contrasts.loc[key, "p_holm"]),
        ]
        body.append(" & ".join(cells) + r" \\")
    head = r"question & pair & difference & Tukey within & Tukey between & Shaffer & Holm \\"
    caption = (
        "Pairs of conditions, p of: Tukey's test with the error within raters, with the error between raters (naive), and "
        f"paired t tests with Shaffer's and with Holm's correction (primary); {contrasts['n'].min()} raters. Differences in "
        "percentage points and in steps of the scale."
    )
    return _latex_table(analysis, f"{stem}-tukey", "llrrrrr", head, body, caption)


def _latex_table(analysis: Analysis, name: str, columns: str, head: str, body: Sequence[str], caption: str) -> str:
    whose = "" if analysis.kind == PEOPLE else f"{analysis.kind[0].upper()}{analysis.kind[1:]}. "
    text = rf"\caption{{{latex_escape(whose + caption)}}}"
    mark = rf"\label{{{latex_label(f'tab:{name}')}}}"
    if len(body) > ROWS_OF_A_PAGE:
        lines = [
            "% needs: booktabs, longtable",
            r"{\footnotesize\setlength{\tabcolsep}{3pt}\setlength{\LTcapwidth}{\linewidth}",
            rf"\begin{{longtable}}{{{columns}}}",
            rf"{text} {mark} \\",
            *(r"\toprule", head, r"\midrule", r"\endfirsthead"),
            *(r"\toprule", head, r"\midrule", r"\endhead"),
            *(r"\bottomrule", r"\endfoot"),
            *body,
            r"\end{longtable}",
            "}",
        ]
        return "\n".join(lines) + "\n"
    lines = [
        "% needs: booktabs",
        r"\begin{table}",
        r"\centering\small",
        text,
        mark,
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        head,
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _question(question: str) -> str:
    return {"child": "style", "naturalness": "naturalness"}[question]


def _latex_p(p: float) -> str:
    if not np.isfinite(p):
        return "--"
    return "$<$ .001" if p < 0.001 else f"{p:.3f}".removeprefix("0")
