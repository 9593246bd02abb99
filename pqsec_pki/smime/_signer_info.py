"""SignerInfo: create and verify one signature in a CMS structure (RFC 5652 5.3-5.6).

A countersignature (11.4) is a SignerInfo too: it signs another signature's value.
"""

from collections.abc import Iterator
from dataclasses import field
from datetime import datetime

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    CMSAlgorithmProtection,
    IssuerAndSerialNumber,
    Oid,
    SetOf,
    SignerInfo,
    algorithm,
    attribute,
    decode,
    encode,
    raw,
    read_time,
    time_of,
)
from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import Digest, PrivateKey, PublicKey, digest_of
from pqsec_pki.certificates import (
    SEQUENCE_NUMBER,
    Certificate,
    read_sequence_number,
    same_name,
)
from pqsec_pki.errors import MalformedError, PqsecError, VerificationError, problems_of
from pqsec_pki.problems import Code, Problem

DATA = "1.2.840.113549.1.7.1"
_CONTENT_TYPE = "1.2.840.113549.1.9.3"
_MESSAGE_DIGEST = "1.2.840.113549.1.9.4"
_SIGNING_TIME = "1.2.840.113549.1.9.5"
COUNTERSIGNATURE = "1.2.840.113549.1.9.6"
_ALGORITHM_PROTECTION = "1.2.840.113549.1.9.52"
_SEQUENCE_NUMBER = SEQUENCE_NUMBER.dotted_string
_NULL = b"\x05\x00"


@dataclass(frozen=True, slots=True)
class Signer:
    """A signer: a certificate and its private key."""

    certificate: Certificate
    key: PrivateKey = field(repr=False)


def make(
    signer: Signer,
    content: bytes,
    *,
    now: datetime,
    number: int | None = None,
    counter: bool = False,
) -> SignerInfo:
    """The SignerInfo over `content`, with the sequence number `number`.

    With `counter`, it is a countersignature over a signature.
    """
    row = signer.key.algorithm
    digest = algorithm(row.digest.oid)
    identifier = decode(AlgorithmIdentifier, row.identifier, "AlgorithmIdentifier")
    protection = CMSAlgorithmProtection(digest_algorithm=digest, signature_algorithm=identifier)
    attributes = [
        attribute(_MESSAGE_DIGEST, encode(row.digest.of(content))),
        attribute(_SIGNING_TIME, encode(time_of(now))),
        attribute(_ALGORITHM_PROTECTION, encode(protection)),
    ]
    if not counter:
        attributes.append(attribute(_CONTENT_TYPE, encode(Oid(DATA))))
    if number is not None:
        attributes.append(attribute(_SEQUENCE_NUMBER, encode(number)))
    return SignerInfo(
        version=1,
        sid=IssuerAndSerialNumber(
            issuer=raw(signer.certificate.issuer_der),
            serial_number=signer.certificate.serial_number,
        ),
        digest_algorithm=digest,
        signed_attributes=sorted(attributes, key=encode),
        signature_algorithm=identifier,
        signature=signer.key.sign(encode(SetOf(attributes))),
        unsigned_attributes=None,
    )


def names(info: SignerInfo, certificate: Certificate) -> bool:
    """Whether `info` names `certificate` as its signer. This is not authenticated.

    MalformedError if OpenSSL cannot read the name of the issuer.
    """
    if isinstance(info.sid, IssuerAndSerialNumber):
        return info.sid.serial_number == certificate.serial_number and same_name(
            encode(info.sid.issuer), certificate.issuer_der
        )
    return info.sid == certificate.subject_key_identifier


def problems(
    info: SignerInfo, content: bytes, signer: Certificate, *, counter: bool = False
) -> Iterator[Problem]:
    """Everything that is wrong with `info` as `signer`'s signature over `content`."""
    try:
        attributes = _attributes(info)
        key = signer.public_key
        digest = _digest(info, key)
        yield from _attribute_problems(attributes, info, counter=counter)
        # RFC 5652 5.4, 5.6: the digest of the content is a signed attribute
        if decode(bytes, attributes[_MESSAGE_DIGEST], "message-digest") != digest.of(content):
            yield Problem("the content was changed after signing", Code.CONTENT_CHANGED)
        # and the signature covers the attributes, re-encoded as an explicit SET OF
        identifier = key.algorithm.cms_identifier(encode(info.signature_algorithm), digest)
        covered = encode(SetOf(list(info.signed_attributes or [])))
        key.verify(info.signature, covered, identifier)
    except PqsecError as error:
        for each in problems_of(error):
            yield each if each.code is not Code.OTHER else each.as_code(Code.SIGNATURE_BAD)


def signing_time(info: SignerInfo) -> datetime | None:
    """The signing time that the signer states; None if there is none."""
    value = _single(info, _SIGNING_TIME)
    return None if value is None else read_time(value, "signing time")


def sequence_number(info: SignerInfo) -> int | None:
    """The sequence number that the signer states (RFC 2985 5.3.5); None if there is none.

    MalformedError if it is not a number that `read_sequence_number` takes.
    """
    value = _single(info, _SEQUENCE_NUMBER)
    return None if value is None else read_sequence_number(value)


def _single(info: SignerInfo, oid: str) -> bytes | None:
    """DER of the only value of that signed attribute; None if it has none or several."""
    for each in info.signed_attributes or []:
        if each.type.dotted_string == oid and len(each.values.as_list()) == 1:
            return encode(each.values.as_list()[0])
    return None


def countersignatures(info: SignerInfo) -> Iterator[SignerInfo]:
    """The countersignatures on `info`; MalformedError if one cannot be read."""
    for each in info.unsigned_attributes or []:
        if each.type.dotted_string == COUNTERSIGNATURE:
            for value in each.values.as_list():
                yield decode(SignerInfo, encode(value), "countersignature")


def _attributes(info: SignerInfo) -> dict[str, bytes]:
    """The signed attributes by OID; each occurs once, with one value (RFC 5652 5.3, 11)."""
    if not info.signed_attributes:
        raise MalformedError("the signature has no signed attributes")
    found: dict[str, bytes] = {}
    for each in info.signed_attributes:
        oid, values = each.type.dotted_string, each.values.as_list()
        if oid in found or len(values) != 1:
            raise MalformedError(f"signed attribute {oid} is missing or repeated")
        found[oid] = encode(values[0])
    if _MESSAGE_DIGEST not in found:
        raise MalformedError("the signature does not name the content's digest")
    return found


def _digest(info: SignerInfo, key: PublicKey) -> Digest:
    # RFC 5754 2: absent or NULL. No signature covers the parameters.
    parameters = info.digest_algorithm.parameters
    if parameters is not None and encode(parameters) != _NULL:
        raise VerificationError("the digest has parameters")
    digest = digest_of(info.digest_algorithm.algorithm.dotted_string)
    if digest not in key.algorithm.cms_digests:
        raise VerificationError(
            f"digest {digest.name} is too weak for {key.algorithm.name} (RFC 9882 3.3)"
        )
    return digest


def _attribute_problems(
    attributes: dict[str, bytes], info: SignerInfo, *, counter: bool
) -> Iterator[Problem]:
    content_type = attributes.get(_CONTENT_TYPE)
    # 11.1: content-type is required, that of the content; 11.4: not in a countersignature
    if counter and content_type is not None:
        yield Problem(
            "the countersignature has a content-type, so it is a signature taken from elsewhere",
            Code.COUNTERSIGNATURE_BAD,
        )
    if not counter and content_type != encode(Oid(DATA)):
        yield Problem("the signature does not say that it covers plain data", Code.SIGNATURE_BAD)
    # RFC 6211 3: the attribute against substituted algorithms must repeat them
    protection = attributes.get(_ALGORITHM_PROTECTION)
    repeated = CMSAlgorithmProtection(
        digest_algorithm=info.digest_algorithm, signature_algorithm=info.signature_algorithm
    )
    if protection is not None and protection != encode(repeated):
        yield Problem("the signature's algorithms were exchanged", Code.SIGNATURE_BAD)
