"""CDR: numbers, strings and sequences to bytes and back, in both byte orders."""

import struct
from collections.abc import Callable, Sequence
from enum import Enum
from functools import lru_cache
from typing import TypeVar

from pqsec_pki.errors import MalformedError

T = TypeVar("T")
_LEAST_ELEMENT = 8
"""Minimum size of an element in bytes: each begins with two lengths or more."""
_SHORT = 64
"""Bytes of a name, at most, that is kept in the cache: a peer chooses them."""
_FILL = (b"", b"\0\0\0", b"\0\0", b"\0")
"""Padding from an offset, modulo 4, to the next aligned number."""


class ByteOrder(Enum):
    """The byte order of a token; the value is its character in struct formats."""

    BIG = ">"
    LITTLE = "<"

    def __init__(self, sign: str) -> None:
        self.u32 = struct.Struct(sign + "I")
        self.i64 = struct.Struct(sign + "q")
        # A cache for names of properties: every message has the same few.
        self.label = lru_cache(maxsize=64)(self._label)

    def _label(self, text: str) -> bytes:
        """`text` as a string, padded to the alignment of a number."""
        data = text.encode() + b"\0"
        return self.u32.pack(len(data)) + data + _FILL[len(data) & 3]


class CdrWriter:
    """Appends CDR values, each aligned to its own size from where the writer began."""

    __slots__ = ("_order", "_parts")

    def __init__(self, order: ByteOrder = ByteOrder.BIG) -> None:
        self._order = order
        self._parts: list[bytes] = []

    def raw(self, data: bytes) -> None:
        self._parts.append(data)

    def u32(self, value: int) -> None:
        parts = self._parts
        parts += (_FILL[sum(map(len, parts)) & 3], self._order.u32.pack(value))

    def i64(self, value: int) -> None:
        parts = self._parts
        parts += (bytes(-sum(map(len, parts)) & 7), self._order.i64.pack(value))

    def octets(self, data: bytes) -> None:
        self.u32(len(data))
        self._parts.append(data)

    def string(self, text: str) -> None:
        self.octets(text.encode() + b"\0")

    def pairs(self, items: Sequence[tuple[str, bytes]]) -> None:
        """A sequence of strings, each with octets: most of a message, so this is optimized."""
        self.u32(len(items))
        parts, label, length = self._parts, self._order.label, self._order.u32.pack
        for name, value in items:
            size = len(value)
            parts += (label(name), length(size), value, _FILL[size & 3])
        if items:
            parts.pop()  # no padding after the last

    def done(self) -> bytes:
        return b"".join(self._parts)


class CdrReader:
    """Reads CDR values one after another; MalformedError if a value is missing or invalid."""

    __slots__ = ("_at", "_data", "_length", "_order")

    def __init__(self, data: bytes, order: ByteOrder) -> None:
        self._data = data
        self._at = 0
        self._order = order
        self._length = order.u32.unpack_from

    @property
    def left(self) -> int:
        return len(self._data) - self._at

    def raw(self, size: int) -> bytes:
        start = self._at
        self._at = start + size
        if self._at > len(self._data):
            raise MalformedError(f"a length of {size} runs past the end")
        return self._data[start : self._at]

    def u32(self) -> int:
        return self._number(self._order.u32)

    def i64(self) -> int:
        return self._number(self._order.i64)

    def octets(self) -> bytes:
        data, start = self._data, (self._at + 7) & -4  # after an aligned length
        if start > len(data):
            raise MalformedError("a number runs past the end")
        (size,) = self._length(data, start - 4)
        self._at = end = start + size
        if end > len(data):
            raise MalformedError(f"a length of {size} runs past the end")
        return data[start:end]

    def string(self) -> str:
        return _text(self.octets())

    def sequence(self, item: Callable[[], T], limit: int) -> tuple[T, ...]:
        return tuple([item() for _ in range(self._count(limit))])

    def pairs(self, limit: int) -> tuple[tuple[str, bytes], ...]:
        """A sequence of strings, each with octets: most of a message, so this is optimized."""
        count, data, length = self._count(limit), self._data, self._length
        end, found = self._at, []
        try:
            for _ in range(count):
                name = (end + 7) & -4  # after an aligned length
                stop = name + length(data, name - 4)[0]
                value = (stop + 7) & -4
                end = value + length(data, value - 4)[0]
                text = (_known if stop - name <= _SHORT else _text)(data[name:stop])
                found.append((text, data[value:end]))
        except struct.error:
            raise MalformedError("a number runs past the end") from None
        if end > len(data):  # an earlier length past the end would have left no next number
            raise MalformedError("a length runs past the end")
        self._at = end
        return tuple(found)

    def _count(self, limit: int) -> int:
        count = self.u32()
        if count > limit or count * _LEAST_ELEMENT > len(self._data) - self._at:
            raise MalformedError(f"{count} elements, more than allowed or than there is room for")
        return count

    def _number(self, kind: struct.Struct) -> int:
        start = self._at + -self._at % kind.size
        self._at = start + kind.size
        if self._at > len(self._data):
            raise MalformedError("a number runs past the end")
        value: int = kind.unpack_from(self._data, start)[0]
        return value


def _text(octets: bytes) -> str:
    text, end, rest = octets.partition(b"\0")
    if not end or rest:
        raise MalformedError("a string that does not end in its only NUL")
    try:
        return text.decode()
    except UnicodeDecodeError:
        raise MalformedError("a string that is not UTF-8") from None


_known = lru_cache(maxsize=64)(_text)
"""A cache for names of properties, as `ByteOrder.label`."""
