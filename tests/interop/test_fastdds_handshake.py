"""Our handshake with Fast DDS's own: either begins, both end with the same secret."""

from dataclasses import fields, replace

import pytest

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KEY_AGREEMENTS, MODP_RAW
from pqsec_pki.algorithms._diffie_hellman import G, P
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import (
    DataHolder,
    IdentityToken,
    KeyMaterial,
    PeerRequirements,
    PermissionsToken,
    Sender,
    adjusted_guid,
    initiates,
    key_exchange_material,
    unprotect_submessage,
)
from tests.interop.conftest import STOCK
from tests.interop.credentials import enrolled
from tests.interop.fastdds import participant
from tests.interop.fastdds_meeting import ECDH, MODP, identity, refused, token

pytestmark = pytest.mark.interop

HYBRID = KEY_AGREEMENTS.named("x25519mlkem768")
ECDSA, RSA, P384 = "ECDSA-SHA256", "RSASSA-PSS-SHA256", "ECDSA+P384+SHA384"
SUBMESSAGE = bytes.fromhex("15050c00 00001000 00000000 00000000")
"""DATA, little-endian."""


BEGINNINGS = {
    "we begin, ECDH": ("bob", ECDH),
    "we begin, DH-MODP": ("bob", MODP_RAW),
    # Fast DDS begins with nothing else.
    "Fast DDS begins, DH-MODP": ("alice", MODP),
}


@pytest.mark.parametrize("beginning", BEGINNINGS)
@pytest.mark.parametrize("profile", STOCK)
def test_both_ends_agree_and_go_on(meet_fastdds, labs, now, profile, beginning):
    we, agreement = BEGINNINGS[beginning]
    both = meet_fastdds(profile, we=we)
    done, handshake = both.we_begin(now, agreement) if we == "bob" else both.fastdds_begins(now)
    both.agree(done, handshake)

    theirs = labs(profile).bob if we == "alice" else labs(profile).alice
    assert done.agreement is agreement
    assert done.peer.certificate.pem == (theirs / "cert.pem").read_bytes()
    assert done.peer.permissions == (theirs / "permissions.p7s").read_bytes()

    material = key_exchange_material(done)
    protected = both.fastdds.protect(handshake, SUBMESSAGE)
    assert unprotect_submessage(material, protected) == SUBMESSAGE
    protected = Sender(material).protect_submessage(SUBMESSAGE)
    assert both.fastdds.unprotect(handshake, protected) == SUBMESSAGE
    assert KeyMaterial.from_holder(DataHolder(*both.fastdds.keys(handshake))).sender_key


def test_fastdds_refuses_what_we_protected_if_any_byte_was_changed(meet_fastdds, now):
    both = meet_fastdds(we="bob")
    done, handshake = both.we_begin(now)
    protected = Sender(key_exchange_material(done)).protect_submessage(SUBMESSAGE)
    for at, octet in enumerate(protected):
        spoilt = protected[:at] + bytes([octet ^ 1]) + protected[at + 1 :]
        with refused("decode_datawriter_submessage", ""):
            both.fastdds.unprotect(handshake, spoilt)


def test_fastdds_asks_for_dh_modp_whatever_it_is_told(fastdds, labs):
    """2.9.1 has no preferred_key_agreement; 2.10.7, 2.14.5, 3.0.2 and 3.1.1 have."""
    own = identity(labs("transition").alice, {})
    introduced = own.guid, token(IdentityToken.announced(own.certificate, own.ca, KEY_AGREEMENTS))
    for wish in ("ECDH", ECDH.wire_name):
        folder = labs("transition").bob
        with participant(fastdds, folder, preferred_key_agreement=wish) as bob:
            _, request = bob.request(bob.meet(*introduced))
        assert dict(request.binary)["c.kagree_algo"].decode() == MODP.wire_name


def test_fastdds_reads_no_dh_modp_in_der(meet_fastdds, now):
    both = meet_fastdds(we="bob")
    with refused("process_handshake", "OpenSSL library cannot set peer"):
        both.we_begin(now, MODP)


@dataclass(frozen=True, kw_only=True)
class ShortSecret(type(MODP)):
    """A replier's DH-MODP whose secret begins with a zero byte."""

    def encapsulate(self, public):
        peer = secret = int.from_bytes(public)
        own = G
        while secret.bit_length() > 8 * 255:
            own, secret = own * G % P, secret * peer % P
        return tuple(each.to_bytes(256).lstrip(b"\0") for each in (own, secret))


def test_a_dh_modp_secret_that_begins_with_a_zero_is_hashed_without_it(meet_fastdds, now):
    row = ShortSecret(**{each.name: getattr(MODP, each.name) for each in fields(MODP)})
    both = meet_fastdds(we="alice", policy=PeerRequirements(agreements=(row,)))
    both.agree(*both.fastdds_begins(now))


@pytest.mark.parametrize("we", ["alice", "bob"])
def test_we_know_fastdds_guids_and_who_begins(meet_fastdds, labs, we):
    both = meet_fastdds(we=we)
    theirs = labs("transition").bob if we == "alice" else labs("transition").alice
    subject = Certificate.from_pem((theirs / "cert.pem").read_bytes()).subject_der
    assert both.fastdds.guid == adjusted_guid(subject, both.fastdds.candidate)
    assert initiates(both.fastdds.guid, both.terms.own.guid) == both.meeting.begins
    assert both.meeting.begins == (we == "alice")


STRANGER = ("identity_ca.cert.pem", "cert.pem", "key.pem")


@pytest.mark.parametrize("we", ["alice", "bob"])
@pytest.mark.parametrize("profile", STOCK)
def test_a_peer_of_another_identity_ca_is_refused(meet_fastdds, other_labs, now, profile, we):
    folder = other_labs(profile).alice.with_name(we)
    files = {name: (folder / name).read_bytes() for name in STRANGER}
    both = meet_fastdds(profile, we=we, ours=files)
    if we == "bob":
        with refused("begin_handshake_reply", "Invalidation error of certificate"):
            both.we_begin(now)
    else:
        with pytest.raises(VerificationError, match="not signed by this CA"):
            both.fastdds_begins(now)


def test_a_peer_with_the_permissions_of_another_is_not_admitted(meet_fastdds, labs, now):
    alices = (labs("transition").alice / "permissions.p7s").read_bytes()
    both = meet_fastdds(we="bob", ours={"permissions.p7s": alices})
    done, handshake = both.we_begin(now)
    with refused("validate_remote_permissions", "Remote participant doesn't found in its perm"):
        both.agree(done, handshake)


def test_a_permissions_token_by_the_specification_is_refused(meet_fastdds, labs, now):
    """Fast DDS 2.9.1 calls a CA's key by its signatures, and compares what is there."""
    both = meet_fastdds(we="bob")
    _, handshake = both.we_begin(now)
    ca = Certificate.from_pem((labs("transition").bob / "permissions_ca.cert.pem").read_bytes())
    ours = PermissionsToken(ca.subject_text, ca.public_key.algorithm.token_name)
    words = "Remote participant PermissionsCA algorithm differs from local"
    with refused("validate_remote_permissions", words):
        both.fastdds.admit(both.meeting, handshake, token(ours))
    theirs = replace(ours, ca_algorithm=ca.public_key.algorithm.wire_name)
    both.fastdds.admit(both.meeting, handshake, token(theirs))


@pytest.mark.parametrize("we", ["alice", "bob"])
@pytest.mark.parametrize(
    ("kinds", "name"),
    [
        (("rsa-2048", "ecdsa-p256"), RSA),
        (("ecdsa-p256", "rsa-2048"), ECDSA),
        (("ecdsa-p256", "ecdsa-p384"), ECDSA),
    ],
    ids=["RSA for P-256", "P-256 for RSA", "P-256 for P-384"],
)
def test_fastdds_names_its_key_by_the_ca_and_we_refuse_that(meet_fastdds, now, kinds, name, we):
    ours, theirs = enrolled(*kinds, now, we, "bob" if we == "alice" else "alice")
    both = meet_fastdds("classical", we=we, ours=ours, theirs=theirs)
    if kinds[1] == "ecdsa-p384":  # or it would not answer at all
        both = both.saying(signature_algorithm=ECDSA.encode())
    begins = both.fastdds_begins if we == "alice" else both.we_begin
    with pytest.raises(VerificationError, match=f"c.dsign_algo '{name}' does not match"):
        begins(now)


def test_fastdds_knows_no_name_for_p384(meet_fastdds, now):
    ours, theirs = enrolled("ecdsa-p256", "ecdsa-p384", now, "bob", "alice")
    both = meet_fastdds("classical", we="bob", ours=ours, theirs=theirs)
    with refused("begin_handshake_reply", f"Not supported signature algorithm ({P384}"):
        both.we_begin(now)


def test_fastdds_refuses_a_post_quantum_request_as_documented(meet_fastdds, now):
    with refused("begin_handshake_reply", "Not supported key agreement algorithm (X25519MLKEM768"):
        meet_fastdds(we="bob").we_begin(now, HYBRID)


@pytest.mark.parametrize(
    ("policy", "words"),
    [
        (PeerRequirements(agreements=(HYBRID,)), "asks for 'DH"),
        (PeerRequirements(agreements=(MODP,), require_alternative=True), "c.dsign_algo"),
    ],
    ids=["key agreement", "alternative signature"],
)
def test_where_post_quantum_is_required_fastdds_is_refused(meet_fastdds, now, policy, words):
    with pytest.raises(VerificationError, match=words):
        meet_fastdds(we="alice", policy=policy).fastdds_begins(now)
