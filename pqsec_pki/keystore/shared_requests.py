"""Requests that wait at servers with one ledger: rows of its database, for all of them.

They are not lines: any client can send one, and they are removed. A server that answers has the
keystore's lock, which excludes other servers; each row is committed at once.
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import _shared, layout
from pqsec_pki.keystore._folder import Folder

if TYPE_CHECKING:
    from pqsec_pki.keystore._postgres import PostgresLedger


class RequestRow(NamedTuple):
    """What is known of a request; its octets are asked for by themselves."""

    sha256: str
    known: str
    """JSON of the server."""
    asked: str
    """The time when it was last sent, in ISO 8601 with its zone."""


@dataclass(frozen=True, slots=True)
class SharedRequests:
    """The rows of the database that has the ledger of the keystore at `root`.

    Methods raise KeystoreError if it does not answer, or the role may not do it.
    """

    root: Path

    def all(self) -> list[RequestRow]:
        """All, in any order."""
        with self._database() as database:
            return [RequestRow(*row) for row in database.waiting()]

    def content(self, sha256: str) -> bytes | None:
        """The octets of the request; None if it does not wait."""
        with self._database() as database:
            return database.waiting_content(sha256)

    def ask_again(self, sha256: str, asked: str) -> bool:
        """Enter that it was sent again; False if it does not wait."""
        with self._database() as database:
            return database.ask_again(sha256, asked)

    def put(self, row: RequestRow, content: bytes) -> None:
        """Add a request."""
        with self._database() as database:
            database.put_waiting(*row, content)

    def remove(self, ids: Collection[str]) -> None:
        """Drop the requests with these SHA-256, as far as they are there."""
        with self._database() as database:
            database.remove_waiting(ids)

    @contextmanager
    def _database(self) -> Iterator["PostgresLedger"]:
        with (
            disk_errors(self.root / layout.SETTINGS),
            Folder.opened(self.root) as folder,
            _shared.reading(self.root, folder) as database,
        ):
            if database is None:
                raise KeystoreError(f"{self.root}: the ledger is no longer in a database")
            yield database
