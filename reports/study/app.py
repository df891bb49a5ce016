"""The web site of a study: consent, instructions, one stimulus a page, thanks. All state is in the database."""

from __future__ import annotations

import asyncio
import hmac
import time
from collections.abc import Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from eval.ratings.reading import PEOPLE, SIMULATED
from reports.study.answers import FormError, read_answer, read_form
from reports.study.database import AnswerStore, Full, Rater, Refused, new_token
from reports.study.guard import TOO_LARGE, Guard, TooLarge
from reports.study.layout import StudyFolder
from reports.study.pages import ASSETS, Pages, asset
from reports.study.plan import Plan, read_plan
from reports.study.sign import signature
from reports.study.texts import CONSENT, THANKS, read_text

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

COOKIE = "rater"

#: Seconds that the cookie, and with it going on and withdrawing, lasts.
COOKIE_AGE = 30 * 24 * 3600

#: New sessions a minute that an open study begins, so that a script cannot fill it in a moment.
NEW_A_MINUTE = 30


class Site:
    """One study, shown.

    Parameters
    ----------
    folder
        The study; its plan, videos and key are checked.
    rehearsal
        Whether answers go to the rehearsal's database: no limit of raters, and no time that a video must be watched.
    invited_only
        Whether only raters with a personal link may begin.
    on_finished
        Called with the store after each session that is finished, in a thread.
    clock
        Seconds since the epoch.

    Raises
    ------
    StoreError
        If the plan or a stimulus was changed, or the answers belong to something else.
    """

    def __init__(
        self,
        folder: StudyFolder,
        *,
        rehearsal: bool = False,
        invited_only: bool = False,
        on_finished: Callable[[], None] | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self.folder, self.rehearsal, self.invited_only = folder, rehearsal, invited_only
        self.plan: Plan = read_plan(folder)
        self.consent_text, self.thanks_text = read_text(folder, CONSENT), read_text(folder, THANKS)
        self.pages = Pages(self.plan, rehearsal=rehearsal)
        self.min_watch = 0.0 if rehearsal else self.plan.min_watch
        self._secret = folder.secret.read_bytes()
        self._clock, self._on_finished = clock, on_finished
        self._recent: list[float] = []
        self._background: set[asyncio.Task] = set()
        self._stats = {name: _stat(folder, name) for name in self.plan.stimuli}
        self.store = AnswerStore(
            folder.database(rehearsal=rehearsal), self.plan, kind=SIMULATED if rehearsal else PEOPLE, clock=clock
        )

    # Pages.

    async def home(self, request: Request) -> Response:
        """Consent for who is new; for others the page that is due."""
        rater = self._rater(request)
        if rater is not None and (rater.consented or rater.withdrawn):
            return _redirect(_due(rater))
        if rater is None and self.invited_only:
            return self._message(
                403,
                "A personal link is needed",
                "This study is open to invited people. Please use the link that you were sent.",
            )
        if rater is None and self._is_full():
            return self._full()
        return self._consent_page(200, invited=rater is not None)

    async def consent(self, request: Request) -> Response:
        """Begin a session."""
        fields = read_form(await request.body())
        rater = self._rater(request)
        if rater is not None and (rater.consented or rater.withdrawn):
            return _redirect(_due(rater))
        token = request.cookies[COOKIE] if rater is not None else self._read_ticket(fields.get("ticket", ""))
        if token is None or (rater is None and self.invited_only):
            return self._message(403, "This form is not valid", "Please open the study's address again.")
        if fields.get("adult") != "yes" or fields.get("agree") != "yes":
            problem = "To take part, please confirm both statements. If you do not want to, just close this page."
            return self._consent_page(422, invited=rater is not None, problem=problem)
        if rater is None and not self._may_begin():
            return self._message(429, "Many people are beginning just now", "Please try again in a minute.")
        try:
            await _done(
                self.store.consent(token, self.consent_text, limit=None if self.rehearsal else self.plan.raters)
            )
        except Full:
            return self._full()
        response = _redirect("/instructions")
        self._set_cookie(request, response, token)
        return response

    async def instructions(self, request: Request) -> Response:
        """What to do, with an example."""
        rater = self._rater(request)
        if rater is None or not rater.consented or rater.withdrawn:
            return _redirect("/")
        link = str(request.url_for("resume", token=request.cookies[COOKIE]))
        return self._html(self.pages.render("instructions", link=link, began=rater.started))

    async def start(self, request: Request) -> Response:
        """Go from the instructions to the stimuli."""
        rater = self._rater(request)
        if rater is None or not rater.consented or rater.withdrawn:
            return _redirect("/")
        await request.body()
        await _done(self.store.start(rater.id))
        return _redirect("/page")

    async def show(self, request: Request) -> Response:
        """The stimulus that is due."""
        rater = self._rater(request)
        if rater is None or not rater.started or rater.finished or rater.withdrawn:
            return _redirect("/" if rater is None else _due(rater))
        return await self._stimulus_page(200, rater, {}, {}, seen=request.method == "GET")

    async def answer(self, request: Request) -> Response:
        """Take the answers to the stimulus that is due."""
        fields = read_form(await request.body())
        rater = self._rater(request)
        if rater is None:
            return self._message(
                403, "No session", "Your answer was not stored: this browser has not begun this study."
            )
        if not rater.started or rater.withdrawn:
            return _redirect(_due(rater))
        try:
            answer = read_answer(fields, self.plan)
        except FormError as error:
            if "" in error.problems or not self._is_due(rater, fields.get("stimulus", "")):
                return self._message(422, "This answer cannot be used", " ".join(error.problems.values()))
            return await self._stimulus_page(422, rater, fields, error.problems)
        try:
            finished = await _done(self.store.answer(rater.id, answer, min_watch=self.min_watch))
        except Refused as refusal:
            if refusal.reason == "too soon":
                text = f"Please watch the video to its end first: {refusal.wait:.0f} more seconds."
                return await self._stimulus_page(409, rater, fields, {"": text}, seen=False)
            if refusal.reason == "finished":
                return _redirect("/thanks")
            text = "It belongs to a video that is not due. Each video is answered once, in its turn."
            return self._message(409, "This answer was not stored", text)
        if finished and not rater.finished and self._on_finished is not None:
            task = asyncio.create_task(asyncio.to_thread(self._on_finished))
            self._background.add(task)
            task.add_done_callback(self._background.discard)
        return _redirect("/thanks" if finished else "/page")

    async def thanks(self, request: Request) -> Response:
        """The end."""
        rater = self._rater(request)
        if rater is None or not rater.finished:
            return _redirect("/" if rater is None else _due(rater))
        return self._html(self.pages.render("thanks", text=self.thanks_text))

    async def ask_withdraw(self, request: Request) -> Response:
        """Ask whether answers should be deleted."""
        rater = self._rater(request)
        if rater is None or rater.withdrawn:
            return self._message(
                200, "There is nothing to delete", "This browser has no answers in this study.", home=False
            )
        return self._html(self.pages.render("withdraw", done=rater.done, finished=rater.finished))

    async def withdraw(self, request: Request) -> Response:
        """Delete the rater's answers."""
        rater = self._rater(request)
        await request.body()
        if rater is None:
            return _redirect("/withdraw")
        await _done(self.store.withdraw(rater.id))
        response = self._message(
            200, "Your answers are deleted", "Nothing that you answered is kept. Thank you for your time.", home=False
        )
        response.delete_cookie(COOKIE, path="/", httponly=True, samesite="lax")
        return response

    async def resume(self, request: Request) -> Response:
        """Go on with the session of a personal link."""
        token = request.path_params["token"]
        rater = self.store.rater(token)
        if rater is None:
            return self._message(
                404, "This link is not valid", "Please check that you have copied all of it.", home=False
            )
        if rater.withdrawn:
            return self._message(410, "This session has ended", "Its answers were deleted on request.", home=False)
        response = _redirect("/")
        self._set_cookie(request, response, token)
        return response

    # Files.

    async def video(self, request: Request) -> Response:
        """The video of the page that is due, or that of the instructions; nothing else is handed out."""
        from starlette.responses import FileResponse

        rater = self._rater(request)
        name = request.path_params["name"].removesuffix(".mp4")
        # The name is looked up in the plan and never becomes part of a path unless it stands there.
        allowed = rater is not None and rater.consented and not rater.withdrawn
        if rater is None or not allowed or not (name == self.plan.example or self._is_due(rater, name)):
            return self._message(404, "Not found", "There is no such video.")
        found = _stat(self.folder, name)
        if found != self._stats[name]:
            return self._message(
                503, "This video cannot be shown", f"The file of stimulus {name} was changed while serving."
            )
        return FileResponse(
            self.folder.video(name), media_type="video/mp4", headers={"Cache-Control": "private, max-age=600"}
        )

    async def asset(self, request: Request) -> Response:
        """Style sheet and script."""
        from starlette.responses import Response

        name = request.path_params["name"]
        if name not in ASSETS:
            return self._message(404, "Not found", "There is no such file.")
        return Response(asset(name), media_type=ASSETS[name], headers={"Cache-Control": "no-cache"})

    async def health(self, _: Request) -> Response:
        """Whether the site is up, and whether it is a rehearsal."""
        from starlette.responses import PlainTextResponse

        return PlainTextResponse("rehearsal\n" if self.rehearsal else "open\n")

    async def robots(self, _: Request) -> Response:
        """Search engines have no business here."""
        from starlette.responses import PlainTextResponse

        return PlainTextResponse("User-agent: *\nDisallow: /\n")

    # Parts.

    def _rater(self, request: Request) -> Rater | None:
        token = request.cookies.get(COOKIE)
        return self.store.rater(token) if token else None

    def _is_due(self, rater: Rater, stimulus: str) -> bool:
        if rater.slot is None or not rater.started:
            return False
        order = self.plan.orders[rater.slot].stimuli
        return rater.done < len(order) and order[rater.done] == stimulus

    async def _stimulus_page(
        self, status: int, rater: Rater, values: dict[str, str], problems: dict[str, str], *, seen: bool = True
    ) -> Response:
        if rater.slot is None:  # consented raters have one
            return _redirect("/")
        order = self.plan.orders[rater.slot]
        position = min(rater.done, len(order.stimuli) - 1)
        shown = await _done(self.store.show(rater.id, position)) if seen else 0.0
        html = self.pages.stimulus(
            order.stimuli[position],
            position=position,
            first_style=order.first_style,
            wait=max(0.0, self.min_watch - shown),
            values=values,
            problems=problems,
        )
        return self._html(html, status)

    def _is_full(self) -> bool:
        return not self.rehearsal and sum(self.store.counts()) >= self.plan.raters

    def _may_begin(self) -> bool:
        now = self._clock()
        self._recent = [moment for moment in self._recent if now - moment < 60.0]
        if not self.rehearsal and len(self._recent) >= NEW_A_MINUTE:
            return False
        self._recent.append(now)
        return True

    def _consent_page(self, status: int, *, invited: bool, problem: str = "") -> Response:
        # The ticket is the session's token to be: sending the form twice begins one session.
        token = new_token()
        ticket = "" if invited else f"{token}.{self._sign_ticket(token)}"
        return self._html(self.pages.render("consent", text=self.consent_text, ticket=ticket, problem=problem), status)

    def _sign_ticket(self, token: str) -> str:
        return signature(b"ticket\0" + token.encode(), self._secret)

    def _read_ticket(self, ticket: str) -> str | None:
        token, _, signed = ticket.partition(".")
        good = hmac.compare_digest(signed.encode(), self._sign_ticket(token).encode())
        return token if good else None

    def _set_cookie(self, request: Request, response: Response, token: str) -> None:
        secure = request.url.scheme == "https"
        response.set_cookie(COOKIE, token, max_age=COOKIE_AGE, path="/", httponly=True, samesite="lax", secure=secure)

    def _full(self) -> Response:
        return self._message(
            403,
            "The study has enough raters",
            "Thank you for wanting to take part; no more answers are needed.",
            home=False,
        )

    def _message(self, status: int, heading: str, text: str, *, home: bool = True) -> Response:
        return self._html(self.pages.render("message", heading=heading, message=text, home=home), status)

    def _html(self, html: str, status: int = 200) -> Response:
        from starlette.responses import HTMLResponse

        return HTMLResponse(html, status)

    # Failures.

    async def http_error(self, _: Request, error: Any) -> Response:
        """A page for what the router refuses."""
        texts = {
            404: ("Not found", "There is no such page."),
            405: ("Not allowed", "This address cannot be used like that."),
        }
        heading, text = texts.get(error.status_code, ("This did not work", str(error.detail)))
        response = self._message(error.status_code, heading, text)
        for name, value in (error.headers or {}).items():
            response.headers[name] = value
        return response

    async def form_error(self, _: Request, error: Any) -> Response:
        """A page for a body that is no form."""
        return self._message(400, "This form cannot be used", " ".join(error.problems.values()))

    async def too_large(self, _: Request, __: Any) -> Response:
        """A page for a body that is too large; the rest of it is not read."""
        response = self._message(413, "Too large", TOO_LARGE)
        response.headers["Connection"] = "close"
        return response

    async def fault(self, _: Request, error: Exception) -> Response:
        """A page for a fault of ours: it says that the answer was not stored, and nothing of the inside."""
        return self._message(
            500, "Something went wrong", "Your last answer was not stored. Please go back and try again."
        )


def make_app(site: Site) -> Guard:
    """The site as an ASGI application."""
    from starlette.applications import Starlette
    from starlette.exceptions import HTTPException
    from starlette.routing import Route

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        yield
        await asyncio.gather(*site._background, return_exceptions=True)
        site.store.close()

    routes = [
        Route("/", site.home),
        Route("/consent", site.consent, methods=["POST"]),
        Route("/instructions", site.instructions),
        Route("/start", site.start, methods=["POST"]),
        Route("/page", site.show),
        Route("/page", site.answer, methods=["POST"]),
        Route("/thanks", site.thanks),
        Route("/withdraw", site.ask_withdraw),
        Route("/withdraw", site.withdraw, methods=["POST"]),
        Route("/r/{token}", site.resume, name="resume"),
        Route("/stimuli/{name}", site.video),
        Route("/static/{name}", site.asset),
        Route("/health", site.health),
        Route("/robots.txt", site.robots),
    ]
    handlers: Any = {
        HTTPException: site.http_error,
        FormError: site.form_error,
        TooLarge: site.too_large,
        Exception: site.fault,
    }
    # The guard is outside of everything, so that its headers are on every response, those of faults too.
    return Guard(Starlette(routes=routes, exception_handlers=handlers, lifespan=lifespan))


def _stat(folder: StudyFolder, name: str) -> tuple[int, int] | None:
    try:
        found = folder.video(name).stat()
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns


def _due(rater: Rater) -> str:
    """Where a rater goes on."""
    if rater.withdrawn:
        return "/withdraw"
    if rater.finished:
        return "/thanks"
    if rater.started:
        return "/page"
    return "/instructions" if rater.consented else "/"


async def _done(future: Any) -> Any:
    return await asyncio.wrap_future(future)


def _redirect(path: str) -> Response:
    from starlette.responses import RedirectResponse

    return RedirectResponse(path, 303)
