"""Counts the handshake messages among RTPS messages on the wire.

They are samples of BuiltinParticipantStatelessMessageWriter, which are never encrypted
(DDS-Security 1.1, 7.4.3 and 7.4.4): a message names its sender, its receiver and its kind. So a
second one of a kind between the same two was repeated. What other writers repeat is encrypted.
"""

import struct
from collections.abc import Iterator
from dataclasses import field

from pqsec_pki._dataclass import dataclass

_HEADER = 20
"""Bytes of an RTPS header (RTPS 2.5, 9.4.4)."""
_DATA, _DATA_FRAG = 0x15, 0x16
_LITTLE, _INLINE_QOS = 0x01, 0x02
_WRITER = bytes.fromhex("000201c3")
_SENDER, _RECEIVER, _CLASS = 4, 52, 100
"""Offsets of the GUIDs and the class of a ParticipantGenericMessage in a sample (7.2.6)."""
_PREFIX = 12
_AUTH_REQUEST = b"+AuthReq"
_LONGEST = 256


@dataclass(slots=True)
class HandshakeTraffic:
    """The handshake traffic of a network, as it is seen."""

    messages: int = 0
    """Each of a pair once."""
    repeats: int = 0
    _seen: set[tuple[bytes, bytes, bytes]] = field(default_factory=set)

    def see(self, datagram: bytes) -> None:
        """Count what begins in this datagram, of which the end may be missing."""
        if not datagram.startswith(b"RTPS"):
            return
        for payload in _payloads(datagram):
            found = _identity(payload)
            if found and found in self._seen:
                self.repeats += 1
            elif found:
                self._seen.add(found)
                self.messages += 1


def _payloads(datagram: bytes) -> Iterator[bytes]:
    """The beginning of each sample of that writer."""
    place = _HEADER
    while place + 4 <= len(datagram):
        kind, flags = datagram[place], datagram[place + 1]
        order = "<" if flags & _LITTLE else ">"
        (length,) = struct.unpack_from(f"{order}H", datagram, place + 2)
        end = place + 4 + length if length else len(datagram)
        if kind in {_DATA, _DATA_FRAG} and datagram[place + 12 : place + 16] == _WRITER:
            yield from _payload(kind, flags, order, datagram[place + 4 : end])
        place = end


def _payload(kind: int, flags: int, order: str, body: bytes) -> Iterator[bytes]:
    """The payload of a Data or DataFrag submessage (RTPS 2.5, 9.4.5.4 and 9.4.5.5), if it is the
    first."""
    if flags & _INLINE_QOS or len(body) < 32:  # noqa: PLR2004 -- no stack puts QoS there
        return
    if kind == _DATA:
        yield body[20:]
    elif struct.unpack_from(f"{order}I", body, 20) == (1,):
        yield body[32:]


def _identity(payload: bytes) -> tuple[bytes, bytes, bytes] | None:
    """Sender, receiver and kind of a handshake message; None if it is another."""
    order = "<" if payload[1:2] == b"\x01" else ">"
    try:
        (length,) = struct.unpack_from(f"{order}I", payload, _CLASS)
        place = _CLASS + 4 + length + -length % 4 + 4  # after it, and the number of tokens
        (length,) = struct.unpack_from(f"{order}I", payload, place)
    except struct.error:
        return None
    kind = payload[place + 4 : place + 4 + length].rstrip(b"\0")
    if not kind or length > _LONGEST or kind.endswith(_AUTH_REQUEST):
        return None
    sender = payload[_SENDER : _SENDER + _PREFIX]
    return sender, payload[_RECEIVER : _RECEIVER + _PREFIX], kind
