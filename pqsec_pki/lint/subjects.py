"""The subjects of rules other than files and documents: certificates, enclaves, the inventory.

Every file is read once, even if several links lead to it, and parsed when first needed. What
cannot be parsed is None, with a separate reason: subjects raise no errors.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import Alone
from pqsec_pki.algorithms import Profile, unpem
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.credentials import (
    CERTIFICATE,
    GOVERNANCE,
    IDENTITY_CA,
    PERMISSIONS,
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
    Credentials,
    TrustAnchors,
)
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lint._anchors import SharedAnchors
from pqsec_pki.lint._one_sided import one_sided
from pqsec_pki.lint.document import Document, GovernanceFile, PermissionsFile
from pqsec_pki.lint.file import Content, File
from pqsec_pki.lint.profile import ProfileFile
from pqsec_pki.lint.roles import CertificateRole, role_of
from pqsec_pki.lint.signed import DocumentAndSigners
from pqsec_pki.problems import Problem
from pqsec_pki.transparency import TreeHead


@dataclass(frozen=True)
class CertificateFile(Content):
    """A file with certificates in PEM; `certificates` are those that can be read."""

    @cached_property
    def _parsed(self) -> tuple[tuple[Certificate, ...], tuple[str, ...]]:
        good: list[Certificate] = []
        bad: list[str] = []
        try:
            blocks = unpem(self.file.data, "certificate")
        except PqsecError as error:
            return (), (str(error),)
        for label, der in blocks:
            if label not in {"CERTIFICATE", "X509 CERTIFICATE", "TRUSTED CERTIFICATE"}:
                continue
            try:
                good.append(Certificate.shared(der))
            except PqsecError as error:
                bad.append(str(error))
        return tuple(good), tuple(bad)

    @property
    def certificates(self) -> tuple[Certificate, ...]:
        """In the order of the file."""
        return self._parsed[0]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why other certificates in the file could not be read."""
        return self._parsed[1]

    @property
    def issued(self) -> Iterator[Certificate]:
        """Certificates that are not self-issued: documents name only such participants."""
        return (each for each in self.certificates if not each.is_self_issued)

    @cached_property
    def role(self) -> CertificateRole:
        """The role by the file's name; for other names, by whether it is marked as a CA."""
        return role_of(self.path.name, self.first)

    @cached_property
    def first(self) -> Certificate | None:
        """The first certificate, which stacks use."""
        return next(iter(self.certificates), None)


Compare: TypeAlias = Callable[[Path, Credentials, TreeHead | None], Iterable[Problem]]
"""Finds problems of the enclave in that folder, whose credentials were verified, and of the head in
its proof, if it has one."""


@dataclass(frozen=True)
class EnclaveFolder:
    """A folder with the credentials of one participant."""

    folder: Path
    name: str
    """The path below `enclaves/`, such as /fleet/robot1; else the folder's own name."""
    files: Mapping[str, File] = field(repr=False)
    """By name; for a link, its target. Broken links are in `broken_links`."""
    broken_links: tuple[str, ...]
    """Names of broken links."""
    now: datetime = field(repr=False)
    proof_demanded: bool = field(repr=False)
    """Whether it must have a proof that the ledger has its documents."""
    compare: Compare | None = field(repr=False)
    """Compares it with what was seen there before."""
    subjects: Mapping[str, "Document | CertificateFile"] = field(repr=False)
    """The documents and certificates in its files, by file name."""
    shared_anchors: SharedAnchors = field(repr=False)

    @property
    def path(self) -> Path:
        """The path of the folder."""
        return self.folder

    @cached_property
    def anchors(self) -> TrustAnchors | None:
        """The CAs in it by their roles; None if one is missing or cannot be read."""
        return self.shared_anchors.of({name: file.data for name, file in self.files.items()})

    def certificate(self, name: str = CERTIFICATE) -> Certificate | None:
        """The first certificate in that file; None if it is missing or cannot be read."""
        found = self.subjects.get(name)
        return found.first if isinstance(found, CertificateFile) else None

    def permissions(self, name: str = PERMISSIONS) -> PermissionsFile | None:
        """The permissions document in that file; None if it is not one."""
        found = self.subjects.get(name)
        return found if isinstance(found, PermissionsFile) else None

    def governance(self, name: str = GOVERNANCE) -> GovernanceFile | None:
        """The governance document in that file; None if it is not one."""
        found = self.subjects.get(name)
        return found if isinstance(found, GovernanceFile) else None

    @property
    def signed_documents(self) -> Iterator[DocumentAndSigners]:
        """Its documents with its permissions CA, if that can be read."""
        ca = self.certificate(PERMISSIONS_CA)
        for name in (PERMISSIONS, GOVERNANCE):
            if ca and name in self.files:
                alternative, others = self.certificate(PERMISSIONS_ALT_CA), tuple(self._others())
                yield DocumentAndSigners(self.files[name], ca, alternative, self.anchors, others)

    @property
    def revocation_lists(self) -> Iterator[tuple[File, RevocationList]]:
        """(file, revocation list) for each readable list, other than among certificates."""
        for file in self.files.values():
            revoked, _ = file.revocation_list
            if revoked and "CERTIFICATE" not in file.labels:
                yield file, revoked

    def _others(self) -> Iterator[tuple[str, Certificate]]:
        names = {"the identity CA": IDENTITY_CA, "the participant itself": CERTIFICATE}
        for role, name in names.items():
            if certificate := self.certificate(name):
                yield role, certificate


@dataclass(frozen=True, eq=False)
class Inventory:
    """Everything that is checked in one run."""

    path: Path
    """The path that the user named, or the first of several."""
    files: tuple[File, ...] = field(repr=False)
    folders: Mapping[Path, int] = field(repr=False)
    """Folder -> its st_mode."""
    documents: tuple[Document, ...] = field(repr=False)
    profiles: tuple[ProfileFile, ...] = field(repr=False)
    certificates: tuple[CertificateFile, ...] = field(repr=False)
    enclaves: tuple[EnclaveFolder, ...] = field(repr=False)
    keystore: Keystore | None
    """The keystore, if the user named a keystore of pqsec."""
    now: datetime = field(repr=False)
    interrupted_change: Path | None = None
    """The journal of an interrupted change of that keystore."""
    missing_parts: Mapping[Path, tuple[str, ...]] = field(default_factory=dict)
    """Keystore of pqsec -> the files that it lacks."""

    def profile_of(self, path: Path) -> Profile | None:
        """The profile of the set of credentials that has this file; None without a keystore."""
        if self.keystore is None:
            return None
        first, *others = self.keystore.sets
        own = (each for each in others if path.is_relative_to(each.folder))
        return next(own, first).profile

    def is_of_further_set(self, path: Path) -> bool:
        """Whether the file is of a set of credentials that is not the keystore's first one."""
        others = self.keystore.sets[1:] if self.keystore else ()
        return any(path.is_relative_to(each.folder) for each in others)

    @cached_property
    def signed_documents(self) -> tuple[DocumentAndSigners, ...]:
        """Each document with each CA that it is checked against, without duplicates."""
        found: dict[tuple[Path, str], DocumentAndSigners] = {}
        in_enclaves = (each for enclave in self.enclaves for each in enclave.signed_documents)
        for each in (*in_enclaves, *self._outside_enclaves()):
            found.setdefault((each.file.path, each.ca.fingerprint), each)
        return tuple(found.values())

    @cached_property
    def one_sided(self) -> tuple[tuple[PermissionsFile, Alone], ...]:
        """Each right without a counterpart in its keystore, with the document that has it."""
        return tuple(one_sided(self))

    def _outside_enclaves(self) -> Iterator[DocumentAndSigners]:
        """Documents outside of enclaves, if there is exactly one permissions CA."""
        in_enclaves = {file.path for each in self.enclaves for file in each.files.values()}
        roles = [(each.role, each.first) for each in self.certificates if each.first]
        signers = {
            each.fingerprint: each for role, each in roles if role is CertificateRole.PERMISSIONS_CA
        }
        counters = [each for role, each in roles if role is CertificateRole.COUNTERSIGNER]
        if len(signers) != 1:
            return
        [ca] = signers.values()
        for file in self.files:
            if file.is_signed and file.path not in in_enclaves:
                yield DocumentAndSigners(file, ca, counters[0] if counters else None, None, ())
