"""Bundles: all files of a keystore that one robot needs, in one file, never a CA's key.

A bundle contains one or several whole enclaves, under the paths of ROS 2, such as
enclaves/fleet/robot1/cert.pem, and those of further sets of credentials under paths such as
sets/hybrid/enclaves/fleet/robot1/cert.pem. It has no private key if the robot generated the keys.
The proof that the ledger has the documents is in the manifest: an earlier pqsec refuses unknown
files.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import field, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Self, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, write
from pqsec_pki.credentials import (
    CA_FILES,
    ENCLAVES,
    FILES,
    IDENTITY_CA,
    KEYS,
    NEEDED,
    Credentials,
    VerifiedCredentials,
    certificates_in,
    verify_credentials,
)
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.enrolment.one_meaning import differences
from pqsec_pki.enrolment.pins import Pins, of_sets, set_named
from pqsec_pki.enrolment.tarball import MAX_ARCHIVE, MAX_MEMBERS
from pqsec_pki.errors import (
    MalformedError,
    PassphraseError,
    PqsecError,
    UsageError,
    VerificationError,
    shown,
)
from pqsec_pki.keystore import (
    BundleNumbers,
    Keystore,
    SetLine,
    bundle_number,
    layout,
    regular_name,
)
from pqsec_pki.problems import Code
from pqsec_pki.tokens import is_reference
from pqsec_pki.transparency import LedgerProof

KIND = "bundle"
Enclaves: TypeAlias = Mapping[str, Mapping[str, bytes]]
"""Files by name, for each participant's name."""


@dataclass(frozen=True)  # no slots, for cached properties
class Bundle:
    """Enclaves by name, each with its files by name. None of them is verified here."""

    created: datetime
    enclaves: Enclaves = field(repr=False)
    """Those of the first set of credentials."""
    number: int | None = None
    """The number of the newest ledger line among its files (`BundleNumbers`). Only a label: the
    manifest is not signed. None in bundles of earlier versions."""
    proof: LedgerProof | None = field(default=None, repr=False)
    """The proof that the ledger has the certificates and documents of all enclaves, and the CAs of
    further sets."""
    profile: str = ""
    """That of the first set."""
    further: Mapping[str, Enclaves] = field(default_factory=dict, repr=False)
    """The same participants in each further set, by the names of their profiles."""
    set_lines: tuple[SetLine, ...] = field(default=(), repr=False)
    """The ledger's lines about the CAs of further sets."""

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
        """The bundle of these participants in all sets; with `keys`, with their private keys.

        To make many bundles, open the ledger once, and give its `numbers`.
        The files are verified at `now`, as the robot will do, and written again from the
        verified values. VerificationError lists everything that is wrong. KeystoreError if a
        participant does not exist or lacks a file, or a file is not the newest by the ledger
        (`CurrentFiles`), or only some have a certificate in a set; UsageError without names.
        """
        regular = list(dict.fromkeys(map(regular_name, names)))
        if not regular:
            raise UsageError("a bundle needs at least one participant")
        with nullcontext(numbers) if numbers else BundleNumbers.of(keystore) as those:
            sets = those.sets_of(regular)
            read = [{name: those.files(name, each.set_name) for name in regular} for each in sets]
            number = those.number_of(files for each in read for files in each.values())
            found = dict(zip((each.set_name for each in sets), read, strict=True))
            written = _verified(found, now, keys=keys)
            made = cls(
                now.replace(microsecond=0),
                number=number,
                profile=keystore.profiles[0].name,
                enclaves=written.pop(layout.FIRST),
                further=written,
            )
            return made.proven(those)

    def proven(self, numbers: BundleNumbers) -> Self:
        """This bundle with the proof for its files, if there is one."""
        if not numbers.proofs:
            return self
        lines = (SetLine.of(numbers.proofs.ledger, *each) for each in self._further_cas)
        set_lines = tuple(filter(None, lines))
        files = [files for each in self.sets.values() for files in each.values()]
        proof = numbers.proofs.proof(files, (each.about for each in set_lines))
        return replace(self, proof=proof, set_lines=set_lines if proof else ())

    @property
    def _further_cas(self) -> list[tuple[str, str]]:
        """The kind and SHA-256 of the ledger's line about each CA of a further set."""
        return sorted(
            (ca_kind(file), each)
            for file, found in of_sets(self.roles, self.further).items()
            for each in found
        )

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The bundle in `data`; MalformedError or VerificationError as Archive.unpack."""
        archive = Archive.unpack(data, KIND)
        if not (names := archive.texts("names")):
            raise MalformedError("the bundle has no participants")
        if not (profiles := archive.texts("profiles")):
            raise MalformedError("the bundle has no set of credentials")
        first, *further = map(set_named, profiles)
        sets = {each: {name: dict[str, bytes]() for name in names} for each in ("", *further)}
        if len({first, *further}) < len(profiles):
            raise MalformedError("the manifest names a profile twice")
        for path, content in archive.files.items():
            place, name, file = parts_of(path)
            if name not in sets.get(place, {}) or file not in FILES:
                raise MalformedError(f"a bundle must not contain {shown(path)}")
            if file in KEYS and is_reference(content):
                raise MalformedError(f"a bundle must not say where a key is: {shown(path)}")
            sets[place][name][file] = content
        for place, enclaves in sets.items():
            for name, files in enclaves.items():
                _check_complete(place, name, files)
        bundle = cls(
            archive.time("created"),
            sets.pop(layout.FIRST),
            bundle_number(archive.about.get("number")),
            LedgerProof.of(archive.about["proof"]) if "proof" in archive.about else None,
            profile=first,
            further=sets,
            set_lines=_set_lines(archive.about.get("set_lines", [])),
        )
        if sorted(bundle.fingerprints) != sorted(archive.texts("ca_sha256")):
            raise MalformedError("the manifest names other CAs than the bundle contains")
        return bundle

    def to_bytes(self) -> bytes:
        """The bundle as a file; TooLargeError if nobody could read it."""
        files = {
            layout.in_set(place, f"{ENCLAVES}{name}/{file}"): data
            for place, enclaves in self.sets.items()
            for name, files in enclaves.items()
            for file, data in files.items()
        }
        about: dict[str, object] = {
            "names": list(self.enclaves),
            "profiles": list(self.profiles),
            "created": self.created.isoformat(),
            "ca_sha256": list(self.fingerprints),
        }
        if self.number is not None:
            about["number"] = self.number
        if self.proof is not None:
            about["proof"] = self.proof.to_json()
        if self.set_lines:
            about["set_lines"] = [each.to_json() for each in self.set_lines]
        return Archive(KIND, about, files).pack()

    def refuse_large(self) -> None:
        """TooLargeError if nobody could read it. A small one is not packed for that."""
        files = [data for each in self._all for data in each.values()]
        if sum(map(len, files)) > MAX_ARCHIVE // 2 or len(files) > MAX_MEMBERS // 2:
            self.to_bytes()

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the names and contents of its files, in hex, whatever its compression."""
        hashes = [
            (place, name, file, hashlib.sha256(data).hexdigest())
            for place, enclaves in sorted(self.sets.items())
            for name, files in sorted(enclaves.items())
            for file, data in sorted(files.items())
        ]
        return hashlib.sha256(json.dumps(hashes).encode()).hexdigest()

    @property
    def sets(self) -> dict[str, Enclaves]:
        """The enclaves of each set, the first one first."""
        return {layout.FIRST: self.enclaves, **self.further}

    @property
    def profiles(self) -> tuple[str, ...]:
        """The profile of each set."""
        return (self.profile, *self.further)

    @property
    def _all(self) -> list[Mapping[str, bytes]]:
        """The files of each enclave in each set."""
        return [files for enclaves in self.sets.values() for files in enclaves.values()]

    @property
    def unpacked_size(self) -> int:
        """The size of all files, in bytes."""
        return sum(len(data) for files in self._all for data in files.values())

    @property
    def names(self) -> tuple[str, ...]:
        """The participants in it."""
        return tuple(self.enclaves)

    @property
    def has_keys(self) -> bool:
        """Whether it contains private keys."""
        return any(key in files for files in self._all for key in KEYS)

    @property
    def credentials(self) -> tuple[Credentials, ...]:
        """Those of each enclave in each set, as of `credentials_by_set`."""
        return tuple(each for found in self.credentials_by_set.values() for each in found)

    @cached_property
    def credentials_by_set(self) -> Mapping[str, tuple[Credentials, ...]]:
        """Those of each enclave without its private keys, not verified; errors as of
        `Credentials.of`."""
        return {
            place: tuple(Credentials.of(name, _public(files)) for name, files in enclaves.items())
            for place, enclaves in self.sets.items()
        }

    @property
    def fingerprints(self) -> tuple[str, ...]:
        """SHA-256 of the CAs' certificates, sorted."""
        return tuple(sorted({each for found in self.roles.values() for each in found}))

    @cached_property
    def roles(self) -> Pins:
        """The fingerprints of the CAs' certificates, by the file that contains them.

        Of all certificates in a file: a stack may trust the second one too. MalformedError for
        a file without certificates.
        """
        found = {
            layout.in_set(place, file): frozenset(self._authorities(place, file))
            for place in self.sets
            for file in CA_FILES
        }
        return {file: pins for file, pins in found.items() if pins}

    def _authorities(self, place: str, file: str) -> Iterator[str]:
        for name, files in self.sets[place].items():
            if file in files:
                for each in certificates_in(files[file], f"{name}: {file}"):
                    yield each.fingerprint


def ca_kind(file: str) -> str:
    """The kind of the ledger's line about the CA in that file."""
    return "identity-ca" if file.endswith(IDENTITY_CA) else "permissions-ca"


def flat_name(name: str) -> str:
    """A participant's name as a file name, such as fleet+robot1; unique for each participant."""
    return name.removeprefix("/").replace("/", "+")


def name_of(flat: str) -> str:
    """The participant's name of which `flat_name` made this."""
    return f"/{flat.replace('+', '/')}"


def parts_of(path: str) -> tuple[str, str, str]:
    """The set, the participant and the name of the file at `path`; empty texts for another path."""
    place, inside = layout.FIRST, path
    if path.startswith(f"{layout.SETS}/"):
        _, place, inside = (*path.split("/", 2), "")[:3]
    folder, _, file = inside.rpartition("/")
    name = folder.removeprefix(ENCLAVES)
    is_regular = path == layout.in_set(place, f"{ENCLAVES}{name}/{file}")
    return (place, name, file) if is_regular else (layout.FIRST, "", "")


def bundle_path(folder: Path, name: str) -> Path:
    """The path of the participant's bundle: fleet+robot1.bundle for /fleet/robot1."""
    return folder / f"{flat_name(name)}.bundle"


def save(goal: Path, data: bytes, *, private: bool = False, force: bool = False) -> None:
    """Write `data` to the file `goal`, and create its folder; errors as in _files.write."""
    with disk_errors(goal.parent):
        goal.parent.mkdir(parents=True, exist_ok=True)
    write(goal, data, private=private, force=force)


def _verified(sets: Mapping[str, Enclaves], now: datetime, *, keys: bool) -> dict[str, Enclaves]:
    """`sets` with all files written again from the verified values.

    With `keys`, also the private keys, which must match the certificates. VerificationError lists
    everything that is wrong with one participant, or what differs between the sets.
    """
    written, found = dict[str, Enclaves](), dict[str, list[VerifiedCredentials]]()
    for place, enclaves in sets.items():
        private = {name: _private(name, files) if keys else {} for name, files in enclaves.items()}
        found[place] = [
            verify_credentials(_credentials(name, {**_public(files), **private[name]}), now=now)
            for name, files in enclaves.items()
        ]
        written[place] = {each.name: {**each.files, **private[each.name]} for each in found[place]}
    if problems := [*differences(found)]:
        raise VerificationError(*problems, hint="`pqsec check` of the keystore says more")
    return written


def _public(files: Mapping[str, bytes]) -> dict[str, bytes]:
    return {file: data for file, data in files.items() if file not in KEYS}


def _credentials(name: str, files: Mapping[str, bytes]) -> Credentials:
    try:
        return Credentials.of(name, files)
    except PassphraseError as error:
        error.hint = (
            "a robot cannot open it: decrypt the key, or let the robot generate its own keys"
        )
        raise


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


def _set_lines(value: object) -> tuple[SetLine, ...]:
    if not isinstance(value, list):
        raise MalformedError("the manifest has set_lines that are not a list")
    return tuple(map(SetLine.of_json, value))


def _check_complete(place: str, name: str, files: Mapping[str, bytes]) -> None:
    try:
        if regular_name(name) != name:
            raise MalformedError(f"a bundle for {shown(name)!r}")
    except PqsecError as error:
        raise MalformedError(f"the bundle is for {shown(name)!r}") from error
    missing = [each for each in NEEDED if each not in files]
    if missing:
        raise MalformedError(
            f"the bundle lacks {', '.join(missing)} of {name}{f' in set {place}' if place else ''}",
            code=Code.FILE_MISSING,
        )
