"""Handshakes that were held with real stacks, replayed without them."""

import json
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from pqsec_pki.algorithms import KEY_AGREEMENTS, load_private_key
from pqsec_pki.algorithms._diffie_hellman import ModpKey
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import (
    AuthRequest,
    DataHolder,
    Discovered,
    Done,
    Final,
    Identity,
    IdentityToken,
    KeyMaterial,
    PeerRequirements,
    Reply,
    ReplySent,
    Request,
    RequestSent,
    Sender,
    Terms,
    Transcript,
    TransformationKind,
    adjusted_guid,
    belongs_to,
    key_exchange_material,
    participant_guid,
    reply_to,
    unprotect_payload,
    unprotect_submessage,
)

NOW = datetime(2030, 1, 1, tzinfo=UTC)
FILE = Path(__file__).parent / "handshake" / "real_stacks.json"


@dataclass(frozen=True)
class Capture:
    """One handshake. Alice is who recorded it, Bob is the stack's plugin."""

    data: dict

    def __str__(self):
        return "-".join(self.data[key] for key in ("stack", "kagree", "python_role"))

    def __getitem__(self, key):
        return self.data[key]

    def octets(self, key):
        return bytes.fromhex(self.data[key])

    def holder(self, key):
        return DataHolder.decode(bytes.fromhex(self.data[key]["cdr_be"]))

    def certificate(self, name):
        return Certificate.from_pem(self.data[f"{name}_pem"].encode())

    @cached_property
    def request(self):
        return Request.from_holder(self.holder("request"))

    @cached_property
    def reply(self):
        return Reply.from_holder(self.holder("reply"))

    @cached_property
    def final(self):
        return Final.from_holder(self.holder("final"))

    @property
    def we_began(self):
        return self.data["python_role"] == "initiator"

    @property
    def agreement(self):
        return KEY_AGREEMENTS.on_wire(self.data["kagree"])

    @property
    def key_pair(self):
        """The ephemeral key that was Alice's."""
        kept = self.data["python_ephemeral"]
        if "modp_x" in kept:
            own = self.request.dh1 if self.we_began else self.reply.dh2
            handle = ModpKey(int(kept["modp_x"], 16), der=len(own) > 256)
        else:
            handle = load_pem_private_key(kept["ec_pkcs8_pem"].encode(), None)
        return self.agreement.key_pair(handle)

    @property
    def transcript(self):
        return Transcript(
            hash_c1=self.request.introduction.digest(),
            hash_c2=self.reply.introduction.digest(),
            challenge1=self.request.challenge1,
            challenge2=self.reply.challenge2,
            dh1=self.request.dh1,
            dh2=self.reply.dh2,
        )

    @property
    def alice(self):
        certificate = self.certificate("alice")
        own = self.request if self.we_began else self.reply
        return Identity(
            certificate=certificate,
            key=load_private_key(self.data["alice_key_pem"].encode()),
            ca=self.certificate("ca"),
            guid=participant_guid(own.introduction.participant_data),
            permissions=own.introduction.permissions,
        )

    @cached_property
    def terms(self):
        """Alice's, who has discovered Bob and, if he sent one, read his AuthRequest."""
        announced = None
        if "bob_auth_request" in self.data:
            announced = AuthRequest.from_holder(self.holder("bob_auth_request")).future_challenge
        return Terms(
            own=self.alice,
            policy=PeerRequirements(agreements=tuple(KEY_AGREEMENTS)),
            discovered=Discovered(guid=self.octets("bob_guid"), future_challenge=announced),
        )

    @cached_property
    def waiting(self):
        """Alice as she was when she waited for Bob's next message."""
        if self.we_began:
            return RequestSent(
                terms=self.terms,
                request=self.request,
                hash_c1=self.request.introduction.digest(),
                key_pair=self.key_pair,
            )
        peer, key = self.terms.admit(self.request.introduction, NOW, others=())
        outcome = Done(
            peer=peer,
            agreement=self.agreement,
            challenge1=self.request.challenge1,
            challenge2=self.reply.challenge2,
            shared_secret=self.agreement.shared_secret(
                self.key_pair.decapsulate(self.request.dh1), self.transcript.reply_octets()
            ),
        )
        return ReplySent(transcript=self.transcript, peer_key=key, _outcome=outcome)

    def finish(self, holder=None):
        """How it ends for Alice, with Bob's last message as it was, or `holder` instead."""
        if self.we_began:
            reply = Reply.from_holder(holder or self.holder("reply"))
            return self.waiting.receive(reply, now=NOW)[1]
        return self.waiting.receive(Final.from_holder(holder or self.holder("final")))

    def answer(self, holder):
        """What Alice would reply to Bob's Request `holder`, if she knew his challenge1."""
        known = Discovered(future_challenge=self.request.challenge1)
        terms = replace(self.terms, discovered=known)
        return reply_to(terms, Request.from_holder(holder), now=NOW)


CAPTURES = [Capture(data) for data in json.loads(FILE.read_text())]
OF_CYCLONE = [capture for capture in CAPTURES if capture["stack"] == "cyclone"]
BEGUN_BY_BOB = [capture for capture in CAPTURES if not capture.we_began]
every = pytest.mark.parametrize("capture", CAPTURES, ids=str)
every_cyclone = pytest.mark.parametrize("capture", OF_CYCLONE, ids=str)


def test_there_are_captures_of_both_stacks_both_roles_and_both_agreements():
    seen = {(c["stack"], c["python_role"]) for c in CAPTURES}
    assert len(seen) == 4
    assert {c["kagree"] for c in CAPTURES} == {"ECDH+prime256v1-CEUM", "DH+MODP-2048-256"}
    assert len(CAPTURES) == 7


@every
@pytest.mark.parametrize("name", ["request", "reply", "final"])
def test_messages_are_read_and_written_octet_for_octet(capture, name):
    holder = capture.holder(name)
    assert holder.encode().hex() == capture[name]["cdr_be"]
    items = [[key, value.hex()] for key, value in holder.binary_properties]
    assert items == capture[name]["binary_properties"]
    ours = getattr(capture, name).to_holder()
    assert sorted(ours.binary_properties) == sorted(holder.binary_properties)


@every
def test_hashes_are_those_that_the_stack_computed(capture):
    assert capture.request.introduction.digest() == capture.octets("hash_c1")
    assert capture.reply.introduction.digest() == capture.octets("hash_c2")
    assert capture.reply.hash_c1 == capture.octets("hash_c1")
    assert capture.reply.hash_c2 == capture.octets("hash_c2")


@every
def test_signed_octets_are_those_that_the_stack_signed(capture):
    assert capture.transcript.reply_octets() == capture.octets("signed_reply")
    assert capture.transcript.final_octets() == capture.octets("signed_final")


@every
def test_both_signatures_verify_and_not_for_each_other(capture):
    ours, theirs = (capture.certificate(name).public_key for name in ("alice", "bob"))
    initiator, replier = (ours, theirs) if capture.we_began else (theirs, ours)
    replier.verify_handshake(capture.reply.signature, capture.octets("signed_reply"))
    initiator.verify_handshake(capture.final.signature, capture.octets("signed_final"))
    with pytest.raises(VerificationError):
        replier.verify_handshake(capture.reply.signature, capture.octets("signed_final"))
    with pytest.raises(VerificationError):
        initiator.verify_handshake(capture.reply.signature, capture.octets("signed_reply"))


@every
def test_the_handshake_ends_as_it_did_with_the_stacks_secret(capture):
    done = capture.finish()
    assert done.shared_secret == capture.octets("shared_secret")
    assert done.peer.certificate.der == capture.certificate("bob").der
    assert done.peer.guid == capture.octets("bob_guid")
    assert done.peer.permissions == b"perm of bob"


@every
def test_key_exchange_keys_are_those_of_the_stack(capture):
    material = key_exchange_material(capture.finish())
    assert material.sender_key == capture.octets("kx_master_sender_key")
    assert material.salt == capture.octets("kx_master_salt")


@every_cyclone
def test_what_the_stack_protected_is_read(capture):
    material = key_exchange_material(capture.finish())
    sealed = capture.octets("kx_submessage_encoded")
    assert unprotect_submessage(material, sealed) == capture.octets("kx_submessage_plain")
    changed = sealed[:-25] + bytes([sealed[-25] ^ 1]) + sealed[-24:]
    with pytest.raises(VerificationError, match="different keys"):
        unprotect_submessage(material, changed)


@every_cyclone
def test_what_we_protect_looks_like_what_the_stack_protects(capture):
    material = key_exchange_material(capture.finish())
    theirs = capture.octets("kx_submessage_encoded")
    ours = Sender(material).protect_submessage(capture.octets("kx_submessage_plain"))
    # Kind and key id; then the frames. Flags and lengths are of another byte order.
    assert ours[4:12] == theirs[4:12]
    assert len(ours) == len(theirs)
    assert [ours[at] for at in (0, 24, 60)] == [theirs[at] for at in (0, 24, 60)]


@every_cyclone
def test_crypto_tokens_of_the_stack_are_read_and_written(capture):
    tokens = [capture["participant_crypto_token"], *capture["datawriter_crypto_tokens"]]
    for token in tokens:
        holder = DataHolder.decode(bytes.fromhex(token["cdr_be"]))
        material = KeyMaterial.from_holder(holder)
        assert material.kind is TransformationKind.AES256_GCM
        assert material.to_holder() == holder


@every_cyclone
def test_a_payload_that_the_stack_protected_is_read_with_the_key_that_it_names(capture):
    tokens = [bytes.fromhex(token["cdr_be"]) for token in capture["datawriter_crypto_tokens"]]
    keys = [KeyMaterial.from_holder(DataHolder.decode(token)) for token in tokens]
    sealed = capture.octets("payload_encoded")
    [key] = [each for each in keys if each.sender_key_id == sealed[4:8]]
    assert unprotect_payload(key, sealed) == capture.octets("payload_plain")


@every
def test_the_guid_of_the_stack_belongs_to_its_subject(capture):
    subject = capture.certificate("bob").subject_der
    guid, candidate = capture.octets("bob_guid"), capture.octets("candidate_guid_bob")
    assert belongs_to(guid, subject)
    ours = adjusted_guid(subject, candidate)
    # Cyclone DDS hashes twelve bytes of the candidate where we and Fast DDS hash sixteen.
    same = range(16) if capture["stack"] == "fastdds" else (*range(6), *range(12, 16))
    assert [ours[at] for at in same] == [guid[at] for at in same]


@every
def test_the_identity_token_of_the_stack_is_read(capture):
    said = tuple(map(tuple, capture["bob_identity_token"]))
    token = IdentityToken.from_holder(DataHolder("DDS:Auth:PKI-DH:1.0", said))
    ours = IdentityToken.of(capture.certificate("bob"), capture.certificate("ca"))
    assert (token.subject, token.ca_subject) == (ours.subject, ours.ca_subject)
    if capture["stack"] == "cyclone":
        assert token == ours
    else:
        # Fast DDS 2.9 has names of signature algorithms there.
        name = capture.certificate("bob").public_key.algorithm.wire_name
        assert (token.algorithm, token.ca_algorithm) == (name, name)


@pytest.mark.parametrize("capture", BEGUN_BY_BOB, ids=str)
def test_the_stacks_request_is_answered_in_its_own_manner(capture):
    reply, _ = reply_to(capture.terms, capture.request, now=NOW)
    theirs, ours = capture.request.introduction, reply.introduction
    assert ours.ends_names_in_nul == theirs.ends_names_in_nul
    assert ours.key_agreement == theirs.key_agreement
    if capture["kagree"] == "DH+MODP-2048-256":
        assert len(reply.dh2) <= 256, "Fast DDS cannot read a DER INTEGER"


def spoilt(message):
    """Each way to change one property of `message`, or to take away one that it needs."""
    holder = message.to_holder()
    optional = {f.name for f in fields(message) if f.default is None}
    for at, (name, value) in enumerate(holder.binary_properties):
        for octet in {0, len(value) // 2, len(value) - 1}:
            changed = value[:octet] + bytes([value[octet] ^ 1]) + value[octet + 1 :]
            yield _with(holder, at, (name, changed))
        yield _with(holder, at, (name, value[:-1]))
        yield _with(holder, at, (name, value), (name, value))
        if name not in optional:
            yield _with(holder, at)


def _with(holder, at, *items):
    before, after = holder.binary_properties[:at], holder.binary_properties[at + 1 :]
    return replace(holder, binary_properties=(*before, *items, *after))


@every
def test_every_changed_property_of_the_stacks_last_message_is_refused(capture):
    message = capture.reply if capture.we_began else capture.final
    for holder in spoilt(message):
        with pytest.raises(VerificationError):
            capture.finish(holder)


@pytest.mark.parametrize("capture", BEGUN_BY_BOB, ids=str)
def test_every_changed_property_of_the_stacks_request_is_refused(capture):
    for holder in spoilt(capture.request):
        with pytest.raises(VerificationError):
            capture.answer(holder)
