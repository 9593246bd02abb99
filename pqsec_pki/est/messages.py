"""Bodies of EST messages: base64, certs-only PKCS#7, and the attributes of a request."""

import base64
import binascii
from collections.abc import Iterable, Iterator

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, pkcs7

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    Oid,
    SubjectPublicKeyInfo,
    attribute,
    decode,
    encode,
)
from pqsec_pki._der import sequence_of
from pqsec_pki.algorithms import SignatureAlgorithm
from pqsec_pki.certificates import FURTHER_REQUESTS, Certificate, alternative_attributes
from pqsec_pki.errors import MalformedError

LINE = 64
_NULL = b"\x05\x00"
"""The parameters of an RSA key, in DER."""


def to_base64(data: bytes) -> bytes:
    """A body in base64 with lines of 64 characters (RFC 8951 3.1, RFC 4648 4)."""
    text = base64.b64encode(data)
    lines = (text[at : at + LINE] for at in range(0, len(text), LINE))
    return b"".join(line + b"\r\n" for line in lines)


def from_base64(body: bytes) -> bytes:
    """The content of a body in base64, with or without line breaks (RFC 8951 3.1).

    MalformedError for other characters.
    """
    try:
        return base64.b64decode(b"".join(body.split()), validate=True)
    except binascii.Error:
        raise MalformedError("the body is not base64") from None


def certs_only(certificates: Iterable[Certificate]) -> bytes:
    """A PKCS#7 SignedData with these certificates and no signature (RFC 7030 4.1.3), in DER."""
    found = [x509.load_der_x509_certificate(each.der) for each in certificates]
    return pkcs7.serialize_certificates(found, Encoding.DER)


def request_attributes(
    algorithm: SignatureAlgorithm, second: SignatureAlgorithm | None, *, has_further: bool = False
) -> bytes:
    """What a request needs, as CsrAttrs in DER (RFC 7030 4.5.2, RFC 9908 3.2).

    The type of its key with its terms, the algorithm of its signature, and for a `second` key the
    attributes that bring it. If the keystore `has_further` sets of credentials, the attribute with
    the requests for those.
    """
    spki = algorithm.generate().public_key.spki
    kind = decode(SubjectPublicKeyInfo, spki, "SubjectPublicKeyInfo").algorithm
    signature = decode(AlgorithmIdentifier, algorithm.identifier, "AlgorithmIdentifier").algorithm
    key = attribute(kind.algorithm.dotted_string, *_terms(kind, algorithm))
    brought = alternative_attributes(second) if second else []
    if has_further:
        brought.append(encode(Oid(FURTHER_REQUESTS)))
    return sequence_of([encode(key), encode(signature), *brought])


def _terms(kind: AlgorithmIdentifier, algorithm: SignatureAlgorithm) -> Iterator[bytes]:
    """What a key must have beside its type: a curve, or the bits of an RSA modulus; or nothing."""
    parameters = encode(kind.parameters) if kind.parameters else b""
    if parameters == _NULL:
        yield encode(int(algorithm.registered.parameter_set or 0))
    elif parameters:
        yield parameters
