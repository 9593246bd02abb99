"""Cuts DER values by their lengths, and joins them.

Only the lengths are used and nothing else is checked: for octets that a strict reader has to accept
as well.
"""

from collections.abc import Iterable

from pqsec_pki.errors import MalformedError

_SEQUENCE = 0x30
_SHORT = 0x7F
"""The largest length that is written in one byte."""


def elements(der: bytes, count: int | None, what: str) -> list[bytes]:
    """The first `count` values inside the SEQUENCE `der`, or all, each with its header.

    MalformedError, naming `what`, if there are fewer.
    """
    found: list[bytes] = []
    try:
        if der[0] != _SEQUENCE:
            raise MalformedError(f"not a DER {what}: no SEQUENCE")
        at, last = _extent(der, 0)
        # As _extent, without a call for each: a peer's certificate has many.
        while at < last if count is None else len(found) < count:
            size, end = der[at + 1], at + 2
            if size > _SHORT:
                first, end = end, end + (size & _SHORT)
                size = int.from_bytes(der[first:end])
            end += size
            found.append(der[at:end])
            at = end
    except IndexError:
        raise MalformedError(f"not a DER {what}: it ends too soon") from None
    return found


def leading(data: bytes, count: int, what: str) -> list[bytes]:
    """The first `count` values of `data`, each with its header, and the octets after them.

    MalformedError, naming `what`, if there are fewer.
    """
    found, at = [], 0
    try:
        for _ in range(count):
            _, end = _extent(data, at)
            found.append(data[at:end])
            at = end
    except IndexError:
        at = len(data) + 1
    if at > len(data):
        raise MalformedError(f"not a DER {what}: it ends too soon")
    return [*found, data[at:]]


def content(der: bytes) -> bytes:
    """The content of the value `der`, without its header."""
    start, end = _extent(der, 0)
    return der[start:end]


def begins(der: bytes, octets: bytes) -> bool:
    """Whether the content of the value `der` begins with `octets`."""
    size = der[1]
    return der.startswith(octets, 2 if size <= _SHORT else 2 + (size & _SHORT))


def _extent(der: bytes, at: int) -> tuple[int, int]:
    """Offsets of the start and end of the content of the value at `at` (X.690 8.1.3)."""
    size, start = der[at + 1], at + 2
    if size > _SHORT:
        first, start = start, start + (size & _SHORT)
        size = int.from_bytes(der[first:start])
    return start, start + size


def sequence_of(parts: Iterable[bytes], tag: int = _SEQUENCE) -> bytes:
    """The DER SEQUENCE of these complete DER values, or another constructed value with `tag`."""
    inside = b"".join(parts)
    size = len(inside)
    if size <= _SHORT:
        return bytes((tag, size)) + inside
    length = size.to_bytes((size.bit_length() + 7) // 8)
    return bytes((tag, _SHORT + 1 + len(length))) + length + inside
