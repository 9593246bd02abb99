"""Protected data as bytes: crypto header, crypto footer, and the submessages around them."""

import struct
from collections.abc import Iterator
from enum import IntEnum
from itertools import islice
from typing import NamedTuple, Self

from pqsec_pki.errors import MalformedError
from pqsec_pki.handshake._cdr import ByteOrder, CdrReader

ALIGNED = 4
KEY_ID_SIZE = 4
SESSION_ID_SIZE = 4
SUFFIX_SIZE = 8
IV_SIZE = SESSION_ID_SIZE + SUFFIX_SIZE
HEADER_SIZE = 4 + KEY_ID_SIZE + IV_SIZE
TAG_SIZE = 16
_RECEIVER_TAG_SIZE = KEY_ID_SIZE + TAG_SIZE
MAX_RECEIVERS = (0xFFFF - TAG_SIZE - 4) // _RECEIVER_TAG_SIZE
"""The limit for tags in one submessage, whose size field has 16 bits."""
_FRAME = struct.Struct(">BBH")
"""Kind, flags, size of what follows (RTPS 2.3, 9.4.5.1)."""
_LITTLE_ENDIAN = 0x01


class CryptoHeader(NamedTuple):
    """The kind, key and vector that protect the data (DDS-Security 1.1, 9.5.2.3)."""

    kind: int
    key_id: bytes
    iv: bytes
    """session_id (4 bytes) and initialization_vector_suffix (8)."""

    @property
    def session_id(self) -> bytes:
        return self.iv[:SESSION_ID_SIZE]

    def encode(self) -> bytes:
        return struct.pack(">I", self.kind) + self.key_id + self.iv

    @classmethod
    def decode(cls, data: bytes) -> Self:
        if len(data) != HEADER_SIZE:
            raise MalformedError(f"a crypto header of a wrong size: {len(data)} bytes")
        kind = int.from_bytes(data[:4])
        return cls(kind, data[4 : 4 + KEY_ID_SIZE], data[4 + KEY_ID_SIZE :])


class ReceiverTag(NamedTuple):
    """ReceiverSpecificMAC (9.5.2.5)."""

    key_id: bytes
    tag: bytes


class CryptoFooter(NamedTuple):
    """The common tag and those for single receivers (9.5.2.5)."""

    tag: bytes
    receiver_tags: tuple[ReceiverTag, ...] = ()

    def encode(self) -> bytes:
        count = struct.pack(">I", len(self.receiver_tags))
        return self.tag + count + b"".join(id_ + tag for id_, tag in self.receiver_tags)

    @classmethod
    def decode(cls, data: bytes) -> Self:
        reader = CdrReader(data, ByteOrder.BIG)
        tag, count = reader.raw(TAG_SIZE), reader.u32()
        if reader.left != count * _RECEIVER_TAG_SIZE:
            raise MalformedError(f"a crypto footer of {len(data)} bytes for {count} receivers")
        each = (ReceiverTag(reader.raw(KEY_ID_SIZE), reader.raw(TAG_SIZE)) for _ in range(count))
        return cls(tag, tuple(each))


class Secure(IntEnum):
    """Kinds of submessages that a protected submessage consists of (7.3.6)."""

    BODY = 0x30
    PREFIX = 0x31
    POSTFIX = 0x32


class Frame(NamedTuple):
    """One submessage."""

    kind: int
    content: bytes
    whole: bytes
    """The submessage with its header."""


def framed(kind: Secure, content: bytes) -> bytes:
    """A submessage, its size big-endian, padded to 4 bytes. `content` has at most 65532."""
    content += bytes(-len(content) % ALIGNED)
    return _FRAME.pack(kind, 0, len(content)) + content


def is_submessage(data: bytes) -> bool:
    """Whether `data` is one aligned submessage with its size, and not a protected one."""
    try:
        found = list(islice(_frames(data), 2))
    except MalformedError:
        return False
    return len(found) == 1 and len(data) % ALIGNED == 0 and found[0].kind not in tuple(Secure)


def parted(data: bytes) -> tuple[CryptoHeader, Frame, CryptoFooter]:
    """The header in SEC_PREFIX, the submessage after it, and the footer in SEC_POSTFIX.

    MalformedError for anything else.
    """
    found = list(islice(_frames(data), 4))
    around = [each.kind for each in found[:1] + found[2:]]
    if around != [Secure.PREFIX, Secure.POSTFIX]:
        raise MalformedError(f"not one protected submessage but {len(found)} parts")
    prefix, body, postfix = found
    return CryptoHeader.decode(prefix.content), body, CryptoFooter.decode(postfix.content)


def _frames(data: bytes) -> Iterator[Frame]:
    """The submessages in `data`, in either byte order; MalformedError for anything else."""
    at = 0
    while at < len(data):
        start = at + _FRAME.size
        if start > len(data):
            raise MalformedError("half a submessage header")
        kind, flags, size = _FRAME.unpack_from(data, at)
        # The flag applies only to the size: Cyclone DDS sets it, and the content is still
        # big-endian.
        if flags & _LITTLE_ENDIAN:
            size = (size & 0xFF) << 8 | size >> 8
        end = start + size
        if end > len(data):
            raise MalformedError("a submessage runs past the end")
        yield Frame(kind, data[start:end], data[at:end])
        at = end
