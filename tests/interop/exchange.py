"""After a handshake: Cyclone DDS and we send each other keys, and then what they protect."""

import struct
from collections.abc import Iterable
from dataclasses import dataclass

from pqsec_pki.handshake import (
    DataHolder,
    Done,
    GenericMessage,
    KeyMaterial,
    MessageClass,
    Sender,
    key_exchange_material,
    unprotect_payload,
    unprotect_submessage,
)
from tests.interop.cyclone_crypto import Crypto, Endpoint, Protection
from tests.interop.cyclone_types import Token

KINDS = ("writer", "reader")
_CLASSES = {
    "writer": MessageClass.WRITER_CRYPTO_TOKENS,
    "reader": MessageClass.READER_CRYPTO_TOKENS,
}
_DATA = struct.Struct("<BBHHH16s")


def data(content: bytes) -> bytes:
    """A DATA submessage, little-endian, with that serialized payload, padded to 4 bytes."""
    content += bytes(-len(content) % 4)
    return _DATA.pack(0x15, 0x05, _DATA.size - 4 + len(content), 0, 16, bytes(16)) + content


def content(submessage: bytes) -> bytes:
    """The serialized payload of a DATA submessage that `data` made."""
    return submessage[_DATA.size :]


PAYLOAD = b"\0\1\0\0hello, reader.\0\0"
SUBMESSAGE = data(PAYLOAD)


def message(class_id: MessageClass, tokens: Iterable[DataHolder]) -> GenericMessage:
    """Crypto tokens on their way; whose is said by nothing but the keys here."""
    return GenericMessage(
        source=bytes(16),
        sequence=1,
        destination_participant=bytes(16),
        class_id=class_id,
        tokens=tuple(tokens),
    )


@dataclass(frozen=True)
class Pair:
    """An endpoint of Cyclone DDS and ours of the other kind, with each other's keys.

    A writer has two: the first for submessages, the second for payloads.
    """

    cyclone: Endpoint
    ours: tuple[KeyMaterial, ...]
    theirs: tuple[KeyMaterial, ...]

    def protect(self, submessage: bytes, *others: "Pair") -> bytes:
        """A submessage from us, for this endpoint of Cyclone DDS and for those of `others`."""
        keys = [self.ours[0], *(each.ours[0] for each in others)]
        receivers = [each for each in keys if each.receiver_key]
        return Sender(self.ours[0]).protect_submessage(submessage, receivers=receivers)

    def unprotect(self, sealed: bytes) -> bytes:
        """The submessage that it protected, as we read it."""
        return unprotect_submessage(self.theirs[0], sealed)

    def protect_payload(self, payload: bytes) -> bytes:
        """A payload from us, if Cyclone DDS's endpoint is a reader."""
        return Sender(self.ours[1]).protect_payload(payload)

    def unprotect_payload(self, sealed: bytes) -> bytes:
        """The payload, if Cyclone DDS's endpoint is a writer."""
        return unprotect_payload(self.theirs[1], sealed)


class Exchange:
    """The volatile secure topic, both directions of it."""

    def __init__(self, crypto: Crypto, done: Done) -> None:
        self._crypto = crypto
        self._material = key_exchange_material(done)
        self._sender = Sender(self._material)
        self._writer, self._reader = crypto.volatile("writer"), crypto.volatile("reader")

    def receive(self, class_id: MessageClass, tokens: Iterable[Token]) -> tuple[KeyMaterial, ...]:
        """What Cyclone DDS sends, as we get it."""
        sample = message(class_id, (DataHolder(*each) for each in tokens)).encode()
        sealed = self._writer.protect(data(sample))
        arrived = GenericMessage.decode(content(unprotect_submessage(self._material, sealed)))
        return tuple(map(KeyMaterial.from_holder, arrived.tokens))

    def send(self, class_id: MessageClass, keys: Iterable[KeyMaterial]) -> tuple[Token, ...]:
        """What we send, as Cyclone DDS gets it."""
        sample = message(class_id, (each.to_holder() for each in keys)).encode()
        sealed = self._sender.protect_submessage(data(sample))
        arrived = GenericMessage.decode(content(self._reader.unprotect(sealed)))
        return tuple(
            Token(each.class_id, each.properties, each.binary_properties) for each in arrived.tokens
        )

    def participants(self) -> KeyMaterial:
        """The participants' keys, both ways; Cyclone DDS's."""
        class_id = MessageClass.PARTICIPANT_CRYPTO_TOKENS
        (theirs,) = self.receive(class_id, self._crypto.tokens())
        self._crypto.take(self.send(class_id, [KeyMaterial.generate(theirs.kind)]))
        return theirs

    def endpoints(self, kind: str, protection: Protection, like: Pair | None = None) -> Pair:
        """A writer or reader of Cyclone DDS and our counterpart, having sent their keys.

        Our counterpart is a new one, or that of `like`.
        """
        return self.introduced(self._crypto.endpoint(kind, protection), protection, like)

    def introduced(
        self, endpoint: Endpoint, protection: Protection, like: Pair | None = None
    ) -> Pair:
        """The same for an `endpoint` that is there."""
        theirs = self.receive(_CLASSES[endpoint.kind], endpoint.tokens())
        count = {"writer": 2, "reader": 1}[endpoint.peers_kind]
        new = (KeyMaterial.generate(theirs[0].kind) for _ in range(count))
        first, *rest = like.ours if like else new
        ours = (first.for_receiver() if protection.origin else first, *rest)
        endpoint.take(self.send(_CLASSES[endpoint.peers_kind], ours))
        return Pair(endpoint, ours, theirs)
