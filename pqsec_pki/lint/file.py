"""A file, read once, and what is known about it before it is parsed."""

import re
import stat
from dataclasses import field
from datetime import datetime
from functools import cached_property
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import is_encrypted, load_private_key
from pqsec_pki.certificates import RevocationList
from pqsec_pki.errors import PqsecError, UnknownAlgorithmError
from pqsec_pki.smime import (
    AmbiguousError,
    CmsContent,
    ListedSigner,
    SignedFile,
    document_in,
    is_signed,
    signers_in,
)
from pqsec_pki.tokens import is_reference, uri_in, usable

_DDS_TAG = re.compile(rb"(?i)<(dds|domain_access_rules|permissions)[\s>/]")
_DER_KEY = re.compile(rb"0(?:[\x00-\x7f]|\x81.|\x82..)\x02\x01[\0\1][\x02\x04\x30]", re.DOTALL)
"""PKCS #8, PKCS #1 or SEC 1: a version 0 or 1, then a tag that certificates and CRLs lack."""


@dataclass(frozen=True, slots=True)
class PrivateKeyInfo:
    """The facts about a private key without its passphrase. This does not keep the key."""

    spki: bytes | None = None
    """DER SubjectPublicKeyInfo of its public key; None if it cannot be loaded here."""
    reason: str | None = None
    """Why it cannot be read, if the reason is not a missing passphrase."""


@dataclass(frozen=True, eq=False)
class File:
    """A file with any content. `data` is empty if it could not be read."""

    path: Path
    """The path below what the user named; the file's own path rather than that of a link."""
    data: bytes = field(repr=False)
    mode: int
    """st_mode of the file itself, with its type."""
    now: datetime = field(repr=False)
    unreadable: str | None = None
    """Why it could not be read."""

    @property
    def permission_bits(self) -> int:
        """The mode, as for chmod."""
        return stat.S_IMODE(self.mode)

    is_signed = False
    """Whether it looks like S/MIME."""

    @cached_property
    def signed(self) -> SignedFile:
        """The file as S/MIME, parsed when it is first asked."""
        return SignedFile(self.data)

    @cached_property
    def signed_text(self) -> tuple[bytes | None, PqsecError | None]:
        """(the document in S/MIME, None), or (None, why it cannot be read)."""
        try:
            return document_in(self.signed), None
        except PqsecError as error:
            return None, error

    @property
    def is_ambiguous(self) -> bool:
        """Whether it is S/MIME from which programs can read different documents."""
        return isinstance(self.signed_text[1], AmbiguousError)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """The labels of its PEM blocks, such as CERTIFICATE."""
        found = re.findall(rb"-----BEGIN ([A-Z0-9 ]{1,64})-----", self.data)
        return tuple(label.decode() for label in found)

    @cached_property
    def is_private_key(self) -> bool:
        """Whether it contains a private key; in DER, only unencrypted ones are recognised."""
        in_pem = any(label.endswith("PRIVATE KEY") for label in self.labels)
        return in_pem or _DER_KEY.match(self.data) is not None

    @cached_property
    def is_reference(self) -> bool:
        """Whether it refers to a private key in a token."""
        return is_reference(self.data)

    @cached_property
    def private_key(self) -> PrivateKeyInfo:
        """The private key in it. A token is not asked."""
        if self.unreadable or is_encrypted(self.data):
            return PrivateKeyInfo()
        try:
            if self.is_reference:
                usable(uri_in(self.data))
                return PrivateKeyInfo()
            return PrivateKeyInfo(load_private_key(self.data).public_key.spki)
        except UnknownAlgorithmError:
            return PrivateKeyInfo()  # stacks accept some kinds that pqsec does not
        except PqsecError as error:
            return PrivateKeyInfo(reason=str(error))

    @property
    def listed(self) -> CmsContent | None:
        """The signatures and certificates in S/MIME; None if it cannot be read."""
        return self._listed[0]

    @property
    def signers(self) -> tuple[ListedSigner, ...]:
        """The signers that the document names; none if it cannot be read."""
        return self.listed.signers if self.listed else ()

    @property
    def signature_error(self) -> str | None:
        """Why the signatures of S/MIME cannot be read, if they cannot."""
        return self._listed[1]

    @cached_property
    def _listed(self) -> tuple[CmsContent | None, str | None]:
        if not self.is_signed:
            return None, None
        try:
            return signers_in(self.signed), None
        except PqsecError as error:
            return None, str(error)

    @cached_property
    def revocation_list(self) -> tuple[RevocationList | None, str | None]:
        """(the list in it, None), or (None, why it cannot be read); (None, None) without one."""
        if not self.is_revocation_list:
            return None, None
        try:
            return RevocationList.from_pem(self.data), None
        except PqsecError as error:
            return None, str(error)

    @property
    def is_revocation_list(self) -> bool:
        """Whether it contains a revocation list in PEM."""
        return "X509 CRL" in self.labels

    @cached_property
    def looks_like_document(self) -> bool:
        """Whether it is S/MIME, or XML of DDS-Security, even if broken."""
        if self.is_signed:
            return True
        head = self.data[:65536]
        if b"<" not in head:  # as in PEM: the search below is slow
            return False
        return bool(_DDS_TAG.search(head.replace(b"\0", b"")))  # also finds tags in UTF-16


class SmimeFile(File):
    """A file that looks like S/MIME: the only one that rules about signatures concern."""

    is_signed = True


class KeyOrListFile(File):
    """A file with a private key or a revocation list; most files have neither."""


class SmimeKeyOrListFile(SmimeFile, KeyOrListFile):
    """A file that is both."""


def file_with(data: bytes, path: Path, mode: int, now: datetime) -> File:
    """The file with that content, as an instance of its subclass: rules about other subclasses do
    not run."""
    made = (SmimeFile if is_signed(data) else File)(path, data, mode, now)
    if made.is_private_key or made.is_revocation_list:
        kind = SmimeKeyOrListFile if made.is_signed else KeyOrListFile
        return kind(path, data, mode, now)
    return made


@dataclass(frozen=True)
class Content:
    """The content of a file."""

    file: File

    @property
    def path(self) -> Path:
        """The path of the file."""
        return self.file.path

    @property
    def now(self) -> datetime:
        """The time of the check."""
        return self.file.now
