"""BER to DER for CMS wrappers: indefinite lengths and constructed strings, bounded.

OpenSSL in streaming mode and BouncyCastle write CMS in that form; hazmat.asn1 reads DER
only. Signed attributes are re-encoded by the verifier, so nothing signed is lost.
"""

import re
from functools import lru_cache

from pqsec_pki.errors import MalformedError

MAX_DEPTH = 24
"""CMS with certificates nests about 12 deep."""
MAX_CHILDREN = 4096
MAX_SIZE = 1 << 20
"""Bytes. A signature without the document is a few kB; with certificates, tens of kB."""
_SHARED_DEPTH = 3
"""ContentInfo, [0], SignedData, and what is in it (RFC 5652 3, 5.1)."""
_MAX_SHARED = 64 << 10
"""Bytes; larger values are not remembered."""
_CONSTRUCTED, _LONG_TAG, _CLASS = 0x20, 0x1F, 0xC0
_SEQUENCE, _SET, _OCTET_STRING = 0x30, 0x31, 0x04
_NOT_CONSTRUCTED = {_SEQUENCE & ~_CONSTRUCTED, _SET & ~_CONSTRUCTED}
_CONTENT = {
    0x01: ("boolean", re.compile(rb".", re.DOTALL)),
    0x02: ("integer", re.compile(rb".|(?!\x00[\x00-\x7f]|\xff[\x80-\xff])..+", re.DOTALL)),
    0x03: ("bit string", re.compile(rb"\x00|[\x00-\x07].+", re.DOTALL)),
    0x05: ("null", re.compile(rb"")),
    0x06: ("object identifier", re.compile(rb"(?:(?!\x80)[\x80-\xff]*[\x00-\x7f])+", re.DOTALL)),
}
"""Universal tag -> its name, and what its content must be (X.690 8.2, 8.3, 8.6, 8.8, 8.19).
OpenSSL refuses anything else wherever it stands, also where no type is expected."""


def to_der(data: bytes) -> bytes:
    """`data` with definite, shortest lengths; MalformedError if it is not one BER value."""
    if len(data) > MAX_SIZE:
        raise MalformedError(f"a signature larger than {MAX_SIZE} bytes")
    der, end = _convert(data, 0, len(data), 0)
    if end != len(data):
        raise MalformedError("bytes after the end of the CMS structure")
    return der


def limit_values(data: bytes, most: int) -> None:
    """MalformedError if `data` has more than `most` values; no more headers than that are read.

    Conversion costs a Python call for each value, and a value can have two octets.
    """
    at = 0
    for _ in range(most):
        if at >= len(data):
            return
        tag, length, at = _header(data, at, len(data))
        at += 0 if tag & _CONSTRUCTED else length or 0
    if at < len(data):
        raise MalformedError(f"the CMS structure has more than {most} values")


def _convert(data: bytes, start: int, end: int, depth: int) -> tuple[bytes, int]:
    """(DER of the value at `start`, offset of its end)."""
    if depth > MAX_DEPTH:
        raise MalformedError("the CMS structure nests too deeply")
    tag, length, start = _header(data, start, end)
    if length is not None and start + length > end:
        raise MalformedError("a length in the CMS structure runs past its end")
    if not tag & _CONSTRUCTED:
        stop = start + (length or 0)
        if tag in _NOT_CONSTRUCTED:  # X.690 8.9.1, 8.11.1
            raise MalformedError("a sequence or set that is not constructed")
        if tag in _CONTENT and not _CONTENT[tag][1].fullmatch(data, start, stop):
            raise MalformedError(f"a broken {_CONTENT[tag][0]}")
        return _value(tag, data[start:stop]), stop
    if depth >= _SHARED_DEPTH and length and length < _MAX_SHARED:
        return _shared(tag, data[start : start + length], depth), start + length
    children, stop = _children(
        data, start, end if length is None else start + length, depth, length
    )
    return _joined(tag, children), stop


@lru_cache(maxsize=32)
def _shared(tag: int, content: bytes, depth: int) -> bytes:
    """DER of a constructed value: all signatures by a CA have its name, certificate, algorithms."""
    children, _ = _children(content, 0, len(content), depth, len(content))
    return _joined(tag, children)


def _joined(tag: int, children: list[bytes]) -> bytes:
    """DER of the constructed value with these parts, in DER."""
    if tag == _OCTET_STRING | _CONSTRUCTED:
        return _value(_OCTET_STRING, b"".join(map(_octets, children)))
    if tag & _CLASS == 0 and tag not in {_SEQUENCE, _SET}:
        raise MalformedError("a value in pieces, which DER does not have")
    if tag == _SET:
        children.sort()
    return _value(tag, b"".join(children))


def _children(
    data: bytes, start: int, end: int, depth: int, length: int | None
) -> tuple[list[bytes], int]:
    children: list[bytes] = []
    while start < end:
        if length is None and data[start : start + 2] == b"\0\0":
            return children, start + 2
        child, start = _convert(data, start, end, depth + 1)
        children.append(child)
        if len(children) > MAX_CHILDREN:
            raise MalformedError("the CMS structure has too many parts")
    if length is None:
        raise MalformedError("the CMS structure does not end")
    return children, start


def _header(data: bytes, start: int, end: int) -> tuple[int, int | None, int]:
    """(tag, length or None for indefinite, offset of the content)."""
    if start + 2 > end:
        raise MalformedError("the CMS structure is cut short")
    tag, first = data[start], data[start + 1]
    if tag & _LONG_TAG == _LONG_TAG:
        raise MalformedError("a tag that CMS does not have")
    start += 2
    if first < 0x80:  # noqa: PLR2004 -- X.690 8.1.3.4: short form
        return tag, first, start
    if first == 0x80:  # noqa: PLR2004 -- X.690 8.1.3.6: indefinite form
        if not tag & _CONSTRUCTED:
            raise MalformedError("an indefinite length where none can be")
        return tag, None, start
    size = first & 0x7F
    if size > 4 or start + size > end:  # noqa: PLR2004 -- 4 GiB is over every limit here
        raise MalformedError("a length in the CMS structure is invalid")
    return tag, int.from_bytes(data[start : start + size], "big"), start + size


def _value(tag: int, content: bytes) -> bytes:
    size = len(content)
    if size < 0x80:  # noqa: PLR2004 -- short form
        return bytes([tag, size]) + content
    octets = size.to_bytes((size.bit_length() + 7) // 8, "big")
    return bytes([tag, 0x80 | len(octets)]) + octets + content


def _octets(der: bytes) -> bytes:
    tag, length, start = _header(der, 0, len(der))
    if tag != _OCTET_STRING or length is None:
        raise MalformedError("a broken octet string in the CMS structure")
    return der[start : start + length]
