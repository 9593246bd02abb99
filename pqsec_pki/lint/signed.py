"""A signed document with the CA that should have signed it, and problems of its signature."""

from collections.abc import Iterator
from contextlib import suppress
from functools import cached_property

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import BROKEN_DIGESTS
from pqsec_pki.certificates import Certificate, same_name
from pqsec_pki.credentials import TrustAnchors
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.lint._keys import key_kind, key_of
from pqsec_pki.lint.file import File
from pqsec_pki.problems import Code, Problem
from pqsec_pki.smime import ListedSigner, verify

_PSS = bytes.fromhex("06092a864886f70d01010a")
"""DER of its object identifier."""
_OF_COUNTERSIGNATURES = {Code.COUNTERSIGNATURE_BAD, Code.SIGNATURE_MISSING}


@dataclass(frozen=True)
class DocumentAndSigners:
    """A document, and the certificates that should have signed it."""

    file: File
    ca: Certificate
    alternative_ca: Certificate | None
    anchors: TrustAnchors | None
    """The enclave's CAs, if the document is in an enclave and they can be read."""
    others: tuple[tuple[str, Certificate], ...]
    """(description, other certificate of the enclave), which may have signed it."""

    @property
    def uncheckable(self) -> str | None:
        """Why pqsec cannot check the CA's signature; None if it can."""
        if not self._is_ours:
            return None
        if key_of(self.ca) is None:
            return f"a key of kind {key_kind(self.ca)}"
        [signer] = self.file.signers
        if not signer.has_attributes:
            return "no signed attributes"
        if _PSS in signer.identifier:
            return "RSASSA-PSS"
        return f"the digest {signer.digest}" if "." in signer.digest else None

    @property
    def plain_problems(self) -> Iterator[str]:
        """Problems of the signature that names the CA."""
        return (str(each) for each in self._problems if each.code not in _OF_COUNTERSIGNATURES)

    @property
    def counter_problems(self) -> Iterator[str]:
        """Problems of countersignatures."""
        bad = Code.COUNTERSIGNATURE_BAD
        return (str(each) for each in self._problems if each.code is bad)

    @property
    def _is_ours(self) -> bool:
        """Whether there is one signature and it names the CA; other rules cover other cases."""
        named = self.file.signers
        return len(named) == 1 and is_by(named[0], self.ca) and self.file.signed_text[0] is not None

    @cached_property
    def _problems(self) -> tuple[Problem, ...]:
        if not self._is_ours or self.uncheckable:
            return ()
        try:
            if self.anchors:
                self.anchors.signatures(self.file.signed)
            else:
                verify(self.file.signed, self.ca, alternative_ca=self.alternative_ca)
        except VerificationError as error:
            return error.problems
        return ()


def is_by(signer: ListedSigner, certificate: Certificate) -> bool:
    """Whether the signature names `certificate` as its signer."""
    if signer.key_identifier is not None:
        return signer.key_identifier == certificate.subject_key_identifier
    if signer.issuer_der is None or signer.serial_number != certificate.serial_number:
        return False
    return same_name(signer.issuer_der, certificate.issuer_der)


def broken_digests(file: File) -> tuple[str, ...]:
    """The broken digests of its signatures: a second document can have the same digest."""
    used = (each.digest for each in file.signers)
    return tuple(BROKEN_DIGESTS[each] for each in used if each in BROKEN_DIGESTS)


def countersigners(file: File, ca: Certificate | None = None) -> tuple[ListedSigner, ...]:
    """The countersigners; with `ca`, only those of signatures that name it as signer."""
    signed = (each for each in file.signers if ca is None or is_by(each, ca))
    return tuple(each for signer in signed for each in signer.countersigners)


def embedded(file: File) -> Iterator[Certificate]:
    """The certificates in the document that its signatures name as signers."""
    for der in file.listed.certificates if file.listed else ():
        with suppress(PqsecError):
            certificate = Certificate.from_der(der)
            if any(is_by(signer, certificate) for signer in file.signers):
                yield certificate
