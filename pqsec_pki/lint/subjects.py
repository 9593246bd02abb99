"""The subjects of rules other than files and documents: certificates, enclaves, the inventory.

Every file is read once, even if several links lead to it, and parsed when first needed. What
cannot be parsed is None, with a separate reason: subjects raise no errors.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path

from pqsec_pki.algorithms import pem, unpem
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import (
    CERTIFICATE,
    GOVERNANCE,
    IDENTITY_CA,
    KEY,
    PERMISSIONS,
    PERMISSIONS_CA,
    TrustAnchors,
)
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lint.document import Document, GovernanceFile, PermissionsFile
from pqsec_pki.lint.file import Content, File

SIX = (IDENTITY_CA, CERTIFICATE, KEY, PERMISSIONS_CA, GOVERNANCE, PERMISSIONS)
"""The files of an enclave that every stack needs."""


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
                good.append(Certificate.from_pem(pem("CERTIFICATE", der)))
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

    @cached_property
    def first(self) -> Certificate | None:
        """The first certificate, which stacks use."""
        return next(iter(self.certificates), None)


@dataclass(frozen=True)
class Enclave:
    """A folder with the credentials of one participant."""

    folder: Path
    name: str
    """The path below `enclaves/`, such as /fleet/robot1; else the folder's own name."""
    files: Mapping[str, File] = field(repr=False)
    """By name; for a link, its target. Broken links are in `lost`."""
    lost: tuple[str, ...]
    """Names of broken links."""
    now: datetime = field(repr=False)
    inventory_files: Mapping[Path, "Document | CertificateFile"] = field(repr=False)

    @property
    def path(self) -> Path:
        """Where it is."""
        return self.folder

    @cached_property
    def anchors(self) -> TrustAnchors | None:
        """The CAs in it by their roles; None if one is missing or cannot be read."""
        try:
            return TrustAnchors.of({name: file.data for name, file in self.files.items()})
        except (KeyError, PqsecError):  # KeyError: a file is missing
            return None

    def certificate(self, name: str = CERTIFICATE) -> Certificate | None:
        """The first certificate in that file; None if it is missing or cannot be read."""
        found = self._subject(name)
        return found.first if isinstance(found, CertificateFile) else None

    def permissions(self, name: str = PERMISSIONS) -> PermissionsFile | None:
        """The permissions document in that file; None if it is not one."""
        found = self._subject(name)
        return found if isinstance(found, PermissionsFile) else None

    def governance(self, name: str = GOVERNANCE) -> GovernanceFile | None:
        """The governance document in that file; None if it is not one."""
        found = self._subject(name)
        return found if isinstance(found, GovernanceFile) else None

    def _subject(self, name: str) -> "Document | CertificateFile | None":
        file = self.files.get(name)
        return self.inventory_files.get(file.path) if file else None


@dataclass(frozen=True, eq=False)
class Inventory:
    """Everything that is checked in one run."""

    path: Path
    """What the user named, or the first of several."""
    files: tuple[File, ...] = field(repr=False)
    folders: Mapping[Path, int] = field(repr=False)
    """Folder -> its st_mode."""
    documents: tuple[Document, ...] = field(repr=False)
    certificates: tuple[CertificateFile, ...] = field(repr=False)
    enclaves: tuple[Enclave, ...] = field(repr=False)
    keystore: Keystore | None
    """The keystore, if the user named a keystore of pqsec."""
    now: datetime = field(repr=False)
    cut_off: Path | None = None
    """The journal of an interrupted change of that keystore."""
    lost: Mapping[Path, tuple[str, ...]] = field(default_factory=dict)
    """Keystore of pqsec -> the files that it lacks."""
