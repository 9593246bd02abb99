"""The attacker converts messages between the two versions, or spoils what the second deflates."""

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

from pqsec_pki.attacks._context import AttackContext, Attempt
from pqsec_pki.attacks._relays import Edit, editing, putting
from pqsec_pki.attacks._tampering import CLASSES
from pqsec_pki.attacks.attack import TRANSCRIPT, Attack, Attacker
from pqsec_pki.handshake import (
    CREDENTIALS_DICTIONARY,
    Final,
    GenericMessage,
    Reply,
    Request,
    WireVersion,
)
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import HandshakeSession, Relay, SessionSide

_FIRST, _SECOND = WireVersion
_BOMB = 16 << 20
"""Bytes of zeros, which deflate to a thousandth."""
_CONVERSIONS: Mapping[str, tuple[WireVersion, Mapping[str, WireVersion]]] = {
    "second to first and back": (
        _SECOND,
        {"request": _FIRST, "reply": _SECOND, "final": _FIRST},
    ),
    "first to second and back": (
        _FIRST,
        {"request": _SECOND, "reply": _FIRST, "final": _SECOND},
    ),
    "the request to the first": (_SECOND, {"request": _FIRST}),
    "the final to the first": (_SECOND, {"final": _FIRST}),
    "the final to the second": (_FIRST, {"final": _SECOND}),
}
"""What is tried -> the version that the initiator sends, and messages with their new version."""


def convert(context: AttackContext) -> Iterator[Attempt]:
    """Both sides accept both versions, so only signatures and states can detect a change."""
    for what, (sent, messages) in _CONVERSIONS.items():
        other = _FIRST if sent is _SECOND else _SECOND
        yield _in_versions(context, sent, other).between(what, _converting(messages))


def strip(context: AttackContext) -> Iterator[Attempt]:
    """Remove the version, so that a receiver takes the message for one of the first."""
    second = _in_versions(context, _SECOND, _FIRST)
    for message in CLASSES:
        yield second.between(f"of the {message}", putting(message, {"ver": None}))


def spoil(context: AttackContext) -> Iterator[Attempt]:
    """Send credentials that inflate to too much, to too little, or not at all."""
    edits: Mapping[str, Edit] = {
        "a bomb of 16 MiB": lambda _: _deflated(bytes(_BOMB)),
        "an end too soon": lambda data: data[: len(data) // 2],
        "bytes after the end": lambda data: data + b"\0",
        "a certificate cut short": partial(_without, 3000, 3100),
        "another form of compression": lambda data: zlib.compress(_inflated(data), 9),
        "a certificate alone": lambda data: _deflated(_inflated(data)[:2000]),
    }
    for what, edit in edits.items():
        yield _in_versions(context, _SECOND).between(what, editing("request", "id", edit))


def _in_versions(context: AttackContext, *versions: WireVersion) -> AttackContext:
    """The context with sides that send the first of `versions`, and accept all."""

    def side(each: SessionSide) -> SessionSide:
        policy = replace(each.terms.policy, versions=versions)
        return replace(each, terms=replace(each.terms, policy=policy))

    session = context.session
    one, other = map(side, session.sides)
    return replace(context, session=replace(session, initiator=one, replier=other))


def _converting(versions: Mapping[str, WireVersion]) -> Relay:
    """Converts the messages of these names; the challenges are those that passed before."""
    known: dict[str, bytes] = {}

    def relay(name: str, data: bytes) -> bytes:
        if name not in CLASSES:
            return data
        sample = GenericMessage.decode(data)
        message = CLASSES[name].from_holder(sample.tokens[0])
        for each in ("challenge1", "challenge2"):
            if value := getattr(message, each, None):
                known[each] = value
        if name not in versions:
            return data
        changed = _converted(message, versions[name], known)
        return replace(sample, tokens=(changed.to_holder(),)).encode()

    return relay


def _converted(
    message: Request | Reply | Final, version: WireVersion, known: Mapping[str, bytes]
) -> Request | Reply | Final:
    if isinstance(message, Final):
        return replace(message, **(known if version is _FIRST else dict.fromkeys(known)))
    introduction = message.introduction
    if version is _SECOND:
        introduction = introduction.in_second_version()
    changed = replace(
        message, introduction=replace(introduction, version=version), challenge1=known["challenge1"]
    )
    return changed.without_optional()


def _deflated(data: bytes) -> bytes:
    compressor = zlib.compressobj(9, wbits=-15, zdict=CREDENTIALS_DICTIONARY)
    return compressor.compress(data) + compressor.flush()


def _inflated(data: bytes) -> bytes:
    return zlib.decompressobj(wbits=-15, zdict=CREDENTIALS_DICTIONARY).decompress(data)


def _without(start: int, end: int, data: bytes) -> bytes:
    whole = _inflated(data)
    return _deflated(whole[:start] + whole[end:])


def _one_version(session: HandshakeSession) -> str | None:
    if session.agreement.binds_transcript:
        return None
    return f"messages with {session.agreement.wire_name} have one version"


_row = partial(Attack, attacker=Attacker.ON_THE_WAY, not_applicable=_one_version)
ATTACKS = (
    _row(
        name="convert-version",
        title="converts messages between the two versions, where both sides accept both",
        refused_at=("final", "authenticated"),
        checks=(Code.C21, Code.C28),
        also=TRANSCRIPT,
        because="the hashes cover the version, and both signatures and the key cover the hashes",
        act=convert,
    ),
    _row(
        name="strip-version",
        title="removes the version of a message, so that it seems to be of the first",
        refused_at=("reply", "final", "authenticated"),
        checks=(Code.C4,),
        also=(
            *(Code.C6, Code.C8, Code.C9, Code.C11, Code.C12, Code.C13, Code.C14, Code.C15),
            *(Code.C16, Code.C17, Code.C18, Code.C20, Code.C22, Code.C28, Code.C29, *TRANSCRIPT),
        ),
        because="nothing has its name of the first version, and later checks miss the values",
        act=strip,
    ),
    _row(
        name="spoil-credentials",
        title="replaces deflated credentials by ones that inflate to 16 MiB, or to nothing valid",
        refused_at=("reply",),
        checks=(Code.C27,),
        act=spoil,
    ),
)
