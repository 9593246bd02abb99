"""After the handshake: the key for key exchange, and one message protected with it.

SharedSecret and challenges give both sides one key (DDS-Security 1.1, 9.5.2.1.2). With it
they send each other the keys for everything else, as crypto tokens in submessages that are
encrypted on the volatile secure topic. This is also the first proof of a common secret.
"""

import hashlib
import hmac
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Self

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from pqsec_pki.errors import MalformedError, UsageError, VerificationError
from pqsec_pki.handshake._cdr import ByteOrder, Reader, Writer
from pqsec_pki.handshake.states import Done
from pqsec_pki.handshake.wire import DataHolder

CRYPTO_TOKEN = "DDS:Crypto:AES_GCM_GMAC"  # noqa: S105 -- a class name, no password
KEY_MATERIAL = "dds.cryp.keymat"
TAG_SIZE = 16
KEY_ID_SIZE = 4
NO_KEY_ID = bytes(KEY_ID_SIZE)
_SESSION_ID_SIZE = 4
_IV_SIZE = 12
"""Bytes: session_id and initialization_vector_suffix."""
_HEADER_SIZE = 4 + KEY_ID_SIZE + _IV_SIZE
MAX_SUBMESSAGE = 0xFFF8
"""Bytes: a submessage says its length in 16 bits, and the content's stands in front."""
_SEC_BODY, _SEC_PREFIX, _SEC_POSTFIX = 0x30, 0x31, 0x32
_FLAG_LITTLE_ENDIAN = 0x01
_FRAME = struct.Struct(">BBH")
"""Kind, flags, size of what follows (RTPS 2.3, 9.4.5.1)."""


class TransformationKind(IntEnum):
    """How data is protected (9.5.2.1.1)."""

    NONE = 0
    AES128_GMAC = 1
    AES128_GCM = 2
    AES256_GMAC = 3
    AES256_GCM = 4

    @property
    def key_size(self) -> int:
        """Bytes of key and salt."""
        return {0: 0, 1: 16, 2: 16}.get(self, 32)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyMaterial:
    """KeyMaterial_AES_GCM_GMAC (9.5.2.1.1): master keys that session keys come from."""

    kind: TransformationKind
    salt: bytes = field(repr=False)
    sender_key_id: bytes
    sender_key: bytes = field(repr=False)
    receiver_key_id: bytes = NO_KEY_ID
    receiver_key: bytes = field(default=b"", repr=False)

    def to_holder(self) -> DataHolder:
        """The crypto token that carries it (9.5.2.1)."""
        return DataHolder(CRYPTO_TOKEN, (), ((KEY_MATERIAL, self.encode()),))

    @classmethod
    def from_holder(cls, holder: DataHolder) -> Self:
        """The inverse; MalformedError for any other token."""
        names = [name for name, _ in holder.binary_properties]
        if holder.class_id != CRYPTO_TOKEN or names != [KEY_MATERIAL]:
            raise MalformedError(f"not a crypto token: {holder.class_id!r} with {names}")
        return cls.decode(holder.binary_properties[0][1])

    def encode(self) -> bytes:
        """dds.cryp.keymat: big-endian CDR, 88 bytes for 256-bit keys without receiver key."""
        writer = Writer()
        writer.u32(self.kind)
        writer.octets(self.salt)
        writer.raw(self.sender_key_id)
        writer.octets(self.sender_key)
        writer.raw(self.receiver_key_id)
        writer.octets(self.receiver_key)
        return writer.done()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """The inverse; MalformedError for anything else."""
        reader = Reader(data, ByteOrder.BIG)
        material = cls(
            kind=_kind(reader.u32()),
            salt=reader.octets(),
            sender_key_id=reader.raw(KEY_ID_SIZE),
            sender_key=reader.octets(),
            receiver_key_id=reader.raw(KEY_ID_SIZE),
            receiver_key=reader.octets(),
        )
        size = material.kind.key_size
        sizes = (len(material.salt), len(material.sender_key), len(material.receiver_key))
        if reader.left or sizes not in {(size, size, 0), (size, size, size)}:
            raise MalformedError(f"key material of odd sizes: {sizes}, {reader.left} left")
        return material

    def session_key(self, session_id: bytes) -> bytes:
        """The key of one session, 16 or 32 bytes (9.5.3.3.3). `session_id` has 4 bytes."""
        data = b"SessionKey" + self.salt + session_id
        return hmac.digest(self.sender_key, data, "sha256")[: self.kind.key_size]


def key_exchange_material(done: Done) -> KeyMaterial:
    """What protects the exchange of keys between the two of `done` (9.5.2.1.2).

    Both sides have the same, for both directions.
    """
    one, two = done.challenge1, done.challenge2
    salt = _derive(one, b"keyexchange salt", two, done.shared_secret)
    key = _derive(two, b"key exchange key", one, done.shared_secret)
    return KeyMaterial(
        kind=TransformationKind.AES256_GCM, salt=salt, sender_key_id=NO_KEY_ID, sender_key=key
    )


def protect(material: KeyMaterial, submessage: bytes) -> bytes:
    """`submessage`, encrypted, between SEC_PREFIX and SEC_POSTFIX (9.5.3.3.4).

    Session and initialization vector are 96 random bits: both directions share one key,
    so a counter on each side could meet the other's. UsageError if it is over 64 KiB.
    """
    if len(submessage) > MAX_SUBMESSAGE:
        raise UsageError(f"a submessage of {len(submessage)} bytes cannot be protected in one")
    iv = os.urandom(_IV_SIZE)
    sealed = _cipher(material, iv).encrypt(iv, submessage, None)
    content, tag = sealed[:-TAG_SIZE], sealed[-TAG_SIZE:]
    header = struct.pack(">I", material.kind) + material.sender_key_id + iv
    return (
        _framed(_SEC_PREFIX, header)
        + _framed(_SEC_BODY, struct.pack(">I", len(content)) + content)
        + _framed(_SEC_POSTFIX, tag + _NO_RECEIVERS)
    )


def unprotect(material: KeyMaterial, data: bytes) -> bytes:
    """The submessage in `data`, the three submessages that protect makes.

    MalformedError if it is not those; VerificationError if it was protected with other
    keys, or changed.
    """
    header, body, footer = _unframed(data)
    identifier, iv = header[:-_IV_SIZE], header[-_IV_SIZE:]
    if identifier != struct.pack(">I", material.kind) + material.sender_key_id:
        raise VerificationError("protected in another way, or with a key of another name")
    tag, receivers = footer[:TAG_SIZE], footer[TAG_SIZE:]
    if receivers != _NO_RECEIVERS:
        raise VerificationError("receiver-specific tags where there is no receiver's key")
    try:
        return _cipher(material, iv).decrypt(iv, _content(body) + tag, None)
    except InvalidTag:
        raise VerificationError("the two sides have different keys, or the data changed") from None


_NO_RECEIVERS = bytes(4)
"""receiver_specific_macs: a sequence of none."""


def _kind(number: int) -> TransformationKind:
    try:
        return TransformationKind(number)
    except ValueError:
        raise MalformedError(f"unknown transformation kind {number}") from None


def _derive(first: bytes, label: bytes, second: bytes, secret: bytes) -> bytes:
    return hmac.digest(hashlib.sha256(first + label + second).digest(), secret, "sha256")


def _cipher(material: KeyMaterial, iv: bytes) -> AESGCM:
    if material.kind is not TransformationKind.AES256_GCM:
        raise UsageError(f"no submessage protection here by {material.kind.name}")
    return AESGCM(material.session_key(iv[:_SESSION_ID_SIZE]))


def _framed(kind: int, content: bytes) -> bytes:
    """A submessage, big-endian, padded to 4 bytes."""
    content += bytes(-len(content) % 4)
    return _FRAME.pack(kind, 0, len(content)) + content


def _unframed(data: bytes) -> tuple[bytes, bytes, bytes]:
    """The contents of SEC_PREFIX, SEC_BODY and SEC_POSTFIX; MalformedError otherwise."""
    found = list(_submessages(data))
    if [kind for kind, _ in found] != [_SEC_PREFIX, _SEC_BODY, _SEC_POSTFIX]:
        raise MalformedError(f"not one protected submessage but {len(found)} parts")
    header, body, footer = (content for _, content in found)
    if len(header) != _HEADER_SIZE or len(footer) < TAG_SIZE:
        raise MalformedError("a crypto header or footer of a wrong size")
    return header, body, footer


def _submessages(data: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(data):
        start = at + _FRAME.size
        if start > len(data):
            raise MalformedError("half a submessage header")
        kind, flags, size = _FRAME.unpack_from(data, at)
        # Only the size follows the flag: Cyclone DDS sets it, and what is inside stays
        # big-endian.
        if flags & _FLAG_LITTLE_ENDIAN:
            size = (size & 0xFF) << 8 | size >> 8
        at = start + size
        if at > len(data):
            raise MalformedError("a submessage runs past the end")
        yield kind, data[start:at]


def _content(body: bytes) -> bytes:
    """CryptoContent (9.5.2.4): a length and that many bytes, then at most 3 of padding."""
    reader = Reader(body, ByteOrder.BIG)
    content = reader.octets()
    if reader.left > 3:  # noqa: PLR2004 -- RTPS aligns submessages to 4
        raise MalformedError(f"{reader.left} bytes after the encrypted content")
    return content
