"""Requests that wait until somebody decides, in a folder of the signer.

Anybody can send one, so their number is limited, also for each name. A file has one: a line of JSON
with what the server knows of it, and the request itself in DER.
"""

import json
from dataclasses import field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, exists, read, write
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.errors import MalformedError, UsageError, located, shown
from pqsec_pki.keystore import key_hashes

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
    request: CertificateRequest = field(repr=False)

    @property
    def keys(self) -> str:
        """Hashes of the keys that it asks for, as in the ledger."""
        return key_hashes(self.request.public_key, self.request.alternative_key)

    def to_json(self) -> dict[str, object]:
        """The request for --json."""
        return {
            "name": self.name,
            "sha256": self.sha256,
            "address": self.address,
            "received": self.received,
        }

    def to_bytes(self) -> bytes:
        """The content of its file."""
        received = self.received.isoformat(timespec="seconds")
        known = {"name": self.name, "address": self.address, "received": received}
        return json.dumps(known).encode() + b"\n" + self.request.der

    @classmethod
    def of(cls, data: bytes) -> Self:
        """MalformedError if it is not one."""
        known, _, der = data.partition(b"\n")
        request = CertificateRequest.from_der(der)
        try:
            value: dict[str, Any] = json.loads(known)
            received = datetime.fromisoformat(value["received"])
            name, address = str(value["name"]), str(value["address"])
        except (ValueError, KeyError, TypeError, RecursionError):
            raise MalformedError("not a request that waits") from None
        return cls(name, request.fingerprint, address, received, request)


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
            paths = sorted(self.folder.glob("*.request"))
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
        waits = WaitingRequest(name, request.fingerprint, address, now, request)
        write(path, waits.to_bytes(), private=True)
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
        return self.folder / f"{sha256}.request"

    def _without_old(self, now: datetime) -> list[WaitingRequest]:
        there = self.all()
        for each in there:
            if each.received < now - LIFETIME:
                self.remove(each.sha256)
        return [each for each in there if each.received >= now - LIFETIME]


def _read(path: Path) -> WaitingRequest:
    with located(path):
        return WaitingRequest.of(read(path))
