"""Copies of certificates and lists for cryptography, which refuses some that all stacks accept.

A copy has no names, which `_rdns` reads, and no encoded default values, such as cA FALSE.
Signatures cover the original.
"""

from pqsec_pki._asn1 import Oid, encode
from pqsec_pki._der import content, elements, sequence_of

_NO_NAME = b"\x30\x00"
_SERIAL = b"\x02\x01\x01"
_FALSE = b"\x01\x01\x00"
_VERSION_1 = b"\xa0\x03\x02\x01\x00"
_OCTETS, _LISTED, _EXTENSIONS = 0x04, 0xA0, 0xA3
"""Tags of an OCTET STRING, and of the extensions of a list and of a certificate."""
_LEAST_OF_LIST, _LEAST_OF_EXTENSION = 3, 2
"""How many elements a TBSCertList and an extension have. What has fewer is left as it is, for
cryptography to refuse."""
_DEFAULTS = {
    encode(Oid("2.5.29.19")): {_FALSE},  # basicConstraints: cA
    # issuingDistributionPoint: its four Booleans
    encode(Oid("2.5.29.28")): {bytes((tag, 1, 0)) for tag in (0x81, 0x82, 0x84, 0x85)},
}
"""OID of an extension, in DER -> encodings of its default values."""


def plain_certificate(der: bytes) -> bytes:
    """The copy of a certificate; `der` itself if that is not DER, for cryptography to refuse.

    It has all parts of a certificate: `Certificate.from_der` read them.
    """
    tbs, *signed = elements(der, None, "certificate")
    values = elements(tbs, None, "certificate")
    if sequence_of([sequence_of(values), *signed]) != der:
        return der
    if values[0] == _VERSION_1:
        del values[0]
    first = values[0][0] == _LISTED  # also the tag of a version
    values[first] = _SERIAL
    values[first + 2] = values[first + 4] = _NO_NAME
    if values[-1][0] == _EXTENSIONS:
        values[-1] = _plain_extensions(values[-1])
    return sequence_of([sequence_of(values), *signed])


def plain_list(der: bytes) -> tuple[bytes, bytes]:
    """The copy of a revocation list, and its TBSCertList with its issuer.

    Encoded defaults of its entries remain in it.
    """
    tbs, *signed = elements(der, None, "revocation list")
    values = elements(tbs, None, "revocation list")
    if len(values) < _LEAST_OF_LIST or sequence_of([sequence_of(values), *signed]) != der:
        return der, tbs
    if values[-1][0] == _LISTED:
        values[-1] = _plain_extensions(values[-1])
    named = sequence_of(values)
    values[2 if values[0][0] == _SERIAL[0] else 1] = _NO_NAME  # after the version, if there is one
    return sequence_of([sequence_of(values), *signed]), named


def _plain_extensions(der: bytes) -> bytes:
    found = elements(content(der), None, "list of extensions")
    if sequence_of([sequence_of(found)], der[0]) != der:
        return der
    return sequence_of([sequence_of(map(_plain_extension, found))], der[0])


def _plain_extension(der: bytes) -> bytes:
    values = elements(der, None, "extension")
    if len(values) < _LEAST_OF_EXTENSION or sequence_of(values) != der:
        return der
    oid, *critical, octets = values
    if critical == [_FALSE]:
        critical = []
    if defaults := _DEFAULTS.get(oid):
        octets = sequence_of([_without(defaults, content(octets))], octets[0])
    return sequence_of([oid, *critical, octets])


def _without(defaults: set[bytes], der: bytes) -> bytes:
    values = elements(der, None, "extension")
    if sequence_of(values) != der:
        return der
    return sequence_of(each for each in values if each not in defaults)
