"""Requests that wait until somebody decides.

Any client can send one, so their number is limited, also for each name. Beyond a limit, the address
with most loses its oldest, so an attacker cannot exclude robots. They are in a folder of the
signer, or, for several servers, in the database that has their ledger.
"""

import json
from collections import Counter
from collections.abc import Collection, Sequence
from datetime import datetime, timedelta
from typing import Any, Protocol, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.errors import MalformedError, UsageError, located, shown
from pqsec_pki.keystore import key_hashes
from pqsec_pki.server.addresses import key_of

MOST_OF_NAME = 3
LIFETIME = timedelta(days=30)
"""Since the request was last sent, or since it was approved."""
_SHORTEST = 16
"""Digits of a request's SHA-256 that name it: with 8, a stranger finds a request for a key of its
own that begins like the robot's, in a day."""


@dataclass(frozen=True, slots=True)
class WaitingRequest:
    """A request that waits."""

    name: str
    sha256: str
    """SHA-256 of its DER; `pqsec inspect` on the robot shows it too."""
    address: str
    """From which it was first sent."""
    received: datetime
    asked: datetime
    """When it was last sent."""
    keys: str
    """Hashes of the keys that it is for, as of `key_hashes`."""

    def to_json(self) -> dict[str, object]:
        """The request for --json."""
        return {
            "name": self.name,
            "sha256": self.sha256,
            "address": self.address,
            "received": self.received,
            "asked": self.asked,
        }

    @property
    def known(self) -> str:
        """What is kept beside it, as JSON in one line."""
        received = self.received.isoformat(timespec="seconds")
        known = {"name": self.name, "address": self.address, "received": received}
        return json.dumps({**known, "keys": self.keys})

    @classmethod
    def of(cls, known: str | bytes, sha256: str, asked: datetime) -> Self:
        """MalformedError if it is not one."""
        try:
            value: dict[str, Any] = json.loads(known)
            received = datetime.fromisoformat(value["received"])
            name, address, keys = (str(value[key]) for key in ("name", "address", "keys"))
        except (ValueError, KeyError, TypeError, RecursionError):
            raise MalformedError("not a request that waits") from None
        return cls(name, sha256, address, received, asked, keys)


class RequestStore(Protocol):
    """Where requests wait: `waiting_folder.py`, or `waiting_rows.py`. Errors name the place."""

    def all(self) -> list[WaitingRequest]:
        """All, in any order."""

    def ask_again(self, sha256: str, now: datetime) -> bool:
        """Whether it is there; if so, it was sent again now."""

    def put(self, waits: WaitingRequest, der: bytes) -> None:
        """Keep a request."""

    def content(self, sha256: str) -> bytes:
        """The DER of a request; FileError if it is gone."""

    def remove(self, ids: Collection[str]) -> None:
        """Drop the requests with these SHA-256, as far as they are there."""


@dataclass(frozen=True, slots=True)
class WaitingRequests:
    """The requests that wait, at most `most`."""

    store: RequestStore
    most: int

    def all(self) -> list[WaitingRequest]:
        """All, oldest first."""
        return sorted(self.store.all(), key=lambda each: (each.received, each.sha256))

    def add(self, request: CertificateRequest, name: str, address: str, now: datetime) -> None:
        """Keep the request, in place of another one if there are too many.

        One that is there stays as it is, and was asked for now.
        """
        if self.store.ask_again(request.fingerprint, now):
            return
        self._make_room(name, address, now)
        sets = (key_hashes(each.public_key, each.alternative_key) for each in request.sets)
        keys = " ".join(sets)
        waits = WaitingRequest(name, request.fingerprint, address, now, now, keys)
        self.store.put(waits, request.der)

    def request(self, waits: WaitingRequest) -> CertificateRequest:
        """The request itself. MalformedError if there is another one in its place."""
        with located(f"request {waits.sha256}"):
            found = CertificateRequest.from_der(self.store.content(waits.sha256))
            if found.fingerprint != waits.sha256:
                raise MalformedError("its SHA-256 is another one")
        return found

    def remove(self, *ids: str) -> None:
        """Drop the requests with these SHA-256, as far as they are there."""
        if ids:
            self.store.remove(ids)

    def named(self, text: str) -> WaitingRequest:
        """The request whose SHA-256 begins so; UsageError if there is none, or several."""
        found = [each for each in self.all() if each.sha256.startswith(text.lower())]
        listed = "`pqsec requests list --config serve.yaml`"
        hint = f"give {_SHORTEST} digits or more of what {listed} shows"
        if len(text) < _SHORTEST:
            raise UsageError(f"'{shown(text)}' is too short for a request's SHA-256", hint=hint)
        if len(found) != 1:
            count = "several waiting requests begin" if found else "no waiting request begins"
            raise UsageError(f"{count} with '{shown(text)}'", hint=hint)
        return found[0]

    def _make_room(self, name: str, address: str, now: datetime) -> None:
        """Drop what is old, and one more if the folder is full, or has enough for that name."""
        there = []
        for each in self.all():
            if each.asked < now - LIFETIME:
                self.remove(each.sha256)
            else:
                there.append(each)
        own = [each for each in there if each.name == name]
        if len(own) >= MOST_OF_NAME:
            self.remove(_to_give_up(own, address).sha256)
        elif len(there) >= self.most:
            self.remove(_to_give_up(there, address).sha256)


def _to_give_up(there: Sequence[WaitingRequest], address: str) -> WaitingRequest:
    """The oldest request of the address with most requests, counting a new one from `address`."""
    keys = {each.sha256: key_of(each.address) for each in there}
    counts = Counter([*keys.values(), key_of(address)])
    return max(there, key=lambda each: (counts[keys[each.sha256]], -each.asked.timestamp()))
