"""Raters and their answers: every change in one place, by one writer, each in a transaction that reaches the disk."""

from __future__ import annotations

import hashlib
import queue
import secrets
import sqlite3
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

from reports.study.plan import Plan
from reports.study.schema import connect, prepare

T = TypeVar("T")

#: Seconds after which a session that is not finished no longer counts as taking part: its place is given to another rater. It
#: can still be gone on with.
ABSENT = 2 * 3600.0

#: Operations that share a transaction at most.
_BATCH = 256


class Full(Exception):
    """The study has as many raters as were planned."""


class Refused(Exception):
    """An answer that cannot count.

    Parameters
    ----------
    reason
        ``out of order``, ``too soon``, ``finished`` or ``not started``.
    wait
        Seconds until it could count, for ``too soon``.
    """

    def __init__(
        self, reason: Literal["out of order", "too soon", "finished", "not started"], wait: float = 0.0
    ) -> None:
        super().__init__(reason)
        self.reason, self.wait = reason, wait


@dataclass(frozen=True)
class Rater:
    """A session as the site sees it; ``done`` counts answered pages."""

    id: int
    name: str
    slot: int | None
    consented: bool
    started: bool
    finished: bool
    withdrawn: bool
    done: int


@dataclass(frozen=True)
class Answer:
    """What was answered on one page; ``action`` is ``None`` where it is not asked."""

    stimulus: str
    style: str
    naturalness: int
    action: str | None


def new_token() -> str:
    """A token that cannot be guessed: 256 random bits."""
    return secrets.token_urlsafe(32)


def hash_token(token: str) -> bytes:
    """What is stored of a token: nobody who reads the database can take a rater's part."""
    return hashlib.sha256(token.encode("utf-8", "replace")).digest()


class AnswerStore:
    """The database of one kind of rater.

    All changes go through one thread, in the order in which they come; those that wait together share one transaction, so that
    the disk is flushed once for all of them, and each is undone alone if it fails. Reading is done on another connection and
    waits for nothing.

    Parameters
    ----------
    path
        The database; made if it is not there.
    plan
        The plan that the answers belong to.
    kind
        Whose answers they are.
    clock
        Seconds since the epoch.

    Raises
    ------
    StoreError
        If the database belongs to something else.
    """

    def __init__(self, path: Path, plan: Plan, *, kind: str, clock: Callable[[], float] = time.time) -> None:
        path.parent.mkdir(mode=0o700, exist_ok=True)
        self.path, self.plan, self.kind, self._clock = path, plan, kind, clock
        self._writing = connect(path)
        path.chmod(0o600)
        prepare(self._writing, path, plan=plan.digest, kind=kind)
        self._reading = connect(path, read_only=True)
        self._waiting: queue.SimpleQueue[tuple[Callable[[sqlite3.Connection], Any], Future] | None] = (
            queue.SimpleQueue()
        )
        self._thread = threading.Thread(target=self._write_all, name="answers", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write what still waits, and close the database."""
        self._waiting.put(None)
        self._thread.join()
        self._reading.close()
        self._writing.close()

    def submit(self, change: Callable[[sqlite3.Connection], T]) -> Future[T]:
        """Hand a change to the writer; the future is done when it is on disk."""
        future: Future[T] = Future()
        self._waiting.put((change, future))
        return future

    def _write_all(self) -> None:
        ended = False
        while not ended:
            batch = [self._waiting.get()]
            while len(batch) < _BATCH and not self._waiting.empty():
                batch.append(self._waiting.get())
            ended = None in batch
            work = [item for item in batch if item is not None]
            if work:
                self._commit(work)

    def _commit(self, work: Sequence[tuple[Callable[[sqlite3.Connection], Any], Future]]) -> None:
        connection = self._writing
        outcomes: list[tuple[Future, Any, BaseException | None]] = []
        try:
            connection.execute("BEGIN IMMEDIATE")
            for change, future in work:
                connection.execute("SAVEPOINT one")
                try:
                    outcomes.append((future, change(connection), None))
                except Exception as error:
                    connection.execute("ROLLBACK TO one")
                    outcomes.append((future, None, error))
                connection.execute("RELEASE one")
            connection.execute("COMMIT")
        except BaseException as error:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            outcomes = [(future, None, error) for _, future in work]
        for future, value, failure in outcomes:
            if failure is None:
                future.set_result(value)
            else:
                future.set_exception(failure)

    # What the site asks.

    def rater(self, token: str) -> Rater | None:
        """The session of a token, or ``None``."""
        row = self._reading.execute(
            "SELECT id, name, slot, consented IS NOT NULL, started IS NOT NULL, finished IS NOT NULL, withdrawn IS NOT NULL, "
            "(SELECT count(*) FROM answers WHERE rater = raters.id) FROM raters WHERE token = ?",
            (hash_token(token),),
        ).fetchone()
        if row is None:
            return None
        consented, started, finished, withdrawn = map(bool, row[3:7])
        return Rater(row[0], row[1], row[2], consented, started, finished, withdrawn, row[7])

    def counts(self) -> tuple[int, int]:
        """Sessions that are finished, and those that are being answered now."""
        return _taking_part(self._reading, self._clock())

    # What the site changes.

    def invite(self, tokens: Sequence[str]) -> Future[None]:
        """Make sessions that wait for their raters."""
        now = self._clock()

        def change(connection: sqlite3.Connection) -> None:
            for token in tokens:
                _new_rater(connection, token, now)

        return self.submit(change)

    def consent(self, token: str, text: str, *, limit: int | None) -> Future[None]:
        """Note a rater's consent, and to which text; give the rater an order of stimuli. The second time changes nothing.

        Parameters
        ----------
        token
            A new one, or that of an invited rater.
        text
            What was consented to.
        limit
            Raters at which enrolment closes, for those who were not invited; fails with :class:`Full`.
        """
        now = self._clock()

        def change(connection: sqlite3.Connection) -> None:
            known = connection.execute("SELECT 1 FROM raters WHERE token = ?", (hash_token(token),)).fetchone()
            if not known:
                if limit is not None and sum(_taking_part(connection, now)) >= limit:
                    raise Full
                _new_rater(connection, token, now)
            digest = hashlib.sha256(text.encode()).hexdigest()
            connection.execute("INSERT OR IGNORE INTO texts VALUES (?, ?)", (digest, text))
            connection.execute(
                "UPDATE raters SET consented = ?, consent = ?, slot = ?, seen = ? WHERE token = ? AND consented IS NULL "
                "AND withdrawn IS NULL",
                (now, digest, _free_slot(connection, len(self.plan.orders), now), now, hash_token(token)),
            )

        return self.submit(change)

    def start(self, rater: int) -> Future[None]:
        """Note that the instructions were read."""
        now = self._clock()

        def change(connection: sqlite3.Connection) -> None:
            connection.execute(
                "UPDATE raters SET started = coalesce(started, ?), seen = ? WHERE id = ? AND consented IS NOT NULL "
                "AND withdrawn IS NULL",
                (now, now, rater),
            )

        return self.submit(change)

    def show(self, rater: int, position: int) -> Future[float]:
        """Note that a page was shown now; gives the seconds since it was shown first."""
        now = self._clock()

        def change(connection: sqlite3.Connection) -> float:
            connection.execute(
                "INSERT INTO views VALUES (?, ?, ?, ?) ON CONFLICT DO UPDATE SET last_shown = excluded.last_shown",
                (rater, position, now, now),
            )
            connection.execute("UPDATE raters SET seen = ? WHERE id = ?", (now, rater))
            (first,) = connection.execute(
                "SELECT first_shown FROM views WHERE rater = ? AND position = ?", (rater, position)
            ).fetchone()
            return now - first

        return self.submit(change)

    def answer(self, rater: int, answer: Answer, *, min_watch: float) -> Future[bool]:
        """Store an answer to the page that is due.

        Gives ``True`` if this answered the last page, and fails with :class:`Refused`. An answer to a stimulus that was
        answered already changes nothing: the first one counts.
        """
        now = self._clock()

        def change(connection: sqlite3.Connection) -> bool:
            slot, started, withdrawn = connection.execute(
                "SELECT slot, started, withdrawn FROM raters WHERE id = ?", (rater,)
            ).fetchone()
            if started is None or withdrawn is not None:
                raise Refused("not started")
            order = self.plan.orders[slot].stimuli
            (position,) = connection.execute("SELECT count(*) FROM answers WHERE rater = ?", (rater,)).fetchone()
            known = connection.execute(
                "SELECT 1 FROM answers WHERE rater = ? AND stimulus = ?", (rater, answer.stimulus)
            ).fetchone()
            if known:
                return position == len(order)
            if position == len(order):
                raise Refused("finished")
            shown = connection.execute(
                "SELECT first_shown, last_shown FROM views WHERE rater = ? AND position = ?", (rater, position)
            ).fetchone()
            if order[position] != answer.stimulus or shown is None:
                raise Refused("out of order")
            wait = min_watch - (now - shown[0])
            if wait > 0:
                raise Refused("too soon", wait)
            connection.execute(
                "INSERT INTO answers VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    *(rater, position, answer.stimulus, answer.style, answer.naturalness, answer.action),
                    *(round(max(0.0, now - shown[1]), 3), now),
                ),
            )
            last = position + 1 == len(order)
            connection.execute(
                "UPDATE raters SET seen = ?, finished = ? WHERE id = ?", (now, now if last else None, rater)
            )
            return last

        return self.submit(change)

    def withdraw(self, rater: int) -> Future[None]:
        """Delete a rater's answers; that there was a rater stays, and nothing else."""
        now = self._clock()

        def change(connection: sqlite3.Connection) -> None:
            connection.execute("DELETE FROM answers WHERE rater = ?", (rater,))
            connection.execute("DELETE FROM views WHERE rater = ?", (rater,))
            connection.execute(
                "UPDATE raters SET withdrawn = coalesce(withdrawn, ?), slot = NULL, finished = NULL WHERE id = ?",
                (now, rater),
            )

        return self.submit(change)


def _new_rater(connection: sqlite3.Connection, token: str, now: float) -> None:
    # A random name: one that counts would tell who came when.
    connection.execute(
        "INSERT INTO raters (name, token, seen) VALUES (?, ?, ?)", (f"r{secrets.token_hex(5)}", hash_token(token), now)
    )


def _taking_part(connection: sqlite3.Connection, now: float) -> tuple[int, int]:
    return connection.execute(
        "SELECT count(finished), count(*) - count(finished) FROM raters WHERE withdrawn IS NULL AND consented IS NOT NULL AND "
        "(finished IS NOT NULL OR seen > ?)",
        (now - ABSENT,),
    ).fetchone()


def _free_slot(connection: sqlite3.Connection, slots: int, now: float) -> int:
    """The first of the orders that fewest raters have who finished or are at it, so that those given up are given again."""
    taken = dict.fromkeys(range(slots), 0)
    for slot, count in connection.execute(
        "SELECT slot, count(*) FROM raters WHERE slot IS NOT NULL AND withdrawn IS NULL AND (finished IS NOT NULL OR seen > ?) "
        "GROUP BY slot",
        (now - ABSENT,),
    ):
        taken[slot] = count
    return min(taken, key=lambda slot: (taken[slot], slot))
