"""Suites, participants that meet in them, and what their handshakes cost at least."""

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache

from primitives import (
    Call,
    agreeing,
    carrying,
    digesting,
    reading,
    signing,
    verifying,
    verifying_certificate,
)
from tries import Spent, noted, spent

from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES, Family, KeyAgreement
from pqsec_pki.benchmark import (
    HandshakeSuite,
    MeasuredParticipants,
    every_suite,
    suites_of,
)
from pqsec_pki.handshake import (
    DataHolder,
    Discovered,
    Final,
    Identity,
    PeerRequirements,
    Reply,
    Request,
    Terms,
    begin,
    reply_to,
)

NOW, YEAR = datetime.now(UTC), timedelta(days=365)
ABOUT_TRANSCRIPT = 220
"""Bytes of what a handshake's signature covers, beside dh1 and dh2."""


def target(suite: HandshakeSuite) -> float | None:
    """The most that the ratio to the floor may be; none for a mix of old and new."""
    parts = [(suite.alternative or suite.signature).family, suite.agreement.family]
    if Family.CLASSICAL not in parts:
        return 1.2
    names = suite.signature.name, suite.agreement.name
    return 2.5 if names == ("ecdsa-p256", "ecdh-p256") else None


def suites(*, everything: bool) -> list[HandshakeSuite]:
    """The profiles'; each kind of key; each agreement with an old, the new with a new key."""
    new = [row for row in KEY_AGREEMENTS if row.family is not Family.CLASSICAL]
    chosen = [
        *suites_of(),
        *suites_of(signatures=list(SIGNATURES)),
        *suites_of(signatures=[SIGNATURES.named("ecdsa-p256")], agreements=list(KEY_AGREEMENTS)),
        *suites_of(signatures=[SIGNATURES.named("ml-dsa-65")], agreements=new),
        *(every_suite() if everything else ()),
    ]
    return list({str(suite): suite for suite in reversed(chosen)}.values())[::-1]


@cache
def participants(suite: HandshakeSuite) -> MeasuredParticipants:
    return MeasuredParticipants.of(suite, NOW)


def handshake(one: Identity, other: Identity, row: KeyAgreement) -> Callable[[], Spent]:
    """A function that runs one, begun by `one`; every message passes as bytes."""
    one, other = _noted(one), _noted(other)
    twice = one.certificate.alternative_key is not None
    policy = PeerRequirements(agreements=(row,), require_alternative=twice)
    ours = Terms(own=one, policy=policy, discovered=Discovered(guid=other.guid))
    theirs = Terms(own=other, policy=policy, discovered=Discovered(guid=one.guid))

    def run() -> None:
        request, waiting = begin(ours, row)
        heard = Request.from_holder(_carried(request))
        reply, awaiting = reply_to(theirs, heard, now=NOW)
        answer = Reply.from_holder(_carried(reply))
        final, done = waiting.receive(answer, now=NOW)
        outcome = awaiting.receive(Final.from_holder(_carried(final)))
        assert done.shared_secret == outcome.shared_secret

    return spent(run)


def _noted(identity: Identity) -> Identity:
    return replace(identity, key=replace(identity.key, handle=noted(identity.key.handle)))


def _carried(message: Request | Reply | Final) -> DataHolder:
    return DataHolder.decode(message.to_holder().encode())


def floor(suite: HandshakeSuite) -> Callable[[], Spent]:
    """A function that makes every primitive call of one handshake, and nothing else."""
    both, row = participants(suite), suite.agreement
    transcript = bytes(row.public_size + row.ciphertext_size + ABOUT_TRANSCRIPT)
    calls = agreeing(row.name)
    for side in (both.initiator, both.responder):
        calls += verifying_certificate(both.ca.key, side.certificate.tbs)
        if both.ca.alternative_key and side.certificate.alternative:
            covered = side.certificate.alternative.covered
            calls += verifying_certificate(both.ca.alternative_key, covered)
        calls += signing(side.key, transcript) + verifying(side.key, transcript)
    return _each(calls)


def wire(suite: HandshakeSuite) -> Callable[[], Spent]:
    """A function that makes the calls that messages and certificates need besides the floor.

    Keys are written and read, each certificate is base64, and the peer's introduction and the
    Reply are digested. CDR, checks and challenges are not in it.
    """
    both, row = participants(suite), suite.agreement
    transcript = bytes(row.public_size + row.ciphertext_size + ABOUT_TRANSCRIPT)
    calls = carrying(row.name)
    for side in (both.initiator, both.responder):
        introduction = side.introduction(row, nul=True)
        covered = b"".join(value for _, value in introduction.properties)
        calls += reading(side.certificate.der, side.key) + digesting(covered)
        calls += digesting(transcript) if row.binds_transcript else []
    return _each(calls)


def _each(calls: list[Call]) -> Callable[[], Spent]:
    def run() -> None:
        for call in calls:
            call()

    return spent(run)
