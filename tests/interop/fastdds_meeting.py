"""We and a participant of Fast DDS, and what passes between the two."""

import os
from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import fields, replace

import pytest

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KEY_AGREEMENTS, load_private_key
from pqsec_pki.certificates import Certificate
from pqsec_pki.handshake import (
    DataHolder,
    Discovered,
    Final,
    Identity,
    IdentityToken,
    PeerRequirements,
    PermissionsToken,
    Reply,
    Request,
    Terms,
    adjusted_guid,
    begin,
    reply_to,
)
from tests.interop.cyclone import Meeting, RefusedError, Token
from tests.interop.fastdds import Participant, participant

DOMAIN = 0
ECDH = KEY_AGREEMENTS.named("ecdh-p256")
MODP = KEY_AGREEMENTS.named("dh-modp-2048-256")
CLASSICAL = PeerRequirements(agreements=(ECDH, MODP))


@contextmanager
def refused(function, words):
    """What is inside must be refused by that function of Fast DDS, with words that begin so."""
    with pytest.raises(RefusedError) as refusal:
        yield
    assert str(refusal.value).startswith(f"{function}: {words}"), refusal.value


def token(message):
    holder = message.to_holder()
    return Token(holder.class_id, holder.properties, holder.binary_properties)


def received(kind, sent):
    return kind.from_holder(DataHolder(*sent))


def unchanged(message):
    return message


@dataclass(frozen=True, kw_only=True)
class OddIdentity(Identity):
    """Ours, but what it says of itself is put in other words."""

    words: Mapping[str, bytes]

    def introduction(self, agreement, *, nul):
        return replace(Identity.introduction(self, agreement, nul=nul), **self.words)


@dataclass(frozen=True)
class Both:
    """We, and a participant of Fast DDS, having heard of each other."""

    terms: Terms
    fastdds: Participant
    meeting: Meeting

    def saying(self, **words):
        """The same, but our introduction has these words."""
        own = {each.name: getattr(self.terms.own, each.name) for each in fields(Identity)}
        return replace(self, terms=replace(self.terms, own=OddIdentity(**own, words=words)))

    def we_begin(self, now, agreement=ECDH, *, request=unchanged, reply=unchanged, final=unchanged):
        """Both ends of a handshake; what is given changes its messages on their way."""
        sent, waiting = begin(self.terms, agreement)
        handshake, answer = self.fastdds.reply(self.meeting, request(token(sent)))
        last, done = waiting.receive(received(Reply, reply(answer)), now=now)
        assert self.fastdds.process(handshake, final(token(last))) is None
        return done, handshake

    def fastdds_begins(self, now, *, request=unchanged, reply=unchanged, final=unchanged):
        """The same, begun by Fast DDS."""
        handshake, sent = self.fastdds.request(self.meeting)
        answer, waiting = reply_to(self.terms, received(Request, request(sent)), now=now)
        last = self.fastdds.process(handshake, reply(token(answer)))
        return waiting.receive(received(Final, final(last))), handshake

    def agree(self, done, handshake):
        """Both know the same secret, and we are let in."""
        theirs = self.fastdds.secret(handshake)
        assert theirs == (done.shared_secret, done.challenge1, done.challenge2)
        credential = self.fastdds.admit(self.meeting, handshake, token(PermissionsToken()))
        assert credential.properties[0][1].encode() == self.terms.own.permissions


def identity(folder, other):
    """Our identity from a participant's folder, with some `other` files in their places."""
    names = ("cert.pem", "key.pem", "identity_ca.cert.pem", "permissions.p7s")
    files = {name: (folder / name).read_bytes() for name in names} | other
    certificate = Certificate.from_pem(files["cert.pem"])
    return Identity(
        certificate=certificate,
        key=load_private_key(files["key.pem"]),
        ca=Certificate.from_pem(files["identity_ca.cert.pem"]),
        guid=adjusted_guid(certificate.subject_der, os.urandom(12) + b"\0\0\1\xc1"),
        permissions=files["permissions.p7s"],
    )


@contextmanager
def meeting(shim, here, there, *, ours=(), policy=CLASSICAL):
    """We with the files in folder `here`, some replaced by `ours`, meet Fast DDS with `there`."""
    own = identity(here, dict(ours))
    with participant(shim, there) as other:
        other.show(*other.join(DOMAIN))
        known = other.meet(
            own.guid, token(IdentityToken.announced(own.certificate, own.ca, KEY_AGREEMENTS))
        )
        terms = Terms(own=own, policy=policy, discovered=Discovered(guid=other.guid))
        yield Both(terms, other, known)
