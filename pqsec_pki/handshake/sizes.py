"""Bytes of the samples of a handshake's messages, without running it."""

from typing import NamedTuple

from pqsec_pki.algorithms import KeyAgreement
from pqsec_pki.handshake.messages import (
    CHALLENGE_SIZE,
    HASH_SIZE,
    Final,
    Introduction,
    Reply,
    Request,
)
from pqsec_pki.handshake.wire import GUID_SIZE, GenericMessage, MessageClass


class MessageSizes(NamedTuple):
    """Bytes of the samples that one participant sends, in the first version of the messages."""

    request: int
    reply: int
    final: int

    @classmethod
    def of(
        cls, introduction: Introduction, agreement: KeyAgreement, signature: int
    ) -> "MessageSizes":
        """With every optional field; `signature` is the bytes of a handshake's signature.

        Only the sizes of the introduction's values matter. An ECDSA signature may be a few bytes
        shorter than its size.
        """
        digest, challenge = bytes(HASH_SIZE), bytes(CHALLENGE_SIZE)
        both = {
            "dh1": bytes(agreement.public_size),
            "dh2": bytes(agreement.ciphertext_size),
            "challenge1": challenge,
            "challenge2": challenge,
            "hash_c1": digest,
            "hash_c2": digest,
            "signature": bytes(signature),
        }
        request = Request(
            introduction=introduction, hash_c1=digest, dh1=both["dh1"], challenge1=challenge
        )
        reply, final = Reply(introduction=introduction, **both), Final(**both)
        return cls(_sample(request), _sample(reply), _sample(final))


def _sample(message: Request | Reply | Final) -> int:
    sample = GenericMessage(
        source=bytes(GUID_SIZE),
        sequence=1,
        destination_participant=bytes(GUID_SIZE),
        class_id=MessageClass.HANDSHAKE,
        tokens=(message.to_holder(),),
    )
    return len(sample.encode())
