"""``study build``: choose stimuli of a run, render them blinded, and sign the plan of who sees what in which order."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark.digest import file_digest
from benchmark.errors import BenchmarkError, ConfigError, DataError, StoreError
from reports.ratings import CLIPS, choose_stimuli, condition_names
from reports.run import FLOOR, RunView, StoredCell
from reports.study.choices import action_choices, plain_action
from reports.study.layout import StudyFolder
from reports.study.order import make_orders
from reports.study.plan import Order, Plan, Stimulus, read_plan, write_plan
from reports.study.sign import make_secret, stimulus_id
from reports.study.texts import write_templates

if TYPE_CHECKING:
    import pandas as pd

    from benchmark.data.cards import Card
    from benchmark.motion.clip import MotionClip

#: Raters of the 2020 study who counted.
RATERS = 36


@dataclass(frozen=True)
class Settings:
    """What a study is built with.

    Attributes
    ----------
    task
        ``source:target``; empty for the run's first.
    methods
        Conditions, by the names of methods; empty for all.
    actions
        Actions that are shown; empty for all.
    clips
        Clips of each condition.
    catch
        Further clips of the source, shown to everybody, that only check attention.
    seconds
        Length of every video; a shorter clip is repeated.
    min_watch
        Seconds that a video must have been shown before an answer counts; ``None`` for the length of the video.
    action_question
        ``list``, ``text`` or ``none``.
    choices
        Answers in the list of actions.
    raters
        Finished sessions planned for.
    seed
        Of the choice of clips, of orders, and of wrong answers.
    size, fps
        Of the videos.
    figure
        ``leg`` or ``height``: every figure is brought to the same size by that; ``own``: sizes are left, and tell children from
        adults.
    credit
        The line under every video in place of the data set's name and licence.
    """

    task: str = ""
    methods: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()
    clips: int = CLIPS
    catch: int = 0
    seconds: float = 10.0
    min_watch: float | None = None
    action_question: str = "list"
    choices: int = 6
    raters: int = RATERS
    seed: int = 0
    size: tuple[int, int] = (640, 480)
    fps: float = 30.0
    figure: str = "leg"
    credit: str = ""


@dataclass(frozen=True)
class Built:
    """A finished build: the study, how its stimuli came about, and how many videos were there already."""

    folder: StudyFolder
    plan: Plan
    notes: tuple[str, ...]
    kept: int
    conditions: tuple[str, ...]


@dataclass(frozen=True)
class _Shown:
    """One video to render."""

    name: str
    cell: StoredCell
    clip_id: str


def build_study(
    run: RunView,
    out: Path,
    settings: Settings | None = None,
    *,
    jobs: int = 1,
    report: Callable[[int, int], None] | None = None,
) -> Built:
    """Build a study, or go on with a build that was interrupted.

    Parameters
    ----------
    run
        The finished run.
    out
        The study's folder.
    settings
        What it is built with.
    jobs
        Videos rendered at a time.
    report
        Called with videos ready and videos in all.

    Raises
    ------
    StoreError
        If the folder holds a study with other settings.
    DataError
        If the run has too little to show.
    ConfigError
        For a setting out of range.
    """
    settings = Settings() if settings is None else settings
    task = settings.task or run.tasks[0]
    _check(run, task, settings)
    folder = StudyFolder(out)
    source, card = name_source(run.dataset, settings.credit)
    _claim(folder, run, settings)
    secret = make_secret(folder.secret)
    rng = np.random.default_rng(settings.seed)
    stimuli, scores, notes = choose_stimuli(
        run,
        task,
        rng=rng,
        clips=settings.clips,
        methods=settings.methods or None,
        actions=settings.actions or None,
    )
    key, shown, example = _name(run, task, stimuli, settings, secret, rng)
    if folder.plan.is_file():
        plan = read_plan(folder)
        kept = len(shown)
    else:
        kept = _render(folder, shown, source, settings, jobs, report)
        plan = _plan(run, folder, task, source, key, scores, stimuli, example, settings, rng)
        write_plan(folder, plan, secret)
    write_templates(
        folder,
        minutes=f"{plan.minutes:.0f}",
        pages=str(plan.pages),
        questions="two" if plan.action_question == "none" else "three",
        source=plan.styles[0],
        target=plan.styles[1],
    )
    conditions = tuple(dict.fromkeys(stimuli["condition"]))
    return Built(folder, plan, (*notes, *_remarks(plan, shown, example, card)), kept, conditions)


def name_source(dataset: str, given: str = "") -> tuple[str, Card | None]:
    """The line under every video: the data set and its licence; and the data set's card.

    Raises
    ------
    ConfigError
        If nothing is known of the licence and no line was given.
    """
    from benchmark.data.cards import load_card
    from reports.video import credit

    try:
        card: Card | None = load_card(dataset.partition(":")[0])
    except BenchmarkError:
        card = None
    if given:
        return given, card
    if card is None or card.id == "folder":
        raise ConfigError(
            f"every video names its data set and licence, and those of {dataset} are not known: give --credit "
            "'My recordings, CC BY 4.0'"
        )
    return credit(dataset), card


def _check(run: RunView, task: str, settings: Settings) -> None:
    from benchmark.errors import UnknownNameError

    if task not in run.tasks:
        raise UnknownNameError("task of the run", task, run.tasks)
    for method in settings.methods:
        if method not in run.methods(task):
            raise UnknownNameError("method of the run", method, run.methods(task))
    known = sorted(set(run.results["action"]) - {""})
    for action in settings.actions:
        if action not in known:
            raise UnknownNameError("action of the run", action, known)
    for name, value, low, high in (
        ("--clips", settings.clips, 1, 1000),
        ("--catch", settings.catch, 0, 100),
        ("--raters", settings.raters, 1, 100_000),
        ("--choices", settings.choices, 2, 9),
        ("--seconds", settings.seconds, 1.0, 120.0),
    ):
        if not low <= value <= high:
            raise ConfigError(f"{name} is {low:g} to {high:g}, not {value:g}")
    if settings.min_watch is not None and not 0 <= settings.min_watch <= 600:
        raise ConfigError(f"--min-watch is 0 to 600 seconds, not {settings.min_watch:g}")
    if settings.figure not in ("leg", "height", "own"):
        raise ConfigError(f"--figure is leg, height or own, not {settings.figure!r}")
    if settings.action_question not in ("list", "text", "none"):
        raise ConfigError(f"--action-question is list, text or none, not {settings.action_question!r}")


def _claim(folder: StudyFolder, run: RunView, settings: Settings) -> None:
    """Make the folder ours, or go on with what was begun there with the same settings on the same results."""
    from benchmark.runner.views import RESULTS

    wanted = json.loads(json.dumps({**asdict(settings), "results": file_digest(run.folder / RESULTS)}))
    if folder.settings.is_file():
        found = json.loads(folder.settings.read_bytes())
        other = sorted(name for name in {*found, *wanted} if found.get(name) != wanted.get(name))
        if other:
            raise StoreError(
                f"{folder.path} holds a study with other settings ({', '.join(other)}): choose another folder by -o"
            )
        return
    if folder.path.exists() and any(folder.path.iterdir()):
        raise StoreError(f"{folder.path} is not empty and holds no study: choose another folder by -o")
    folder.stimuli.mkdir(parents=True)
    folder.private.mkdir(mode=0o700)
    folder.answers.mkdir(mode=0o700)
    folder.settings.write_text(json.dumps(wanted, indent=1), encoding="utf-8")


def _name(
    run: RunView, task: str, stimuli: pd.DataFrame, settings: Settings, secret: bytes, rng: np.random.Generator
) -> tuple[pd.DataFrame, list[_Shown], str]:
    """The key under ids that say nothing, what is to be rendered, and the id of the example."""
    import pandas as pd

    cells: dict[str, StoredCell] = {}
    for cell in run.cells(task):
        cells.setdefault(cell.method, cell)
    of_condition = {condition: method for method, condition in condition_names(run, task).items()}
    key = stimuli.copy()
    key["stimulus"] = [
        stimulus_id(f"{row['condition']}\0{row['clip_id']}", secret) for row in stimuli.to_dict("records")
    ]
    key["expected"] = [f"{row['expected']}|{plain_action(row['action'])}" for row in stimuli.to_dict("records")]
    shown = [
        _Shown(row["stimulus"], cells[of_condition[row["condition"]]], row["clip_id"]) for row in key.to_dict("records")
    ]
    spare = _spare(cells, run, set(stimuli["clip_id"]), rng)
    if len(spare) < settings.catch:
        raise DataError(
            f"{settings.catch} catch trials need as many clips that are not shown, and there are {len(spare)}"
        )
    catch = []
    for cell, item in spare[: settings.catch]:
        name = stimulus_id(f"catch\0{item['clip_id']}", secret)
        shown.append(_Shown(name, cell, item["clip_id"]))
        catch.append(
            {
                "stimulus": name,
                "condition": "",
                "clip_id": item["clip_id"],
                "action": item["action"],
                "actor": item["actor"],
                "attention": True,
                "expected": f"{item['action']}|{plain_action(item['action'])}",
            }
        )
    if catch:
        key = pd.concat([key, pd.DataFrame(catch)], ignore_index=True)
    example = ""
    if len(spare) > settings.catch:
        cell, item = spare[settings.catch]
        example = stimulus_id(f"example\0{item['clip_id']}", secret)
        shown.append(_Shown(example, cell, item["clip_id"]))
    # Rendered in the order of their ids: when a file was made says nothing of what belongs together.
    return key, sorted(shown, key=lambda video: video.name), example


def _spare(
    cells: Mapping[str, StoredCell], run: RunView, taken: set[str], rng: np.random.Generator
) -> list[tuple[StoredCell, dict[str, Any]]]:
    """Clips of the source that are not shown, shuffled; where there is none, of real performers."""
    for method in (FLOOR, run.real_method, *cells):
        if method in cells:
            left = [item for item in cells[method].items if item["state"] == "ok" and item["clip_id"] not in taken]
            if left:
                return [(cells[method], left[index]) for index in rng.permutation(len(left))]
    return []


def _render(
    folder: StudyFolder,
    shown: Sequence[_Shown],
    source: str,
    settings: Settings,
    jobs: int,
    report: Callable[[int, int], None] | None,
) -> int:
    """Render what is not there yet; returns how many were."""
    from reports.video import common_camera

    ready = _ready(folder)
    waiting = [video for video in shown if video.name not in ready]
    done = kept = len(shown) - len(waiting)

    def note(facts: tuple[str, str]) -> None:
        nonlocal done
        done += 1
        with folder.rendered.open("a", encoding="utf-8") as file:
            file.write(json.dumps(facts) + "\n")
        if report is not None:
            report(done, len(shown))

    if report is not None:
        report(done, len(shown))
    camera = None
    if waiting:
        # One camera for all, so that figures of one size are seen at one scale, however far a clip reaches.
        camera = common_camera(
            (_clip(video) for video in shown), size=settings.size, footer=source, normalise=_normalise(settings)
        )
    work = [(video, folder.video(video.name), source, settings, camera) for video in waiting]
    if jobs <= 1 or len(work) < 2:
        for task in work:
            note(_render_one(*task))
        return kept
    from concurrent.futures import as_completed
    from multiprocessing import get_context

    with ProcessPoolExecutor(min(jobs, len(work)), mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(_render_one, *task) for task in work]
        try:
            for future in as_completed(futures):
                note(future.result())
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return kept


def _ready(folder: StudyFolder) -> dict[str, str]:
    """Videos that are whole: their file has the digest that was noted when it was finished."""
    ready = {}
    if folder.rendered.is_file():
        for line in folder.rendered.read_text(encoding="utf-8").splitlines():
            try:
                name, digest = json.loads(line)
            except ValueError:  # the line that was being written when the build was killed
                continue
            if folder.video(name).is_file() and file_digest(folder.video(name)) == digest:
                ready[name] = digest
    for path in folder.stimuli.glob(".*"):
        path.unlink()
    return ready


def _clip(video: _Shown) -> MotionClip:
    clip = video.cell.clip(video.clip_id)
    if clip is None:
        raise DataError(f"{video.cell.folder} has no stored result for {video.clip_id}: run the run again")
    return clip


def _normalise(settings: Settings) -> Any:
    return "none" if settings.figure == "own" else settings.figure


def _render_one(video: _Shown, path: Path, source: str, settings: Settings, camera: Any) -> tuple[str, str]:
    from reports.video import Panel, write_video

    facts = write_video(
        [Panel(_clip(video))],
        path,
        size=settings.size,
        fps=settings.fps,
        seconds=settings.seconds,
        footer=source,
        # One colour: which arm is the left one is not asked, and colours draw the eye away from the motion.
        sides=False,
        normalise=_normalise(settings),
        camera=camera,
    )
    # All files have the same date.
    os.utime(path, (0, 0))
    return video.name, facts.sha256


def _plan(
    run: RunView,
    folder: StudyFolder,
    task: str,
    source: str,
    key: pd.DataFrame,
    scores: pd.DataFrame,
    stimuli: pd.DataFrame,
    example: str,
    settings: Settings,
    rng: np.random.Generator,
) -> Plan:
    names = [*key["stimulus"], *([example] if example else [])]
    lists: Mapping[str, tuple[str, ...]] = {}
    if settings.action_question == "list":
        others = sorted(set(run.results["action"]) - {""})
        lists = action_choices(list(key["action"]), others, count=settings.choices, rng=rng)
    action_of = dict(zip(key["stimulus"], key["action"], strict=True))
    videos = {
        name: Stimulus(
            sha256=file_digest(folder.video(name)),
            bytes=folder.video(name).stat().st_size,
            actions=lists.get(action_of.get(name, ""), ()),
        )
        for name in sorted(names)
    }
    compared = key[key["condition"] != ""]
    cells = {
        (row["condition"], row["clip_id"]): row["stimulus"]
        for row in compared.sort_values(["condition", "clip_id"]).to_dict("records")
    }
    orders = make_orders(
        cells, extra=list(key.loc[key["condition"] == "", "stimulus"]), raters=settings.raters, rng=rng
    )
    _write_private(folder, key, scores, stimuli)
    styles = task.partition(":")
    # Which style is the first answer changes from one order to the next of the same design.
    swaps = [int(swap) for swap in rng.permutation(np.arange(len(orders)) % 2)]
    return Plan(
        format=1,
        source=source,
        styles=(styles[0], styles[2]),
        seconds=settings.seconds,
        width=settings.size[0],
        height=settings.size[1],
        min_watch=settings.seconds if settings.min_watch is None else settings.min_watch,
        action_question=settings.action_question,  # type: ignore[arg-type]
        raters=settings.raters,
        same_size=settings.figure != "own",
        example=example,
        stimuli=videos,
        orders=tuple(
            Order(stimuli=tuple(order), first_style=swap)  # type: ignore[arg-type]
            for order, swap in zip(orders, swaps, strict=True)
        ),
        key_sha256=file_digest(folder.key),
        evidence_sha256=file_digest(folder.evidence),
    )


def _write_private(folder: StudyFolder, key: pd.DataFrame, scores: pd.DataFrame, stimuli: pd.DataFrame) -> None:
    """The key as a stimuli file, and the scores under the same ids; stimuli that are no condition have none."""
    written = key.assign(attention=np.where(key["attention"], "yes", "no"))
    written.to_csv(folder.key, index=False, lineterminator="\n")
    places = key.merge(stimuli[["stimulus", "condition", "clip_id"]], on=["condition", "clip_id"], how="left")
    renamed = dict(zip(places["stimulus_y"], places["stimulus_x"], strict=True))
    evidence = scores.assign(stimulus=scores["stimulus"].map(renamed)).set_index("stimulus")
    evidence.reindex(key["stimulus"]).to_csv(folder.evidence, lineterminator="\n")


def _remarks(plan: Plan, shown: Sequence[_Shown], example: str, card: Card | None) -> list[str]:
    notes = []
    long = [_clip(video).duration for video in shown if video.name != example]
    cut = [duration for duration in long if duration > plan.seconds]
    if cut:
        notes.append(
            f"{len(cut)} of {len(long)} stimuli are longer than {plan.seconds:g} s (up to {max(cut):.1f} s) and are cut there."
        )
    digests = [stimulus.sha256 for name, stimulus in plan.stimuli.items() if name != example]
    twice = len(digests) - len(set(digests))
    if twice:
        notes.append(f"{twice} stimuli show the same motion as another one, in the same or in another condition.")
    if card is not None and card.licence.name == "none stated":
        notes.append(
            f"{card.title.partition(':')[0]} has no licence for redistribution ({card.licence.redistribution}). The videos "
            "show figures drawn from joints, no pictures of anybody; even so, show them to your raters only, and do not "
            "publish them."
        )
    elif card is not None and card.licence.commercial is False:
        notes.append(f"Licence of the data: {card.licence.name}; redistribution {card.licence.redistribution}.")
    return notes
