"""List the signatures in a signed document, not verified: only for display.

Nothing here is checked. Anyone can write any signer's name into a file; only verify()
checks whether the signature is that signer's.
"""

from collections.abc import Iterator
from datetime import datetime
from functools import lru_cache

from pqsec_pki._asn1 import IssuerAndSerialNumber, SignerInfo, encode
from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import digest_of
from pqsec_pki.certificates import name_text, read_name
from pqsec_pki.errors import MalformedError, UnknownAlgorithmError
from pqsec_pki.smime import _signer_info
from pqsec_pki.smime.signed_file import SignedFile

MAX_SIGNATURES = 64
"""Signatures and countersignatures in total; DDS stacks accept one signature."""


@dataclass(frozen=True, slots=True)
class ListedSigner:
    """One signature, unverified."""

    issuer: str | None
    """The issuer of the signer's certificate, RFC 4514; None if there is a key identifier."""
    issuer_der: bytes | None
    """The same name in DER."""
    serial_number: int | None
    key_identifier: bytes | None
    """The signer's subjectKeyIdentifier, if the signer is named by it."""
    identifier: bytes
    """DER AlgorithmIdentifier of the signature."""
    digest: str
    """Name of the digest, or its dotted OID if it is not supported."""
    has_attributes: bool
    """Whether the signature covers attributes, with the document's digest among them."""
    signed_at: datetime | None
    number: int | None
    """The sequence number, if there is one."""
    countersigners: "tuple[ListedSigner, ...]" = ()


@dataclass(frozen=True, slots=True)
class CmsContent:
    """Everything in a document's CMS structure, unverified."""

    signers: tuple[ListedSigner, ...]
    certificates: tuple[bytes, ...]
    """Embedded certificates in DER, or other values in their place."""


def signers_in(message: bytes | SignedFile) -> CmsContent:
    """The signatures and certificates in S/MIME `message`; MalformedError if it is not."""
    data = SignedFile.of(message).cms
    listed = _Lister()
    return CmsContent(
        signers=tuple(listed.signers(data.signer_infos.as_list())),
        certificates=tuple(encode(each) for each in data.certificates or []),
    )


class _Lister:
    """Counts the signatures while listing them, as a limit against hostile files."""

    def __init__(self) -> None:
        self._left = MAX_SIGNATURES

    def signers(self, infos: list[SignerInfo]) -> Iterator[ListedSigner]:
        for info in infos:
            self._left -= 1
            if self._left < 0:
                raise MalformedError(f"more than {MAX_SIGNATURES} signatures in the document")
            yield self._signer(info)

    def _signer(self, info: SignerInfo) -> ListedSigner:
        issuer_der, serial_number, key_identifier = _sid(info)
        return ListedSigner(
            issuer=None if issuer_der is None else _name(issuer_der),
            issuer_der=issuer_der,
            serial_number=serial_number,
            key_identifier=key_identifier,
            identifier=encode(info.signature_algorithm),
            digest=_digest(info.digest_algorithm.algorithm.dotted_string),
            has_attributes=bool(info.signed_attributes),
            signed_at=_signer_info.signing_time(info),
            number=_signer_info.sequence_number(info),
            countersigners=tuple(self.signers(list(_signer_info.countersignatures(info)))),
        )


def _sid(info: SignerInfo) -> tuple[bytes | None, int | None, bytes | None]:
    if isinstance(info.sid, IssuerAndSerialNumber):
        return encode(info.sid.issuer), info.sid.serial_number, None
    return None, None, info.sid


def _digest(oid: str) -> str:
    try:
        return digest_of(oid).name
    except UnknownAlgorithmError:
        return oid


@lru_cache(MAX_SIGNATURES)
def _name(der: bytes) -> str:
    """The name as text; a fleet's documents are all of one signer."""
    try:
        return name_text(read_name(der))
    except MalformedError as error:
        raise MalformedError(f"the signer's name cannot be read: {error}") from error
