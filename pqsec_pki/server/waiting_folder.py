"""Requests that wait in a folder of the signer.

A file has one request: a line of JSON with what the server knows of it, then its DER. It was
modified when the request was last sent.
"""

import os
from collections.abc import Collection
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, exists, read, write
from pqsec_pki.errors import FileError, located
from pqsec_pki.server.waiting import WaitingRequest

_LONGEST = 8192
"""Octets of the first line."""
_REMEMBERED = 2048
"""Requests that are remembered: for each new one the server looks at all."""


@dataclass(frozen=True, slots=True)
class RequestFolder:
    """A store of requests, for servers of one machine."""

    folder: Path

    def all(self) -> list[WaitingRequest]:
        """All, in any order; errors name the file."""
        with disk_errors(self.folder):
            paths = list(self.folder.glob("*.request"))
        return [each for each in map(_read, paths) if each]

    def ask_again(self, sha256: str, now: datetime) -> bool:
        """Whether it is there; if so, it was sent again now."""
        path = self._path(sha256)
        with disk_errors(path):
            try:
                os.utime(path, (now.timestamp(), now.timestamp()))
            except FileNotFoundError:
                return False
        return True

    def put(self, waits: WaitingRequest, der: bytes) -> None:
        """Keep a request."""
        path = self._path(waits.sha256)
        with disk_errors(self.folder):
            self.folder.mkdir(mode=0o700, exist_ok=True)
        write(path, waits.known.encode() + b"\n" + der, private=True)
        self.ask_again(waits.sha256, waits.asked)  # unless somebody just decided

    def content(self, sha256: str) -> bytes:
        """The DER of a request; FileError if it is gone."""
        return read(self._path(sha256)).partition(b"\n")[2]

    def remove(self, ids: Collection[str]) -> None:
        """Drop the requests with these SHA-256, as far as they are there."""
        with disk_errors(self.folder):
            for each in ids:
                self._path(each).unlink(missing_ok=True)

    def _path(self, sha256: str) -> Path:
        return self.folder / f"{sha256}.request"


def _read(path: Path) -> WaitingRequest | None:
    """The request there; None if it was removed."""
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
