"""What each participant has, by the ledger; and whether its files are that still.

For thousands at a time: nothing is parsed, and files that were found to be right before
and have the same inode, size and time of change since are not read again.
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
"""In private/: what was found to be right. Without it, all files are read."""
_MAX_SEEN = 64 << 20
"""Bytes; of 10,000 participants it has half a million."""


class Files(StrEnum):
    """How a participant's files stand to the ledger."""

    RIGHT = "right"
    GONE = "gone"
    """There is no certificate."""
    OTHER_CERTIFICATE = "other certificate"
    OTHER_PERMISSIONS = "other permissions"
    """The certificate is right."""


@dataclass(frozen=True, slots=True)
class ParticipantState:
    """One participant."""

    made_at: datetime
    not_after: datetime
    """Of its newest certificate."""
    revoked: bool
    issued_by_previous_ca: bool
    """Whether its identity CA made way for another, and it did not come along."""
    compromised: bool
    """Whether a certificate of its key, but not this one, was revoked as compromised."""
    keys: str
    """Hashes of those that are certified, as `key_hashes` has them; empty if not known."""
    requested: bool
    """Whether it ever asked for a certificate of its own key, which is not here then."""
    config_digest: str
    """What it was issued, or given permissions, with; renewed or not."""
    files: Files


@dataclass(frozen=True, slots=True)
class KeystoreState:
    """A keystore's participants, and its governance."""

    participants: dict[str, ParticipantState]
    governance_digest: str | None
    """What the governance was signed with; None if the file is not the newest that was."""
    head: str
    """Of the ledger, before it was asked."""


def participant_states(keystore: Keystore) -> KeystoreState:
    """All participants of the ledger, by name, and how their files are.

    KeystoreError for a damaged ledger; FileError if the disk refuses.
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
                config_digest=intern(config_digest),  # thousands have the same
                files=files.look(line.name, line.sha256, permissions),
            )
        if keystore.to_change:
            files.remember()
        governance = _governance_digest(keystore, ledger.of_name("governance", "")[-1:])
        return KeystoreState(found, governance, head)


def config_digests_in(ledger: Ledger) -> dict[str, str]:
    """Name -> what it was issued, or given permissions, with."""
    return {line.name: config_digest for line, config_digest, _ in _newest(ledger)}


def _newest(ledger: Ledger) -> Iterator[tuple[Newest, str, str]]:
    """Of each participant its newest line, its mark, and the SHA-256 of its permissions.

    Permissions that were signed again for the same certificate have a mark of their own.
    """
    documents = ledger.newest_with_digest("permissions")
    document = next(documents, None)
    for line in ledger.newest_with_digest("participant"):
        while document and document.name < line.name:  # of somebody who was not issued here
            document = next(documents, None)
        if document and document.name == line.name:
            yield line, document.config_digest or line.config_digest, document.sha256
        else:
            yield line, line.config_digest, ""


@lru_cache(maxsize=1024)
def _time(text: str) -> datetime:
    """Those of one batch are alike."""
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        raise KeystoreError(
            f"the ledger has {shown(text)} for a time",
            hint="`pqsec log --verify` tells which lines were altered",
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
    """Looks at participants' files, and keeps what it has seen to be right."""

    def __init__(self, root: Path, seen: dict[str, str]) -> None:
        self._enclaves = f"{root}/{_layout.ENCLAVES}"
        self._root = root
        self._seen = seen
        self._news = False

    @classmethod
    def of(cls, keystore: Keystore) -> "_Files":
        seen: object = {}
        with suppress(FileError, ValueError, RecursionError):
            memory = keystore.root / _layout.PRIVATE / _SEEN
            seen = json.loads(read(memory, limit=_MAX_SEEN))
        return cls(keystore.root, seen if isinstance(seen, dict) else {})

    def look(self, name: str, certificate: str, permissions: str) -> Files:
        """How they are, against the SHA-256 of each in the ledger."""
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
        self._news = True
        found = _compared(folder, certificate, permissions)
        if found is Files.RIGHT:
            self._seen[name] = seen
        else:
            self._seen.pop(name, None)
        return found

    def remember(self) -> None:
        """For the next time; who may only read the keystore looks at all files again."""
        if not self._news:
            return
        data = json.dumps(self._seen, separators=(",", ":")).encode()
        with suppress(OSError, PqsecError), Folder.opened(self._root) as root:
            root.refuse_outsiders()
            with root.below(_layout.PRIVATE) as private:
                private.replace(_SEEN, data)


def _stamp(path: str) -> str:
    """What changes whenever the file does, or another takes its place."""
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
    """SHA-256 of the DER in a PEM file of one certificate; None if it is none."""
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
