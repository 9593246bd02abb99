"""Alternative keys and signatures: a second, post-quantum pair inside a certificate.

ITU-T X.509 (10/2019) 9.8. Three extensions, never critical (stock stacks refuse
unknown critical ones): the subject's alternative key, the algorithm of the alternative
signature, and its value over everything but itself and the `signature` field.
"""

from dataclasses import dataclass
from typing import Self

from pqsec_pki._asn1 import (
    BitString,
    Extension,
    Oid,
    PreTBSCertificate,
    TBSCertificate,
    bits,
    decode,
    encode,
    whole_bytes,
)
from pqsec_pki.algorithms import PrivateKey, PublicKey
from pqsec_pki.errors import MalformedError

SUBJECT_ALT_PUBLIC_KEY_INFO = "2.5.29.72"
ALT_SIGNATURE_ALGORITHM = "2.5.29.73"
ALT_SIGNATURE_VALUE = "2.5.29.74"


@dataclass(frozen=True, slots=True)
class Alternative:
    """What a certificate says of alternative keys; any part may be absent."""

    spki: bytes | None
    identifier: bytes | None
    signature: bytes | None
    covered: bytes
    """DER PreTBSCertificate: what the alternative signature covers."""

    @classmethod
    def of(cls, tbs: TBSCertificate) -> Self | None:
        """The alternative parts of `tbs`; None if it has none of the three extensions."""
        found = {each.extn_id.dotted_string: each.extn_value for each in tbs.extensions or []}
        parts = [
            found.get(oid)
            for oid in (SUBJECT_ALT_PUBLIC_KEY_INFO, ALT_SIGNATURE_ALGORITHM, ALT_SIGNATURE_VALUE)
        ]
        spki, identifier, value = parts
        if parts == [None, None, None]:
            return None
        if (identifier is None) != (value is None):
            raise MalformedError("half an alternative signature")
        return cls(spki, identifier, None if value is None else _unbits(value), covered_by(tbs))

    def verify(self, issuer: PublicKey) -> None:
        """VerificationError unless `issuer` made the alternative signature."""
        if self.identifier is None or self.signature is None:
            raise MalformedError("there is no alternative signature")
        issuer.verify(self.signature, self.covered, self.identifier)


def covered_by(tbs: TBSCertificate) -> bytes:
    """The DER that an alternative signature over `tbs` covers."""
    kept = [e for e in tbs.extensions or [] if e.extn_id.dotted_string != ALT_SIGNATURE_VALUE]
    return encode(
        PreTBSCertificate(
            version=tbs.version,
            serial_number=tbs.serial_number,
            issuer=tbs.issuer,
            validity=tbs.validity,
            subject=tbs.subject,
            subject_public_key_info=tbs.subject_public_key_info,
            issuer_unique_id=tbs.issuer_unique_id,
            subject_unique_id=tbs.subject_unique_id,
            extensions=kept or None,
        )
    )


def add_key(tbs: TBSCertificate, alternative: PublicKey) -> None:
    """Put the subject's alternative key into `tbs`."""
    _add(tbs, SUBJECT_ALT_PUBLIC_KEY_INFO, alternative.spki)


def add_signature(tbs: TBSCertificate, issuer: PrivateKey) -> None:
    """Sign `tbs` with the issuer's alternative key; nothing may change in it afterwards."""
    _add(tbs, ALT_SIGNATURE_ALGORITHM, issuer.algorithm.identifier)
    _add(tbs, ALT_SIGNATURE_VALUE, encode(bits(issuer.sign(covered_by(tbs)))))


def _add(tbs: TBSCertificate, oid: str, value: bytes) -> None:
    extension = Extension(extn_id=Oid(oid), critical=False, extn_value=value)
    tbs.extensions = [*(tbs.extensions or []), extension]


def _unbits(der: bytes) -> bytes:
    value = decode(BitString, der, "alternative signature")
    return whole_bytes(value, "the alternative signature")
