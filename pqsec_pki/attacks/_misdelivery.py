"""The attacker on the way delivers messages relabeled, reordered, cut short or made longer."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

from pqsec_pki.attacks._context import AttackContext, Attempt
from pqsec_pki.attacks._relays import adding, changing_token, enveloped, on
from pqsec_pki.attacks.attack import Attack, Attacker
from pqsec_pki.handshake import DataHolder, GenericMessage
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import AUTH_REQUEST, HANDSHAKE

_MISLABELED: Mapping[str, Callable[[GenericMessage], GenericMessage]] = {
    "to another address": lambda it: replace(it, destination_participant=it.source),
    "as another kind of message": lambda it: replace(it, class_id="dds.sec.auth_other"),
    "as another version": lambda it: replace(it, tokens=(_as_version_9(it.tokens[0]),)),
    "twice in one": lambda it: replace(it, tokens=it.tokens * 2),
}


def mislabel(context: AttackContext) -> Iterator[Attempt]:
    """Send valid tokens in a message with wrong fields."""
    for message in (AUTH_REQUEST, *HANDSHAKE):
        for what, edit in _MISLABELED.items():
            yield context.between(f"the {message} {what}", enveloped(message, edit))


def _as_version_9(token: DataHolder) -> DataHolder:
    return replace(token, class_id=token.class_id.replace(":1.0", ":9.0"))


def reorder(context: AttackContext) -> Iterator[Attempt]:
    """Send another message than the expected one, with all fields that the expected one has."""
    for due in HANDSHAKE:
        for other in HANDSHAKE:
            if other != due:
                relay = changing_token(due, partial(_as, context.token(other)))
                yield context.between(f"a {other} instead of a {due}", relay)


def _as(other: DataHolder, due: DataHolder) -> DataHolder:
    known = dict(due.binary_properties)
    more = tuple(pair for pair in other.binary_properties if pair[0] not in known)
    return replace(other, binary_properties=due.binary_properties + more)


_PADDING = bytes(64)


def truncate(context: AttackContext) -> Iterator[Attempt]:
    """Cut messages short, after all fields that the receiver needs."""
    for message in (AUTH_REQUEST, *HANDSHAKE):
        for what, size in _CUTS.items():
            padding = adding(message, ("x", _PADDING))
            cut = on(message, partial(_without_end, size))
            yield context.between(f"{what} of the {message}", padding, cut)


_CUTS: Mapping[str, int] = {
    "a byte too few": 1,
    "half of the last field too few": len(_PADDING) // 2,
    "the last field too few": len(_PADDING),
    "the last field and its length too few": len(_PADDING) + 4,
}


def _without_end(size: int, data: bytes) -> bytes:
    return data[:-size]


def oversize(context: AttackContext) -> Iterator[Attempt]:
    """Send messages that could cost memory or time before authentication."""
    many = [(f"x{at}", b"") for at in range(10_000)]
    for message in HANDSHAKE:
        relay = adding(message, ("x", bytes(1 << 20)))
        yield context.between(f"a field of 1 MiB in the {message}", relay)
        yield context.between(f"10,000 fields in the {message}", adding(message, *many))
        claimed = on(message, _with_length)
        last = adding(message, ("x", _PADDING))
        yield context.between(f"a length of 4 GiB in the {message}", last, claimed)


def _with_length(sample: bytes) -> bytes:
    """The sample, with a length of 4 GiB at the start of its last field."""
    end = len(_PADDING)
    return sample[: -end - 4] + b"\xff" * 4 + sample[-end:]


ATTACKS = (
    Attack(
        name="mislabel",
        attacker=Attacker.ON_THE_WAY,
        title="readdresses a message, or labels it with another kind or version",
        refused_at=("auth", "reply", "final", "authenticated"),
        checks=(Code.C2, Code.C3),
        act=mislabel,
    ),
    Attack(
        name="reorder",
        attacker=Attacker.ON_THE_WAY,
        title="delivers another message than the expected one",
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
