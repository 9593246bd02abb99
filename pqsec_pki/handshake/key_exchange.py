"""After the handshake: key material of participants and endpoints, and the key that protects it.

Both sides derive one key from SharedSecret and the challenges, for the exchange of keys
(DDS-Security 1.1, 9.5.2.1.2). With it they protect all other key material: the participant's,
that of each writer and reader for submessages, and that of each writer for payloads. It is
sent as crypto tokens, several in one message, over the volatile secure topic.
"""

import hashlib
import hmac
import os
import secrets
from dataclasses import field, replace
from enum import IntEnum
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError, UsageError
from pqsec_pki.handshake._cdr import ByteOrder, CdrReader, CdrWriter
from pqsec_pki.handshake._secured import KEY_ID_SIZE
from pqsec_pki.handshake.states import Done
from pqsec_pki.handshake.wire import DataHolder

CRYPTO_TOKEN = "DDS:Crypto:AES_GCM_GMAC"  # noqa: S105 -- a class name, not a password
KEY_MATERIAL = "dds.cryp.keymat"
NO_KEY_ID = bytes(KEY_ID_SIZE)
_FILLING = bytes(20)
"""Bytes that Fast DDS writes after key material of kind NONE."""


class TransformationKind(IntEnum):
    """How data is protected (9.5.2.1.1): signed (GMAC), or encrypted as well (GCM)."""

    NONE = 0
    AES128_GMAC = 1
    AES128_GCM = 2
    AES256_GMAC = 3
    AES256_GCM = 4

    @property
    def key_size(self) -> int:
        """Bytes of key and salt."""
        return {0: 0, 1: 16, 2: 16}.get(self, 32)

    @property
    def encrypts(self) -> bool:
        """Whether the content is encrypted."""
        return self in {TransformationKind.AES128_GCM, TransformationKind.AES256_GCM}


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyMaterial:
    """KeyMaterial_AES_GCM_GMAC (9.5.2.1.1): master keys from which session keys are derived.

    Salt and keys have the size of the kind, key ids 4 bytes; without origin authentication
    there is no receiver key, and its id is all zero. MalformedError for anything else.
    """

    kind: TransformationKind
    salt: bytes = field(repr=False)
    sender_key_id: bytes
    sender_key: bytes = field(repr=False)
    receiver_key_id: bytes = NO_KEY_ID
    receiver_key: bytes = field(default=b"", repr=False)

    def __post_init__(self) -> None:
        size = self.kind.key_size
        due = (size, size, 0 if self.receiver_key_id == NO_KEY_ID else size)
        sizes = (len(self.salt), len(self.sender_key), len(self.receiver_key))
        if sizes != due:
            raise MalformedError(f"key material of sizes {sizes}, not {due}")

    @classmethod
    def generate(cls, kind: TransformationKind) -> Self:
        """New key material for one participant, writer or reader as a sender."""
        salt, key = os.urandom(kind.key_size), os.urandom(kind.key_size)
        return cls(kind=kind, salt=salt, sender_key_id=_new_key_id(), sender_key=key)

    def for_receiver(self) -> Self:
        """This key with a new receiver key, for one receiver only: for origin authentication.

        All receivers have the sender's key and could use it; only this receiver has both keys.
        """
        key = os.urandom(self.kind.key_size)
        return replace(self, receiver_key_id=_new_key_id(), receiver_key=key)

    def to_holder(self) -> DataHolder:
        """The crypto token that carries it (9.5.2.1)."""
        return DataHolder(CRYPTO_TOKEN, (), ((KEY_MATERIAL, self.encode()),))

    @classmethod
    def from_holder(cls, holder: DataHolder) -> Self:
        """The inverse; MalformedError for any other token."""
        names = [name for name, _ in holder.binary_properties]
        if holder.class_id != CRYPTO_TOKEN or names != [KEY_MATERIAL]:
            raise MalformedError("not a crypto token with one dds.cryp.keymat")
        return cls.decode(holder.binary_properties[0][1])

    def encode(self) -> bytes:
        """dds.cryp.keymat: big-endian CDR, 88 bytes for 256-bit keys without receiver key."""
        writer = CdrWriter()
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
        reader = CdrReader(data, ByteOrder.BIG)
        material = cls(
            kind=_kind(reader.u32()),
            salt=reader.octets(),
            sender_key_id=reader.raw(KEY_ID_SIZE),
            sender_key=reader.octets(),
            receiver_key_id=reader.raw(KEY_ID_SIZE),
            receiver_key=reader.octets(),
        )
        rest = reader.raw(reader.left)
        if rest and (material.kind is not TransformationKind.NONE or rest != _FILLING):
            raise MalformedError(f"{len(rest)} bytes after the key material")
        return material

    def session_key(self, session_id: bytes) -> bytes:
        """The key of one session, 16 or 32 bytes (9.5.3.3.3). `session_id` has 4 bytes."""
        return self._session_key(b"SessionKey", self.sender_key, session_id)

    def session_receiver_key(self, session_id: bytes) -> bytes:
        """The session key of this receiver's tags (9.5.3.3.3); UsageError if it has no key."""
        if not self.receiver_key:
            raise UsageError("this key material has no receiver's key")
        return self._session_key(b"SessionReceiverKey", self.receiver_key, session_id)

    def _session_key(self, label: bytes, key: bytes, session_id: bytes) -> bytes:
        digest = hmac.digest(key, label + self.salt + session_id, "sha256")
        return digest[: self.kind.key_size]


def key_exchange_material(done: Done) -> KeyMaterial:
    """The key material that protects the exchange of keys after `done` (9.5.2.1.2).

    Both sides derive the same, for both directions.
    """
    one, two = done.challenge1, done.challenge2
    salt = _derive(one, b"keyexchange salt", two, done.shared_secret)
    key = _derive(two, b"key exchange key", one, done.shared_secret)
    return KeyMaterial(
        kind=TransformationKind.AES256_GCM, salt=salt, sender_key_id=NO_KEY_ID, sender_key=key
    )


def _kind(number: int) -> TransformationKind:
    try:
        return TransformationKind(number)
    except ValueError:
        raise MalformedError(f"unknown transformation kind {number}") from None


def _new_key_id() -> bytes:
    """A random key id other than NO_KEY_ID, which means the key of the key exchange or none."""
    return (1 + secrets.randbelow((1 << 8 * KEY_ID_SIZE) - 1)).to_bytes(KEY_ID_SIZE)


def _derive(first: bytes, label: bytes, second: bytes, secret: bytes) -> bytes:
    return hmac.digest(hashlib.sha256(first + label + second).digest(), secret, "sha256")
