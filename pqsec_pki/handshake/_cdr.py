"""CDR: numbers, strings and sequences to bytes and back, in both byte orders."""

import struct
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple, TypeVar

from pqsec_pki.errors import MalformedError

T = TypeVar("T")
_LEAST_ELEMENT = 8
"""Bytes: every element of every sequence here begins with two lengths or more."""


class ByteOrder(Enum):
    """The byte order of a token; the value is struct's sign for it."""

    BIG = ">"
    LITTLE = "<"


class _Numbers(NamedTuple):
    u32: struct.Struct
    i64: struct.Struct


_NUMBERS = {
    order: _Numbers(struct.Struct(order.value + "I"), struct.Struct(order.value + "q"))
    for order in ByteOrder
}


class Writer:
    """Appends CDR values, each aligned to its own size from where the writer began."""

    __slots__ = ("_data", "_numbers")

    def __init__(self, order: ByteOrder = ByteOrder.BIG) -> None:
        self._data = bytearray()
        self._numbers = _NUMBERS[order]

    def raw(self, data: bytes) -> None:
        self._data += data

    def u32(self, value: int) -> None:
        self._number(self._numbers.u32, value)

    def i64(self, value: int) -> None:
        self._number(self._numbers.i64, value)

    def octets(self, data: bytes) -> None:
        self.u32(len(data))
        self._data += data

    def string(self, text: str) -> None:
        self.octets(text.encode() + b"\0")

    def done(self) -> bytes:
        return bytes(self._data)

    def _number(self, kind: struct.Struct, value: int) -> None:
        self._data += bytes(-len(self._data) % kind.size) + kind.pack(value)


class Reader:
    """Takes CDR values one after another; MalformedError where there is none."""

    __slots__ = ("_at", "_data", "_numbers")

    def __init__(self, data: bytes, order: ByteOrder) -> None:
        self._data = data
        self._at = 0
        self._numbers = _NUMBERS[order]

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
        return self._number(self._numbers.u32)

    def i64(self) -> int:
        return self._number(self._numbers.i64)

    def octets(self) -> bytes:
        return self.raw(self.u32())

    def string(self) -> str:
        data = self.octets()
        if not data or data.find(b"\0") != len(data) - 1:
            raise MalformedError("a string that does not end in its only NUL")
        try:
            return data[:-1].decode()
        except UnicodeDecodeError:
            raise MalformedError("a string that is not UTF-8") from None

    def sequence(self, item: Callable[[], T], limit: int) -> tuple[T, ...]:
        count = self.u32()
        if count > limit or count * _LEAST_ELEMENT > self.left:
            raise MalformedError(f"{count} elements, more than allowed or than there is room for")
        return tuple(item() for _ in range(count))

    def _number(self, kind: struct.Struct) -> int:
        start = self._at + -self._at % kind.size
        self._at = start + kind.size
        if self._at > len(self._data):
            raise MalformedError("a number runs past the end")
        value: int = kind.unpack_from(self._data, start)[0]
        return value
