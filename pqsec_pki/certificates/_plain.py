"""Copies of certificates and lists for cryptography, which refuses some that all stacks accept.

A copy has no names, which `_rdns` reads, and no encoded default values, such as cA FALSE. Names
inside its extensions have the types of strings that cryptography reads. Signatures cover the
original.
"""

from collections.abc import Callable

from pqsec_pki._asn1 import Oid, encode
from pqsec_pki._der import begins, content, elements, sequence_of
from pqsec_pki.certificates._rdns import plain_name

MINIMUM_0 = b"\x80\x01\x00"
"""The default minimum of a subtree of nameConstraints, encoded."""
_NO_NAME = b"\x30\x00"
_SERIAL = b"\x02\x01\x01"
_FALSE = b"\x01\x01\x00"
_VERSION_1 = b"\xa0\x03\x02\x01\x00"
_OID, _SEQUENCE, _LISTED, _EXTENSIONS = 0x06, 0x30, 0xA0, 0xA3
"""Tags; the last two are of the extensions of a list and of a certificate."""
_LEAST_OF_LIST, _LEAST_OF_EXTENSION = 3, 2
"""How many elements a TBSCertList and an extension have. What has fewer is left as it is, for
cryptography to refuse."""
_OTHER_NAME, _DIRECTORY_NAME = 0xA0, 0xA4
_CONTAINERS = {_SEQUENCE, 0xA0, 0xA1, 0xA2}
"""Tags of what has a directoryName in it, in the extensions below."""
_DEEPEST = -3
"""The level of a directoryName in a distribution point; see `_plain_value`."""
_PLACES: dict[str, tuple[int, set[bytes]]] = {
    "2.5.29.19": (1, {_FALSE}),  # basicConstraints: cA
    # issuingDistributionPoint: its four Booleans
    "2.5.29.28": (1, {bytes((tag, 1, 0)) for tag in (0x81, 0x82, 0x84, 0x85)}),
    "2.5.29.30": (3, {MINIMUM_0}),  # nameConstraints
    "2.5.29.17": (1, set()),  # subjectAltName
    "2.5.29.18": (1, set()),  # issuerAltName
    "2.5.29.29": (1, set()),  # certificateIssuer
    "2.5.29.31": (1, set()),  # cRLDistributionPoints
    "2.5.29.35": (1, set()),  # authorityKeyIdentifier
    "2.5.29.46": (1, set()),  # freshestCRL
    "1.3.6.1.5.5.7.1.1": (1, set()),  # authorityInfoAccess
    "1.3.6.1.5.5.7.1.11": (1, set()),  # subjectInfoAccess
}
"""Extension -> how deep its default values are, and their encodings."""
_PLACES_BY_DER = {encode(Oid(oid)): places for oid, places in _PLACES.items()}


def plain_certificate(der: bytes) -> bytes:
    """The copy of a certificate; `der` itself if that is not DER, for cryptography to refuse.

    It has all parts of a certificate: `Certificate.from_der` read them.
    MalformedError if OpenSSL cannot read a name in its extensions.
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
        values[-1] = _mapped(values[-1], _plain_extensions)
    return sequence_of([sequence_of(values), *signed])


def plain_list(der: bytes) -> tuple[bytes, bytes]:
    """The copy of a revocation list, and its TBSCertList with its issuer.

    MalformedError as plain_certificate.
    """
    tbs, *signed = elements(der, None, "revocation list")
    values = elements(tbs, None, "revocation list")
    if len(values) < _LEAST_OF_LIST or sequence_of([sequence_of(values), *signed]) != der:
        return der, tbs
    issuer = 2 if values[0][0] == _SERIAL[0] else 1  # after the version, if there is one
    for at, each in enumerate(values[issuer + 1 :], issuer + 1):
        if each[0] == _LISTED:
            values[at] = _mapped(each, _plain_extensions)
        elif each[0] == _SEQUENCE and _FALSE in each:  # some lists have 100,000 entries
            values[at] = _mapped(each, _plain_entry)
    named = sequence_of(values)
    values[issuer] = _NO_NAME
    return sequence_of([sequence_of(values), *signed]), named


def _mapped(der: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """`der` with each value in it changed; `der` itself if it is not DER."""
    values = elements(bytes((_SEQUENCE,)) + der[1:], None, "value")
    if sequence_of(values, der[0]) != der:
        return der
    return sequence_of(map(change, values), der[0])


def _plain_entry(der: bytes) -> bytes:
    return _mapped(der, lambda each: _plain_extensions(each) if each[0] == _SEQUENCE else each)


def _plain_extensions(der: bytes) -> bytes:
    return _mapped(der, _plain_extension)


def _plain_extension(der: bytes) -> bytes:
    values = elements(der, None, "extension")
    if len(values) < _LEAST_OF_EXTENSION or sequence_of(values) != der:
        return der
    oid, *critical, octets = values
    if critical == [_FALSE]:
        critical = []
    level, defaults = _PLACES_BY_DER.get(oid, (0, set()))
    if level and any(each in octets for each in (bytes((_DIRECTORY_NAME,)), *defaults)):
        octets = sequence_of([_plain_value(content(octets), defaults, level)], octets[0])
    return sequence_of([oid, *critical, octets])


def _plain_value(der: bytes, defaults: set[bytes], level: int) -> bytes:
    """A value in an extension: without `defaults`, which are at level 0, and with plain names."""
    if level == 0 and der in defaults:
        return b""
    if der[0] == _DIRECTORY_NAME:
        return _mapped(der, plain_name)
    is_other = der[0] == _OTHER_NAME and begins(der, bytes((_OID,)))
    if der[0] not in _CONTAINERS or is_other or level < _DEEPEST:
        return der
    return _mapped(der, lambda each: _plain_value(each, defaults, level - 1))
