"""Bytes of the samples of a handshake's messages, without running it."""

from typing import NamedTuple

from pqsec_pki.algorithms import KeyAgreement
from pqsec_pki.handshake import compact
from pqsec_pki.handshake.messages import (
    CHALLENGE_SIZE,
    HASH_SIZE,
    Final,
    Introduction,
    Reply,
    Request,
)
from pqsec_pki.handshake.wire import GUID_SIZE, DataHolder, GenericMessage, MessageClass


class MessageSizes(NamedTuple):
    """Bytes of the samples that one participant sends."""

    request: int
    reply: int
    final: int

    @classmethod
    def of(
        cls, introduction: Introduction, agreement: KeyAgreement, signature: int
    ) -> "MessageSizes":
        """In the first version, with every optional field.

        `signature` is the bytes of a handshake's signature. Only the sizes of the introduction's
        values matter. An ECDSA signature may be a few bytes shorter than its size.
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
        return cls(*(_sample(each.to_holder()) for each in (request, reply, final)))

    @classmethod
    def of_second(
        cls,
        credentials: int,
        participant_data: int,
        names: int,
        agreement: KeyAgreement,
        signature: int,
    ) -> "MessageSizes":
        """In the second version, with so many bytes of `id`, `pd`, `alg` and `sig`."""
        sizes = {
            compact.VERSION: 1,
            "id": credentials,
            "pd": participant_data,
            "alg": names,
            "dh1": agreement.public_size,
            "dh2": agreement.ciphertext_size,
            "ch1": CHALLENGE_SIZE,
            "ch2": CHALLENGE_SIZE,
            "sig": signature,
        }
        messages = (
            DataHolder(kind, (), tuple((name, bytes(sizes[name])) for name in compact.names(kind)))
            for kind in (Request.CLASS_ID, Reply.CLASS_ID, Final.CLASS_ID)
        )
        return cls(*map(_sample, messages))


def _sample(token: DataHolder) -> int:
    sample = GenericMessage(
        source=bytes(GUID_SIZE),
        sequence=1,
        destination_participant=bytes(GUID_SIZE),
        class_id=MessageClass.HANDSHAKE,
        tokens=(token,),
    )
    return len(sample.encode())
