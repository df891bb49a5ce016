"""Tables of the answers' database."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from benchmark.errors import StoreError

#: Version of the tables, kept in ``user_version``.
VERSION = 1

#: Milliseconds that a writer waits for another process that writes.
_PATIENCE = 10_000

_TABLES = """
CREATE TABLE study (
    plan TEXT NOT NULL,
    kind TEXT NOT NULL
) STRICT;
CREATE TABLE texts (
    digest TEXT PRIMARY KEY,
    text TEXT NOT NULL
) STRICT;
CREATE TABLE raters (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    token BLOB NOT NULL UNIQUE CHECK (length(token) = 32),
    slot INTEGER,
    consented REAL,
    consent TEXT REFERENCES texts (digest),
    started REAL,
    finished REAL,
    withdrawn REAL,
    seen REAL NOT NULL
) STRICT;
CREATE TABLE views (
    rater INTEGER NOT NULL REFERENCES raters (id),
    position INTEGER NOT NULL,
    first_shown REAL NOT NULL,
    last_shown REAL NOT NULL,
    PRIMARY KEY (rater, position)
) STRICT, WITHOUT ROWID;
CREATE TABLE answers (
    rater INTEGER NOT NULL REFERENCES raters (id),
    position INTEGER NOT NULL CHECK (position >= 0),
    stimulus TEXT NOT NULL,
    style TEXT NOT NULL,
    naturalness INTEGER NOT NULL CHECK (naturalness BETWEEN 1 AND 7),
    action TEXT,
    seconds REAL NOT NULL,
    answered REAL NOT NULL,
    PRIMARY KEY (rater, position),
    UNIQUE (rater, stimulus)
) STRICT, WITHOUT ROWID;
"""


def connect(path: Path, *, read_only: bool = False) -> sqlite3.Connection:
    """Open a database.

    Writers log ahead (WAL), so that reading and exporting never wait for them nor they for it. Every commit reaches the disk
    before it is answered for (``synchronous = FULL``): what a person said cannot be asked again after a power cut.

    Raises
    ------
    StoreError
        If it is missing (when read only) or is no database.
    """
    if read_only and not path.is_file():
        raise StoreError(f"{path} is missing: nobody has taken part yet")
    try:
        connection = sqlite3.connect(
            f"{path.resolve().as_uri()}{'?mode=ro' if read_only else ''}",
            uri=True,
            isolation_level=None,
            check_same_thread=False,
            timeout=_PATIENCE / 1000,
        )
        connection.execute("PRAGMA foreign_keys = ON")
        connection.execute("PRAGMA secure_delete = ON")
        if not read_only:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.DatabaseError as error:
        raise StoreError(f"{path} cannot be used as a database of answers: {error}") from error
    return connection


def prepare(connection: sqlite3.Connection, path: Path, *, plan: str, kind: str) -> None:
    """Make the tables, or check that those that are there belong to this plan and this kind of rater.

    Raises
    ------
    StoreError
        If they do not.
    """
    connection.execute("BEGIN IMMEDIATE")
    try:
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if version == 0 and not connection.execute("SELECT 1 FROM sqlite_master").fetchone():
            for statement in _TABLES.split(";\n"):
                if statement.strip():
                    connection.execute(statement)
            connection.execute("INSERT INTO study VALUES (?, ?)", (plan, kind))
            connection.execute(f"PRAGMA user_version = {VERSION}")
        check(connection, path, plan=plan, kind=kind)
        connection.execute("COMMIT")
    except BaseException:
        connection.execute("ROLLBACK")
        raise


def check(connection: sqlite3.Connection, path: Path, *, plan: str, kind: str) -> None:
    """Refuse a database of another version, plan or kind of rater.

    Raises
    ------
    StoreError
        Saying what it is.
    """
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version != VERSION:
        raise StoreError(f"{path} has version {version} of the tables, and this suite knows version {VERSION}")
    found = connection.execute("SELECT plan, kind FROM study").fetchone()
    if found is None or found[1] != kind:
        raise StoreError(f"{path} holds answers of {found and found[1]!r}, not of {kind!r}: they are never mixed")
    if found[0] != plan:
        raise StoreError(f"{path} holds answers to another plan: restore that plan, or move the answers away")
