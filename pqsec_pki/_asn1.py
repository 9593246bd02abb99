"""ASN.1 structures of X.509, PKCS#8, PKCS#10 and CMS; the only user of hazmat.asn1.

cryptography marks that module as unstable, so nothing else may import it, pyproject
pins the versions it was tested with, and golden-file tests watch its output. It reads
and writes DER only. Field names follow the specifications, in snake case.
"""

import re
from datetime import UTC, datetime
from threading import RLock
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from cryptography.hazmat import asn1
from cryptography.hazmat.asn1 import (
    TLV,
    BitString,
    Default,
    Explicit,
    GeneralizedTime,
    Implicit,
    Null,
    SetOf,
    UTCTime,
)
from cryptography.x509 import ObjectIdentifier

from pqsec_pki.errors import MalformedError, library_call, words_of

if TYPE_CHECKING:
    from cryptography.hazmat.asn1 import sequence

__all__ = [
    "TLV",
    "AlgorithmIdentifier",
    "Attribute",
    "BitString",
    "CMSAlgorithmProtection",
    "CertificationRequestInfo",
    "ContentInfo",
    "ECPrivateKey",
    "EncapsulatedContentInfo",
    "EncryptedPrivateKeyInfo",
    "Extension",
    "IssuerAndSerialNumber",
    "KeyReference",
    "NameHolder",
    "Oid",
    "OneAsymmetricKey",
    "PBES2Params",
    "PBKDF2Params",
    "PreTBSCertList",
    "RevokedEntry",
    "SeedAndExpandedKey",
    "SetOf",
    "Signed",
    "SignedData",
    "SignerInfo",
    "SubjectPublicKeyInfo",
    "TBSCertList",
    "TBSCertificate",
    "Time",
    "Validity",
    "algorithm",
    "attribute",
    "bits",
    "decode",
    "encode",
    "moment_of",
    "plain_words",
    "raw",
    "read_time",
    "time_of",
    "whole_bytes",
]

Oid = ObjectIdentifier
Time = UTCTime | GeneralizedTime
T = TypeVar("T")

FIRST_GENERALIZED_YEAR = 2050


def encode(value: object) -> bytes:
    """The DER encoding of `value`."""
    return asn1.encode_der(value)


def decode(kind: type[T], der: bytes, what: str) -> T:
    """`der` decoded as a `kind`; MalformedError, naming `what`, if it is not one."""
    with library_call(lambda error: MalformedError(f"not a DER {what}: {plain_words(error)}")):
        return asn1.decode_der(kind, der)


_PARSE_ERROR = r"ParseError \{ kind: (\w+)(?:.*location: \[(.*?)\])?"
_PARSE_ERRORS = {
    "EncodedDefault": "a default value is encoded, such as cA FALSE, which DER forbids",
    "ExtraData": "there is data after the end",
    "IntegerOverflow": "a number is too large",
    "InvalidLength": "a length is not encoded as in DER",
    "InvalidSetOrdering": "the elements of a SET are not in order",
    "ShortData": "it ends too soon",
    "UnexpectedTag": "a value has another tag than expected",
}


def plain_words(error: BaseException) -> str:
    """The message of cryptography's parser in plain words."""
    found = re.search(_PARSE_ERROR, str(error))
    if not found:
        return words_of(error)
    place = f" ({found[2]})".replace('"', "") if found[2] else ""
    return _PARSE_ERRORS.get(found[1], "a value is invalid") + place


def raw(der: bytes) -> TLV:
    """A complete DER value, embedded unchanged in another structure."""
    return decode(TLV, der, "value")


def bits(data: bytes) -> BitString:
    """A BIT STRING of whole bytes."""
    return BitString(data, 0)


def whole_bytes(value: BitString, what: str) -> bytes:
    """The bytes of a BIT STRING that has no unused bits; MalformedError otherwise."""
    if value.padding_bits():
        raise MalformedError(f"{what} is not a whole number of bytes")
    return value.as_bytes()


def time_of(moment: datetime) -> Time:
    """UTCTime through 2049, GeneralizedTime from 2050 (RFC 5280 4.1.2.5); whole seconds."""
    whole = moment.replace(microsecond=0)
    return UTCTime(whole) if whole.year < FIRST_GENERALIZED_YEAR else GeneralizedTime(whole)


def read_time(der: bytes, what: str) -> datetime:
    """The time in a DER Time; MalformedError if it is not one."""
    if der[:1] == b"\x17":
        return moment_of(decode(UTCTime, der, what))
    return moment_of(decode(GeneralizedTime, der, what))


def moment_of(time: Time) -> datetime:
    """`time` as an aware datetime in UTC."""
    return time.as_datetime().replace(tzinfo=UTC)


class _Root:
    """The `__asn1_root__` of a class, which the parser and other such classes ask for.

    A command needs few of them, and each takes a third of a millisecond. Only one thread makes
    one: `asn1.sequence` fails where two do (both CA keys are decrypted at once).
    """

    _making = RLock()  # one for all: a structure makes those inside it

    def __get__(self, _: object, kind: type[Any]) -> object:
        with self._making:
            if vars(kind)["__asn1_root__"] is self:
                asn1.sequence(kind)
        return kind.__asn1_root__


def _sequence(kind: Any) -> Any:
    """`asn1.sequence`, but applied when `__asn1_root__` is first read."""

    def init(self: object, **values: object) -> None:
        if values.keys() != kind.__annotations__.keys():
            raise TypeError(f"{kind.__name__} has the fields {', '.join(kind.__annotations__)}")
        vars(self).update(values)

    kind.__init__, kind.__asn1_root__ = init, _Root()
    return kind


if not TYPE_CHECKING:
    sequence = _sequence

# RFC 5280 4.1, X.509 (10/2019) 7.2. Without a docstring, inspect would write a signature for
# each class, which takes longer than all else.


@sequence
class AlgorithmIdentifier:
    """An algorithm and its parameters (RFC 5280 4.1.1.2)."""

    algorithm: Oid
    parameters: TLV | Null | None


@sequence
class SubjectPublicKeyInfo:
    """A public key with its algorithm (RFC 5280 4.1.2.7)."""

    algorithm: AlgorithmIdentifier
    subject_public_key: BitString


@sequence
class Extension:
    """An extension of a certificate or revocation list (RFC 5280 4.1.2.9)."""

    extn_id: Oid
    critical: Annotated[bool, Default(False)]  # noqa: FBT003 -- the ASN.1 DEFAULT
    extn_value: bytes


@sequence
class Validity:
    """The validity of a certificate (RFC 5280 4.1.2.5)."""

    not_before: Time
    not_after: Time


@sequence
class TBSCertificate:
    """What the signature of a certificate covers (RFC 5280 4.1.2)."""

    version: Annotated[int, Explicit(0), Default(0)]
    serial_number: int
    signature: AlgorithmIdentifier
    issuer: TLV
    validity: TLV
    subject: TLV
    subject_public_key_info: TLV
    issuer_unique_id: Annotated[BitString | None, Implicit(1)]
    subject_unique_id: Annotated[BitString | None, Implicit(2)]
    extensions: Annotated[list[Extension] | None, Explicit(3)]


@sequence
class Signed:
    """A Certificate, CertificateList or CertificationRequest: content, algorithm, signature."""

    tbs: TLV
    signature_algorithm: AlgorithmIdentifier
    signature: BitString


@sequence
class Attribute:
    """An attribute of a request, key or signature (RFC 5652 5.3)."""

    type: Oid
    values: SetOf[TLV]


@sequence
class DirectoryAttributes:
    """The extension subjectDirectoryAttributes with one attribute (RFC 5280 4.2.1.8)."""

    attribute: Attribute


@sequence
class AttributeTypeAndValue:
    """A part of a name (RFC 5280 4.1.2.4)."""

    type: Oid
    value: TLV


@sequence
class NameHolder:
    """A SEQUENCE with a Name in it: only a class can be decoded."""

    name: list[SetOf[AttributeTypeAndValue]]


# RFC 5958 (PKCS#8), RFC 5915, RFC 9881 6


@sequence
class OneAsymmetricKey:
    """A private key in PKCS#8 (RFC 5958 2)."""

    version: int
    algorithm: AlgorithmIdentifier
    private_key: bytes
    attributes: Annotated[SetOf[Attribute] | None, Implicit(0)]
    public_key: Annotated[BitString | None, Implicit(1)]


@sequence
class ECPrivateKey:
    """An elliptic curve private key (RFC 5915 3)."""

    version: int
    private_key: bytes
    parameters: Annotated[Oid | None, Explicit(0)]
    public_key: Annotated[BitString | None, Explicit(1)]


@sequence
class KeyReference:
    """A reference to a private key in a token, as OpenSSL's pkcs11-provider reads it."""

    description: TLV
    uri: str


@sequence
class SeedAndExpandedKey:
    """An ML-DSA private key in both forms (RFC 9881 6)."""

    seed: bytes
    expanded_key: bytes


# RFC 8018 (PKCS#5): PBES2


@sequence
class PBKDF2Params:
    """Parameters of PBKDF2 (RFC 8018 A.2)."""

    salt: bytes
    iteration_count: int
    key_length: int | None
    prf: AlgorithmIdentifier | None


@sequence
class PBES2Params:
    """Parameters of PBES2 (RFC 8018 A.4)."""

    key_derivation: AlgorithmIdentifier
    encryption: AlgorithmIdentifier


@sequence
class EncryptedPrivateKeyInfo:
    """An encrypted private key (RFC 5958 3)."""

    algorithm: AlgorithmIdentifier
    encrypted_data: bytes


# RFC 5652 (CMS), RFC 6211


@sequence
class EncapsulatedContentInfo:
    """The content of a CMS signature; none if it is detached (RFC 5652 5.2)."""

    content_type: Oid
    content: Annotated[bytes | None, Explicit(0)]


@sequence
class IssuerAndSerialNumber:
    """The name of a certificate (RFC 5652 10.2.4)."""

    issuer: TLV
    serial_number: int


@sequence
class SignerInfo:
    """One signature (RFC 5652 5.3)."""

    version: int
    sid: IssuerAndSerialNumber | Annotated[bytes, Implicit(0)]
    digest_algorithm: AlgorithmIdentifier
    signed_attributes: Annotated[list[Attribute] | None, Implicit(0)]
    signature_algorithm: AlgorithmIdentifier
    signature: bytes
    unsigned_attributes: Annotated[list[Attribute] | None, Implicit(1)]


@sequence
class SignedData:
    """The content type of signatures (RFC 5652 5.1)."""

    version: int
    digest_algorithms: SetOf[AlgorithmIdentifier]
    encapsulated_content: EncapsulatedContentInfo
    certificates: Annotated[list[TLV] | None, Implicit(0)]
    crls: Annotated[list[TLV] | None, Implicit(1)]
    signer_infos: SetOf[SignerInfo]


@sequence
class ContentInfo:
    """A CMS structure that contains signatures (RFC 5652 3)."""

    content_type: Oid
    content: Annotated[SignedData, Explicit(0)]


@sequence
class CMSAlgorithmProtection:
    """The algorithms, as a signed attribute (RFC 6211 2)."""

    digest_algorithm: AlgorithmIdentifier
    signature_algorithm: Annotated[AlgorithmIdentifier, Implicit(1)]


# RFC 2986 (PKCS#10), RFC 5280 5.1 (revocation lists)


@sequence
class CertificationRequestInfo:
    """What the signature of a request covers (RFC 2986 4.1)."""

    version: int
    subject: TLV
    subject_public_key_info: TLV
    attributes: Annotated[list[Attribute], Implicit(0)]


@sequence
class RevokedEntry:
    """A revoked certificate (RFC 5280 5.1.2.6)."""

    user_certificate: int
    revocation_date: Time
    crl_entry_extensions: list[Extension] | None


@sequence
class TBSCertList:
    """What the signature of a revocation list covers (RFC 5280 5.1.2)."""

    version: int | None
    signature: AlgorithmIdentifier
    issuer: TLV
    this_update: Time
    next_update: Time | None
    revoked_certificates: list[TLV] | None
    crl_extensions: Annotated[list[Extension] | None, Explicit(0)]


@sequence
class PreTBSCertList:
    """What an alternative signature covers: without `signature` and altSignatureValue (9.8)."""

    version: int | None
    issuer: TLV
    this_update: Time
    next_update: Time | None
    revoked_certificates: list[TLV] | None
    crl_extensions: Annotated[list[Extension] | None, Explicit(0)]


def algorithm(oid: str, *, null: bool = False) -> AlgorithmIdentifier:
    """An AlgorithmIdentifier without parameters, or with NULL, as RSA requires."""
    return AlgorithmIdentifier(algorithm=Oid(oid), parameters=Null() if null else None)


def attribute(oid: str, *values: bytes) -> Attribute:
    """An attribute with these DER values."""
    return Attribute(type=Oid(oid), values=SetOf([raw(value) for value in values]))
