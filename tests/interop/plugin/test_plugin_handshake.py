"""The plugin's handshake, in C and out of it: with itself, and with Cyclone DDS's own plugin.

The library is loaded as Cyclone DDS loads it, and called as it calls it.
"""

import os
import shutil

import pytest

from pqsec_pki.algorithms import load_private_key, private_key_pem
from pqsec_pki.certificates import Reason
from pqsec_pki.lifecycle import revoke
from tests.interop.conftest import LAB_PROFILES, STOCK, YEAR, Lab
from tests.interop.cyclone import RefusedError, participant
from tests.interop.plugin.couple import DOMAIN, couple

pytestmark = pytest.mark.interop

STOCK_PEERS = 'peers = "stock"\n'
FIELDS = {
    "request": ("c.id", "c.perm", "c.pdata", "c.dsign_algo", "c.kagree_algo", "dh1", "challenge1"),
    "reply": ("c.id", "c.perm", "c.pdata", "dh2", "challenge1", "challenge2", "signature"),
    "final": ("challenge1", "challenge2", "dh1", "dh2", "hash_c1", "hash_c2", "signature"),
}


@pytest.fixture
def beside_cyclone(shim, plugins, labs):
    """beside_cyclone(profile, "alice") is alice with our plugin, and bob with Cyclone's own."""

    def sides(profile, we):
        ours = labs(profile).alice.with_name(we)
        theirs = ours.with_name("bob" if we == "alice" else "alice")
        return (shim.folder, ours), (plugins, theirs)

    return sides


@pytest.mark.slow(but=3)
@pytest.mark.parametrize("profile", LAB_PROFILES)
def test_two_with_the_plugin_meet(shim, labs, profile):
    lab = labs(profile)
    with couple((shim.folder, lab.alice), (shim.folder, lab.bob)) as both:
        both.agree(both.shake_hands())


@pytest.mark.parametrize("we", ["alice", "bob"])
@pytest.mark.parametrize("profile", STOCK)
def test_it_meets_cyclones_own_plugin_whoever_begins(beside_cyclone, settings, profile, we):
    ours, theirs = beside_cyclone(profile, we)
    with couple((ours[0], settings(ours[1], STOCK_PEERS)), theirs) as both:
        both.agree(both.shake_hands())


@pytest.mark.parametrize("we", ["alice", "bob"])
def test_a_transition_identity_wants_both_signatures_unless_told(beside_cyclone, we):
    sides = beside_cyclone("transition", we)
    with couple(*sides) as both, pytest.raises(RefusedError):
        both.shake_hands()


@pytest.mark.parametrize("profile", ["pq", "hybrid", "cnsa2"])
def test_cyclones_own_plugin_is_refused_by_post_quantum_peers(shim, plugins, labs, profile):
    ours, theirs = labs(profile).alice, labs("classical").bob
    with couple((shim.folder, ours), (plugins, theirs)) as both, pytest.raises(RefusedError):
        both.shake_hands()


def test_a_peer_may_ask_only_for_what_is_allowed(shim, labs, settings):
    lab = labs("pq")
    other = settings(lab.bob, 'key_agreements = ["x25519mlkem768"]\n')
    sides = (shim.folder, lab.alice), (shim.folder, other)
    with couple(*sides) as both, pytest.raises(RefusedError, match="the peer asks for"):
        both.shake_hands()
    agreed = settings(lab.alice, 'key_agreements = ["mlkem768", "x25519mlkem768"]\n')
    # bob begins, with what alice allows too
    with couple((shim.folder, agreed), (shim.folder, other)) as both:
        both.agree(both.shake_hands())


SECOND_VERSION = "wire_versions = [2, 1]\n"


@pytest.mark.parametrize("profile", ["transition", "pq"])
def test_two_with_the_second_version_use_it_and_meet_one_without(shim, labs, settings, profile):
    lab, seen = labs(profile), []

    def watched(name, token):
        seen.append("ver" in dict(token.binary))
        return token

    ours, theirs = (settings(each, SECOND_VERSION) for each in (lab.alice, lab.bob))
    for alice, bob, used in (
        (ours, theirs, True),
        (ours, lab.bob, False),
        (lab.alice, theirs, False),
    ):
        seen.clear()
        with couple((shim.folder, alice), (shim.folder, bob)) as both:
            both.agree(both.shake_hands(watched))
        assert seen == [used] * 3


def test_one_who_allows_the_second_version_only_meets_no_other(shim, labs, settings):
    lab = labs("pq")
    only = settings(lab.alice, "wire_versions = [2]\n"), settings(lab.bob, "wire_versions = [2]\n")
    for sides in ((only[0], lab.bob), (lab.alice, only[1])):
        refused = pytest.raises(RefusedError, match="version")
        with couple(*((shim.folder, each) for each in sides)) as both, refused:
            both.shake_hands()


def flipped(token, name):
    binary = [
        (each, value[:-9] + bytes([value[-9] ^ 1]) + value[-8:] if each == name else value)
        for each, value in token.binary
    ]
    assert tuple(binary) != token.binary
    return token._replace(binary=tuple(binary))


@pytest.mark.parametrize(
    ("message", "name"), [(message, name) for message in FIELDS for name in FIELDS[message]]
)
def test_a_changed_bit_ends_the_handshake(shim, labs, message, name):
    """And the true message, should it come after all, still is good where it was waited for."""
    lab = labs("pq")

    def relay(sent, token):
        return flipped(token, name) if sent == message else token

    with couple((shim.folder, lab.alice), (shim.folder, lab.bob)) as both:
        with pytest.raises(RefusedError):
            both.shake_hands(relay)
        both.agree(both.shake_hands())


def test_a_message_is_good_after_a_forged_one_was_refused(shim, labs):
    lab = labs("pq")
    with couple((shim.folder, lab.alice), (shim.folder, lab.bob)) as both:
        one, other = both.first, both.second
        begun, request = one.participant.request(one.meeting)
        answered, reply = other.participant.reply(other.meeting, request)
        with pytest.raises(RefusedError, match="signature"):
            one.participant.process(begun, flipped(reply, "signature"))
        final = one.participant.process(begun, reply)
        with pytest.raises(RefusedError, match="signature"):
            other.participant.process(answered, flipped(final, "signature"))
        assert other.participant.process(answered, final) is None
        both.agree((begun, answered))
        with pytest.raises(RefusedError, match="the handshake is over"):
            one.participant.process(begun, reply)


def test_a_peer_that_is_met_again_announces_the_same_challenge(shim, labs):
    """The other side, which has not noticed that it was lost for a moment, refuses any other."""
    lab = labs("pq")
    with couple((shim.folder, lab.alice), (shim.folder, lab.bob)) as both:
        other = both.second.participant
        spare = other.meet(both.first.participant.guid, both.first.participant.identity_token)
        begun, request = both.first.participant.request(both.first.meeting)
        _, reply = other.reply(spare, request)
        both.first.participant.process(begun, reply)


def test_another_ca_of_the_same_name_is_refused(shim, labs, other_labs):
    sides = (shim.folder, labs("pq").alice), (shim.folder, other_labs("pq").bob)
    with couple(*sides) as both, pytest.raises(RefusedError, match="not signed by this CA"):
        both.shake_hands()


def test_foreign_permissions_are_refused(shim, labs, enclave):
    lab = labs("pq")
    borrowed = {"permissions.p7s": (lab.alice / "permissions.p7s").read_bytes()}
    with (
        participant(shim.folder, enclave(lab.bob, borrowed)) as one,
        pytest.raises(RefusedError, match="they have no grant for CN=/lab/bob"),
    ):
        one.join(DOMAIN)


def test_a_revoked_peer_is_refused_and_its_own_list_refuses_it(shim, tmp_path, now):
    lab = Lab.create(tmp_path / "lab", LAB_PROFILES["transition"], now)
    with couple((shim.folder, lab.alice), (shim.folder, lab.bob)) as both:
        both.agree(both.shake_hands())
    careless = shutil.copytree(lab.bob, tmp_path / "careless")
    revoke(lab.keystore, lab.authorities, ["/lab/bob"], reason=Reason.KEY_COMPROMISE, now=now)
    sides = (shim.folder, lab.alice), (shim.folder, careless)
    with couple(*sides) as both, pytest.raises(RefusedError, match="was revoked on"):
        both.shake_hands()
    with (
        pytest.raises(RefusedError, match="was revoked on"),
        participant(shim.folder, lab.bob),
    ):
        pass


def _lost_alternative_key(lab, folder):
    (folder / "alt.key.pem").unlink()


def _key_of_another(lab, folder):
    shutil.copy(lab.bob / "key.pem", folder / "key.pem")


def _alternative_key_of_another(lab, folder):
    shutil.copy(lab.bob / "alt.key.pem", folder / "alt.key.pem")


def _encrypted_key(lab, folder):
    key = load_private_key((folder / "key.pem").read_bytes())
    (folder / "key.pem").write_bytes(private_key_pem(key, b"secret"))


def _lost_certificate(lab, folder):
    (folder / "cert.pem").unlink()


def _unknown_setting(lab, folder):
    (folder / "pqsec.toml").write_text("peer = 'stock'")


def _another_ca(lab, folder):
    shutil.copy(folder / "permissions_ca.cert.pem", folder / "identity_ca.cert.pem")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_lost_alternative_key, "alt.key.pem: it is missing"),
        (_key_of_another, "not the private key of the certificate"),
        (_alternative_key_of_another, "not the alternative key of the certificate"),
        (_encrypted_key, "encrypted and no passphrase"),
        (_lost_certificate, "no such file"),
        (_unknown_setting, "peer is not a setting"),
        (_another_ca, "was issued by"),
    ],
)
def test_an_identity_that_is_not_sound_is_refused_with_the_reason(
    shim, labs, enclave, spoil, words
):
    lab = labs("transition")
    folder = enclave(lab.alice, {})
    spoil(lab, folder)
    with pytest.raises(RefusedError, match=words), participant(shim.folder, folder):
        pass


def test_an_expired_identity_is_refused(shim, tmp_path, now):
    lab = Lab.create(tmp_path / "lab", LAB_PROFILES["pq"], now - 2 * YEAR)
    with pytest.raises(RefusedError, match="expired on"), participant(shim.folder, lab.alice):
        pass


def test_an_encrypted_key_opens_with_its_password(shim, labs, enclave):
    lab = labs("pq")
    folder = enclave(lab.alice, {})
    _encrypted_key(lab, folder)
    with participant(shim.folder, folder, passphrase="secret") as one:
        one.join(DOMAIN)


def test_the_log_of_the_agent_tells_who_was_refused_and_why(shim, labs, other_labs):
    sides = (shim.folder, labs("pq").alice), (shim.folder, other_labs("pq").bob)
    with couple(*sides) as both, pytest.raises(RefusedError):
        both.shake_hands()
    last = shim.log.splitlines()[-1]
    assert f"[{os.getpid()}]: begin_handshake_reply refused: " in last
    assert "is not signed by this CA" in last
