"""The state of each participant by the ledger, and whether its files are the ledger's newest.

It is fast for thousands: nothing is parsed, and files that were right before are not read
again while their inode, size and change time stay the same.
"""

import base64
import binascii
import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from sys import intern

from pqsec_pki._files import disk_errors, read
from pqsec_pki.errors import FileError, KeystoreError, PqsecError, shown
from pqsec_pki.keystore import _layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore._ledger import Ledger, Newest
from pqsec_pki.keystore.compromised import compromised_keys_in
from pqsec_pki.keystore.keystore import Keystore

_SEEN = "seen.json"
"""In private/: the files that were right. Without it, all files are read."""
_MAX_SEEN = 64 << 20
"""Bytes; 10,000 participants take half a million."""


class Files(StrEnum):
    """How a participant's files compare with the ledger."""

    RIGHT = "right"
    GONE = "gone"
    """The folder has no certificate."""
    OTHER_CERTIFICATE = "other certificate"
    OTHER_PERMISSIONS = "other permissions"
    """The certificate is right, the permissions are not."""


@dataclass(frozen=True, slots=True)
class ParticipantState:
    """The state of one participant."""

    made_at: datetime
    not_after: datetime
    """Of its newest certificate."""
    revoked: bool
    issued_by_previous_ca: bool
    """Whether its certificate was issued by an identity CA that has been replaced."""
    compromised: bool
    """Whether a certificate for its key was revoked as compromised."""
    keys: str
    """Hashes of the certified keys, as of `key_hashes`; empty if not known."""
    requested: bool
    """Whether it ever sent a certificate request; then its key is not here."""
    config_digest: str
    """The config digest with which it was issued or its permissions were signed."""
    files: Files


@dataclass(frozen=True, slots=True)
class KeystoreState:
    """The state of a keystore's participants and governance."""

    participants: dict[str, ParticipantState]
    governance_digest: str | None
    """The governance's config digest; None if the file is not the newest governance signed."""
    head: str
    """The ledger's head when the state was read."""


def participant_states(keystore: Keystore) -> KeystoreState:
    """The state of all participants in the ledger, by name, and of the governance.

    KeystoreError for a damaged ledger; FileError for a disk error.
    """
    authority = keystore.identity_ca.fingerprint
    with keystore.open_ledger() as ledger, disk_errors(keystore.root):
        head = ledger.head
        revoked = {each.sha256 for each in ledger.of_kind("revocation")}
        compromised = compromised_keys_in(keystore.root, ledger)
        files = _Files.of(keystore)
        found: dict[str, ParticipantState] = {}
        for line, config_digest, permissions in _newest(ledger):
            found[line.name] = ParticipantState(
                made_at=_time(line.at),
                not_after=_time(line.not_after),
                revoked=line.sha256 in revoked,
                issued_by_previous_ca=line.issuer not in {"", authority},
                compromised=any(each in compromised for each in line.keys.split()),
                keys=line.keys,
                requested=line.requests > 0,
                config_digest=intern(config_digest),  # thousands share one
                files=files.compare(line.name, line.sha256, permissions),
            )
        if keystore.to_change:
            files.save()
        governance = _governance_digest(keystore, ledger.of_name("governance", "")[-1:])
        return KeystoreState(found, governance, head)


def config_digests_in(ledger: Ledger) -> dict[str, str]:
    """Name -> the config digest with which it was issued or its permissions were signed."""
    return {line.name: config_digest for line, config_digest, _ in _newest(ledger)}


def _newest(ledger: Ledger) -> Iterator[tuple[Newest, str, str]]:
    """Each participant's newest line, its config digest, and the SHA-256 of its permissions.

    Permissions that were signed again for the same certificate have their own config digest.
    """
    documents = ledger.newest_with_digest("permissions")
    document = next(documents, None)
    for line in ledger.newest_with_digest("participant"):
        while document and document.name < line.name:  # its participant was not issued here
            document = next(documents, None)
        if document and document.name == line.name:
            yield line, document.config_digest or line.config_digest, document.sha256
        else:
            yield line, line.config_digest, ""


@lru_cache(maxsize=1024)
def _time(text: str) -> datetime:
    """Parse a time of the ledger; cached, because one batch shares its times."""
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        raise KeystoreError(
            f"the ledger has {shown(text)} for a time",
            hint="`pqsec log --verify` shows which lines were altered",
        ) from None


def _governance_digest(keystore: Keystore, newest: list[Entry]) -> str | None:
    path = f"{keystore.root}/{_layout.ENCLAVES}/{_layout.GOVERNANCE}"
    with suppress(FileNotFoundError):
        for each in newest:
            if _sha256(path) == each.sha256:
                return each.details.get("mark", "")
    return None


# Files


class _Files:
    """Compares participants' files with the ledger, and remembers those that are right."""

    def __init__(self, root: Path, seen: dict[str, str]) -> None:
        self._enclaves = f"{root}/{_layout.ENCLAVES}"
        self._root = root
        self._seen = seen
        self._changed = False

    @classmethod
    def of(cls, keystore: Keystore) -> "_Files":
        seen: object = {}
        with suppress(FileError, ValueError, RecursionError):
            path = keystore.root / _layout.PRIVATE / _SEEN
            seen = json.loads(read(path, limit=_MAX_SEEN))
        return cls(keystore.root, seen if isinstance(seen, dict) else {})

    def compare(self, name: str, certificate: str, permissions: str) -> Files:
        """Compare `name`'s files with the SHA-256 of its certificate and permissions."""
        folder = f"{self._enclaves}{name}"
        try:
            stamps = [_stamp(f"{folder}/{_layout.CERTIFICATE}")]
        except (FileNotFoundError, NotADirectoryError):
            return Files.GONE
        with suppress(FileNotFoundError):
            stamps.append(_stamp(f"{folder}/{_layout.PERMISSIONS}"))
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
        return found

    def save(self) -> None:
        """Save the files that are right, for the next time; errors are ignored."""
        if not self._changed:
            return
        data = json.dumps(self._seen, separators=(",", ":")).encode()
        with suppress(OSError, PqsecError), Folder.opened(self._root) as root:
            root.refuse_outsiders()
            with root.below(_layout.PRIVATE) as private:
                private.replace(_SEEN, data)


def _stamp(path: str) -> str:
    """A value that changes when the file is changed or replaced."""
    found = os.lstat(path)
    return f"{found.st_ino}:{found.st_size}:{found.st_ctime_ns}"


def _compared(folder: str, certificate: str, permissions: str) -> Files:
    if _fingerprint(f"{folder}/{_layout.CERTIFICATE}") != certificate:
        return Files.OTHER_CERTIFICATE
    with suppress(FileNotFoundError):
        if _sha256(f"{folder}/{_layout.PERMISSIONS}") == permissions:
            return Files.RIGHT
    return Files.OTHER_PERMISSIONS


def _sha256(path: str) -> str:
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _fingerprint(path: str) -> str | None:
    """SHA-256 of the DER in a PEM file with one certificate; None if it is not base64."""
    with Path(path).open("rb") as file:
        lines: Iterator[bytes] = iter(file.read().split(b"\n"))
    for line in lines:
        if line.startswith(b"-----BEGIN"):
            break
    body = b"".join(line for line in lines if not line.startswith(b"-----END"))
    try:
        return hashlib.sha256(base64.b64decode(body)).hexdigest()
    except binascii.Error:
        return None
