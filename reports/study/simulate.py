"""``study simulate``: simulated observers take the study through its web pages, as a browser would.

What they answer is drawn beforehand by the model of ``eval.ratings.observers`` from the evidence that the build put aside; how
they answer is real: every page is fetched, its form is read out of the HTML, filled in and sent, with cookies and redirects.
The site runs as a rehearsal, whose answers are kept apart and are called *simulated observers, not people* everywhere.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import numpy as np

from benchmark.errors import BenchmarkError, DataError
from reports.study.layout import StudyFolder
from reports.study.plan import Plan, read_plan

if TYPE_CHECKING:
    import httpx

    from eval.ratings.observers import Observed

#: Sessions at a time.
_AT_ONCE = 200

#: Seconds that a page may take.
_PATIENCE = 60.0


class SimulationError(BenchmarkError):
    """A site that does not answer as it should."""


@dataclass(frozen=True)
class Simulated:
    """What was done: sessions, pages answered, seconds, and how the answers came about."""

    sessions: int
    pages: int
    seconds: float
    notes: tuple[str, ...]


@dataclass
class Form:
    """A form of a page: where it goes, its hidden fields, and the answers that it offers."""

    action: str = ""
    hidden: dict[str, str] = field(default_factory=dict)
    choices: dict[str, list[str]] = field(default_factory=dict)
    text: list[str] = field(default_factory=list)


class _Forms(HTMLParser):
    """Reads the forms and the videos of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.forms: list[Form] = []
        self.videos: list[str] = []

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        if tag == "form":
            self.forms.append(Form(values.get("action", "")))
        elif tag == "video":
            self.videos.append(values.get("src", ""))
        elif tag == "input" and self.forms:
            form, name, kind = self.forms[-1], values.get("name", ""), values.get("type", "text")
            if kind == "hidden":
                form.hidden[name] = values.get("value", "")
            elif kind in ("radio", "checkbox"):
                form.choices.setdefault(name, []).append(values.get("value", ""))
            else:
                form.text.append(name)


def read_page(html: str) -> tuple[list[Form], list[str]]:
    """The forms of a page, and the addresses of its videos."""
    parser = _Forms()
    parser.feed(html)
    return parser.forms, parser.videos


def simulate_study(
    folder: StudyFolder, count: int, *, seed: int = 0, report: Callable[[int, int], None] | None = None
) -> Simulated:
    """Let simulated observers take a study through a server of its own.

    Parameters
    ----------
    folder
        The study.
    count
        Sessions, careless observers among them.
    seed
        Of the observers. Those that a rehearsal holds already are followed by others, not by the same again.
    report
        Called with pages answered and pages in all.

    Raises
    ------
    StoreError
        If the study was changed.
    DataError
        With fewer than three sessions.
    SimulationError
        If the site refuses what it should take.
    """
    import time

    plan = read_plan(folder)
    observed = observe_study(folder, plan, count, seed=seed)
    sheets = _sheets(observed)[:count]
    start = time.monotonic()
    with running_server(folder) as base:
        pages = asyncio.run(drive(base, plan, sheets, report=report))
    return Simulated(len(sheets), pages, time.monotonic() - start, observed.notes)


def observe_study(folder: StudyFolder, plan: Plan, count: int, *, seed: int = 0) -> Observed:
    """What ``count`` simulated observers would answer, careless ones among them; one more where shares do not come out even."""
    import pandas as pd

    from eval.ratings.observers import ObserverModel, observe
    from eval.ratings.reading import read_stimuli

    if count < 3:
        raise DataError(f"{count} simulated observers are too few to rehearse an analysis: three or more are needed")
    model = ObserverModel()
    attentive = next(n for n in range(1, count + 1) if n + round(n * model.careless) >= count)
    stimuli = read_stimuli(folder.key)
    scores = pd.read_csv(folder.evidence)
    return observe(
        stimuli,
        scores,
        rng=np.random.default_rng([seed, _present(folder)]),
        raters=max(attentive, 2),
        model=model,
        styles=plan.styles,
        real=plan.styles,
    )


def _present(folder: StudyFolder) -> int:
    from reports.study.schema import connect

    path = folder.database(rehearsal=True)
    if not path.is_file():
        return 0
    connection = connect(path, read_only=True)
    try:
        return int(connection.execute("SELECT count(*) FROM raters").fetchone()[0])
    finally:
        connection.close()


def _sheets(observed: Observed) -> list[dict[str, Mapping[str, Any]]]:
    """Of each observer the answers by stimulus."""
    return [
        {str(row["stimulus"]): {str(name): value for name, value in row.items()} for row in rows.to_dict("records")}
        for _, rows in observed.ratings.groupby("rater", sort=True)
    ]


async def drive(
    base: str,
    plan: Plan,
    sheets: Sequence[Mapping[str, Mapping[str, Any]]],
    *,
    report: Callable[[int, int], None] | None = None,
) -> int:
    """Take a session for each sheet of answers, many at a time; returns the pages answered."""
    import httpx

    done = 0
    gate = asyncio.Semaphore(_AT_ONCE)
    limits = httpx.Limits(max_connections=_AT_ONCE, max_keepalive_connections=_AT_ONCE)

    def note() -> None:
        nonlocal done
        done += 1
        if report is not None:
            report(done, len(sheets) * plan.pages)

    # One pool of connections for all; cookies are kept by hand, because each session has its own.
    async with httpx.AsyncHTTPTransport(limits=limits) as transport:

        async def one(sheet: Mapping[str, Mapping[str, Any]]) -> None:
            async with gate:
                client = httpx.AsyncClient(
                    base_url=base, transport=_shared(transport), timeout=_PATIENCE, follow_redirects=True
                )
                async with client:
                    await take_session(client, plan, sheet, note)

        await asyncio.gather(*(one(sheet) for sheet in sheets))
    return done


def _shared(transport: httpx.AsyncBaseTransport) -> httpx.AsyncBaseTransport:
    """A transport that outlives the clients that use it."""
    import httpx

    class Shared(httpx.AsyncBaseTransport):
        async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
            return await transport.handle_async_request(request)

    return Shared()


async def take_session(
    client: httpx.AsyncClient, plan: Plan, sheet: Mapping[str, Mapping[str, Any]], note: Callable[[], None]
) -> None:
    """One session from consent to thanks.

    Raises
    ------
    SimulationError
        If a page is not the one that should come.
    """
    page = await _get(client, "/")
    form = _form(page, "/consent")
    page = await _post(client, form, {name: values[0] for name, values in form.choices.items()})
    page = await _post(client, _form(page, "/start"), {})
    for _ in range(plan.pages):
        form, videos = _form_and_videos(page, "/page")
        name = form.hidden.get("stimulus", "")
        if name not in sheet or videos != [f"/stimuli/{name}.mp4"]:
            raise SimulationError(f"{client.base_url} shows the stimulus {name!r} with the videos {videos}")
        video = await client.get(videos[0], headers={"Range": "bytes=0-1023"})
        if video.status_code != 206:
            raise SimulationError(f"{client.base_url} does not hand out the video that is due ({video.status_code})")
        page = await _post(client, form, _fill(form, sheet[name]))
        note()
    if page.url.path != "/thanks":
        raise SimulationError(f"{client.base_url} does not end with thanks but with {page.url.path}")


def _fill(form: Form, answers: Mapping[str, Any]) -> dict[str, str]:
    filled = {"style": str(answers["style"]), "naturalness": str(answers["naturalness"])}
    if "action" in form.text:
        filled["action"] = str(answers["action"])
    elif "action" in form.choices:
        filled["action"] = _choose(form.choices["action"], str(answers["action"]))
    return filled


def _choose(offered: Sequence[str], wanted: str) -> str:
    """The offered answer that says what is wanted; for a wrong answer that is not offered, the one that cannot tell."""
    from eval.ratings.reading import same_answer

    for answer in offered:
        if same_answer(answer, wanted):
            return answer
    return offered[-1]


def _form(page: httpx.Response, action: str) -> Form:
    return _form_and_videos(page, action)[0]


def _form_and_videos(page: httpx.Response, action: str) -> tuple[Form, list[str]]:
    forms, videos = read_page(page.text)
    for form in forms:
        if form.action == action:
            return form, videos
    raise SimulationError(f"{page.url} (status {page.status_code}) has no form for {action}")


async def _get(client: httpx.AsyncClient, path: str) -> httpx.Response:
    page = await client.get(path)
    if page.status_code != 200:
        raise SimulationError(f"{page.url} answers with status {page.status_code}")
    return page


async def _post(client: httpx.AsyncClient, form: Form, answers: Mapping[str, str]) -> httpx.Response:
    body = urlencode({**form.hidden, **answers})
    page = await client.post(form.action, content=body, headers={"Content-Type": "application/x-www-form-urlencoded"})
    if page.status_code != 200:
        raise SimulationError(f"{form.action} answers with status {page.status_code}")
    return page


@contextmanager
def running_server(folder: StudyFolder) -> Iterator[str]:
    """A rehearsal of the study on a free port of this machine, in a process of its own; yields its address."""
    from multiprocessing import get_context

    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(str(folder.path), theirs), daemon=True)
    process.start()
    theirs.close()
    try:
        try:
            yield ours.recv()
        except EOFError:
            raise SimulationError(
                "the server of the rehearsal did not start; `study serve --rehearsal` says why"
            ) from None
    finally:
        process.terminate()
        process.join(10)
        if process.is_alive():
            process.kill()
            process.join()


def _serve(path: str, pipe: Any) -> None:
    from pathlib import Path

    from reports.study.serve import address, bind, serve

    bound = bind("127.0.0.1", 0)
    serve(StudyFolder(Path(path)), bound, rehearsal=True, started=lambda _: pipe.send(address(bound)))
