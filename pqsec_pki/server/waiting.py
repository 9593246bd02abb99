"""Requests that wait until somebody decides, in a folder of the signer.

Anybody can send one, so their number is limited, also for each name. Who sends most gives up some,
so a stranger keeps no robot out. A file has one request: a line of JSON with what the server knows
of it, then its DER. It was modified when the request was last sent.
"""

import json
import os
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, exists, read, write
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.errors import FileError, MalformedError, UsageError, located, shown
from pqsec_pki.keystore import key_hashes
from pqsec_pki.server.addresses import key_of

MOST_OF_NAME = 3
LIFETIME = timedelta(days=30)
"""Since the request was last sent, or since it was approved."""
_SHORTEST = 16
"""Digits of a request's SHA-256 that name it: with 8, a stranger finds a request for a key of its
own that begins like the robot's, in a day."""
_LONGEST = 8192
"""Octets of the first line."""
_REMEMBERED = 2048
"""Requests that are not read again: for each new one all are looked at."""


@dataclass(frozen=True, slots=True)
class WaitingRequest:
    """A request that waits."""

    name: str
    sha256: str
    """Of its DER; `pqsec inspect` on the robot shows it too."""
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
    def line(self) -> bytes:
        """The first line of its file."""
        received = self.received.isoformat(timespec="seconds")
        known = {"name": self.name, "address": self.address, "received": received}
        return json.dumps({**known, "keys": self.keys}).encode() + b"\n"

    @classmethod
    def of(cls, line: bytes, sha256: str, asked: datetime) -> Self:
        """MalformedError if it is not one."""
        try:
            value: dict[str, Any] = json.loads(line)
            received = datetime.fromisoformat(value["received"])
            name, address, keys = (str(value[key]) for key in ("name", "address", "keys"))
        except (ValueError, KeyError, TypeError, RecursionError):
            raise MalformedError("not a request that waits") from None
        return cls(name, sha256, address, received, asked, keys)


@dataclass(frozen=True, slots=True)
class WaitingRequests:
    """The folder with the requests that wait, at most `most`."""

    folder: Path
    most: int

    def all(self) -> list[WaitingRequest]:
        """All, oldest first; errors name the file."""
        with disk_errors(self.folder):
            paths = list(self.folder.glob("*.request"))
        found = filter(None, map(_read, paths))
        return sorted(found, key=lambda each: (each.received, each.sha256))

    def add(self, request: CertificateRequest, name: str, address: str, now: datetime) -> None:
        """Keep the request, in place of another one if there are too many.

        One that is there stays as it is, and was asked for now.
        """
        path = self._path(request.fingerprint)
        if not exists(path):
            self._make_room(name, address, now)
            with disk_errors(self.folder):
                self.folder.mkdir(mode=0o700, exist_ok=True)
            keys = key_hashes(request.public_key, request.alternative_key)
            waits = WaitingRequest(name, request.fingerprint, address, now, now, keys)
            write(path, waits.line + request.der, private=True)
        with disk_errors(path), suppress(FileNotFoundError):  # somebody just decided
            os.utime(path, (now.timestamp(), now.timestamp()))

    def request(self, waits: WaitingRequest) -> CertificateRequest:
        """The request itself; errors name the file. MalformedError if it has another one."""
        path = self._path(waits.sha256)
        with located(path):
            found = CertificateRequest.from_der(read(path).partition(b"\n")[2])
            if found.fingerprint != waits.sha256:
                raise MalformedError("its name is not the SHA-256 of its request")
        return found

    def remove(self, sha256: str) -> None:
        """Drop the request, if it is there."""
        with disk_errors(self.folder):
            self._path(sha256).unlink(missing_ok=True)

    def named(self, text: str) -> WaitingRequest:
        """The request whose SHA-256 begins so; UsageError if there is none, or several."""
        found = [each for each in self.all() if each.sha256.startswith(text.lower())]
        hint = f"give {_SHORTEST} digits or more of what `pqsec requests list` shows"
        if len(text) < _SHORTEST:
            raise UsageError(f"'{shown(text)}' is too short for a request's SHA-256", hint=hint)
        if len(found) != 1:
            count = "several waiting requests begin" if found else "no waiting request begins"
            raise UsageError(f"{count} with '{shown(text)}'", hint=hint)
        return found[0]

    def _path(self, sha256: str) -> Path:
        return self.folder / f"{sha256}.request"

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
    """What was asked for longest ago, of the address with most, with the new one from `address`."""
    keys = {each.sha256: key_of(each.address) for each in there}
    counts = Counter([*keys.values(), key_of(address)])
    return max(there, key=lambda each: (counts[keys[each.sha256]], -each.asked.timestamp()))


def _read(path: Path) -> WaitingRequest | None:
    """What waits there; None if it does no more."""
    with located(path):
        try:
            with disk_errors(path):
                found = path.stat()
                return _waiting(path, found.st_ino, found.st_mtime_ns)
        except FileError:
            if exists(path):
                raise
            return None


@lru_cache(maxsize=_REMEMBERED)
def _waiting(path: Path, _inode: int, asked: int) -> WaitingRequest:
    """The request in the file, which is replaced and never changed; `asked` is in nanoseconds."""
    with path.open("rb") as file:
        line = file.readline(_LONGEST)
    return WaitingRequest.of(line, path.stem, datetime.fromtimestamp(asked / 1e9, UTC))
