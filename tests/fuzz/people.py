"""Two who meet, and what they say to each other: real messages for tests to spoil.

Alice begins and Bob replies. Carol and Dave are other people with the same keys, so what
they say fits as well as anything a stranger could say.
"""

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cache

from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES, pair_private
from pqsec_pki.certificates import Authority
from pqsec_pki.handshake import (
    Discovered,
    Done,
    Final,
    Identity,
    MessageConventions,
    PeerRequirements,
    Reply,
    ReplySent,
    Request,
    RequestSent,
    Terms,
    WireVersion,
    adjusted_guid,
    begin,
    reply_to,
)
from pqsec_pki.smime import Signer, sign

NOW = datetime(2026, 6, 1, tzinfo=UTC)
DAY = timedelta(days=1)
EVERYTHING = PeerRequirements(agreements=tuple(KEY_AGREEMENTS))
ENTITY = b"\0\0\1\xc1"
KEYS_OF = {"alice": "hers", "carol": "hers", "bob": "his", "dave": "his"}


@cache
def authority(main, alternative=None):
    second = SIGNATURES.named(alternative) if alternative else None
    return Authority.create(
        "Identity CA", SIGNATURES.named(main), alternative=second, now=NOW, validity=90 * DAY
    )


@cache
def keys(kind, whose):
    """One key, or a key and its alternative for a `kind` like "rsa-2048 and ml-dsa-44"."""
    del whose
    return [SIGNATURES.named(name).generate() for name in kind.split(" and ")]


@cache
def enrolled(kind, name):
    """The identity of CN=`name`. One CA issues plain certificates, another those of pairs."""
    key, *second = keys(kind, KEYS_OF[name])
    ca = authority("ecdsa-p256", "ml-dsa-65") if second else authority("ecdsa-p256")
    certificate = ca.issue(
        name,
        key.public_key,
        alternative=second[0].public_key if second else None,
        now=NOW,
        validity=30 * DAY,
    )
    return Identity(
        certificate=certificate,
        key=pair_private(key, second[0]) if second else key,
        ca=ca.certificate,
        guid=adjusted_guid(certificate.subject_der, name.encode().ljust(12) + ENTITY),
        permissions=b"permissions of " + name.encode(),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Meeting:
    """A handshake that went well: every message, and every state on the way."""

    of_alice: Terms
    of_bob: Terms
    request: Request
    waiting: RequestSent
    reply: Reply
    awaiting: ReplySent
    final: Final
    done: Done
    """Alice's."""


@cache
def signed(name):
    """The signed permissions of CN=`name`: the second version carries no others."""
    ca = authority("ecdsa-p256")
    document = f"<dds><permissions>of {name}</permissions></dds>\n".encode()
    return sign(document, Signer(ca.certificate, ca.key), now=NOW)


def meet(kind, agreement, *, alice="alice", bob="bob", optional=True):
    """Two people of one kind of key meet; without what is `optional` if that is False."""
    return shaken(enrolled(kind, alice), enrolled(kind, bob), agreement, optional=optional)


def meet_in_second(kind, agreement):
    """Alice and Bob meet, with messages of the second version."""
    own = [replace(enrolled(kind, name), permissions=signed(name)) for name in ("alice", "bob")]
    return shaken(*own, agreement, version=WireVersion.SECOND)


def shaken(one, other, agreement, *, optional=True, version=WireVersion.FIRST):
    """The handshake of two identities."""
    of_alice, of_bob = (
        Terms(
            own=own,
            policy=replace(EVERYTHING, versions=(version,)),
            discovered=Discovered(guid=peer.guid),
            conventions=MessageConventions(sends_optional=optional),
        )
        for own, peer in ((one, other), (other, one))
    )
    request, waiting = begin(of_alice, agreement)
    reply, awaiting = reply_to(of_bob, request, now=NOW)
    final, done = waiting.receive(reply, now=NOW)
    return Meeting(
        of_alice=of_alice,
        of_bob=of_bob,
        request=request,
        waiting=waiting,
        reply=reply,
        awaiting=awaiting,
        final=final,
        done=done,
    )
