"""The ledger's table in SQLite: its rows, and the conversion of an older table."""

import json
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

from pqsec_pki.keystore._chain import START, Entry, Line, details_text, link

FORMAT = 2
"""SQLite's user_version. Format 1 was a table `issued` without chain, operator and details."""

_SCHEMA = (
    """CREATE TABLE ledger (
        number INTEGER PRIMARY KEY,
        at TEXT NOT NULL,
        operator TEXT,
        kind TEXT NOT NULL,
        name TEXT NOT NULL,
        serial TEXT,
        issuer TEXT,
        sha256 TEXT NOT NULL,
        not_after TEXT,
        details TEXT NOT NULL,
        chain TEXT NOT NULL UNIQUE,
        UNIQUE (kind, sha256)
    ) STRICT""",
    "CREATE INDEX ledger_name ON ledger (kind, name)",
    # RFC 5280 4.1.2.2: unique for each CA
    "CREATE UNIQUE INDEX ledger_serial ON ledger (issuer, serial) WHERE kind = 'participant'",
    """CREATE TRIGGER ledger_stays BEFORE UPDATE ON ledger
        BEGIN SELECT RAISE (ABORT, 'lines are only added'); END""",
    """CREATE TRIGGER ledger_remains BEFORE DELETE ON ledger
        BEGIN SELECT RAISE (ABORT, 'lines are only added'); END""",
)
_KEYS = (
    "CREATE TEMP TABLE IF NOT EXISTS certified (number INTEGER, key TEXT)",
    "CREATE INDEX IF NOT EXISTS temp.certified_key ON certified (key)",
    "CREATE INDEX IF NOT EXISTS temp.certified_number ON certified (number)",
)
"""They are not part of the ledger, and not in a file."""
COLUMNS = "at, kind, name, serial, sha256, not_after, issuer, details, operator"
_DETAILS = COLUMNS.split(", ").index("details")
_FILL = (
    f"INSERT INTO ledger (number, {COLUMNS}, chain)"  # noqa: S608 -- no outside text
    " VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
)
_INSERT = f"{_FILL} ON CONFLICT (kind, sha256) DO NOTHING"


@contextmanager
def transaction(database: sqlite3.Connection) -> Iterator[None]:
    """All changes of the block, or none."""
    database.execute("BEGIN IMMEDIATE")
    try:
        yield
        database.execute("COMMIT")
    except BaseException:
        with suppress(sqlite3.Error):
            database.execute("ROLLBACK")
        raise


@contextmanager
def part_of_change(database: sqlite3.Connection) -> Iterator[None]:
    """All changes of the block, or none. The caller commits them, or drops them."""
    if not database.in_transaction:
        database.execute("BEGIN IMMEDIATE")
    database.execute("SAVEPOINT part")
    try:
        yield
    except BaseException:
        with suppress(sqlite3.Error):
            database.execute("ROLLBACK TO part")
        raise
    finally:
        with suppress(sqlite3.Error):
            database.execute("RELEASE part")


def format_of(database: sqlite3.Connection) -> int:
    """The database's format; 0 if it is new."""
    version: int = database.execute("PRAGMA user_version").fetchone()[0]
    return version


def has_format_1(database: sqlite3.Connection) -> bool:
    """Whether there are lines of format 1 to convert."""
    there = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'issued'"
    return database.execute(there).fetchone() is not None


def is_our_own(database: sqlite3.Connection) -> bool:
    """Whether the table is the one that `make` creates, without anything added.

    A view in its place could return rows without end, and a trigger could drop lines.
    """
    there = "SELECT sql FROM sqlite_master WHERE tbl_name = 'ledger' AND sql IS NOT NULL"
    found = {sql for (sql,) in database.execute(there)}
    return _SCHEMA[0] in found and found <= set(_SCHEMA)


def make(database: sqlite3.Connection) -> None:
    """Create the table with the lines of format 1, if there are any; within a transaction."""
    for statement in _SCHEMA:
        database.execute(statement)
    append(database, _format_1(database))
    database.execute("DROP TABLE IF EXISTS issued")
    database.execute(f"PRAGMA user_version = {FORMAT}")


def _format_1(database: sqlite3.Connection) -> list[Entry]:
    """The lines of format 1, in which the only identity CA issued all participants."""
    if not has_format_1(database):
        return []
    rows = database.execute(
        "SELECT at, kind, name, serial, sha256, not_after FROM issued ORDER BY id"
    ).fetchall()
    issuer = next((row[4] for row in rows if row[1] == "identity-ca"), None)
    return [
        replace(Entry(*row), issuer=issuer if row[1] == "participant" else None) for row in rows
    ]


def fill(database: sqlite3.Connection, rows: Iterable[tuple[Any, ...]]) -> None:
    """Create the table in an empty database, with rows of number, COLUMNS and chain value."""
    with transaction(database):
        make(database)
        database.executemany(_FILL, rows)


def extend(database: sqlite3.Connection, rows: Iterable[tuple[Any, ...]]) -> None:
    """Add such rows to a database that has the lines before them."""
    with transaction(database):
        database.executemany(_FILL, rows)


def rows(database: sqlite3.Connection, *, after: int = 0) -> Iterator[tuple[Any, ...]]:
    """Such rows of the lines after number `after`, oldest first."""
    query = f"SELECT number, {COLUMNS}, chain FROM ledger WHERE number > ? ORDER BY number"  # noqa: S608
    yield from database.execute(query, (after,))


def begin_keys(database: sqlite3.Connection) -> int:
    """Create the table of certified keys beside the ledger, in memory; the last line in it."""
    database.execute("PRAGMA temp_store = MEMORY")
    for statement in _KEYS:
        database.execute(statement)
    found = database.execute("SELECT ifnull(max(number), 0) FROM temp.certified")
    return int(found.fetchone()[0])


def add_keys(database: sqlite3.Connection, rows: Iterable[tuple[int, str]]) -> None:
    """Add the keys, separated by blanks, of lines by their numbers."""
    pairs = ((number, key) for number, keys in rows for key in keys.split())
    database.executemany("INSERT INTO temp.certified VALUES (?, ?)", pairs)


def last(database: sqlite3.Connection) -> tuple[int, str]:
    """The number and the chain value of the newest line; 0 and START if there is none."""
    newest = "SELECT number, chain FROM ledger ORDER BY number DESC LIMIT 1"
    return database.execute(newest).fetchone() or (0, START)


def append(database: sqlite3.Connection, entries: Iterable[Entry]) -> None:
    """Append lines; lines that exist already are skipped."""
    number, before = last(database)
    for entry in entries:
        chain = link(before, number + 1, entry)
        row = (number + 1, *_row(entry), chain)
        if database.execute(_INSERT, row).rowcount:
            number, before = number + 1, chain


def line(row: Sequence[Any]) -> Line:
    """The line in a row of number, chain and COLUMNS."""
    number, chain, *columns = row
    found = entry(columns)
    # SQLite could read other values than Python from another JSON spelling.
    if details_text(found) != columns[_DETAILS]:
        found = replace(found, details={"unreadable": columns[_DETAILS]})
    return Line(number, found, chain)


def entry(row: Iterable[Any]) -> Entry:
    """The entry in a row of COLUMNS; damaged details become {"unreadable": text}."""
    at, kind, name, serial, sha256, not_after, issuer, details, operator = row
    return Entry(
        *(at, kind, name, serial, sha256, not_after),
        issuer=issuer,
        details=_details(details),
        operator=operator,
    )


def _details(text: str) -> dict[str, str]:
    """The details of a line; {"unreadable": text} if they are damaged."""
    with suppress(ValueError, RecursionError):
        read = json.loads(text)
        if isinstance(read, dict) and all(isinstance(each, str) for each in read.values()):
            return read
    return {"unreadable": text}


def _row(entry: Entry) -> tuple[Any, ...]:
    """In the order of COLUMNS."""
    return (
        *(entry.at, entry.kind, entry.name, entry.serial, entry.sha256, entry.not_after),
        *(entry.issuer, details_text(entry), entry.operator),
    )
