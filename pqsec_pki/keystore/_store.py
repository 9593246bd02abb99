"""Storage of the lines of a ledger: the interface that `Ledger` and the journal need."""

import sqlite3
from typing import Protocol

from pqsec_pki.keystore._copies import CopyKey

MAX_TEXT = 16 << 20
MAX_DETAILS = MAX_TEXT - (64 << 10)
"""Bytes of one text in a line, or of all names in a question; our own lines have under 10,000."""


class LedgerStore(Protocol):
    """A place that keeps the lines; the file in `private/` is one."""

    @property
    def place(self) -> str:
        """Its path or address, for messages."""

    @property
    def key(self) -> CopyKey | None:
        """The key of the present content; None if nothing can use a copy of it again."""

    def update(self, database: sqlite3.Connection) -> bool:
        """Add the newer lines to a copy of what was there; False if it had others."""

    def load(self, database: sqlite3.Connection) -> None:
        """Fill an empty database in memory with the table and its lines.

        KeystoreError if there is no ledger; errors of SQLite if it is not one.
        """
