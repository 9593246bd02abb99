"""An insider between two participants of a stock stack: with its plain suites both have one key.

wire.md, section 15. The plugins cannot tell: each side authenticated the insider, which signed for
itself. Only the first protected message names another destination (C26); the stack's core reads it.
"""

import os
from contextlib import ExitStack
from dataclasses import replace
from datetime import timedelta

import pytest

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES
from pqsec_pki.handshake import (
    DataHolder,
    Final,
    Identity,
    IdentityToken,
    Reply,
    Request,
    Transcript,
    adjusted_guid,
    initiates,
)
from tests.interop import cyclone, fastdds
from tests.interop.conftest import permissions_of
from tests.interop.cyclone import RefusedError, Token
from tests.interop.cyclone_crypto import crypto
from tests.interop.exchange import SUBMESSAGE

pytestmark = pytest.mark.interop

DOMAIN = 0
ENTITY = b"\0\0\1\xc1"


def token(message):
    holder = DataHolder.decode(message.to_holder().encode())
    return Token(holder.class_id, holder.properties, holder.binary_properties)


def certified(lab, now, between):
    """A participant of the lab whose GUID lies between these two: the second replies to it."""
    key = SIGNATURES.named("ecdsa-p256").generate()
    for number in range(1000):
        name = f"/lab/eve{number}"
        certificate = lab.authorities.identity.issue(
            name, key.public_key, now=now, validity=timedelta(days=30)
        )
        guid = adjusted_guid(certificate.subject_der, os.urandom(12) + ENTITY)
        if initiates(between[0], guid) and initiates(guid, between[1]):
            permissions = lab.sign(permissions_of(name, now))
            ca = lab.keystore.participant("/lab/alice").identity_ca
            return Identity(
                certificate=certificate, key=key, ca=ca, guid=guid, permissions=permissions
            )
    raise AssertionError


@dataclass(frozen=True)
class Between:
    """The insider: it has a certificate, and neither secret of a key agreement."""

    own: Identity

    def meetings(self, *others):
        """What each of the others knows of the insider."""
        announced = token(
            IdentityToken.announced(self.own.certificate, self.own.ca, KEY_AGREEMENTS)
        )
        return [other.meet(self.own.guid, announced) for other in others]

    def relay(self, bob, alice):
        """Both handshakes, with bob as initiator and alice as replier: their handles."""
        with_bob, with_alice = self.meetings(bob, alice)
        assert with_bob.begins
        assert not with_alice.begins
        one, sent = bob.request(with_bob)
        request = Request.from_holder(DataHolder(*sent))
        introduction = replace(
            self.own.introduction(KEY_AGREEMENTS.named("ecdh-p256"), nul=True),
            key_agreement=request.introduction.key_agreement,
            signature_algorithm=request.introduction.signature_algorithm,
        )
        mine = introduction.digest()
        asked = replace(request, introduction=introduction, hash_c1=mine)
        two, answered = alice.reply(with_alice, token(asked))
        reply = Reply.from_holder(DataHolder(*answered))
        values = Transcript(
            hash_c1=request.introduction.digest(),
            hash_c2=mine,
            challenge1=request.challenge1,
            challenge2=reply.challenge2,
            dh1=request.dh1,
            dh2=reply.dh2,
        )
        signature = self.own.key.sign_handshake(values.reply_octets())
        to_bob = Reply(introduction=introduction, signature=signature, **values.values())
        assert Final.from_holder(DataHolder(*bob.process(one, token(to_bob))))
        values = replace(values, hash_c1=mine, hash_c2=reply.introduction.digest())
        final = Final(
            signature=self.own.key.sign_handshake(values.final_octets()), **values.values()
        )
        assert alice.process(two, token(final)) is None
        return one, two


@pytest.fixture
def meet(labs, now):
    """meet(start) gives bob and alice, each started by `start(folder)`, and the insider."""
    with ExitStack() as stack:

        def both(start):
            lab = labs("classical")
            found = [stack.enter_context(start(folder)) for folder in (lab.bob, lab.alice)]
            for each in found:
                each.show(*each.join(DOMAIN))
            bob, alice = found
            own = certified(lab, now, (bob.guid, alice.guid))
            return bob, alice, Between(own)

        yield both


def test_two_of_cyclone_have_one_key_with_an_insider_between(meet, plugins):
    bob, alice, eve = meet(lambda folder: cyclone.participant(plugins, folder))
    one, two = eve.relay(bob, alice)
    assert bob.secret(one) == alice.secret(two)
    with (
        crypto(plugins, bob.secret_handle(one)) as bobs,
        crypto(plugins, alice.secret_handle(two)) as alices,
    ):
        sealed = bobs.volatile("writer").protect(SUBMESSAGE)
        assert alices.volatile("reader").unprotect(sealed) == SUBMESSAGE


def test_two_of_fastdds_have_one_key_with_an_insider_between(meet, request):
    shim = request.getfixturevalue("fastdds")
    bob, alice, eve = meet(lambda folder: fastdds.participant(shim, folder))
    one, two = eve.relay(bob, alice)
    assert bob.secret(one) == alice.secret(two)
    assert alice.unprotect(two, bob.protect(one, SUBMESSAGE)) == SUBMESSAGE


def test_the_insider_cannot_answer_for_another(meet, plugins):
    """With the certificate of the other in its messages, the signature is the wrong one."""
    bob, alice, eve = meet(lambda folder: cyclone.participant(plugins, folder))
    other = replace(eve.own, key=SIGNATURES.named("ecdsa-p256").generate())
    with pytest.raises(RefusedError):
        Between(other).relay(bob, alice)
