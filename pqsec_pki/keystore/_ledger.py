"""The ledger: every certificate and signed document that was ever made here."""

import sqlite3
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import astuple, dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from pqsec_pki._files import PRIVATE_MODE, create
from pqsec_pki.errors import KeystoreError

_SCHEMA = """
CREATE TABLE IF NOT EXISTS issued (
    id INTEGER PRIMARY KEY,
    at TEXT NOT NULL,
    kind TEXT NOT NULL,
    name TEXT NOT NULL,
    serial TEXT UNIQUE,
    sha256 TEXT NOT NULL UNIQUE,
    not_after TEXT
) STRICT;
CREATE INDEX IF NOT EXISTS issued_name ON issued (name);
CREATE TRIGGER IF NOT EXISTS issued_stays BEFORE UPDATE ON issued
    BEGIN SELECT RAISE (ABORT, 'lines are only added'); END;
CREATE TRIGGER IF NOT EXISTS issued_remains BEFORE DELETE ON issued
    BEGIN SELECT RAISE (ABORT, 'lines are only added'); END;
"""


@dataclass(frozen=True, slots=True)
class Entry:
    """One thing that was made: when, what, for whom, and its SHA-256."""

    at: str
    """ISO 8601, UTC."""
    kind: str
    """identity-ca, permissions-ca, participant, governance or permissions."""
    name: str
    serial: str | None
    """A certificate's serial number in hex; None for documents."""
    sha256: str
    """Of a certificate's DER, or of a signed document's file."""
    not_after: str | None


class Ledger:
    """The database, open. Lines are only ever added."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with suppress(FileExistsError):
                create(path, b"", mode=PRIVATE_MODE)
            self._database = sqlite3.connect(path)
        except (sqlite3.Error, OSError) as error:
            raise KeystoreError(f"{path}: {error}") from error
        try:
            self._database.execute("PRAGMA journal_mode = WAL")
            self._database.execute("PRAGMA synchronous = FULL")
            self._database.executescript(_SCHEMA)
        except sqlite3.Error as error:
            self._database.close()
            raise KeystoreError(f"{path}: not a ledger: {error}") from error

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
        try:
            with self._database:
                self._database.executemany(
                    "INSERT INTO issued (at, kind, name, serial, sha256, not_after)"
                    " VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT (sha256) DO NOTHING",
                    map(astuple, entries),
                )
        except (sqlite3.Error, ValueError, OverflowError) as error:
            raise KeystoreError(f"{self._path}: {error}") from error

    def check(self) -> None:
        """KeystoreError if lines could not be added now."""
        try:
            self._database.execute("BEGIN IMMEDIATE")
            self._database.execute("ROLLBACK")
        except sqlite3.Error as error:
            raise KeystoreError(f"{self._path}: {error}") from error

    def entries(self) -> list[Entry]:
        """All lines, oldest first."""
        try:
            found = self._database.execute(
                "SELECT at, kind, name, serial, sha256, not_after FROM issued ORDER BY id"
            ).fetchall()
        except sqlite3.Error as error:
            raise KeystoreError(f"{self._path}: {error}") from error
        return [Entry(*row) for row in found]
