"""Our handshake with Cyclone DDS's own: either begins, both end with the same secret.

And then with each other's keys, and what these protect goes both ways.
"""

import os
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import (
    AuthRequest,
    DataHolder,
    Discovered,
    Final,
    Identity,
    IdentityToken,
    PeerRequirements,
    Reply,
    Request,
    Terms,
    adjusted_guid,
    begin,
    belongs_to,
    initiates,
    reply_to,
)
from tests.interop.conftest import STOCK
from tests.interop.cyclone import Meeting, Participant, RefusedError, Token, participant
from tests.interop.cyclone_crypto import Protection, crypto
from tests.interop.exchange import KINDS, PAYLOAD, SUBMESSAGE, Exchange

pytestmark = pytest.mark.interop

DOMAIN = 0
ENTITY = b"\0\0\1\xc1"
ECDH = KEY_AGREEMENTS.named("ecdh-p256")
MODP = KEY_AGREEMENTS.named("dh-modp-2048-256")
HYBRID = KEY_AGREEMENTS.named("x25519mlkem768")


def token(message):
    """Our message as Cyclone DDS's plugin takes it, through the bytes of the wire."""
    holder = DataHolder.decode(message.to_holder().encode())
    return Token(holder.class_id, holder.properties, holder.binary_properties)


@dataclass(frozen=True)
class Sides:
    """We, and a participant of Cyclone DDS, having heard of each other."""

    terms: Terms
    cyclone: Participant
    plugins: Path
    meeting: Meeting
    permissions: Token
    """The permissions token, the same for both."""

    def cyclone_begins(self, change=lambda message: message):
        """Both ends of a handshake that Cyclone DDS begins; `change` spoils our Reply."""
        handshake, request = self.cyclone.request(self.meeting)
        reply, waiting = reply_to(
            self.terms, Request.from_holder(DataHolder(*request)), now=datetime.now(UTC)
        )
        final = self.cyclone.process(handshake, token(change(reply)))
        return waiting.receive(Final.from_holder(DataHolder(*final))), handshake

    def we_begin(self, agreement, change=lambda message: message):
        """The same, begun by us; `change` spoils our Final."""
        request, waiting = begin(self.terms, agreement)
        handshake, reply = self.cyclone.reply(self.meeting, token(request))
        final, done = waiting.receive(Reply.from_holder(DataHolder(*reply)), now=datetime.now(UTC))
        assert self.cyclone.process(handshake, token(change(final))) is None
        return done, handshake

    def agree(self, done, handshake):
        """Both know the same, and Cyclone DDS lets us in."""
        theirs = self.cyclone.secret(handshake)
        assert theirs == (done.shared_secret, done.challenge1, done.challenge2)
        credential = self.cyclone.admit(self.meeting, handshake, self.permissions)
        own = self.terms.own
        assert dict(credential.properties)["c.id"].encode() == own.certificate.pem
        assert dict(credential.properties)["c.perm"].encode() == own.permissions

    def talk(self, done, handshake):
        """Both send their keys under that of the handshake, and use them."""
        with crypto(self.plugins, self.cyclone.secret_handle(handshake)) as theirs:
            exchange = Exchange(theirs, done)
            exchange.participants()
            writer, reader = (exchange.endpoints(kind, Protection()) for kind in KINDS)
            for pair in (writer, reader):
                assert pair.unprotect(pair.cyclone.protect(SUBMESSAGE)) == SUBMESSAGE
                assert pair.cyclone.unprotect(pair.protect(SUBMESSAGE)) == SUBMESSAGE
            assert writer.unprotect_payload(writer.cyclone.protect_payload(PAYLOAD)) == PAYLOAD
            assert reader.cyclone.unprotect_payload(reader.protect_payload(PAYLOAD)) == PAYLOAD


@pytest.fixture
def sides(plugins, labs):
    """sides(profile) gives both, of one lab; with `lab`, ours is another one.

    Who begins follows from the names: /lab/bob does.
    """
    with ExitStack() as stack:

        def start(profile, *, we="alice", lab=None, optional=True, announce=True):
            peer = "bob" if we == "alice" else "alice"
            mine = (lab or labs(profile)).keystore.participant(f"/lab/{we}")
            own = Identity(
                certificate=mine.certificate,
                key=mine.key,
                ca=mine.identity_ca,
                guid=adjusted_guid(mine.certificate.subject_der, os.urandom(12) + ENTITY),
                permissions=mine.permissions,
            )
            folder = labs(profile).alice.with_name(peer)
            other = stack.enter_context(participant(plugins, folder, optional=optional))
            credential, permissions = other.join(DOMAIN)
            other.show(credential, permissions)
            announced = os.urandom(32) if announce else None
            meeting = other.meet(
                own.guid,
                token(IdentityToken.announced(own.certificate, own.ca, KEY_AGREEMENTS)),
                token(AuthRequest(future_challenge=announced)) if announced else None,
            )
            theirs = dict(meeting.auth_request.binary) if meeting.auth_request else {}
            terms = Terms(
                own=own,
                policy=PeerRequirements(agreements=(ECDH, MODP)),
                discovered=Discovered(guid=other.guid, **theirs),
                announced=announced,
            )
            return Sides(terms, other, plugins, meeting, permissions)

        yield start


both_begin = pytest.mark.parametrize("we_begin", [True, False], ids=["we begin", "cyclone begins"])


def shake_hands(sides, profile, *, we_begin, agreement=ECDH, **options):
    both = sides(profile, we="bob" if we_begin else "alice", **options)
    return both, both.we_begin(agreement) if we_begin else both.cyclone_begins()


BEGINNINGS = {
    "we begin, ECDH": {"we_begin": True},
    "we begin, DH-MODP": {"we_begin": True, "agreement": MODP},
    # Cyclone DDS begins with nothing else.
    "cyclone begins, ECDH": {"we_begin": False},
}


@pytest.mark.parametrize("announce", [True, False], ids=["we announce", "cyclone announces"])
@pytest.mark.parametrize("optional", [True, False], ids=["all fields", "mandatory fields"])
@pytest.mark.parametrize("beginning", BEGINNINGS.values(), ids=BEGINNINGS)
@pytest.mark.parametrize("profile", STOCK)
def test_both_ends_agree_and_go_on(sides, profile, beginning, optional, announce):
    both, ends = shake_hands(sides, profile, **beginning, optional=optional, announce=announce)
    assert (both.meeting.auth_request is None) == announce
    both.agree(*ends)
    both.talk(*ends)


@pytest.mark.parametrize("we", ["alice", "bob"])
def test_we_know_cyclone_guids_and_who_begins(sides, labs, we):
    both = sides("transition", we=we)
    peer = "bob" if we == "alice" else "alice"
    subject = labs("transition").keystore.participant(f"/lab/{peer}").certificate.subject_der
    assert belongs_to(both.cyclone.guid, subject)
    assert initiates(both.terms.own.guid, both.cyclone.guid) != both.meeting.begins


@both_begin
@pytest.mark.parametrize("profile", STOCK)
def test_a_peer_of_another_identity_ca_is_refused(sides, other_labs, profile, we_begin):
    refusal = RefusedError if we_begin else VerificationError
    with pytest.raises(refusal):
        shake_hands(sides, profile, we_begin=we_begin, lab=other_labs(profile))


def flipped(name):
    """A change to one field of a message."""

    def change(message):
        value = getattr(message, name)
        return replace(message, **{name: value[:-1] + bytes([value[-1] ^ 1])})

    return change


@pytest.mark.parametrize("field", ["dh2", "challenge1", "hash_c1", "hash_c2", "signature"])
def test_cyclone_refuses_our_reply_if_it_was_changed(sides, field):
    with pytest.raises(RefusedError, match="process_handshake"):
        sides("transition").cyclone_begins(flipped(field))


@pytest.mark.parametrize("field", ["challenge1", "challenge2", "signature"])
def test_cyclone_refuses_our_final_if_it_was_changed(sides, field):
    with pytest.raises(RefusedError, match="process_handshake"):
        sides("transition", we="bob").we_begin(ECDH, flipped(field))


def test_cyclone_refuses_a_post_quantum_request_as_documented(sides):
    with pytest.raises(RefusedError, match="kagree"):
        sides("transition", we="bob").we_begin(HYBRID)


@pytest.mark.parametrize(
    ("policy", "words"),
    [
        (PeerRequirements(agreements=(HYBRID,)), "asks for 'ECDH"),
        (PeerRequirements(agreements=(ECDH,), require_alternative=True), "c.dsign_algo"),
    ],
    ids=["key agreement", "alternative signature"],
)
def test_where_post_quantum_is_required_cyclone_is_refused(sides, policy, words):
    both = sides("transition")
    with pytest.raises(VerificationError, match=words):
        replace(both, terms=replace(both.terms, policy=policy)).cyclone_begins()
