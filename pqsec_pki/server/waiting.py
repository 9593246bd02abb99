"""Requests that wait until somebody decides, in a folder of the signer, and the decisions.

Anybody can send one, so their number is limited, also for each name. The decision is a line of the
ledger; a request is answered when its robot asks again.
"""

import json
from collections.abc import Iterable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, exists, read, write
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.errors import MalformedError, UsageError, located, shown
from pqsec_pki.keystore import Entry, Keystore, Ledger, change

APPROVAL, REFUSAL = "request-approval", "request-refusal"
"""Kinds of lines; they have the SHA-256 of the request."""
MOST_OF_NAME = 3
LIFETIME = timedelta(days=30)
_SHORTEST = 8
"""Digits of a request's SHA-256 that name it."""


@dataclass(frozen=True, slots=True)
class WaitingRequest:
    """A request that waits."""

    name: str
    sha256: str
    """Of its DER; `pqsec inspect` on the robot shows it too."""
    address: str
    received: datetime

    def to_json(self) -> dict[str, object]:
        """The request for --json."""
        return {
            "name": self.name,
            "sha256": self.sha256,
            "address": self.address,
            "received": self.received,
        }

    @classmethod
    def of(cls, data: bytes) -> Self:
        """MalformedError if it is not one."""
        try:
            value: dict[str, Any] = json.loads(data)
            received = datetime.fromisoformat(value["received"])
            return cls(str(value["name"]), str(value["sha256"]), str(value["address"]), received)
        except (ValueError, KeyError, TypeError, RecursionError):
            raise MalformedError("not a request that waits") from None


@dataclass(frozen=True, slots=True)
class WaitingRoom:
    """The folder with the requests that wait, at most `most`."""

    folder: Path
    most: int

    def all(self) -> list[WaitingRequest]:
        """All, oldest first; errors name the file."""
        if not exists(self.folder):
            return []
        with disk_errors(self.folder):
            paths = sorted(self.folder.glob("*.json"))
        return sorted(map(_read, paths), key=lambda each: each.received)

    def add(self, request: CertificateRequest, name: str, address: str, now: datetime) -> bool:
        """Keep the request; False if there are too many. One that is there stays."""
        path = self._path(request.fingerprint)
        if exists(path):
            return True
        there = self._without_old(now)
        if len(there) >= self.most or sum(each.name == name for each in there) >= MOST_OF_NAME:
            return False
        with disk_errors(self.folder):
            self.folder.mkdir(mode=0o700, exist_ok=True)
        waits = WaitingRequest(name, request.fingerprint, address, now)
        text = json.dumps({**waits.to_json(), "received": now.isoformat(timespec="seconds")})
        write(path, text.encode(), private=True)
        return True

    def remove(self, sha256: str) -> None:
        """It waits no more."""
        with disk_errors(self.folder):
            self._path(sha256).unlink(missing_ok=True)

    def named(self, text: str) -> WaitingRequest:
        """The request whose SHA-256 begins so; UsageError if there is none, or several."""
        found = [each for each in self.all() if each.sha256.startswith(text.lower())]
        if len(text) < _SHORTEST or len(found) != 1:
            raise UsageError(
                f"'{shown(text)}' names {len(found)} of the requests that wait",
                hint=f"give {_SHORTEST} digits or more of what `pqsec requests list` shows",
            )
        return found[0]

    def _path(self, sha256: str) -> Path:
        return self.folder / f"{sha256}.json"

    def _without_old(self, now: datetime) -> list[WaitingRequest]:
        there = self.all()
        for each in there:
            if each.received < now - LIFETIME:
                self.remove(each.sha256)
        return [each for each in there if each.received >= now - LIFETIME]


def decision_on(ledger: Ledger, request: CertificateRequest, name: str) -> str:
    """APPROVAL or REFUSAL of the request, by the ledger; empty if nobody decided."""
    for kind in (REFUSAL, APPROVAL):
        if any(each.sha256 == request.fingerprint for each in ledger.of_name(kind, name)):
            return kind
    return ""


def is_late(ledger: Ledger, request: CertificateRequest, name: str) -> bool:
    """Whether the approval of the request is older than the newest certificate of `name`."""
    approved, issued = ledger.numbers(APPROVAL), ledger.numbers("participant")
    lines = ledger.of_name("participant", name)[-1:]
    return any(issued[each.sha256] > approved.get(request.fingerprint, 0) for each in lines)


def decide(
    keystore: Keystore, room: WaitingRoom, ids: Iterable[str], kind: str, *, now: datetime
) -> list[WaitingRequest]:
    """Enter the decision on these requests, all or none; errors as of `WaitingRoom.named`."""
    chosen = {each.sha256: each for each in map(room.named, ids)}

    entries = [
        Entry(
            at=now.isoformat(timespec="seconds"),
            kind=kind,
            name=each.name,
            serial=None,
            sha256=each.sha256,
            not_after=None,
            details={"address": each.address},
        )
        for each in chosen.values()
    ]
    with change(keystore.root) as transaction:
        transaction.record(*entries)
    if kind == REFUSAL:
        for sha256 in chosen:
            room.remove(sha256)
    return list(chosen.values())


def _read(path: Path) -> WaitingRequest:
    with located(path):
        return WaitingRequest.of(read(path, limit=1 << 16))
