"""GUIDs that belong to a subject name, the initiator, and c.pdata."""

import hashlib
import struct

from pqsec_pki.errors import MalformedError
from pqsec_pki.handshake.wire import GUID_SIZE

_DERIVED = 6
"""Bytes of a GUID that come from the subject name."""
_PID_SENTINEL = 0x0001
_PID_PARTICIPANT_GUID = 0x0050


def adjusted_guid(subject_der: bytes, candidate: bytes) -> bytes:
    """The GUID (16 bytes) that the holder of `subject_der`, a DER Name, must use.

    DDS-Security 1.1, 9.3.3, table 52, validate_local_identity: a one bit, 47 bits of the
    name's SHA-256, 48 bits of `candidate`'s, and the candidate's entity id.
    """
    # The stacks differ in the low half: Cyclone DDS hashes 12 bytes of the candidate, Fast
    # DDS and OpenDDS all 16. No stack checks that half.
    return _high_half(subject_der) + hashlib.sha256(candidate).digest()[:_DERIVED] + candidate[12:]


def belongs_to(guid: bytes, subject_der: bytes) -> bool:
    """Whether the holder of `subject_der` may use `guid`."""
    return guid[:_DERIVED] == _high_half(subject_der)


def initiates(own: bytes, peer: bytes) -> bool:
    """Whether `own` initiates: the participant with the smaller GUID sends the Request.

    Most bits come from the subject names, so these decide who initiates.
    """
    return own < peer


def participant_data(guid: bytes) -> bytes:
    """The smallest c.pdata: a big-endian parameter list, without header, with the GUID alone."""
    return struct.pack(">HH16sHH", _PID_PARTICIPANT_GUID, GUID_SIZE, guid, _PID_SENTINEL, 0)


def participant_guid(data: bytes) -> bytes:
    """The GUID (16 bytes) in c.pdata; MalformedError if the list is broken or has none."""
    at, found = 0, b""
    while at + 4 <= len(data):
        kind, size = struct.unpack_from(">HH", data, at)
        if kind == _PID_SENTINEL:
            break
        at += 4 + size
        if at > len(data):
            raise MalformedError("c.pdata: a parameter runs past the end")
        if kind == _PID_PARTICIPANT_GUID:
            if size != GUID_SIZE:
                raise MalformedError(f"c.pdata: a GUID of {size} bytes")
            if found:  # readers could differ in which one they use
                raise MalformedError("c.pdata: two participant GUIDs")
            found = data[at - size : at]
        at += -size % 4
    if not found:
        raise MalformedError("c.pdata: no participant GUID")
    return found


def _high_half(subject_der: bytes) -> bytes:
    digest = hashlib.sha256(subject_der).digest()[:_DERIVED]
    return (int.from_bytes(digest) >> 1 | 1 << 47).to_bytes(_DERIVED)
