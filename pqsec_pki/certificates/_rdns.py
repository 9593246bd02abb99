"""Reads a DER Name (RFC 5280 4.1.2.4) as OpenSSL reads it, and compares two (7.1).

cryptography refuses a PrintableString with `_`, `*` or `@`, which certificates of real CAs have,
decodes a T61String as UTF-8, and accepts strings that no stack can read.
"""

import re
from collections.abc import Iterator
from typing import TypeAlias

from cryptography import x509
from cryptography.x509.name import _ASN1Type

from pqsec_pki._asn1 import NameHolder, Oid, decode, encode, plain_words
from pqsec_pki._der import content, sequence_of
from pqsec_pki.errors import MalformedError, library_call

_NUMERIC, _UTF8, _BMP, _BITS, _SET = 0x12, 0x0C, 0x1E, 0x03, 0x31
_CODECS = {
    _UTF8: "utf-8",
    _NUMERIC: "latin-1",
    0x13: "latin-1",  # PrintableString
    0x14: "latin-1",  # T61String
    0x16: "latin-1",  # IA5String
    0x1C: "utf-32-be",  # UniversalString
    _BMP: "utf-16-be",
}
"""Tag -> how OpenSSL decodes it. Of other strings (VisibleString), it cannot read the name."""
_SPACES = re.compile("[ \t\n\v\f\r]+")
_CAPITALS = {capital: capital + 32 for capital in range(ord("A"), ord("Z") + 1)}

Canonical: TypeAlias = tuple[frozenset[tuple[Oid, int, str | bytes]], ...]


class ReadAttribute(x509.NameAttribute[str | bytes]):
    """An attribute that was read from a certificate, with the DER of its value."""

    def __init__(self, oid: Oid, value: str | bytes, der: bytes) -> None:
        # Not by its own __init__, which warns about lengths, and refuses some BIT STRINGs.
        self._oid, self._value, self._type = oid, value, _ASN1Type(der[0])
        self.der = der


def read_name(der: bytes) -> x509.Name:
    """The name; MalformedError if OpenSSL cannot read it, or it is not DER."""
    with library_call(lambda error: MalformedError(f"not a name: {plain_words(error)}")):
        return x509.Name(
            [
                x509.RelativeDistinguishedName(
                    [ReadAttribute(oid, _value(each), each) for oid, each in rdn]
                )
                for rdn in _rdns(der)
            ]
        )


def plain_name(der: bytes) -> bytes:
    """The same name in DER, with UTF8Strings, for cryptography; MalformedError as read_name."""
    return sequence_of(
        sequence_of(sorted(_plain_attribute(oid, value) for oid, value in rdn), _SET)
        for rdn in _rdns(der)
    )


def _plain_attribute(oid: Oid, der: bytes) -> bytes:
    value = _value(der)
    if isinstance(value, str) and der[0] != _NUMERIC:  # which no other string is equal to
        der = sequence_of([value.encode()], _UTF8)
    return sequence_of([encode(oid), der])


def same_name(one: bytes, other: bytes) -> bool:
    """Whether two DER Names are the same name (RFC 5280 7.1), as OpenSSL compares them.

    Case of ASCII letters, the type of a string and the number of spaces do not matter.
    """
    return one == other or canonical_name(one) == canonical_name(other)


def canonical_name(der: bytes) -> Canonical:
    """The DER Name in a form that is equal for the same names; MalformedError as read_name."""
    return tuple(frozenset(_canonical(oid, value) for oid, value in rdn) for rdn in _rdns(der))


def _canonical(oid: Oid, der: bytes) -> tuple[Oid, int, str | bytes]:
    value = _value(der)
    if isinstance(value, bytes) or der[0] == _NUMERIC:
        return oid, der[0], value
    return oid, _UTF8, _SPACES.sub(" ", value).strip(" ").translate(_CAPITALS)


def _rdns(der: bytes) -> Iterator[list[tuple[Oid, bytes]]]:
    for rdn in decode(NameHolder, sequence_of([der]), "name").name:
        yield [(each.type, encode(each.value)) for each in rdn.as_list()]


def _value(der: bytes) -> str | bytes:
    tag, octets = der[0], content(der)
    if tag == _BITS:
        return octets
    codec = _CODECS.get(tag)
    if codec is None:
        raise MalformedError(f"a name has a value of type {tag}, which OpenSSL cannot read")
    try:
        text = octets.decode(codec)
    except UnicodeError:
        raise MalformedError("a string in a name is not encoded as its type says") from None
    if tag == _BMP and len(text) * 2 != len(octets):
        raise MalformedError("a BMPString in a name has characters above U+FFFF")
    return text
