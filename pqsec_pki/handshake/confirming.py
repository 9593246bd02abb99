"""The first protected message, and the only one that confirms the key (wire.md, C26).

Crypto tokens are the first messages that two peers send under the key of their key exchange.
One key serves both directions, so successful decryption proves too little: a participant
can also decrypt its own message sent back, and a message to a third one with the same key.
The message must name its reader as the destination and the peer as the source.
"""

import struct

from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.handshake._checks import check
from pqsec_pki.handshake.key_exchange import KeyMaterial, key_exchange_material
from pqsec_pki.handshake.protection import Sender, unprotect_submessage
from pqsec_pki.handshake.states import Done
from pqsec_pki.handshake.wire import GenericMessage, MessageClass
from pqsec_pki.problems import Code

_PREFIX_SIZE = 12
"""Number of bytes of a GUID that identify the participant."""
_WRITER, _READER = bytes.fromhex("ff0202c3"), bytes.fromhex("ff0202c4")
"""Entity IDs of the volatile secure topic (DDS-Security 1.1, 7.4.6.2)."""
_DATA = struct.Struct("<BBHHH4s4sII")
"""A DATA submessage up to its payload (RTPS 2.3, 9.4.5.3), little-endian."""
_DATA_KIND, _LITTLE_ENDIAN_WITH_PAYLOAD = 0x15, 0x05
_TO_PAYLOAD = 16
"""octetsToInlineQos: bytes from after that field to the payload."""


def confirmation(own: bytes, done: Done, keys: KeyMaterial) -> bytes:
    """The first protected message of the participant with GUID `own` (16 bytes): its `keys`."""
    message = token_message(own, done.peer.guid, keys)
    return Sender(key_exchange_material(done)).protect_submessage(message)


def confirmed(own: bytes, done: Done, data: bytes) -> KeyMaterial:
    """The keys in the peer's first message to `own`, which confirms the key of the peer.

    VerificationError, with C26, if it cannot be decrypted, is for another participant or from
    another than the one that authenticated, or is not such a message.
    """
    with check(Code.C26):
        message = _message_in(unprotect_submessage(key_exchange_material(done), data))
        if message.destination_participant != own:
            raise VerificationError("the first protected message is for another participant")
        if message.source != _writer_of(done.peer.guid):
            raise VerificationError("the first protected message is not from the peer")
        wanted = MessageClass.PARTICIPANT_CRYPTO_TOKENS
        if message.class_id != wanted or len(message.tokens) != 1:
            raise MalformedError(f"expected a '{wanted}' with one token")
        return KeyMaterial.from_holder(message.tokens[0])


def token_message(source: bytes, destination: bytes, keys: KeyMaterial) -> bytes:
    """The submessage, not protected, that carries `keys` from one participant to another.

    Both are GUIDs of 16 bytes (DDS-Security 1.1, 7.4.4.3).
    """
    sample = GenericMessage(
        source=_writer_of(source),
        sequence=1,
        destination_participant=destination,
        class_id=MessageClass.PARTICIPANT_CRYPTO_TOKENS,
        tokens=(keys.to_holder(),),
    ).encode()
    sample += bytes(-len(sample) % 4)
    size = _DATA.size - 4 + len(sample)
    head = _DATA_KIND, _LITTLE_ENDIAN_WITH_PAYLOAD, size, 0, _TO_PAYLOAD
    return _DATA.pack(*head, _READER, _WRITER, 0, 1) + sample


def _message_in(submessage: bytes) -> GenericMessage:
    if len(submessage) < _DATA.size:
        raise MalformedError(f"a first protected message of {len(submessage)} bytes")
    kind, flags, size, _, to_payload, reader, writer, *_ = _DATA.unpack_from(submessage)
    found = kind, flags, size, to_payload, reader, writer
    size_due = len(submessage) - 4
    due = _DATA_KIND, _LITTLE_ENDIAN_WITH_PAYLOAD, size_due, _TO_PAYLOAD, _READER, _WRITER
    if found != due:
        raise MalformedError("the first protected message is not of the volatile secure topic")
    return GenericMessage.decode(submessage[_DATA.size :])


def _writer_of(guid: bytes) -> bytes:
    return guid[:_PREFIX_SIZE] + _WRITER
