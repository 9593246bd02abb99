"""The ledger: every certificate and signed document that was ever made here."""

import sqlite3
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

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
"""


@dataclass(frozen=True, slots=True, kw_only=True)
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

    def to_json(self) -> dict[str, str | None]:
        """For the journal."""
        return asdict(self)

    @classmethod
    def from_json(cls, entry: dict[str, str]) -> Self:
        """The inverse of to_json."""
        return cls(**entry)


class Ledger:
    """The database, open. Lines are only ever added."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._database = sqlite3.connect(path)
            self._database.execute("PRAGMA journal_mode = WAL")
            self._database.execute("PRAGMA synchronous = FULL")
            self._database.executescript(_SCHEMA)
        except sqlite3.Error as error:
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
        rows = [(e.at, e.kind, e.name, e.serial, e.sha256, e.not_after) for e in entries]
        try:
            with self._database:
                self._database.executemany(
                    "INSERT INTO issued (at, kind, name, serial, sha256, not_after)"
                    " VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT (sha256) DO NOTHING",
                    rows,
                )
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
        keys = ("at", "kind", "name", "serial", "sha256", "not_after")
        return [Entry(**dict(zip(keys, row, strict=True))) for row in found]
