"""The attacker on the way changes messages: their fields, their order, their size."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from functools import partial

from pqsec_pki.attacks._relays import (
    Edit,
    adding,
    editing,
    enveloped,
    on,
    preceding,
    putting,
    retold,
)
from pqsec_pki.attacks._scene import Attempt, Scene
from pqsec_pki.attacks.attack import CERTIFICATE, COVERED, DOCUMENT, TRANSCRIPT, Attack, Attacker
from pqsec_pki.handshake import (
    DataHolder,
    Final,
    GenericMessage,
    KeyMaterial,
    Reply,
    Request,
    TransformationKind,
    token_message,
)
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck.report import AUTH_REQUEST, HANDSHAKE, MESSAGE

_CLASSES: Mapping[str, type[Request | Reply | Final]] = {
    "request": Request,
    "reply": Reply,
    "final": Final,
}


# Fields


def change_fields(message: str, scene: Scene) -> Iterator[Attempt]:
    """One bit of a field: at its begin, in its middle and at its end."""
    for name, _ in scene.token(message).binary_properties:
        for word, place in (("first", 0.0), ("middle", 0.5), ("last", 1.0)):
            relay = editing(message, name, partial(_with_less, place))
            yield scene.between(f"{name}, {word} byte", relay)


def drop_fields(scene: Scene) -> Iterator[Attempt]:
    """Fields that must be there. Without an optional one nothing is lost."""
    for message, kind in _CLASSES.items():
        optional = {field.name for field in fields(kind) if field.default is None}
        for name, _ in scene.token(message).binary_properties:
            if name not in optional:
                yield scene.between(f"{name} of the {message}", putting(message, {name: None}))


def double_fields(scene: Scene) -> Iterator[Attempt]:
    """Of two values, two readers may take different ones: the first is forged, the last is not.

    Who takes the last sees nothing wrong. Cyclone DDS takes the first.
    """
    for message in HANDSHAKE:
        for name, value in scene.token(message).binary_properties:
            relay = preceding(message, (name, value[::-1]))
            yield scene.between(f"{name} of the {message}", relay)


def smuggle_fields(scene: Scene) -> Iterator[Attempt]:
    """Fast DDS hashes every field whose name begins with "c.", other stacks hash five."""
    for message in HANDSHAKE:
        yield scene.between(f"c.extra in the {message}", adding(message, ("c.extra", b"1")))


def _with_less(place: float, value: bytes) -> bytes:
    """One bit less, so that the numbers of an ML-KEM key stay below its modulus."""
    at = int(place * (len(value) - 1))
    byte = value[at]
    return value[:at] + bytes([byte & byte - 1 if byte else 1]) + value[at + 1 :]


# Whole messages


_MISLABELED: Mapping[str, Callable[[GenericMessage], GenericMessage]] = {
    "to another address": lambda it: replace(it, destination_participant=it.source),
    "as another kind of message": lambda it: replace(it, class_id="dds.sec.auth_other"),
    "as another version": lambda it: replace(it, tokens=(_as_version_9(it.tokens[0]),)),
    "twice in one": lambda it: replace(it, tokens=it.tokens * 2),
}


def mislabel(scene: Scene) -> Iterator[Attempt]:
    """Right tokens in a wrong message."""
    for message in (AUTH_REQUEST, *HANDSHAKE):
        for what, edit in _MISLABELED.items():
            yield scene.between(f"the {message} {what}", enveloped(message, edit))


def _as_version_9(token: DataHolder) -> DataHolder:
    return replace(token, class_id=token.class_id.replace(":1.0", ":9.0"))


def reorder(scene: Scene) -> Iterator[Attempt]:
    """Another message than is due, which has all that is looked for in the one that is."""
    for due in HANDSHAKE:
        for other in HANDSHAKE:
            if other != due:
                relay = retold(due, partial(_as, scene.token(other)))
                yield scene.between(f"a {other} where a {due} is due", relay)


def _as(other: DataHolder, due: DataHolder) -> DataHolder:
    known = dict(due.binary_properties)
    more = tuple(pair for pair in other.binary_properties if pair[0] not in known)
    return replace(other, binary_properties=due.binary_properties + more)


_PADDING = bytes(64)


def truncate(scene: Scene) -> Iterator[Attempt]:
    """Messages that end too early, but behind all that is looked for."""
    for message in (AUTH_REQUEST, *HANDSHAKE):
        for what, size in _CUTS.items():
            padding = adding(message, ("x", _PADDING))
            cut = on(message, partial(_without_end, size))
            yield scene.between(f"{what} of the {message}", padding, cut)


_CUTS: Mapping[str, int] = {
    "a byte too few": 1,
    "half of the last field too few": len(_PADDING) // 2,
    "the last field too few": len(_PADDING),
    "the last field and its length too few": len(_PADDING) + 4,
}


def _without_end(size: int, data: bytes) -> bytes:
    return data[:-size]


def oversize(scene: Scene) -> Iterator[Attempt]:
    """What would cost memory or time before anybody is authenticated."""
    many = [(f"x{at}", b"") for at in range(10_000)]
    for message in HANDSHAKE:
        relay = adding(message, ("x", bytes(1 << 20)))
        yield scene.between(f"a field of 1 MiB in the {message}", relay)
        yield scene.between(f"10,000 fields in the {message}", adding(message, *many))
        claimed = on(message, _with_length)
        last = adding(message, ("x", _PADDING))
        yield scene.between(f"a length of 4 GiB in the {message}", last, claimed)


def _with_length(sample: bytes) -> bytes:
    """What the last field begins with is its length."""
    end = len(_PADDING)
    return sample[: -end - 4] + b"\xff" * 4 + sample[-end:]


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
"""Where a byte of each part stands in a protected submessage (DDS-Security 1.1, 9.5.3.3.4)."""


def change_message(scene: Scene) -> Iterator[Attempt]:
    """What is sent under the keys that were agreed."""
    one, other = scene.encounter.sides
    for turn, (side, peer) in enumerate(((one, other), (other, one)), start=1):
        for part, at in _PROTECTED.items():
            yield scene.between(f"{part} in {side.name}'s", on(MESSAGE, _flip_at(at), turn))
        keys = KeyMaterial.generate(TransformationKind.AES256_GCM)
        forged = token_message(side.guid, peer.guid, keys)
        in_clear = on(MESSAGE, partial(_instead, forged), turn)
        yield scene.between(f"unprotected in {side.name}'s name", in_clear)


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
        title="changes what is sent encrypted afterwards, or sends it unencrypted",
        refused_at=("message",),
        checks=(Code.C26,),
        act=change_message,
    ),
    Attack(
        name="drop-field",
        attacker=Attacker.ON_THE_WAY,
        title="takes a required field out of a message",
        refused_at=("reply", "final", "authenticated"),
        checks=(Code.C4,),
        also=(
            *(Code.C6, Code.C8, Code.C9, Code.C11, Code.C12, Code.C14, Code.C15, Code.C16),
            *(Code.C17, Code.C18, Code.C20, Code.C22, *TRANSCRIPT, *DOCUMENT),
        ),
        because="what is missing is missed again by whoever uses it; what is only repeated is not",
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
        act=smuggle_fields,
    ),
    Attack(
        name="mislabel",
        attacker=Attacker.ON_THE_WAY,
        title="readdresses a message, or says it is of another kind or version",
        refused_at=("auth", "reply", "final", "authenticated"),
        checks=(Code.C2, Code.C3),
        act=mislabel,
    ),
    Attack(
        name="reorder",
        attacker=Attacker.ON_THE_WAY,
        title="delivers a message where another one is due",
        refused_at=("reply", "final", "authenticated"),
        checks=(Code.C3,),
        act=reorder,
    ),
    Attack(
        name="truncate",
        attacker=Attacker.ON_THE_WAY,
        title="cuts messages short",
        refused_at=("auth", "reply", "final", "authenticated"),
        checks=(Code.C1,),
        act=truncate,
    ),
    Attack(
        name="oversize",
        attacker=Attacker.ON_THE_WAY,
        title="sends messages of 1 MiB, of 10,000 fields, or that claim 4 GiB, to exhaust memory",
        refused_at=("reply", "final", "authenticated"),
        checks=(Code.C1,),
        act=oversize,
    ),
)
