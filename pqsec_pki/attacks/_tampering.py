"""The attacker on the way changes the fields of a message, or its encrypted content."""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import partial

from pqsec_pki.attacks._context import AttackContext, Attempt
from pqsec_pki.attacks._relays import (
    Edit,
    adding,
    editing,
    on,
    preceding,
    putting,
)
from pqsec_pki.attacks.attack import CERTIFICATE, COVERED, DOCUMENT, TRANSCRIPT, Attack, Attacker
from pqsec_pki.handshake import (
    Final,
    KeyMaterial,
    Reply,
    Request,
    TransformationKind,
    token_message,
)
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import HANDSHAKE, MESSAGE

CLASSES: Mapping[str, type[Request | Reply | Final]] = {
    "request": Request,
    "reply": Reply,
    "final": Final,
}


# Fields


def change_fields(message: str, context: AttackContext) -> Iterator[Attempt]:
    """Change one bit of a field: at its start, in its middle or at its end."""
    for name, _ in context.token(message).binary_properties:
        for word, place in (("first", 0.0), ("middle", 0.5), ("last", 1.0)):
            relay = editing(message, name, partial(_with_less, place))
            yield context.between(f"{name}, {word} byte", relay)


def drop_fields(context: AttackContext) -> Iterator[Attempt]:
    """Remove a required field. Removing an optional one does no harm."""
    for message, kind in CLASSES.items():
        optional = {field.name for field in fields(kind) if field.default is None}
        for name, _ in context.token(message).binary_properties:
            if name not in optional:
                yield context.between(f"{name} of the {message}", putting(message, {name: None}))


def double_fields(context: AttackContext) -> Iterator[Attempt]:
    """Send a field twice: the first value is forged, the last is genuine.

    A receiver that uses the last value notices nothing. Cyclone DDS uses the first.
    """
    for message in HANDSHAKE:
        for name, value in context.token(message).binary_properties:
            relay = preceding(message, (name, value[::-1]))
            yield context.between(f"{name} of the {message}", relay)


def add_fields(context: AttackContext) -> Iterator[Attempt]:
    """Add a field: Fast DDS hashes every field named "c.*", other stacks hash five fields."""
    for message in HANDSHAKE:
        yield context.between(f"c.extra in the {message}", adding(message, ("c.extra", b"1")))


def _with_less(place: float, value: bytes) -> bytes:
    """The value with one bit cleared, so that numbers of an ML-KEM key stay below its modulus."""
    at = int(place * (len(value) - 1))
    byte = value[at]
    return value[:at] + bytes([byte & byte - 1 if byte else 1]) + value[at + 1 :]


# Protected messages


_PROTECTED = {
    "kind": 7,
    "key id": 11,
    "session id": 15,
    "initialization vector": 23,
    "length": 31,
    "ciphertext": 40,
    "tag": -12,
    "number of receivers": -1,
}
"""The offset of one byte of each part of a protected submessage (DDS-Security 1.1, 9.5.3.3.4)."""


def change_message(context: AttackContext) -> Iterator[Attempt]:
    """Change a protected message, or send it unprotected."""
    one, other = context.session.sides
    for occurrence, (side, peer) in enumerate(((one, other), (other, one)), start=1):
        for part, at in _PROTECTED.items():
            yield context.between(f"{part} in {side.name}'s", on(MESSAGE, _flip_at(at), occurrence))
        keys = KeyMaterial.generate(TransformationKind.AES256_GCM)
        forged = token_message(side.guid, peer.guid, keys)
        in_clear = on(MESSAGE, partial(_instead, forged), occurrence)
        yield context.between(f"unprotected in {side.name}'s name", in_clear)


def _flip_at(at: int) -> Edit:
    def edit(data: bytes) -> bytes:
        changed = bytearray(data)
        changed[at] ^= 1
        return bytes(changed)

    return edit


def _instead(forged: bytes, data: bytes) -> bytes:
    del data
    return forged


ATTACKS = (
    Attack(
        name="change-request",
        attacker=Attacker.ON_THE_WAY,
        title="changes one bit of the request, in each of its fields",
        refused_at=("reply", "final"),
        checks=(
            Code.C8,
            Code.C9,
            *CERTIFICATE,
            Code.C11,
            Code.C12,
            Code.C14,
            Code.C15,
            Code.C16,
            Code.C17,
            Code.C19,
        ),
        also=(*TRANSCRIPT, *DOCUMENT),
        because=COVERED,
        act=partial(change_fields, "request"),
    ),
    Attack(
        name="change-reply",
        attacker=Attacker.ON_THE_WAY,
        title="changes one bit of the reply, in each of its fields",
        refused_at=("final",),
        checks=(
            Code.C9,
            *CERTIFICATE,
            Code.C11,
            Code.C12,
            Code.C16,
            Code.C18,
            Code.C19,
            Code.C20,
            Code.C21,
        ),
        also=(*TRANSCRIPT, Code.C22, *DOCUMENT),
        because=COVERED,
        act=partial(change_fields, "reply"),
    ),
    Attack(
        name="change-final",
        attacker=Attacker.ON_THE_WAY,
        title="changes one bit of the final message, in each of its fields",
        refused_at=("authenticated",),
        checks=(Code.C23, Code.C24),
        act=partial(change_fields, "final"),
    ),
    Attack(
        name="change-message",
        attacker=Attacker.ON_THE_WAY,
        title="changes the encrypted message after the handshake, or sends it unencrypted",
        refused_at=("message",),
        checks=(Code.C26,),
        act=change_message,
    ),
    Attack(
        name="drop-field",
        attacker=Attacker.ON_THE_WAY,
        title="removes a required field from a message",
        refused_at=("reply", "final", "authenticated"),
        checks=(Code.C4,),
        also=(
            *(Code.C6, Code.C8, Code.C9, Code.C11, Code.C12, Code.C14, Code.C15, Code.C16),
            *(Code.C17, Code.C18, Code.C20, Code.C22, Code.C28, *TRANSCRIPT, *DOCUMENT),
        ),
        because="later checks also miss a value that they use, but not one that is only repeated",
        act=drop_fields,
    ),
    Attack(
        name="double-field",
        attacker=Attacker.ON_THE_WAY,
        title="gives a field a second value, so that two readers may see different ones",
        refused_at=("reply", "final", "authenticated"),
        checks=(Code.C5,),
        act=double_fields,
    ),
    Attack(
        name="smuggle-field",
        attacker=Attacker.ON_THE_WAY,
        title="adds a field that some stacks sign and others do not",
        refused_at=("reply", "final", "authenticated"),
        checks=(Code.C7,),
        act=add_fields,
    ),
)
