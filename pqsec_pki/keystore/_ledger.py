"""The ledger: every certificate, signed document and revocation that was ever made here."""

import json
import sqlite3
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from pqsec_pki._files import PRIVATE_MODE, create
from pqsec_pki.errors import FileError, KeystoreError, PqsecError
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
_PATIENCE = 30.0
"""Seconds to wait for another process to finish with the database."""
_DISK = ("SQLITE_IOERR", "SQLITE_FULL", "SQLITE_READONLY", "SQLITE_CANTOPEN", "SQLITE_PERM")
_COLUMNS = "at, kind, name, serial, sha256, not_after, issuer, details, operator"
_DETAILS = _COLUMNS.split(", ").index("details")
_INSERT = (
    f"INSERT INTO ledger (number, {_COLUMNS}, chain)"  # noqa: S608 -- no outside text
    " VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (kind, sha256) DO NOTHING"
)

_TOLD = "CASE WHEN json_valid(details) THEN json_extract(details, '$.{}') END"
_NEWEST_MARKED = (  # beside max(), SQLite takes the other columns from the row that has it
    "SELECT max(number), name, sha256, at, ifnull(not_after, ''),"  # noqa: S608 -- no outside text
    f" ifnull(CAST({_TOLD.format('mark')} AS TEXT), ''), count({_TOLD.format('request')})"
    " FROM ledger WHERE kind = ? GROUP BY name ORDER BY name"
)


class Ledger:
    """The database, open. Lines are only ever added."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with suppress(FileExistsError):
                create(path, b"", mode=PRIVATE_MODE)
            self._database = sqlite3.connect(path, timeout=_PATIENCE, isolation_level=None)
        except (sqlite3.Error, OSError) as error:
            raise KeystoreError(f"{path}: {error}") from error
        try:
            with self._errors("not a ledger: "):
                self._write_ahead()
                self._database.execute("PRAGMA synchronous = FULL")
                self._prepare()
        except PqsecError:
            self._database.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._database.close()

    def add(self, entries: Iterable[Entry]) -> None:
        """Add lines, all or none; those that are there already stay as they are."""
        with self._errors(), self._transaction():
            self._append(entries)

    def check(self) -> None:
        """KeystoreError if lines could not be added now."""
        with self._errors(), self._transaction():
            pass

    def lines(self) -> Iterator[Line]:
        """All lines, oldest first."""
        with self._errors():
            rows = self._database.execute(
                f"SELECT number, chain, {_COLUMNS} FROM ledger ORDER BY number"  # noqa: S608
            )
            for number, chain, *columns in rows:
                entry = _entry(columns)
                # Another spelling could tell SQLite something else than us.
                if details_text(entry) != columns[_DETAILS]:
                    entry = replace(entry, details={"unreadable": columns[_DETAILS]})
                yield Line(number, entry, chain)

    def of_kind(self, kind: str) -> list[Entry]:
        """The entries of that kind, oldest first."""
        return self._find("kind = ? ORDER BY number", kind)

    def of_name(self, kind: str, name: str) -> list[Entry]:
        """The entries of that kind and name, oldest first."""
        return self._find("kind = ? AND name = ? ORDER BY number", kind, name)

    def newest(self, kind: str) -> list[Entry]:
        """For each name the newest entry of that kind."""
        newest = "SELECT max(number) FROM ledger WHERE kind = ? GROUP BY name"
        return self._find(f"number IN ({newest})", kind)

    def newest_marked(self, kind: str) -> Iterator[tuple[str, str, str, str, str, int]]:
        """Of the newest line of that kind on each name: name, SHA-256, at, not_after and mark.

        Last, how many of all its lines answer requests. Sorted by name, and one after the
        other: for thousands. What a line lacks is empty.
        """
        with self._errors():
            rows = self._database.execute(_NEWEST_MARKED, (kind,))
            yield from (row[1:] for row in rows)

    def numbers(self, kind: str) -> dict[str, int]:
        """The number of the line on each thing of that kind, by SHA-256."""
        with self._errors():
            rows = self._database.execute(
                "SELECT sha256, number FROM ledger WHERE kind = ?", (kind,)
            )
            return dict(rows.fetchall())

    def newest_numbers(self, kind: str) -> dict[str, int]:
        """The number of the newest line of that kind, by name."""
        with self._errors():
            rows = self._database.execute(
                "SELECT name, max(number) FROM ledger WHERE kind = ? GROUP BY name", (kind,)
            )
            return dict(rows.fetchall())

    def _find(self, condition: str, *values: str) -> list[Entry]:
        with self._errors():
            rows = self._database.execute(
                f"SELECT {_COLUMNS} FROM ledger WHERE {condition}",  # noqa: S608
                values,
            )
            return [_entry(row) for row in rows]

    def _append(self, entries: Iterable[Entry]) -> None:
        last = self._database.execute(
            "SELECT number, chain FROM ledger ORDER BY number DESC LIMIT 1"
        ).fetchone()
        number, before = last or (0, START)
        for entry in entries:
            chain = link(before, number + 1, entry)
            row = (number + 1, *_columns(entry), chain)
            if self._database.execute(_INSERT, row).rowcount:
                number, before = number + 1, chain

    def _write_ahead(self) -> None:
        """Readers and a writer side by side. For this switch alone SQLite does not wait."""
        give_up = time.monotonic() + _PATIENCE
        while True:
            try:
                self._database.execute("PRAGMA journal_mode = WAL")
            except sqlite3.OperationalError as error:
                if error.sqlite_errorname != "SQLITE_BUSY" or time.monotonic() > give_up:
                    raise
                time.sleep(0.01)
            else:
                return

    def _prepare(self) -> None:
        """Make the table, or bring one of format 1 up to date; once, whoever comes first."""
        if self._format() == FORMAT:
            return
        with self._transaction():
            found = self._format()
            if found > FORMAT:
                raise KeystoreError(f"{self._path}: made by a newer pqsec (format {found})")
            if found < FORMAT:
                for statement in _SCHEMA:
                    self._database.execute(statement)
                self._append(self._format_1())
                self._database.execute("DROP TABLE IF EXISTS issued")
                self._database.execute(f"PRAGMA user_version = {FORMAT}")

    def _format(self) -> int:
        version: int = self._database.execute("PRAGMA user_version").fetchone()[0]
        return version

    def _format_1(self) -> list[Entry]:
        """The lines of format 1; there was one identity CA, and it issued all participants."""
        there = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'issued'"
        if not self._database.execute(there).fetchone():
            return []
        rows = self._database.execute(
            "SELECT at, kind, name, serial, sha256, not_after FROM issued ORDER BY id"
        ).fetchall()
        issuer = next((row[4] for row in rows if row[1] == "identity-ca"), None)
        return [
            replace(Entry(*row), issuer=issuer if row[1] == "participant" else None) for row in rows
        ]

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._database.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._database.execute("COMMIT")
        except BaseException:
            with suppress(sqlite3.Error):
                self._database.execute("ROLLBACK")
            raise

    @contextmanager
    def _errors(self, otherwise: str = "") -> Iterator[None]:
        """Say what the disk refuses as a FileError, and anything else as a KeystoreError."""
        try:
            yield
        except (sqlite3.Error, ValueError, TypeError, OverflowError, RecursionError) as error:
            name = str(getattr(error, "sqlite_errorname", ""))
            if name.startswith(_DISK):
                raise FileError(f"{self._path}: {str(error).lower()}") from error
            busy = name.startswith("SQLITE_BUSY")
            words = "another process is at work here" if busy else f"{otherwise}{error}"
            raise KeystoreError(f"{self._path}: {words}") from error


def _columns(entry: Entry) -> tuple[Any, ...]:
    """In the order of _COLUMNS."""
    return (
        *(entry.at, entry.kind, entry.name, entry.serial, entry.sha256, entry.not_after),
        *(entry.issuer, details_text(entry), entry.operator),
    )


def _entry(row: Iterable[Any]) -> Entry:
    at, kind, name, serial, sha256, not_after, issuer, details, operator = row
    return Entry(
        *(at, kind, name, serial, sha256, not_after),
        issuer=issuer,
        details=_details(details),
        operator=operator,
    )


def _details(text: str) -> dict[str, str]:
    """The details of a line; of one that somebody damaged, what no line was written with."""
    with suppress(ValueError, RecursionError):
        read = json.loads(text)
        if isinstance(read, dict):
            return read
    return {"unreadable": text}
