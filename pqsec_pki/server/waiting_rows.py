"""Requests that wait in the database that has the ledger, for all servers with that ledger."""

from collections.abc import Collection
from datetime import UTC, datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import FileError, MalformedError, located
from pqsec_pki.keystore import RequestRow, SharedRequests
from pqsec_pki.server.waiting import WaitingRequest


@dataclass(frozen=True, slots=True)
class RequestRows:
    """A store of requests, for servers of several machines. KeystoreError as of its rows."""

    rows: SharedRequests

    def all(self) -> list[WaitingRequest]:
        """All, in any order; MalformedError for a row that is not one."""
        return [_waiting(each) for each in self.rows.all()]

    def ask_again(self, sha256: str, now: datetime) -> bool:
        """Whether it is there; if so, it was sent again now."""
        return self.rows.ask_again(sha256, now.isoformat())

    def put(self, waits: WaitingRequest, der: bytes) -> None:
        """Keep a request."""
        self.rows.put(RequestRow(waits.sha256, waits.known, waits.asked.isoformat()), der)

    def content(self, sha256: str) -> bytes:
        """The DER of a request; FileError if it is gone."""
        found = self.rows.content(sha256)
        if found is None:
            raise FileError(f"request {sha256} no longer waits")
        return found

    def remove(self, ids: Collection[str]) -> None:
        """Drop the requests with these SHA-256, as far as they are there."""
        self.rows.remove(ids)


def _waiting(row: RequestRow) -> WaitingRequest:
    with located(f"request {row.sha256}"):
        try:
            asked = datetime.fromisoformat(row.asked).astimezone(UTC)
        except (ValueError, OverflowError):
            raise MalformedError("not a request that waits") from None
        return WaitingRequest.of(row.known, row.sha256, asked)
