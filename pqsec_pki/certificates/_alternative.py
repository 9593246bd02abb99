"""Alternative keys and signatures: a second, post-quantum pair inside a certificate.

ITU-T X.509 (10/2019) 9.8. Three extensions, never critical (stock stacks refuse
unknown critical ones): the subject's alternative key, the algorithm of the alternative
signature, and its value over everything but itself and the `signature` field.

Revocation lists carry the last two as extensions. Requests carry all three as
attributes with the same OIDs, as BouncyCastle does.
"""

from collections.abc import Callable, Mapping
from typing import Self

from cryptography import x509

from pqsec_pki._asn1 import (
    Attribute,
    BitString,
    CertificationRequestInfo,
    Extension,
    Oid,
    PreTBSCertList,
    TBSCertificate,
    TBSCertList,
    attribute,
    bits,
    decode,
    encode,
    whole_bytes,
)
from pqsec_pki._dataclass import dataclass
from pqsec_pki._der import begins, content, elements, sequence_of
from pqsec_pki.algorithms import PrivateKey, PublicKey, SignatureAlgorithm
from pqsec_pki.errors import MalformedError

SUBJECT_ALT_PUBLIC_KEY_INFO = "2.5.29.72"
ALT_SIGNATURE_ALGORITHM = "2.5.29.73"
ALT_SIGNATURE_VALUE = "2.5.29.74"
_ALL = (SUBJECT_ALT_PUBLIC_KEY_INFO, ALT_SIGNATURE_ALGORITHM, ALT_SIGNATURE_VALUE)
_OIDS = frozenset(map(Oid, _ALL))
_VALUE_OID = encode(Oid(ALT_SIGNATURE_VALUE))
_VERSION, _EXTENSIONS = b"\xa0", 0xA3
"""Tags of TBSCertificate's first value, which version 1 lacks, and of its last."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """The alternative key and signature of a certificate, request or list; any may be absent."""

    spki: bytes | None
    identifier: bytes | None
    signature: bytes | None
    covered: bytes
    """DER of what the alternative signature covers."""

    @classmethod
    def of(cls, der: bytes, extensions: x509.Extensions) -> Self | None:
        """The alternative parts of TBSCertificate `der`, whose extensions are `extensions`.

        None if it has none of the three.
        """
        if _OIDS.isdisjoint([each.oid for each in extensions]):
            return None
        found = {
            each.oid.dotted_string: each.value.public_bytes()
            for each in extensions
            if each.oid in _OIDS
        }
        return cls._from(found, lambda: _covered_by_certificate(der))

    @classmethod
    def of_request(cls, info: CertificationRequestInfo) -> Self | None:
        """The alternative parts of a request; None if it has none of the three attributes."""
        found = _attribute_values(info.attributes)
        return cls._from(found, lambda: _covered_by_request(info))

    @classmethod
    def of_list(cls, tbs: TBSCertList) -> Self | None:
        """The alternative parts of a revocation list; None if it has none."""
        return cls._from(_values(tbs.crl_extensions), lambda: _covered_by_list(tbs))

    @classmethod
    def _from(cls, found: Mapping[str, bytes], covered: Callable[[], bytes]) -> Self | None:
        spki, identifier, value = (found.get(oid) for oid in _ALL)
        if spki is identifier is value is None:
            return None
        if (identifier is None) != (value is None):
            raise MalformedError("half an alternative signature")
        return cls(spki, identifier, None if value is None else _unbits(value), covered())

    def verify(self, issuer: PublicKey) -> None:
        """VerificationError unless `issuer` made the alternative signature."""
        if self.identifier is None or self.signature is None:
            raise MalformedError("there is no alternative signature")
        issuer.verify(self.signature, self.covered, self.identifier)


def _covered_by_certificate(tbs: bytes) -> bytes:
    """DER of what the alternative signature in DER TBSCertificate `tbs` covers.

    Cut out, not decoded and encoded again: each peer's certificate needs it.
    """
    values = elements(tbs, None, "certificate")
    del values[1 + values[0].startswith(_VERSION)]  # `signature`, after version and serial number
    if values[-1][0] == _EXTENSIONS:
        extensions = elements(content(values[-1]), None, "certificate")
        kept = [each for each in extensions if not begins(each, _VALUE_OID)]
        values[-1] = sequence_of([sequence_of(kept)], _EXTENSIONS)
    return sequence_of(values)


def add_key(tbs: TBSCertificate, alternative: PublicKey) -> None:
    """Put the subject's alternative key into `tbs`."""
    _add(tbs, SUBJECT_ALT_PUBLIC_KEY_INFO, alternative.spki)


def add_signature(tbs: TBSCertificate, issuer: PrivateKey) -> None:
    """Sign `tbs` with the issuer's alternative key; nothing may change in it afterwards."""
    _add(tbs, ALT_SIGNATURE_ALGORITHM, issuer.algorithm.identifier)
    _add(tbs, ALT_SIGNATURE_VALUE, encode(bits(issuer.sign(_covered_by_certificate(encode(tbs))))))


def add_list_signature(tbs: TBSCertList, issuer: PrivateKey) -> None:
    """Sign a revocation list with the issuer's alternative key; nothing may change after."""
    plain = tbs.crl_extensions or []
    algorithm = _extension(ALT_SIGNATURE_ALGORITHM, issuer.algorithm.identifier)
    tbs.crl_extensions = [*plain, algorithm]
    signature = encode(bits(issuer.sign(_covered_by_list(tbs))))
    tbs.crl_extensions = [*plain, algorithm, _extension(ALT_SIGNATURE_VALUE, signature)]


def add_request_proof(info: CertificationRequestInfo, alternative: PrivateKey) -> None:
    """Add an alternative key to a request, with a proof of possession; do not change it after."""
    asked = [
        attribute(SUBJECT_ALT_PUBLIC_KEY_INFO, alternative.public_key.spki),
        attribute(ALT_SIGNATURE_ALGORITHM, alternative.algorithm.identifier),
    ]
    # A SET OF: DER sorts it
    others = info.attributes
    info.attributes = sorted([*others, *asked], key=encode)
    proof = attribute(
        ALT_SIGNATURE_VALUE, encode(bits(alternative.sign(_covered_by_request(info))))
    )
    info.attributes = sorted([*others, *asked, proof], key=encode)


def alternative_attributes(algorithm: SignatureAlgorithm) -> list[bytes]:
    """The attributes that bring a key of that algorithm in a request, for those who ask for it.

    Each is an OID, or an attribute whose value is known (AttrOrOID of RFC 8951 4), in DER.
    """
    kind = attribute(ALT_SIGNATURE_ALGORITHM, algorithm.identifier)
    ends = (encode(Oid(each)) for each in (SUBJECT_ALT_PUBLIC_KEY_INFO, ALT_SIGNATURE_VALUE))
    return [*ends, encode(kind)]


def _add(tbs: TBSCertificate, oid: str, value: bytes) -> None:
    tbs.extensions = [*(tbs.extensions or []), _extension(oid, value)]


def _extension(oid: str, value: bytes) -> Extension:
    return Extension(extn_id=Oid(oid), critical=False, extn_value=value)


def _covered_by_request(info: CertificationRequestInfo) -> bytes:
    kept = [each for each in info.attributes if each.type.dotted_string != ALT_SIGNATURE_VALUE]
    return encode(
        CertificationRequestInfo(
            version=info.version,
            subject=info.subject,
            subject_public_key_info=info.subject_public_key_info,
            attributes=kept,
        )
    )


def _covered_by_list(tbs: TBSCertList) -> bytes:
    return encode(
        PreTBSCertList(
            version=tbs.version,
            issuer=tbs.issuer,
            this_update=tbs.this_update,
            next_update=tbs.next_update,
            revoked_certificates=tbs.revoked_certificates,
            crl_extensions=_without_value(tbs.crl_extensions),
        )
    )


def _without_value(extensions: list[Extension] | None) -> list[Extension] | None:
    return [e for e in extensions or [] if e.extn_id.dotted_string != ALT_SIGNATURE_VALUE] or None


def _values(extensions: list[Extension] | None) -> dict[str, bytes]:
    return {each.extn_id.dotted_string: each.extn_value for each in extensions or []}


def _attribute_values(attributes: list[Attribute]) -> dict[str, bytes]:
    """The three attributes by OID; each occurs once, with one value."""
    found: dict[str, bytes] = {}
    for each in attributes:
        oid, values = each.type.dotted_string, each.values.as_list()
        if oid not in _ALL:
            continue
        if oid in found or len(values) != 1:
            raise MalformedError(f"attribute {oid} is missing or repeated")
        found[oid] = encode(values[0])
    return found


def _unbits(der: bytes) -> bytes:
    value = decode(BitString, der, "alternative signature")
    return whole_bytes(value, "the alternative signature")
