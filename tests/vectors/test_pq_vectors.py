"""Our own post-quantum handshakes, replayed by our code and by a checker that has none of it."""

import json
import struct
import zlib
from base64 import b64decode, b64encode
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path

import pytest
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec, x25519

from pqsec_pki.algorithms import KEY_AGREEMENTS
from pqsec_pki.algorithms._agreement import Hybrid
from pqsec_pki.algorithms._diffie_hellman import ECDH, X25519
from pqsec_pki.certificates import Certificate, verify_authority
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import (
    DataHolder,
    Discovered,
    Final,
    Identity,
    PeerRequirements,
    Reply,
    Request,
    Terms,
    WireVersion,
    begin,
    initiates,
    key_exchange_material,
    reply_to,
    unprotect_submessage,
)
from tests.vectors.handshake import check_pq, make_pq

NOW = datetime(2125, 1, 1, tzinfo=UTC)
FILE = Path(__file__).parent / "handshake" / "pq.json"
MESSAGES = {"request": Request, "reply": Reply, "final": Final}
SENT_FIRST = {"initiator": "request", "replier": "reply"}


@dataclass(frozen=True)
class Vector:
    """One handshake. Where a private key is due it has a stranger's: none was kept."""

    data: dict

    def __str__(self):
        return self.data["name"].replace(" ", "-")

    def __getitem__(self, key):
        return bytes.fromhex(self.data[key])

    def holder(self, which):
        return DataHolder.decode(b64decode(self.data[which]))

    def message(self, which):
        return MESSAGES[which].from_holder(self.holder(which))

    @property
    def agreement(self):
        return KEY_AGREEMENTS.on_wire(self.data["key_agreement"])

    @property
    def ca(self):
        return Certificate.from_pem(self.data["identity_ca"].encode())

    @property
    def is_dual(self):
        return self.ca.alternative_key is not None

    def terms(self, side, peer):
        introduction = self.message(SENT_FIRST[side]).introduction
        certificate = Certificate.from_pem(introduction.certificate)
        own = Identity(
            certificate=certificate,
            key=certificate.public_key.algorithm.generate(),
            ca=self.ca,
            guid=self[f"{side}_guid"],
            permissions=introduction.permissions,
        )
        policy = PeerRequirements(
            agreements=(self.agreement,),
            versions=(introduction.version,),
            require_alternative=self.is_dual,
        )
        return Terms(own=own, policy=policy, discovered=Discovered(guid=self[f"{peer}_guid"]))

    @cached_property
    def request_sent(self):
        """The initiator as it was when it waited for the Reply."""
        request = self.message("request")
        pair = key_pair(self.agreement, self.data["initiator_ephemeral"])
        _, waiting = begin(self.terms("initiator", "replier"), self.agreement)
        return replace(waiting, request=request, hash_c1=self["hash_c1"], key_pair=pair)

    @cached_property
    def reply_sent(self):
        """The replier, waiting for the Final; what it derived is not that of the vector."""
        _, waiting = self.answer(self.message("request"))
        return replace(waiting, transcript=self.transcript)

    @property
    def transcript(self):
        return self.request_sent._transcript(self.message("reply"))

    def answer(self, request):
        """What the replier would answer today."""
        return reply_to(self.terms("replier", "initiator"), request, now=NOW)

    def finish(self, reply):
        """How it ends for the initiator."""
        return self.request_sent.receive(reply, now=NOW)[1]


def key_pair(row, kept):
    """The ephemeral key that was kept."""
    match row:
        case Hybrid():
            handle = key_pair(row.first, kept), key_pair(row.second, kept)
        case ECDH():
            handle = ec.derive_private_key(int(kept["ecdh"], 16), row.curve)
        case X25519():
            handle = x25519.X25519PrivateKey.from_private_bytes(bytes.fromhex(kept["x25519"]))
        case _:
            handle = row.private.from_seed_bytes(bytes.fromhex(kept["ml_kem_seed"]))
    return row.key_pair(handle)


VECTORS = [Vector(data) for data in json.loads(FILE.read_text())]
SECOND = [Vector(data) for data in json.loads(FILE.with_name("second.json").read_text())]
second = pytest.mark.parametrize("vector", SECOND, ids=str)
every = pytest.mark.parametrize("vector", VECTORS, ids=str)
every_message = pytest.mark.parametrize("which", MESSAGES)


def test_the_file_has_every_kind_of_identity_with_every_kind_of_agreement():
    assert {vector.data["signature_algorithm"] for vector in VECTORS} == set(check_pq.SIGNATURES)
    assert {vector.data["key_agreement"] for vector in VECTORS} == set(check_pq.HALVES)
    post_quantum = {row.wire_name for row in KEY_AGREEMENTS if row.binds_transcript}
    assert post_quantum == set(check_pq.HALVES)
    assert len(set(map(str, VECTORS))) == len(VECTORS) == 9


def test_the_file_has_no_identity_key():
    assert "PRIVATE" not in FILE.read_text()
    assert {name for vector in VECTORS for name in vector.data["initiator_ephemeral"]} == {
        *("ml_kem_seed", "x25519", "ecdh")
    }


# With our code


@every
@every_message
def test_messages_are_read_and_written_octet_for_octet(vector, which):
    octets = b64decode(vector.data[which])
    assert vector.holder(which).encode() == octets
    assert vector.message(which).to_holder().encode() == octets


@every
def test_the_identity_ca_and_who_begins_are_right(vector):
    verify_authority(vector.ca, now=NOW)
    assert initiates(vector["initiator_guid"], vector["replier_guid"])


@every
def test_hashes_and_signed_octets_are_as_recorded(vector):
    request, reply = vector.message("request"), vector.message("reply")
    assert request.introduction.digest() == request.hash_c1 == vector["hash_c1"]
    assert reply.introduction.digest() == reply.hash_c2 == vector["hash_c2"]
    transcript = vector.transcript
    assert check_pq.sha256(transcript.reply_octets()) == vector["signed_reply_sha256"]
    assert check_pq.sha256(transcript.final_octets()) == vector["signed_final_sha256"]


@every
def test_the_handshake_ends_with_the_recorded_secret_and_keys(vector):
    reply, pair = vector.message("reply"), vector.request_sent.key_pair
    done = vector.finish(reply)
    assert pair.public == vector.message("request").dh1
    assert pair.decapsulate(reply.dh2) == vector["secret"]
    assert done.shared_secret == vector["shared_secret"]
    assert done.peer.guid == vector["replier_guid"]
    material = key_exchange_material(done)
    assert (material.salt, material.sender_key) == (vector["kx_salt"], vector["kx_key"])
    opened = unprotect_submessage(material, vector["protected_submessage"])
    assert opened == vector["submessage"] == make_pq.SUBMESSAGE


@every
def test_the_replier_takes_request_and_final(vector):
    assert vector.reply_sent.receive(vector.message("final")).peer.guid == vector["initiator_guid"]


def altered(holder):
    """`holder` with one octet changed, in the middle and at the end of each property."""
    items = holder.binary_properties
    for at, (name, value) in enumerate(items):
        # A pair's signature ends with that of the plain key.
        for octet in (len(value) // 2, len(value) - 1):
            changed = (name, flipped(value, octet))
            yield name, replace(holder, binary_properties=(*items[:at], changed, *items[at + 1 :]))


def flipped(octets, at):
    return octets[:at] + bytes([octets[at] ^ 1]) + octets[at + 1 :]


@every
def test_an_altered_request_is_refused(vector):
    for name, holder in altered(vector.holder("request")):
        # Nothing in the Request vouches for these two; the Reply will show the change.
        if name not in ("dh1", "challenge1"):
            with pytest.raises(VerificationError):
                vector.answer(Request.from_holder(holder))


@every
def test_an_altered_reply_is_refused(vector):
    for _, holder in altered(vector.holder("reply")):
        with pytest.raises(VerificationError):
            vector.finish(Reply.from_holder(holder))


@every
def test_an_altered_final_is_refused(vector):
    for _, holder in altered(vector.holder("final")):
        with pytest.raises(VerificationError):
            vector.reply_sent.receive(Final.from_holder(holder))


# Without our code


@every
def test_the_checker_that_has_none_of_our_code_agrees(vector):
    check_pq.check(vector.data)


@every
@every_message
def test_the_checker_refuses_an_altered_token(vector, which):
    octets = b64decode(vector.data[which])
    for at in range(5, len(octets), len(octets) // 7):
        spoilt = vector.data | {which: b64encode(flipped(octets, at)).decode()}
        with pytest.raises((check_pq.WrongError, InvalidSignature, ValueError, struct.error)):
            check_pq.check(spoilt)


@every
def test_the_checker_refuses_another_value_for_each_step(vector):
    for name in check_pq.recomputed(vector.data):
        with pytest.raises(check_pq.WrongError, match=name):
            check_pq.check(vector.data | {name: "00"})


@every
def test_a_handshake_held_today_passes_the_checker(vector):
    made = make_pq.vector(*make_pq.SUITES[VECTORS.index(vector)])
    check_pq.check(made)
    assert list(made) == list(vector.data)
    assert made["name"] == vector.data["name"]


# The second version


@second
def test_the_second_version_is_read_and_ends_as_recorded(vector):
    for which in MESSAGES:
        assert vector.message(which).version is WireVersion.SECOND
    request, reply = vector.message("request"), vector.message("reply")
    assert request.introduction.digest() == vector["hash_c1"]
    assert reply.introduction.digest() == vector["hash_c2"]
    done = vector.finish(reply)
    assert done.shared_secret == vector["shared_secret"]
    assert vector.reply_sent.receive(vector.message("final")).peer.guid == vector["initiator_guid"]


@second
def test_an_altered_message_of_the_second_version_is_refused(vector):
    for which, take in (("request", vector.answer), ("reply", vector.finish)):
        for name, holder in altered(vector.holder(which)):
            if (which, name) not in (("request", "dh1"), ("request", "ch1")):
                with pytest.raises(VerificationError):
                    refused_or_differs(vector, which, take, MESSAGES[which].from_holder(holder))
    for _, holder in altered(vector.holder("final")):
        with pytest.raises(VerificationError):
            vector.reply_sent.receive(Final.from_holder(holder))


def refused_or_differs(vector, which, take, message):
    """A Request with other permissions gets an answer, to another hash than the initiator's."""
    take(message)
    if which == "request" and message.introduction.digest() != vector["hash_c1"]:
        raise VerificationError("answered, and the initiator will refuse the signature")


@second
def test_the_checker_agrees_on_the_second_version_and_refuses_what_is_altered(vector):
    check_pq.check(vector.data)
    for name in check_pq.recomputed(vector.data):
        with pytest.raises(check_pq.WrongError, match=name):
            check_pq.check(vector.data | {name: "00"})
    for which in MESSAGES:
        octets = b64decode(vector.data[which])
        for at in range(5, len(octets), len(octets) // 7):
            spoilt = vector.data | {which: b64encode(flipped(octets, at)).decode()}
            with pytest.raises(
                (check_pq.WrongError, InvalidSignature, ValueError, struct.error, zlib.error)
            ):
                check_pq.check(spoilt)


@second
def test_a_handshake_of_the_second_version_held_today_passes_the_checker(vector):
    suite = make_pq.SECOND_SUITES[SECOND.index(vector)]
    made = make_pq.vector(*suite, WireVersion.SECOND)
    check_pq.check(made)
    assert made["name"] == vector.data["name"]
