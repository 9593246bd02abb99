"""Bundles: all that one robot needs of a keystore, in one file, and never a CA's key.

A bundle holds whole enclaves, one or several, under the paths that ROS 2 knows:
enclaves/fleet/robot1/cert.pem. With keys that were made on the robot it has no key.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Self

from pqsec_pki._files import disk_errors, write
from pqsec_pki.credentials import (
    CA_FILES,
    ENCLAVES,
    FILES,
    KEYS,
    NEEDED,
    Credentials,
    certificates_in,
    verify_credentials,
)
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.errors import MalformedError, PassphraseError, PqsecError, UsageError, shown
from pqsec_pki.keystore import Keystore, enclave_files, regular_name
from pqsec_pki.problems import Code

KIND = "bundle"


@dataclass(frozen=True)  # no slots: what is worked out once is kept
class Bundle:
    """Enclaves by name, each with its files by name. Nothing of it is verified here."""

    created: datetime
    enclaves: Mapping[str, Mapping[str, bytes]] = field(repr=False)

    @classmethod
    def of(
        cls, keystore: Keystore, names: Iterable[str], *, now: datetime, keys: bool = True
    ) -> Self:
        """The bundle of these participants; without `keys` only what anybody may read.

        What is in it was verified, as its robot will at `now`, and written again from that:
        VerificationError lists everything that is wrong. KeystoreError if a participant is not
        there or lacks a file, UsageError for no names.
        """
        regular = list(dict.fromkeys(map(regular_name, names)))
        if not regular:
            raise UsageError("a bundle is for at least one participant")
        enclaves = {
            name: _verified(name, enclave_files(keystore.root, name), now, keys=keys)
            for name in regular
        }
        return cls(now.replace(microsecond=0), enclaves)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The bundle in `data`; MalformedError or VerificationError as Archive.unpack."""
        archive = Archive.unpack(data, KIND)
        enclaves: dict[str, dict[str, bytes]] = {name: {} for name in archive.texts("names")}
        if not enclaves:
            raise MalformedError("the bundle is for nobody")
        for path, content in archive.files.items():
            folder, _, file = path.rpartition("/")
            name = folder.removeprefix(ENCLAVES)
            if not folder.startswith(f"{ENCLAVES}/") or name not in enclaves or file not in FILES:
                raise MalformedError(f"a bundle holds no {shown(path)}")
            enclaves[name][file] = content
        for name, files in enclaves.items():
            _check_complete(name, files)
        bundle = cls(archive.time("created"), enclaves)
        if sorted(bundle.fingerprints) != sorted(archive.texts("ca_sha256")):
            raise MalformedError("the manifest names other CAs than the bundle holds")
        return bundle

    def to_bytes(self) -> bytes:
        """The bundle as a file."""
        files = {
            f"{ENCLAVES}{name}/{file}": data
            for name, files in self.enclaves.items()
            for file, data in files.items()
        }
        about = {
            "names": list(self.enclaves),
            "created": self.created.isoformat(),
            "ca_sha256": list(self.fingerprints),
        }
        return Archive(KIND, about, files).pack()

    @cached_property
    def sha256(self) -> str:
        """Of the names and contents of its files, in hex; however it is packed."""
        hashes = [
            (name, file, hashlib.sha256(data).hexdigest())
            for name, files in sorted(self.enclaves.items())
            for file, data in sorted(files.items())
        ]
        return hashlib.sha256(json.dumps(hashes).encode()).hexdigest()

    @property
    def names(self) -> tuple[str, ...]:
        """The participants in it."""
        return tuple(self.enclaves)

    @property
    def has_keys(self) -> bool:
        """Whether it holds private keys."""
        return any(key in files for files in self.enclaves.values() for key in KEYS)

    @property
    def fingerprints(self) -> tuple[str, ...]:
        """SHA-256 of the CAs' certificates, sorted."""
        return tuple(sorted({each for found in self.roles.values() for each in found}))

    @cached_property
    def roles(self) -> Mapping[str, frozenset[str]]:
        """The same by the file that they stand in.

        Of all in each file: a stack may trust the second one too. MalformedError for a file
        that is not certificates.
        """
        found = {file: frozenset(self._authorities(file)) for file in CA_FILES}
        return {file: pins for file, pins in found.items() if pins}

    def _authorities(self, file: str) -> Iterator[str]:
        for name, files in self.enclaves.items():
            if file in files:
                for each in certificates_in(files[file], f"{name}: {file}"):
                    yield each.fingerprint


def flat_name(name: str) -> str:
    """A participant's name as a file's: fleet+robot1. No other participant has it."""
    return name.removeprefix("/").replace("/", "+")


def save(goal: Path, data: bytes, *, private: bool = False, force: bool = False) -> None:
    """Write `data` to the file `goal`, and make its folder; errors as _files.write."""
    with disk_errors(goal.parent):
        goal.parent.mkdir(parents=True, exist_ok=True)
    write(goal, data, private=private, force=force)


def _verified(
    name: str, files: Mapping[str, bytes], now: datetime, *, keys: bool
) -> dict[str, bytes]:
    """The files, written again; with the private `keys`, which must be the certificate's."""
    private = {file: data for file, data in files.items() if file in KEYS} if keys else {}
    public = {file: data for file, data in files.items() if file not in KEYS}
    try:
        credentials = Credentials.of(name, {**public, **private})
    except PassphraseError as error:
        error.hint = "no robot could open it: decrypt it, or let the robot make its own keys"
        raise
    return {**verify_credentials(credentials, now=now).files, **private}


def _check_complete(name: str, files: Mapping[str, bytes]) -> None:
    try:
        if regular_name(name) != name:
            raise MalformedError(f"a bundle for {shown(name)!r}")
    except PqsecError as error:
        raise MalformedError(f"the bundle is for {shown(name)!r}") from error
    missing = [each for each in NEEDED if each not in files]
    if missing:
        raise MalformedError(
            f"the bundle lacks {', '.join(missing)} of {name}", code=Code.FILE_MISSING
        )
