"""The attacker on the way changes messages: their fields, their order, their size."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from functools import partial

from pqsec_pki.attacks._relays import (
    Edit,
    adding,
    editing,
    enveloped,
    instead,
    on,
    putting,
)
from pqsec_pki.attacks._scene import Attempt, Scene
from pqsec_pki.attacks.attack import Attack, Attacker
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
from pqsec_pki.selfcheck.course import AROUND_TOKEN
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
    """Of two values, two readers may take different ones."""
    for message in HANDSHAKE:
        for name, value in scene.token(message).binary_properties:
            relay = adding(message, (name, value[::-1]))
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
    """Another message than is due."""
    for due in HANDSHAKE:
        for other in HANDSHAKE:
            if other != due:
                relay = instead(due, scene.token(other))
                yield scene.between(f"a {other} where a {due} is due", relay)


def truncate(scene: Scene) -> Iterator[Attempt]:
    """Messages that end too early."""
    for message in (AUTH_REQUEST, *HANDSHAKE):
        for what, edit in _CUTS.items():
            yield scene.between(f"{what} of the {message}", on(message, edit))


_CUTS: Mapping[str, Edit] = {
    "nothing": lambda _: b"",
    "the first byte": lambda data: data[:1],
    "the first half": lambda data: data[: len(data) // 2],
    "all but the last byte": lambda data: data[:-1],
}


def oversize(scene: Scene) -> Iterator[Attempt]:
    """What would cost memory or time before anybody is authenticated."""
    many = [("x", b"")] * 10_000
    for message in HANDSHAKE:
        relay = adding(message, ("x", bytes(1 << 20)))
        yield scene.between(f"a field of 1 MiB in the {message}", relay)
        yield scene.between(f"10,000 fields in the {message}", adding(message, *many))
        yield scene.between(f"a length of 4 GiB in the {message}", on(message, _with_length))


def _with_length(sample: bytes) -> bytes:
    """What a token begins with is the length of its class name."""
    return sample[:AROUND_TOKEN] + b"\xff" * 4 + sample[AROUND_TOKEN + 4 :]


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
        act=partial(change_fields, "request"),
    ),
    Attack(
        name="change-reply",
        attacker=Attacker.ON_THE_WAY,
        title="changes one bit of the reply, in each of its fields",
        refused_at=("final",),
        act=partial(change_fields, "reply"),
    ),
    Attack(
        name="change-final",
        attacker=Attacker.ON_THE_WAY,
        title="changes one bit of the final message, in each of its fields",
        refused_at=("authenticated",),
        act=partial(change_fields, "final"),
    ),
    Attack(
        name="change-message",
        attacker=Attacker.ON_THE_WAY,
        title="changes what is sent encrypted afterwards, or sends it unencrypted",
        refused_at=("message",),
        act=change_message,
    ),
    Attack(
        name="drop-field",
        attacker=Attacker.ON_THE_WAY,
        title="takes a required field out of a message",
        refused_at=("reply", "final", "authenticated"),
        act=drop_fields,
    ),
    Attack(
        name="double-field",
        attacker=Attacker.ON_THE_WAY,
        title="gives a field a second value, so that two readers may see different ones",
        refused_at=("reply", "final", "authenticated"),
        act=double_fields,
    ),
    Attack(
        name="smuggle-field",
        attacker=Attacker.ON_THE_WAY,
        title="adds a field that some stacks sign and others do not",
        refused_at=("reply", "final", "authenticated"),
        act=smuggle_fields,
    ),
    Attack(
        name="mislabel",
        attacker=Attacker.ON_THE_WAY,
        title="readdresses a message, or says it is of another kind or version",
        refused_at=("auth", "reply", "final", "authenticated"),
        act=mislabel,
    ),
    Attack(
        name="reorder",
        attacker=Attacker.ON_THE_WAY,
        title="delivers a message where another one is due",
        refused_at=("reply", "final", "authenticated"),
        act=reorder,
    ),
    Attack(
        name="truncate",
        attacker=Attacker.ON_THE_WAY,
        title="cuts messages short",
        refused_at=("auth", "reply", "final", "authenticated"),
        act=truncate,
    ),
    Attack(
        name="oversize",
        attacker=Attacker.ON_THE_WAY,
        title="sends messages of 1 MiB, of 10,000 fields, or that claim 4 GiB, to exhaust memory",
        refused_at=("reply", "final", "authenticated"),
        act=oversize,
    ),
)
