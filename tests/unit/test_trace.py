"""A trace holds all that an implementer needs, in right pieces, and no more than it may."""

import hashlib
import hmac
import json
from base64 import b64decode

import pytest
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from pqsec_pki.algorithms import KEY_AGREEMENTS, PROFILES, SIGNATURES
from pqsec_pki.certificates import Certificate
from pqsec_pki.handshake import GenericMessage, adjusted_guid
from pqsec_pki.selfcheck import HandshakeParty, HandshakeSetup, run_handshake, stack_named
from pqsec_pki.selfcheck.trace import trace
from tests.unit.keystores import NOW, made

NAMES = [profile.name for profile in PROFILES]
HALVES = {
    "x25519mlkem768": [("mlkem768", 1184, 1088), ("x25519", 32, 32)],
    "secp256r1mlkem768": [("ecdh-p256", 65, 65), ("mlkem768", 1184, 1088)],
    "secp384r1mlkem1024": [("ecdh-p384", 97, 97), ("mlkem1024", 1568, 1568)],
}
each_profile = pytest.mark.parametrize("profile", NAMES)


@pytest.fixture(scope="module")
def keystores(tmp_path_factory):
    """keystores["pq"] is one with two participants."""
    folder = tmp_path_factory.mktemp("traces")
    return {name: made(folder / name, name) for name in NAMES}


@pytest.fixture
def traced(keystores):
    """traced("pq", kem=..., stacks=...) is the trace of a handshake between the two."""

    def make(profile, kem=None, stacks=("pqsec", "pqsec"), domain=0):
        setup = HandshakeSetup(
            keystore=keystores[profile],
            domain=domain,
            now=NOW,
            agreement=kem and KEY_AGREEMENTS.named(kem),
        )
        # /talker initiates: its GUID is the smaller one.
        guests = [
            HandshakeParty(name=name, stack=stack_named(stack))
            for name, stack in zip(("/talker", "/listener"), stacks, strict=True)
        ]
        return trace(run_handshake(setup, *guests), lambda data: [f"{len(data)} bytes described"])

    return make


def pieces(told, name):
    """The pieces of the message of that name, by name."""
    [message] = [each for each in told.messages if each.name == name]
    return {each.name: each for each in message.pieces}


def derived(told):
    return {each.name: each for each in told.derived}


# All is there


@each_profile
def test_all_messages_are_told_in_order_and_can_be_replayed(traced, profile):
    told = traced(profile)
    names = ["auth request", "auth request", "request", "reply", "final", "message", "message"]
    assert [each.name for each in told.messages] == names
    assert [each.sample for each in told.messages] == [each.data for each in told.report.sent]
    for each in told.messages[:5]:
        message = GenericMessage.decode(each.sample)
        assert each.header["token_class"] == message.tokens[0].class_id
        assert each.header["destination"] == message.destination_participant.hex()
        found = [(piece.name, piece.data) for piece in each.pieces]
        assert found == list(message.tokens[0].binary_properties)
    for each in told.messages[5:]:
        assert b"".join(piece.data for piece in each.pieces) == each.sample


@each_profile
def test_parts_make_up_the_whole(traced, profile):
    for message in traced(profile).messages:
        for piece in message.pieces:
            assert not piece.parts or b"".join(part.data for part in piece.parts) == piece.data


@pytest.mark.parametrize("kem", HALVES)
def test_the_halves_of_a_hybrid_are_named_in_their_order(traced, kem):
    told = traced("transition", kem)
    for message in ("request", "reply", "final"):
        parts = pieces(told, message)["dh1"].parts
        assert [(part.name, len(part.data)) for part in parts] == [
            (f"{name} public key", size) for name, size, _ in HALVES[kem]
        ]
    for message in ("reply", "final"):
        parts = pieces(told, message)["dh2"].parts
        assert [len(part.data) for part in parts] == [size for *_, size in HALVES[kem]]
        for part, (name, *_) in zip(parts, HALVES[kem], strict=True):
            kind = "ciphertext" if name.startswith("mlkem") else "public key"
            assert part.name == f"{name} {kind}"


@pytest.mark.parametrize("kem", [row.name for row in KEY_AGREEMENTS if row.name not in HALVES])
def test_a_single_key_agreement_is_in_one_piece(traced, kem):
    told = traced("classical", kem)
    assert pieces(told, "request")["dh1"].parts == ()
    assert pieces(told, "request")["dh1"].words == (f"{kem} public key",)


@pytest.mark.parametrize(
    ("profile", "names"),
    [
        ("transition", ["ml-dsa-65", "ecdsa-p256"]),
        ("hybrid", ["ml-dsa-65", "ecdsa-p256"]),
        ("pq", []),
        ("classical", []),
    ],
)
def test_a_signature_of_two_is_parted(traced, profile, names):
    told = traced(profile)
    for message in ("reply", "final"):
        signature = pieces(told, message)["signature"]
        assert [part.name for part in signature.parts] == names
        if names:
            first, second = signature.parts
            assert len(first.data) == SIGNATURES.named("ml-dsa-65").signature_size
            assert second.data.startswith(b"\x30")


# What it means is right


def test_certificates_and_documents_are_described_by_whom_is_asked(traced):
    for message in ("request", "reply"):
        found = pieces(traced("transition", stacks=("opendds", "opendds")), message)
        for name in ("c.id", "c.perm"):
            assert found[name].words == (
                f"{len(found[name].data.rstrip(bytes(1)))} bytes described",
            )


def test_the_guid_is_told(traced):
    told = traced("classical")
    found = pieces(told, "request")
    certificate = Certificate.from_pem(found["c.id"].data)
    guid = found["c.pdata"].words[0].rpartition(" ")[2]
    assert bytes.fromhex(guid)[:6] == adjusted_guid(certificate.subject_der, bytes(16))[:6]


@pytest.mark.parametrize(("stack", "end"), [("pqsec", "and a NUL"), ("fastdds", "without a NUL")])
def test_whether_names_end_in_nul_is_told(traced, stack, end):
    found = pieces(traced("classical", stacks=(stack, "pqsec")), "request")
    assert found["c.dsign_algo"].words == (f"ECDSA-SHA256, {end}",)
    assert found["c.kagree_algo"].words[0].endswith(end)


@each_profile
def test_the_signatures_cover_what_it_says(traced, profile):
    told = traced(profile)
    signers = {"reply": "reply", "final": "request"}
    for message, introduced in signers.items():
        pem = pieces(told, introduced)["c.id"].data
        key = Certificate.from_pem(pem).handshake_keys[0]
        octets = derived(told)[f"signed in the {message}"].data
        key.verify_handshake(pieces(told, message)["signature"].data, octets)
    for name in ("hash_c1", "hash_c2"):
        assert derived(told)[name].data == pieces(told, "final")[name].data


@each_profile
def test_the_secrets_open_the_messages(traced, profile):
    """As another implementer would do it, from the trace alone."""
    told = traced(profile)
    found = {name: piece.data for name, piece in derived(told).items()}
    one, two = (pieces(told, "reply")[f"challenge{number}"].data for number in (1, 2))
    for name, label, (first, second) in (
        ("key exchange salt", b"keyexchange salt", (one, two)),
        ("key exchange key", b"key exchange key", (two, one)),
    ):
        salt = hashlib.sha256(first + label + second).digest()
        assert found[name] == hmac.digest(salt, found["SharedSecret"], "sha256")
    for message in told.messages[5:]:
        way = f"{message.sender} to {message.receiver}"
        part = {each.name: each.data for each in message.pieces}
        session = part["session id"]
        text = b"SessionKey" + found["key exchange salt"] + session
        assert found[f"session key, {way}"] == hmac.digest(
            found["key exchange key"], text, "sha256"
        )
        vector = session + part["initialization vector suffix"]
        size = int.from_bytes(part["length of the ciphertext"])
        sealed = part["ciphertext"][:size] + part["tag"]
        plain = AESGCM(found[f"session key, {way}"]).decrypt(vector, sealed, None)
        assert plain == found[f"plaintext, {way}"]


# What is kept back


SECRETS = {
    "SharedSecret",
    "key exchange salt",
    "key exchange key",
    *(
        f"{what}, {way}"
        for what in ("session key", "plaintext")
        for way in ("/talker to /listener", "/listener to /talker")
    ),
}


def test_secrets_are_named_and_their_values_left_out(traced):
    told = traced("transition")
    assert {each.name for each in told.derived if each.secret} == SECRETS
    text = json.dumps(told.to_json(show_secrets=False))
    for piece in told.derived:
        assert (piece.data.hex() in text) != piece.secret
        assert f'"name": "{piece.name}"' in text
        assert piece.data.hex() not in repr(piece)
        assert str(piece.data) not in repr(told)


def test_secrets_are_shown_only_if_told_to(traced):
    told = traced("transition")
    text = json.dumps(told.to_json(show_secrets=True))
    assert [each.name for each in told.derived if each.data.hex() not in text] == []


@each_profile
def test_no_private_key_is_ever_shown(traced, keystores, profile):
    text = json.dumps(traced(profile).to_json(show_secrets=True))
    paths = list(keystores[profile].root.rglob("*key.pem"))
    assert len(paths) >= 4
    for path in paths:
        lines = path.read_text().splitlines()[1:-1]
        der = b64decode("".join(lines))
        parts = [der[at : at + 16] for at in range(len(der) - 15)] + [
            line.encode() for line in lines
        ]
        assert [part for part in parts if part.hex() in text] == []


# Where it failed


def test_a_trace_ends_where_the_handshake_did(traced):
    """Cyclone DDS refuses the request of Fast DDS."""
    told = traced("classical", stacks=("fastdds", "cyclonedds"))
    assert told.report.failed.name == "reply"
    assert [each.name for each in told.messages][-1] == "request"
    assert told.derived == ()


def test_a_trace_of_a_reply_that_is_refused_has_what_was_signed(traced, keystores):
    """It is too large for that version, which it is known to be after it was made."""
    told = traced("transition", stacks=("pqsec", "fastdds-3.1"))
    assert told.report.failed.name == "reply"
    assert [each.name for each in told.messages][-2:] == ["request", "reply"]
    assert {each.name for each in told.derived} == {
        *("hash_c1", "hash_c2", "signed in the reply", "signed in the final")
    }


def test_a_trace_of_what_never_began_has_no_messages(traced):
    told = traced("classical", domain=7)
    assert told.messages == told.derived == ()
    assert told.to_json(show_secrets=True)["report"]["ok"] is False
