"""Requests of one participant for several sets of credentials, in one request.

The first request carries the others in an attribute, so its signature covers them, and each of the
others names the key of the first in an attribute that its own signature covers. So none of them can
be left out, exchanged, or put beside a request of somebody else.

No standard attribute says this: that of RFC 9763 names a certificate, and CMC (RFC 5272) another
message. The OIDs are UUIDs (X.667).
"""

import hashlib

from pqsec_pki._asn1 import CertificationRequestInfo, attribute, decode, encode
from pqsec_pki._der import elements, sequence_of
from pqsec_pki.errors import MalformedError

FURTHER_REQUESTS = "2.25.110116875939854138831225003061073633024"
"""SEQUENCE OF CertificationRequest: those of the further sets, in the keystore's order."""
FIRST_KEY = "2.25.211550453605672779033883294015917426764"
"""OCTET STRING: SHA-256 of the first request's SubjectPublicKeyInfo."""
MOST = 8
"""Further requests. There are fewer profiles."""


def further_in(info: CertificationRequestInfo) -> list[bytes]:
    """The requests that it carries, in DER; MalformedError for an empty or long list."""
    value = _value(info, FURTHER_REQUESTS)
    if value is None:
        return []
    found = elements(value, None, "list of further requests")
    if not 0 < len(found) <= MOST or sequence_of(found) != value:
        raise MalformedError(f"not a list of 1 to {MOST} further requests")
    return found


def first_key_in(info: CertificationRequestInfo) -> bytes | None:
    """The hash of the key of the request that it belongs beside; None without one."""
    value = _value(info, FIRST_KEY)
    return None if value is None else decode(bytes, value, "hash of the first key")


def add_further(info: CertificationRequestInfo, requests: list[bytes]) -> None:
    """Let the request carry others, in DER."""
    _add(info, FURTHER_REQUESTS, sequence_of(requests))


def add_first_key(info: CertificationRequestInfo, spki: bytes) -> None:
    """Let the request say beside which key it belongs."""
    _add(info, FIRST_KEY, encode(hash_of(spki)))


def hash_of(spki: bytes) -> bytes:
    """How a key is named."""
    return hashlib.sha256(spki).digest()


def _add(info: CertificationRequestInfo, oid: str, value: bytes) -> None:
    info.attributes = sorted([*info.attributes, attribute(oid, value)], key=encode)  # a SET OF


def _value(info: CertificationRequestInfo, oid: str) -> bytes | None:
    found = [each.values.as_list() for each in info.attributes if each.type.dotted_string == oid]
    if not found:
        return None
    if len(found) != 1 or len(found[0]) != 1:
        raise MalformedError(f"attribute {oid} is empty or repeated")
    return encode(found[0][0])
