"""Encodes and decodes the octets between shim and agent. `shim/wire.c` is the other side.

Little-endian; strings and lists have a 32-bit count in front. A letter names each kind:

    h handle   n int32   s string   o octets   g GUID, 16 octets   c challenge, 32 octets
    t token, a DataHolder   p strings   d, q pairs of strings   b octet   m uint32   x int64

Octets that are not UTF-8 become surrogates: signed documents are sent as strings.
"""

import struct
from collections.abc import Callable, Collection
from typing import Any, TypeVar

from pqsec_pki.errors import MalformedError
from pqsec_pki.handshake import MAX_TOKEN, DataHolder

MAX_FRAME = 1 << 20
"""Octets. No token is larger than MAX_TOKEN, and few are in one frame."""
MAX_ITEMS = 1024
"""In one list."""
_TEXT = ("utf-8", "surrogateescape")
_FORMS = {"h": "Q", "n": "i", "b": "B", "m": "I", "x": "q"}
"""Letter -> format of struct, of numbers."""

Item = TypeVar("Item")
Pairs = tuple[tuple[str, str], ...]


class MessageReader:
    """Reads the values of a frame. MalformedError if the octets are not the expected value."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def left(self) -> int:
        """The number of octets that are not read yet."""
        return len(self._data) - self._at

    def one(self, kind: str) -> Any:
        """The next value, of the kind with that letter."""
        return _READERS[kind](self)

    def raw(self, size: int) -> bytes:
        """The next `size` octets."""
        end = self._at + size
        if end > len(self._data):
            raise MalformedError("a frame ends early")
        found = self._data[self._at : end]
        self._at = end
        return found

    def number(self, form: str) -> int:
        """The next number, in that format of struct."""
        found: int
        (found,) = struct.unpack(f"<{form}", self.raw(struct.calcsize(form)))
        return found

    def octets(self) -> bytes:
        return self.raw(self.number("I"))

    def text(self) -> str:
        return self.octets().decode(*_TEXT)

    def items(self, item: "Callable[[MessageReader], Item]") -> tuple[Item, ...]:
        count = self.number("I")
        if count > MAX_ITEMS:
            raise MalformedError(f"a list of more than {MAX_ITEMS}")
        return tuple(item(self) for _ in range(count))

    def finish(self) -> None:
        """MalformedError if octets are left."""
        if self._at != len(self._data):
            raise MalformedError("a frame is too long")


def _pair(reader: MessageReader) -> tuple[str, str]:
    return reader.text(), reader.text()


def _binary_pair(reader: MessageReader) -> tuple[str, bytes]:
    return reader.text(), reader.octets()


def _token(reader: MessageReader) -> DataHolder:
    """A token, no larger than on the network: Cyclone DDS passes tokens of any size from peers."""
    before = reader.left
    found = DataHolder(reader.text(), reader.items(_pair), reader.items(_binary_pair))
    if before - reader.left > MAX_TOKEN:
        raise MalformedError(f"a token larger than {MAX_TOKEN} bytes")
    return found


def _pairs(reader: MessageReader) -> Pairs:
    return reader.items(_pair)


def _number(form: str) -> Callable[[MessageReader], int]:
    return lambda reader: reader.number(form)


_READERS: dict[str, Callable[[MessageReader], Any]] = {
    **{kind: _number(form) for kind, form in _FORMS.items()},
    "s": MessageReader.text,
    "o": MessageReader.octets,
    "g": lambda reader: reader.raw(16),
    "c": lambda reader: reader.raw(32),
    "t": _token,
    "p": lambda reader: reader.items(MessageReader.text),
    "d": _pairs,
    "q": _pairs,
}


class MessageWriter:
    """Writes values into a frame. MalformedError if the frame would be too long."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    @property
    def octets(self) -> bytes:
        whole = b"".join(self._parts)
        if len(whole) > MAX_FRAME:
            raise MalformedError(f"an answer of more than {MAX_FRAME} octets")
        return whole

    def one(self, kind: str, value: Any) -> None:
        """Add a value of the kind with that letter."""
        _WRITERS[kind](self, value)

    def raw(self, value: bytes) -> None:
        """Add octets without their number, which the other side knows."""
        self._parts.append(value)

    def number(self, form: str, value: int) -> None:
        """Add a number in that format of struct."""
        self._parts.append(struct.pack(f"<{form}", value))

    def block(self, value: bytes) -> None:
        """Add octets."""
        self.number("I", len(value))
        self._parts.append(value)

    def text(self, value: str) -> None:
        self.block(value.encode(*_TEXT))

    def items(
        self, values: Collection[Item], item: "Callable[[MessageWriter, Item], None]"
    ) -> None:
        """Add a list."""
        self.number("I", len(values))
        for each in values:
            item(self, each)


def _put_pair(writer: MessageWriter, pair: tuple[str, str]) -> None:
    for each in pair:
        writer.text(each)


def _put_binary_pair(writer: MessageWriter, pair: tuple[str, bytes]) -> None:
    writer.text(pair[0])
    writer.block(pair[1])


def _put_token(writer: MessageWriter, token: DataHolder) -> None:
    writer.text(token.class_id)
    writer.items(token.properties, _put_pair)
    writer.items(token.binary_properties, _put_binary_pair)


def _put_pairs(writer: MessageWriter, pairs: Pairs) -> None:
    writer.items(pairs, _put_pair)


def _put_number(form: str) -> "Callable[[MessageWriter, int], None]":
    return lambda writer, value: writer.number(form, value)


_WRITERS: dict[str, Callable[[MessageWriter, Any], None]] = {
    **{kind: _put_number(form) for kind, form in _FORMS.items()},
    "s": MessageWriter.text,
    "o": MessageWriter.block,
    "g": MessageWriter.raw,
    "c": MessageWriter.raw,
    "t": _put_token,
    "p": lambda writer, names: writer.items(names, MessageWriter.text),
    "d": _put_pairs,
    "q": _put_pairs,
}
