"""``study serve``: the site on a port, until it is told to stop."""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.errors import BenchmarkError, ConfigError, DataError
from reports.study.app import Site, make_app
from reports.study.export import export_ratings
from reports.study.layout import StudyFolder

if TYPE_CHECKING:
    from reports.study.database import AnswerStore

#: Requests at a time, beyond which others are told to try again; and seconds that an idle connection is kept.
_MOST, _IDLE = 2000, 15

#: Connections that may wait to be accepted.
_QUEUE = 1024

#: Seconds that requests have to end when the server is told to stop.
_GRACE = 5


def bind(host: str, port: int) -> socket.socket:
    """A socket that listens; port 0 takes a free one.

    Raises
    ------
    ConfigError
        If the place is taken or no address of this machine.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((host, port))
        bound.listen(_QUEUE)
    except (OSError, OverflowError) as error:
        bound.close()
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"cannot listen on {host}:{port} ({reason}): choose another --host or --port") from error
    return bound


def address(bound: socket.socket) -> str:
    """The address to open in a browser."""
    host, port = bound.getsockname()[:2]
    if host in ("0.0.0.0", "::"):
        host = "127.0.0.1"
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"


def serve(
    folder: StudyFolder,
    bound: socket.socket,
    *,
    rehearsal: bool = False,
    invited_only: bool = False,
    export: Path | None = None,
    started: Callable[[Site], None] | None = None,
) -> None:
    """Show a study until the process is interrupted.

    Parameters
    ----------
    folder
        The study.
    bound
        Where to listen, as :func:`bind` gives it.
    rehearsal, invited_only
        As of :class:`reports.study.app.Site`.
    export
        A ratings file that is kept up to date: written after each finished session and at the end.
    started
        Called when all is checked and the site is about to listen.

    Raises
    ------
    StoreError
        If the plan, a video or the key was changed.
    """
    import uvicorn

    def write() -> None:
        if export is None:
            return
        try:
            export_ratings(folder, export, rehearsal=rehearsal, plan=site.plan)
        except DataError:  # nobody has answered anything yet
            pass
        except BenchmarkError as error:
            print(f"the export failed: {error}", file=sys.stderr)

    site = Site(folder, rehearsal=rehearsal, invited_only=invited_only, on_finished=write if export else None)
    try:
        if started is not None:
            started(site)
        config = uvicorn.Config(
            make_app(site),
            lifespan="on",
            log_level="warning",
            # Addresses of raters are not logged.
            access_log=False,
            server_header=False,
            limit_concurrency=_MOST,
            timeout_keep_alive=_IDLE,
            timeout_graceful_shutdown=_GRACE,
        )
        uvicorn.Server(config).run(sockets=[bound])
    finally:
        bound.close()
        write()


def invite(folder: StudyFolder, count: int) -> list[str]:
    """Make sessions for invited raters and return their tokens, which are stored nowhere.

    The site may be running meanwhile.
    """
    from eval.ratings.reading import PEOPLE
    from reports.study.database import AnswerStore, new_token
    from reports.study.plan import read_plan

    store: AnswerStore = AnswerStore(
        folder.database(rehearsal=False), read_plan(folder, check_videos=False), kind=PEOPLE
    )
    try:
        tokens = [new_token() for _ in range(count)]
        store.invite(tokens).result()
    finally:
        store.close()
    return tokens
