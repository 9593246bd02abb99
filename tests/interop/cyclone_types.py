"""The structures that Cyclone DDS's security plugins take and give, through ctypes.

They are those of dds_security_api_types.h.
"""

import ctypes
from collections.abc import Iterable
from ctypes import POINTER, Structure
from typing import NamedTuple

Byte, Count, Number, Text = ctypes.c_ubyte, ctypes.c_uint32, ctypes.c_int32, ctypes.c_char_p
Handle = ctypes.c_int64


class Octets(Structure):
    _fields_ = (("maximum", Count), ("length", Count), ("buffer", POINTER(Byte)))

    @classmethod
    def of(cls, data: bytes) -> "Octets":
        # Aligned to 4 bytes, because Cyclone's reader aligns addresses, not offsets.
        block = (Count * (len(data) // 4 + 1))()
        ctypes.memmove(block, data, len(data))
        return cls(len(data), len(data), ctypes.cast(block, POINTER(Byte)))

    @property
    def data(self) -> bytes:
        return ctypes.string_at(self.buffer, self.length)


class _Property(Structure):
    _fields_ = (("name", Text), ("value", Text), ("propagate", Byte))


class Properties(Structure):
    _fields_ = (("maximum", Count), ("length", Count), ("buffer", POINTER(_Property)))

    @classmethod
    def of(cls, pairs: Iterable[tuple[str, str | bytes]]) -> "Properties":
        octets = (
            (name, each if isinstance(each, bytes) else each.encode()) for name, each in pairs
        )
        items = [_Property(name.encode(), value, 1) for name, value in octets]
        array = (_Property * len(items))(*items)
        return cls(len(items), len(items), ctypes.cast(array, POINTER(_Property)))


class _BinaryProperty(Structure):
    _fields_ = (("name", Text), ("value", Octets), ("propagate", Byte))


class BinaryProperties(Structure):
    _fields_ = (("maximum", Count), ("length", Count), ("buffer", POINTER(_BinaryProperty)))

    @classmethod
    def of(cls, pairs: Iterable[tuple[str, bytes]]) -> "BinaryProperties":
        items = [_BinaryProperty(name.encode(), Octets.of(value), 1) for name, value in pairs]
        array = (_BinaryProperty * len(items))(*items)
        return cls(len(items), len(items), ctypes.cast(array, POINTER(_BinaryProperty)))


class Token(NamedTuple):
    """A DataHolder as a value: identity, permissions and handshake messages."""

    class_id: str
    properties: tuple[tuple[str, str | bytes], ...] = ()
    binary: tuple[tuple[str, bytes], ...] = ()


class DataHolder(Structure):
    _fields_ = (("class_id", Text), ("properties", Properties), ("binary", BinaryProperties))

    @classmethod
    def of(cls, token: Token) -> "DataHolder":
        plain, binary = Properties.of(token.properties), BinaryProperties.of(token.binary)
        return cls(token.class_id.encode(), plain, binary)

    @property
    def token(self) -> Token:
        plain = self.properties.buffer[: self.properties.length]
        binary = self.binary.buffer[: self.binary.length]
        return Token(
            (self.class_id or b"").decode(),
            tuple((each.name.decode(), each.value.decode(errors="replace")) for each in plain),
            tuple((each.name.decode(), each.value.data) for each in binary),
        )


class DataHolders(Structure):
    _fields_ = (("maximum", Count), ("length", Count), ("buffer", POINTER(DataHolder)))

    @classmethod
    def of(cls, tokens: Iterable[Token]) -> "DataHolders":
        items = [DataHolder.of(each) for each in tokens]
        array = (DataHolder * len(items))(*items)
        return cls(len(items), len(items), ctypes.cast(array, POINTER(DataHolder)))

    @property
    def tokens(self) -> tuple[Token, ...]:
        return tuple(each.token for each in self.buffer[: self.length])


class Handles(Structure):
    _fields_ = (("maximum", Count), ("length", Count), ("buffer", POINTER(Handle)))

    @classmethod
    def of(cls, handles: Iterable[int]) -> "Handles":
        items = tuple(handles)
        array = (Handle * len(items))(*items)
        return cls(len(items), len(items), ctypes.cast(array, POINTER(Handle)))


class Qos(Structure):
    _fields_ = (("properties", Properties), ("binary", BinaryProperties), ("tags", Properties))


class ParticipantAttributes(Structure):
    _fields_ = (
        ("unauthenticated", Byte),
        ("access", Byte),
        ("rtps", Byte),
        ("discovery", Byte),
        ("liveliness", Byte),
        ("plugin", Count),
        ("properties", Properties),
    )


class EndpointAttributes(Structure):
    _fields_ = (
        ("read", Byte),
        ("write", Byte),
        ("discovery", Byte),
        ("liveliness", Byte),
        ("submessage", Byte),
        ("payload", Byte),
        ("key", Byte),
        ("plugin", Count),
        ("properties", Properties),
    )


class Guid(Structure):
    _fields_ = (("octets", Byte * 16),)

    @classmethod
    def of(cls, octets: bytes) -> "Guid":
        return cls((Byte * 16)(*octets))


class SharedSecret(Structure):
    _fields_ = (
        ("secret", POINTER(Byte)),
        ("size", Number),
        ("challenge1", Byte * 32),
        ("challenge2", Byte * 32),
    )

    @classmethod
    def of(cls, secret: bytes, challenge1: bytes, challenge2: bytes) -> "SharedSecret":
        array = (Byte * len(secret))(*secret)
        challenges = (Byte * 32)(*challenge1), (Byte * 32)(*challenge2)
        return cls(ctypes.cast(array, POINTER(Byte)), len(secret), *challenges)


class Failure(Structure):
    _fields_ = (("message", Text), ("code", Number), ("minor_code", Number))
