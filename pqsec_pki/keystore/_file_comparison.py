"""Compares participants' files with the ledger.

Files that were right before are not read again while their inode, size and change time stay
the same.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from pqsec_pki._files import exists, read
from pqsec_pki.errors import FileError, MissingError, PqsecError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore._shared_files import pem_fingerprint
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.states import Compare, Files

_MAX_SEEN = 64 << 20
"""Bytes; 10,000 participants take half a million."""


def presence(keystore: Keystore) -> Compare:
    """Tells only which participants' certificates are gone."""
    enclaves = f"{keystore.folder}/{layout.ENCLAVES}"
    gone = Files.ELSEWHERE if keystore.ledger_address else Files.GONE

    def compare(name: str, _certificate: str, _permissions: str) -> Files:
        there = exists(f"{enclaves}{name}/{layout.CERTIFICATE}", follow=False)
        return Files.NOT_COMPARED if there else gone

    return compare


class FileComparison:
    """Compares participants' files with the ledger, and remembers those that are right."""

    def __init__(
        self, root: Path, seen: dict[str, str], older: Mapping[str, str] | None = None
    ) -> None:
        """`older` are the names by the SHA-256 of their certificates, if others use the ledger."""
        self._older = older
        self._enclaves = f"{root}/{layout.ENCLAVES}"
        self._root = root
        self._seen = seen
        self._changed = False

    @classmethod
    def of(cls, keystore: Keystore) -> "FileComparison":
        """A comparison that knows the files that were right before."""
        seen: object = {}
        with suppress(FileError, ValueError, RecursionError):
            path = keystore.folder / layout.PRIVATE / layout.SEEN
            seen = json.loads(read(path, limit=_MAX_SEEN))
        older = None
        if keystore.ledger_address:
            with keystore.open_ledger() as ledger:
                older = ledger.issued()
        return cls(keystore.folder, seen if isinstance(seen, dict) else {}, older)

    def compare(self, name: str, certificate: str, permissions: str) -> Files:
        """Compare `name`'s files with the SHA-256 of its certificate and permissions."""
        folder = f"{self._enclaves}{name}"
        try:
            stamps = [_stamp(f"{folder}/{layout.CERTIFICATE}")]
        except (FileNotFoundError, NotADirectoryError):
            return Files.GONE if self._older is None else Files.ELSEWHERE
        with suppress(FileNotFoundError):
            stamps.append(_stamp(f"{folder}/{layout.PERMISSIONS}"))
        whole = " ".join((*stamps, certificate, permissions)).encode()
        seen = hashlib.blake2b(whole, digest_size=12).hexdigest()
        if self._seen.get(name) == seen:
            return Files.RIGHT
        self._changed = True
        found = _compared(folder, certificate, permissions)
        if found is Files.RIGHT:
            self._seen[name] = seen
        else:
            self._seen.pop(name, None)
        is_older = found is Files.OTHER_CERTIFICATE and self._was_issued(name, folder)
        return Files.ELSEWHERE if is_older else found

    def _was_issued(self, name: str, folder: str) -> bool:
        """Whether the folder has a certificate that was issued to `name` before the newest."""
        here = pem_fingerprint(read(Path(f"{folder}/{layout.CERTIFICATE}")))
        return bool(self._older and self._older.get(here or "") == name)

    def save(self) -> None:
        """Save the files that are right, for the next time; errors are ignored."""
        if not self._changed:
            return
        data = json.dumps(self._seen, separators=(",", ":")).encode()
        if len(data) > _MAX_SEEN:
            return
        with suppress(OSError, PqsecError), Folder.opened(self._root) as root:
            root.refuse_outsiders()
            with root.below(layout.PRIVATE) as private:
                private.replace(layout.SEEN, data)


def _stamp(path: str) -> str:
    """A value that changes when the file is changed or replaced."""
    found = os.lstat(path)
    return f"{found.st_ino}:{found.st_size}:{found.st_ctime_ns}"


def _compared(folder: str, certificate: str, permissions: str) -> Files:
    if pem_fingerprint(read(Path(f"{folder}/{layout.CERTIFICATE}"))) != certificate:
        return Files.OTHER_CERTIFICATE
    with suppress(MissingError):
        found = hashlib.sha256(read(Path(f"{folder}/{layout.PERMISSIONS}"))).hexdigest()
        if found == permissions:
            return Files.RIGHT
    return Files.OTHER_PERMISSIONS
