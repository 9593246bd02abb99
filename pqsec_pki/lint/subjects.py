"""What rules look at: files, what is in them, enclaves, and all of it together.

Every file is read once, links and all, and parsed when first asked for. What cannot be
parsed is None, with the reason beside it: no subject raises.
"""

import re
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path

from pqsec_pki.algorithms import pem, unpem
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import Governance, Grant, Node, Permissions, Tree, read_tree, validate
from pqsec_pki.errors import InvalidDocumentError, PqsecError, Problem
from pqsec_pki.keystore import Keystore
from pqsec_pki.lint.rule import Found
from pqsec_pki.smime import document_in, is_signed

CERTIFICATE, KEY = "cert.pem", "key.pem"
PERMISSIONS, GOVERNANCE = "permissions.p7s", "governance.p7s"
IDENTITY_CA, PERMISSIONS_CA = "identity_ca.cert.pem", "permissions_ca.cert.pem"
SIX = (IDENTITY_CA, CERTIFICATE, KEY, PERMISSIONS_CA, GOVERNANCE, PERMISSIONS)
"""What every stack needs of an enclave."""


@dataclass(frozen=True)
class File:
    """A file, whatever is in it. `data` is empty where it could not be read."""

    path: Path
    """As reached from what the user named; where several links lead, the file itself."""
    data: bytes = field(repr=False)
    mode: int
    """st_mode of the file itself, with its type."""
    now: datetime = field(repr=False)
    unreadable: str | None = None
    """Why there is no data."""

    @property
    def permission_bits(self) -> int:
        """The mode as chmod takes it."""
        return stat.S_IMODE(self.mode)

    @cached_property
    def is_signed(self) -> bool:
        """Whether it looks like S/MIME."""
        return is_signed(self.data)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """The labels of its PEM blocks, such as CERTIFICATE."""
        found = re.findall(rb"-----BEGIN ([A-Z0-9 ]{1,64})-----", self.data)
        return tuple(label.decode() for label in found)

    @property
    def is_private_key(self) -> bool:
        """Whether a private key in PEM is in it."""
        return any(label.endswith("PRIVATE KEY") for label in self.labels)

    @property
    def is_revocation_list(self) -> bool:
        """Whether a revocation list in PEM is in it."""
        return "X509 CRL" in self.labels

    @cached_property
    def looks_like_document(self) -> bool:
        """Whether it is S/MIME or XML of this standard, broken or not."""
        if self.is_signed:
            return True
        head = self.data[:65536].replace(b"\0", b"")  # so that UTF-16 shows its tags too
        return bool(re.search(rb"(?i)<(dds|domain_access_rules|permissions)[\s>/]", head))


@dataclass(frozen=True)
class Document:
    """A governance or permissions document, bare or signed.

    What cannot be told to be one of the two is of this class itself.
    """

    file: File

    @property
    def path(self) -> Path:
        """Where it is."""
        return self.file.path

    @property
    def now(self) -> datetime:
        """The time of the check."""
        return self.file.now

    @cached_property
    def xml(self) -> bytes | None:
        """The document itself; None with `reason` if S/MIME is around it that cannot be read."""
        return self._xml[0]

    @cached_property
    def _xml(self) -> tuple[bytes | None, str | None]:
        if not self.file.is_signed:
            return self.file.data, None
        try:
            return document_in(self.file.data), None
        except PqsecError as error:
            return None, str(error)

    @cached_property
    def _first_line(self) -> int:
        """How many lines of the file stand before the document."""
        if not self.file.is_signed or self.xml is None:
            return 0
        text = self.file.data.replace(b"\r\n", b"\n")
        place = text.find(self.xml.replace(b"\r\n", b"\n").strip())
        return text.count(b"\n", 0, place) if place > 0 else 0

    def line(self, line: int | None) -> int | None:
        """The line of the file where that line of the document is."""
        return None if line is None else line + self._first_line

    @cached_property
    def _tree(self) -> tuple[Tree | None, str | None]:
        if self.xml is None:
            return None, self._xml[1]
        try:
            return read_tree(self.xml), None
        except PqsecError as error:
            return None, str(error)

    @property
    def tree(self) -> Tree | None:
        """All that is in the XML; None with `reason` if it is not well formed."""
        return self._tree[0]

    @property
    def root(self) -> Node | None:
        """The root element."""
        return self.tree.root if self.tree else None

    @cached_property
    def nodes(self) -> Mapping[str, tuple[Node, ...]]:
        """All elements by their tag, in document order."""
        found: dict[str, list[Node]] = {}
        for node in self.root.walk() if self.root else ():
            found.setdefault(node.tag, []).append(node)
        return {tag: tuple(nodes) for tag, nodes in found.items()}

    def all(self, *tags: str) -> Iterator[Node]:
        """All elements with one of these tags."""
        for tag in tags:
            yield from self.nodes.get(tag, ())

    def at(self, place: Node | int | None, message: str) -> Found:
        """What was found at an element, or a line, of the document."""
        return Found(message, self.line(place.line if isinstance(place, Node) else place))

    @property
    def reason(self) -> str | None:
        """Why there is no tree."""
        return self._tree[1]

    @cached_property
    def problems(self) -> tuple[Problem, ...]:
        """What breaks the schema; lines are of the document, not the file."""
        if self.xml is None or self.tree is None:
            return ()
        try:
            validate(self.xml)
        except InvalidDocumentError as error:
            return error.problems
        except PqsecError as error:
            return (Problem(None, None, str(error)),)
        return ()


class GovernanceFile(Document):
    """A governance document."""

    @cached_property
    def governance(self) -> Governance | None:
        """What it says; None if it breaks its schema."""
        try:
            return Governance.from_xml(self.xml or b"")
        except PqsecError:
            return None


class PermissionsFile(Document):
    """A permissions document."""

    @cached_property
    def permissions(self) -> Permissions | None:
        """What it says; None if it breaks its schema."""
        try:
            return Permissions.from_xml(self.xml or b"")
        except PqsecError:
            return None

    @property
    def grants(self) -> tuple[Grant, ...]:
        """Its grants; none if it breaks its schema."""
        return self.permissions.grants if self.permissions else ()


@dataclass(frozen=True)
class CertificateFile:
    """A file with certificates in PEM; `certificates` are those that can be read."""

    file: File

    @property
    def path(self) -> Path:
        """Where it is."""
        return self.file.path

    @property
    def now(self) -> datetime:
        """The time of the check."""
        return self.file.now

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

    @property
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


@dataclass(frozen=True)
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


Subject = File | Document | CertificateFile | Enclave | Inventory


def document_of(file: File) -> Document:
    """The document in `file`, of the class of what it is."""
    document = Document(file)
    root = document.root
    kinds = {"domain_access_rules": GovernanceFile, "permissions": PermissionsFile}
    for child in root.children if root and root.tag == "dds" else ():
        if child.tag in kinds:
            known = kinds[child.tag](file)
            vars(known).update(vars(document))  # what was parsed is not parsed again
            return known
    return document
