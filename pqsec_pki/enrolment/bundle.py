"""Bundles: all files of a keystore that one robot needs, in one file, never a CA's key.

A bundle contains one or several whole enclaves, under the paths of ROS 2, such as
enclaves/fleet/robot1/cert.pem. It has no private key if the robot generated the keys. The proof
that the ledger has the documents is in the manifest: an earlier pqsec refuses unknown files.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
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
from pqsec_pki.enrolment.tarball import MAX_ARCHIVE, MAX_MEMBERS
from pqsec_pki.errors import MalformedError, PassphraseError, PqsecError, UsageError, shown
from pqsec_pki.keystore import (
    BundleNumbers,
    Keystore,
    bundle_number,
    refuse_further_sets,
    regular_name,
)
from pqsec_pki.problems import Code
from pqsec_pki.tokens import is_reference
from pqsec_pki.transparency import LedgerProof

KIND = "bundle"


@dataclass(frozen=True)  # no slots, for cached properties
class Bundle:
    """Enclaves by name, each with its files by name. None of them is verified here."""

    created: datetime
    enclaves: Mapping[str, Mapping[str, bytes]] = field(repr=False)
    number: int | None = None
    """The number of the newest ledger line among its files (`BundleNumbers`). Only a label: the
    manifest is not signed. None in bundles of earlier versions."""
    proof: LedgerProof | None = field(default=None, repr=False)
    """The proof that the ledger has the certificates and documents of all enclaves."""

    @classmethod
    def of(
        cls,
        keystore: Keystore,
        names: Iterable[str],
        *,
        now: datetime,
        keys: bool = True,
        numbers: BundleNumbers | None = None,
    ) -> Self:
        """The bundle of these participants; with `keys`, including their private keys.

        To make many bundles, open the ledger once, and give its `numbers`.
        The files are verified at `now`, as the robot will do, and written again from the
        verified values. VerificationError lists everything that is wrong. KeystoreError if a
        participant does not exist or lacks a file, or a file is not the newest by the ledger
        (`CurrentFiles`); UsageError without names.
        """
        refuse_further_sets(keystore, "a bundle has")
        regular = list(dict.fromkeys(map(regular_name, names)))
        if not regular:
            raise UsageError("a bundle needs at least one participant")
        with nullcontext(numbers) if numbers else BundleNumbers.of(keystore) as those:
            found = {name: those.files(name) for name in regular}
            enclaves = {name: _verified(name, found[name], now, keys=keys) for name in regular}
            known = [number for files in found.values() if (number := those.number(files))]
            proof = those.proofs.proof(enclaves.values()) if those.proofs else None
        return cls(now.replace(microsecond=0), enclaves, max(known, default=None), proof)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The bundle in `data`; MalformedError or VerificationError as Archive.unpack."""
        archive = Archive.unpack(data, KIND)
        enclaves: dict[str, dict[str, bytes]] = {name: {} for name in archive.texts("names")}
        if not enclaves:
            raise MalformedError("the bundle has no participants")
        for path, content in archive.files.items():
            folder, _, file = path.rpartition("/")
            name = folder.removeprefix(ENCLAVES)
            if not folder.startswith(f"{ENCLAVES}/") or name not in enclaves or file not in FILES:
                raise MalformedError(f"a bundle must not contain {shown(path)}")
            if file in KEYS and is_reference(content):
                raise MalformedError(f"a bundle must not say where a key is: {shown(path)}")
            enclaves[name][file] = content
        for name, files in enclaves.items():
            _check_complete(name, files)
        number = bundle_number(archive.about.get("number"))
        proof = LedgerProof.of(archive.about["proof"]) if "proof" in archive.about else None
        bundle = cls(archive.time("created"), enclaves, number, proof)
        if sorted(bundle.fingerprints) != sorted(archive.texts("ca_sha256")):
            raise MalformedError("the manifest names other CAs than the bundle contains")
        return bundle

    def to_bytes(self) -> bytes:
        """The bundle as a file; TooLargeError if nobody could read it."""
        files = {
            f"{ENCLAVES}{name}/{file}": data
            for name, files in self.enclaves.items()
            for file, data in files.items()
        }
        about: dict[str, object] = {
            "names": list(self.enclaves),
            "created": self.created.isoformat(),
            "ca_sha256": list(self.fingerprints),
        }
        if self.number is not None:
            about["number"] = self.number
        if self.proof is not None:
            about["proof"] = self.proof.to_json()
        return Archive(KIND, about, files).pack()

    def refuse_large(self) -> None:
        """TooLargeError if nobody could read it. A small one is not packed for that."""
        files = [data for each in self.enclaves.values() for data in each.values()]
        if sum(map(len, files)) > MAX_ARCHIVE // 2 or len(files) > MAX_MEMBERS // 2:
            self.to_bytes()

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the names and contents of its files, in hex, whatever its compression."""
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
        """Whether it contains private keys."""
        return any(key in files for files in self.enclaves.values() for key in KEYS)

    @property
    def credentials(self) -> tuple[Credentials, ...]:
        """Those of each enclave without its private keys, not verified; errors as of
        `Credentials.of`."""
        return tuple(
            Credentials.of(name, {file: data for file, data in files.items() if file not in KEYS})
            for name, files in self.enclaves.items()
        )

    @property
    def fingerprints(self) -> tuple[str, ...]:
        """SHA-256 of the CAs' certificates, sorted."""
        return tuple(sorted({each for found in self.roles.values() for each in found}))

    @cached_property
    def roles(self) -> Mapping[str, frozenset[str]]:
        """The fingerprints of the CAs' certificates, by the file that contains them.

        Of all certificates in a file: a stack may trust the second one too. MalformedError for
        a file without certificates.
        """
        found = {file: frozenset(self._authorities(file)) for file in CA_FILES}
        return {file: pins for file, pins in found.items() if pins}

    def _authorities(self, file: str) -> Iterator[str]:
        for name, files in self.enclaves.items():
            if file in files:
                for each in certificates_in(files[file], f"{name}: {file}"):
                    yield each.fingerprint


def flat_name(name: str) -> str:
    """A participant's name as a file name, such as fleet+robot1; unique for each participant."""
    return name.removeprefix("/").replace("/", "+")


def name_of(flat: str) -> str:
    """The participant's name of which `flat_name` made this."""
    return f"/{flat.replace('+', '/')}"


def bundle_path(folder: Path, name: str) -> Path:
    """The path of the participant's bundle: fleet+robot1.bundle for /fleet/robot1."""
    return folder / f"{flat_name(name)}.bundle"


def save(goal: Path, data: bytes, *, private: bool = False, force: bool = False) -> None:
    """Write `data` to the file `goal`, and create its folder; errors as in _files.write."""
    with disk_errors(goal.parent):
        goal.parent.mkdir(parents=True, exist_ok=True)
    write(goal, data, private=private, force=force)


def _verified(
    name: str, files: Mapping[str, bytes], now: datetime, *, keys: bool
) -> dict[str, bytes]:
    """The files, written again; with `keys`, the private keys, which must match the certificate."""
    private = _private(name, files) if keys else {}
    public = {file: data for file, data in files.items() if file not in KEYS}
    try:
        credentials = Credentials.of(name, {**public, **private})
    except PassphraseError as error:
        error.hint = (
            "a robot cannot open it: decrypt the key, or let the robot generate its own keys"
        )
        raise
    return {**verify_credentials(credentials, now=now).files, **private}


def _private(name: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The files of private keys; none if they are in a token, whose URI the robot knows itself."""
    private = {file: data for file, data in files.items() if file in KEYS}
    outside = [file for file, data in private.items() if is_reference(data)]
    if outside and len(outside) < len(private):
        raise UsageError(
            f"{name} has one key in a token and one in a file: a bundle can bring neither",
            hint="request it on its robot: `pqsec request --participant-key-uri`",
        )
    return {} if outside else private


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
