"""What rules look at beside files and documents: certificates, enclaves, all of it together.

Every file is read once, links and all, and parsed when first asked for. What cannot be
parsed is None, with the reason beside it: no subject raises.
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
"""What every stack needs of an enclave."""


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
        """Why others in it could not be read."""
        return self._parsed[1]

    @cached_property
    def first(self) -> Certificate | None:
        """The one that stacks take."""
        return next(iter(self.certificates), None)


@dataclass(frozen=True)
class Enclave:
    """A folder that one participant runs from."""

    folder: Path
    name: str
    """The path below `enclaves/`, as /fleet/robot1; else the folder's own name."""
    files: Mapping[str, File] = field(repr=False)
    """By name; a link is the file it leads to, and broken ones are in `lost`."""
    lost: tuple[str, ...]
    """Links that lead nowhere."""
    now: datetime = field(repr=False)
    inventory_files: Mapping[Path, "Document | CertificateFile"] = field(repr=False)

    @property
    def path(self) -> Path:
        """Where it is."""
        return self.folder

    @cached_property
    def anchors(self) -> TrustAnchors | None:
        """The CAs in it by their roles, if they are there and can be read."""
        try:
            return TrustAnchors.of({name: file.data for name, file in self.files.items()})
        except (KeyError, PqsecError):  # for KeyError: there is none of that name
            return None

    def certificate(self, name: str = CERTIFICATE) -> Certificate | None:
        """The first certificate in that file, if it can be read."""
        found = self._subject(name)
        return found.first if isinstance(found, CertificateFile) else None

    def permissions(self, name: str = PERMISSIONS) -> PermissionsFile | None:
        """The permissions document of that name, if it is one."""
        found = self._subject(name)
        return found if isinstance(found, PermissionsFile) else None

    def governance(self, name: str = GOVERNANCE) -> GovernanceFile | None:
        """The governance document of that name, if it is one."""
        found = self._subject(name)
        return found if isinstance(found, GovernanceFile) else None

    def _subject(self, name: str) -> "Document | CertificateFile | None":
        file = self.files.get(name)
        return self.inventory_files.get(file.path) if file else None


@dataclass(frozen=True, eq=False)
class Inventory:
    """All that is checked in one run."""

    path: Path
    """What the user named, or the first of several."""
    files: tuple[File, ...] = field(repr=False)
    folders: Mapping[Path, int] = field(repr=False)
    """st_mode of each folder looked into."""
    documents: tuple[Document, ...] = field(repr=False)
    certificates: tuple[CertificateFile, ...] = field(repr=False)
    enclaves: tuple[Enclave, ...] = field(repr=False)
    keystore: Keystore | None
    """If what the user named is a keystore of pqsec's."""
    now: datetime = field(repr=False)
    cut_off: Path | None = None
    """A change of that keystore that a command began and did not finish."""
    lost: Mapping[Path, tuple[str, ...]] = field(default_factory=dict)
    """What keystores of pqsec's lack, of those that the user named."""
