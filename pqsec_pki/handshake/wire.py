"""Data holders as bytes: CDR as in DDS-Security messages.

This module knows only names and values, no keys or states. Tokens are in the sender's byte
order; hashes and signatures always cover the big-endian form (DDS-Security 1.1, 9.3.2.5).
"""

from collections.abc import Iterable
from enum import StrEnum
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError
from pqsec_pki.handshake._cdr import ByteOrder, CdrReader, CdrWriter

MAX_TOKEN = 256 << 10
"""Bytes. The largest measured (ML-DSA-87, signed permissions) is 38 kB."""
MAX_SAMPLE = MAX_TOKEN + (4 << 10)
"""Bytes: a token and the message around it."""
MAX_PROPERTIES = 64
"""Properties in one list. A Reply, the longest token, has twelve."""
MAX_TOKENS = 8
"""Tokens in one message. Handshakes have one, writers two."""
GUID_SIZE = 16
_ALIGNED = 4
_ENCAPSULATION_SIZE = 4

Property = tuple[str, str]
BinaryProperty = tuple[str, bytes]


class MessageClass(StrEnum):
    """message_class_id of a ParticipantGenericMessage (7.4.3.5, 7.4.4.5)."""

    AUTH_REQUEST = "dds.sec.auth_request"
    HANDSHAKE = "dds.sec.auth"
    PARTICIPANT_CRYPTO_TOKENS = "dds.sec.participant_crypto_tokens"
    WRITER_CRYPTO_TOKENS = "dds.sec.datawriter_crypto_tokens"
    READER_CRYPTO_TOKENS = "dds.sec.datareader_crypto_tokens"


@dataclass(frozen=True, slots=True)
class DataHolder:
    """A token: a class, and named values (DDS-Security 1.1, 7.2.3). Names may repeat."""

    class_id: str
    properties: tuple[Property, ...] = ()
    binary_properties: tuple[BinaryProperty, ...] = ()

    def encode(self, order: ByteOrder = ByteOrder.BIG) -> bytes:
        """CDR without encapsulation header."""
        writer = CdrWriter(order)
        _write_holder(writer, self)
        return writer.done()

    @classmethod
    def decode(cls, data: bytes, order: ByteOrder = ByteOrder.BIG) -> "DataHolder":
        """The inverse; MalformedError if `data` is not exactly one, or too large."""
        if len(data) > MAX_TOKEN:
            raise MalformedError(f"a token larger than {MAX_TOKEN} bytes")
        reader = CdrReader(data, order)
        holder = _read_holder(reader)
        if reader.left:
            raise MalformedError(f"{reader.left} bytes after the token")
        return holder


@dataclass(frozen=True, slots=True, kw_only=True)
class GenericMessage:
    """ParticipantGenericMessage (7.2.6): tokens from one participant to another.

    GUIDs have 16 bytes; all zero means none.
    """

    source: bytes
    sequence: int
    related_source: bytes = bytes(GUID_SIZE)
    related_sequence: int = 0
    destination_participant: bytes
    destination_endpoint: bytes = bytes(GUID_SIZE)
    source_endpoint: bytes = bytes(GUID_SIZE)
    class_id: str
    tokens: tuple[DataHolder, ...]

    def encode(self, order: ByteOrder = ByteOrder.LITTLE) -> bytes:
        """The sample: 4 bytes of encapsulation header, then CDR in that order."""
        writer = CdrWriter(order)
        for guid, sequence in (
            (self.source, self.sequence),
            (self.related_source, self.related_sequence),
        ):
            writer.raw(guid)
            writer.i64(sequence)
        writer.raw(self.destination_participant + self.destination_endpoint + self.source_endpoint)
        writer.string(self.class_id)
        writer.u32(len(self.tokens))
        for token in self.tokens:
            _write_holder(writer, token)
        return _HEADERS[order] + writer.done()

    @classmethod
    def decode(cls, sample: bytes) -> Self:
        """The inverse; MalformedError for anything else. Padding to 4 bytes may follow."""
        if len(sample) > MAX_SAMPLE:
            raise MalformedError(f"a sample larger than {MAX_SAMPLE} bytes")
        # RTPS 2.3, 10.2.1.2: the two last bytes of the header are options, which are ignored.
        order = _ORDERS.get(sample[:2])
        if order is None or len(sample) < _ENCAPSULATION_SIZE:
            raise MalformedError("not CDR: unknown encapsulation")
        reader = CdrReader(sample[_ENCAPSULATION_SIZE:], order)
        message = cls(
            source=reader.raw(GUID_SIZE),
            sequence=reader.i64(),
            related_source=reader.raw(GUID_SIZE),
            related_sequence=reader.i64(),
            destination_participant=reader.raw(GUID_SIZE),
            destination_endpoint=reader.raw(GUID_SIZE),
            source_endpoint=reader.raw(GUID_SIZE),
            class_id=reader.string(),
            tokens=reader.sequence(lambda: _read_holder(reader), MAX_TOKENS),
        )
        if reader.left >= _ALIGNED:
            raise MalformedError(f"{reader.left} bytes after the message")
        return message


_HEADERS = {ByteOrder.BIG: b"\0\0\0\0", ByteOrder.LITTLE: b"\0\1\0\0"}
_ORDERS = {header[:2]: order for order, header in _HEADERS.items()}


def encode_properties(items: Iterable[BinaryProperty]) -> bytes:
    """The octets that hashes and signatures cover: the list alone, big-endian, without header."""
    writer = CdrWriter()
    writer.pairs(tuple(items))
    return writer.done()


def _write_holder(writer: CdrWriter, holder: DataHolder) -> None:
    writer.string(holder.class_id)
    writer.u32(len(holder.properties))
    for name, value in holder.properties:
        writer.string(name)
        writer.string(value)
    writer.pairs(holder.binary_properties)


def _read_holder(reader: CdrReader) -> DataHolder:
    return DataHolder(
        reader.string(),
        reader.sequence(lambda: (reader.string(), reader.string()), MAX_PROPERTIES),
        reader.pairs(MAX_PROPERTIES),
    )
