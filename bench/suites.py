"""Suites, people who meet in them, and what their handshakes cost at least."""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cache
from itertools import product

from primitives import agreeing, signing, verifying, verifying_certificate
from tries import Spent, noted, spent

from pqsec_pki.algorithms import KEY_AGREEMENTS, PROFILES, SIGNATURES, Family, pair_private
from pqsec_pki.certificates import Authority
from pqsec_pki.documents import DomainSet, Grant, Permissions
from pqsec_pki.handshake import (
    DataHolder,
    Discovered,
    Final,
    Identity,
    PeerRequirements,
    Reply,
    Request,
    Terms,
    adjusted_guid,
    begin,
    reply_to,
)
from pqsec_pki.smime import Signer, sign

NOW, YEAR = datetime.now(UTC), timedelta(days=365)
ENTITY = b"\0\0\1\xc1"
ABOUT_TRANSCRIPT = 220
"""Bytes of what a handshake's signature covers, beside dh1 and dh2."""


@dataclass(frozen=True)
class Suite:
    """What CA and identities sign with, and how the two sides agree on a secret."""

    key: str
    agreement: str
    alternative: str | None = None

    def __str__(self) -> str:
        keys = f"{self.key} and {self.alternative}" if self.alternative else self.key
        return f"{keys}, {self.agreement}"

    @property
    def target(self) -> float | None:
        """The most that the ratio to the floor may be; none for a mix of old and new."""
        keys = [SIGNATURES.named(name) for name in (self.key, self.alternative) if name]
        parts = [keys[-1].family, KEY_AGREEMENTS.named(self.agreement).family]
        if Family.CLASSICAL not in parts:
            return 1.25
        return 2.5 if (self.key, self.agreement) == ("ecdsa-p256", "ecdh-p256") else None


def suites(*, everything: bool) -> list[Suite]:
    """The profiles'; each kind of key; each agreement with an old, the new with a new key."""
    usual = {Family.CLASSICAL: "ecdh-p256", Family.HYBRID: "x25519mlkem768", Family.PQ: "mlkem768"}
    chosen = [
        *map(_of_profile, PROFILES),
        *(Suite(row.name, usual[row.family]) for row in SIGNATURES),
    ]
    chosen += [Suite("ecdsa-p256", row.name) for row in KEY_AGREEMENTS]
    new = [row.name for row in KEY_AGREEMENTS if row.family is not Family.CLASSICAL]
    chosen += [Suite("ml-dsa-65", name) for name in new]
    if everything:
        chosen += [Suite(key.name, row.name) for key, row in product(SIGNATURES, KEY_AGREEMENTS)]
    return list(dict.fromkeys(chosen))


def _of_profile(profile) -> Suite:
    second = profile.alternative_key
    return Suite(
        profile.participant_key.name, profile.key_agreement.name, second.name if second else None
    )


@dataclass(frozen=True)
class People:
    """A CA, and the two participants that have its certificates and permissions."""

    ca: Authority
    alice: Identity
    bob: Identity


@cache
def people(key: str, alternative: str | None) -> People:
    row = SIGNATURES.named(key)
    second = SIGNATURES.named(alternative) if alternative else None
    ca = Authority.create("Identity CA", row, alternative=second, now=NOW, validity=10 * YEAR)
    return People(ca, *(_enrolled(ca, name) for name in ("/bench/alice", "/bench/bob")))


def _enrolled(ca: Authority, name: str) -> Identity:
    key = ca.key.algorithm.generate()
    second = ca.alternative_key.algorithm.generate() if ca.alternative_key else None
    public = second.public_key if second else None
    certificate = ca.issue(name, key.public_key, alternative=public, now=NOW, validity=YEAR)
    return Identity(
        certificate=certificate,
        key=pair_private(key, second) if second else key,
        ca=ca.certificate,
        guid=adjusted_guid(certificate.subject_der, os.urandom(12) + ENTITY),
        permissions=_permissions(ca, certificate.subject_name),
    )


def _permissions(ca: Authority, subject: str) -> bytes:
    """A signed document of the usual size; the handshake carries it and does not read it."""
    grant = Grant.least(
        subject_name=subject,
        not_before=NOW,
        not_after=NOW + YEAR,
        domains=DomainSet.of(0),
        publish=["rt/chatter"],
        subscribe=["rt/cmd"],
    )
    signer = Signer(ca.certificate, ca.key)
    second = Signer(ca.certificate, ca.alternative_key) if ca.alternative_key else None
    return sign(Permissions(grants=(grant,)).to_xml(), signer, countersigner=second, now=NOW)


def handshake(one: Identity, other: Identity, agreement: str) -> Callable[[], Spent]:
    """A function that runs one, begun by `one`; every message passes as bytes."""
    row = KEY_AGREEMENTS.named(agreement)
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


def floor(suite: Suite) -> Callable[[], Spent]:
    """A function that makes every primitive call of one handshake, and nothing else."""
    both = people(suite.key, suite.alternative)
    row = KEY_AGREEMENTS.named(suite.agreement)
    transcript = bytes(row.public_size + row.ciphertext_size + ABOUT_TRANSCRIPT)
    calls = agreeing(suite.agreement)
    for side in (both.alice, both.bob):
        calls += verifying_certificate(both.ca.key, side.certificate.tbs)
        if both.ca.alternative_key and side.certificate.alternative:
            covered = side.certificate.alternative.covered
            calls += verifying_certificate(both.ca.alternative_key, covered)
        calls += signing(side.key, transcript) + verifying(side.key, transcript)

    def run() -> None:
        for call in calls:
            call()

    return spent(run)
