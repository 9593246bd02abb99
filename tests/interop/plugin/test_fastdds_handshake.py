"""Our plugin through the adapter for Fast DDS: with itself, with our plugin for Cyclone DDS, and
with Fast DDS's own. The library calls it as a DomainParticipant would, in a process of its own."""

import pytest

from tests.interop.conftest import LAB_PROFILES, STOCK
from tests.interop.cyclone import RefusedError
from tests.interop.fastdds import participant
from tests.interop.fastdds_shim import FastDdsShim
from tests.interop.plugin.couple import couple
from tests.interop.plugin.test_plugin_handshake import FIELDS, STOCK_PEERS, flipped
from tests.interop.roots import ROOTS

pytestmark = pytest.mark.interop


@pytest.fixture(params=ROOTS)
def ours_in_fastdds(request, fastdds_with_ours) -> FastDdsShim:
    """Of each version."""
    return fastdds_with_ours(request.param)


@pytest.mark.slow(but=3)
@pytest.mark.parametrize("profile", LAB_PROFILES)
def test_two_with_the_plugin_meet(ours_in_fastdds, labs, profile):
    lab = labs(profile)
    with couple((ours_in_fastdds, lab.alice), (ours_in_fastdds, lab.bob)) as both:
        both.agree(both.shake_hands())


@pytest.mark.parametrize("in_cyclone", ["alice", "bob"])
def test_it_meets_the_plugin_in_cyclone_dds_whoever_begins(ours_in_fastdds, shim, labs, in_cyclone):
    lab = labs("pq")
    sides = [
        (shim.folder if folder.name == in_cyclone else ours_in_fastdds, folder)
        for folder in (lab.alice, lab.bob)
    ]
    with couple(*sides) as both:
        both.agree(both.shake_hands())


def test_messages_of_the_second_version_pass_between_the_stacks(
    ours_in_fastdds, shim, labs, settings
):
    lab = labs("transition")
    alice, bob = (settings(each, "wire_versions = [2]\n") for each in (lab.alice, lab.bob))
    for first, second in ((ours_in_fastdds, shim.folder), (shim.folder, ours_in_fastdds)):
        with couple((first, alice), (second, bob)) as both:
            both.agree(both.shake_hands())


@pytest.fixture
def beside_fastdds(ours_in_fastdds, fastdds, labs):
    """beside_fastdds(profile, "alice") is alice with our plugin, and bob with Fast DDS's own."""

    def sides(profile, we):
        ours = labs(profile).alice.with_name(we)
        theirs = ours.with_name("bob" if we == "alice" else "alice")
        return (ours_in_fastdds, ours), (fastdds, theirs)

    return sides


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("we", ["alice", "bob"])
@pytest.mark.parametrize("profile", STOCK)
def test_it_meets_fast_ddss_own_plugin_if_allowed(beside_fastdds, settings, profile, we):
    (plugins, ours), theirs = beside_fastdds(profile, we)
    with couple((plugins, settings(ours, STOCK_PEERS)), theirs) as both:
        both.agree(both.shake_hands())


@pytest.mark.parametrize("we", ["alice", "bob"])
def test_a_transition_identity_wants_both_signatures_unless_told(beside_fastdds, we):
    with couple(*beside_fastdds("transition", we)) as both, pytest.raises(RefusedError):
        both.shake_hands()


@pytest.mark.parametrize(
    ("message", "name"), [(message, name) for message in FIELDS for name in FIELDS[message]]
)
def test_a_changed_bit_ends_the_handshake(ours_in_fastdds, labs, message, name):
    """And the true message is still good."""
    lab = labs("pq")

    def relay(sent, token):
        return flipped(token, name) if sent == message else token

    with couple((ours_in_fastdds, lab.alice), (ours_in_fastdds, lab.bob)) as both:
        with pytest.raises(RefusedError):
            both.shake_hands(relay)
        both.agree(both.shake_hands())


def test_a_participant_does_what_it_is_granted_and_is_told_why_not(ours_in_fastdds, labs):
    with participant(ours_in_fastdds, labs("pq").alice) as one:
        one.join(0)
        for what in ("datawriter", "datareader"):
            one.check(f"check_create_{what}", 0, "rt/chatter")
            with pytest.raises(RefusedError, match="its default is DENY"):
                one.check(f"check_create_{what}", 0, "rt/secret")
            with pytest.raises(RefusedError, match="names domain 200"):
                one.check(f"check_create_{what}", 200, "rt/chatter")


def test_how_often_fast_dds_sends_again_is_its_own_affair(ours_in_fastdds, labs):
    resending = {
        "max_handshake_requests": "100",
        "initial_handshake_resend_period": "250",
        "handshake_resend_period_gain": "1.1",
    }
    with participant(ours_in_fastdds, labs("pq").alice, **resending) as one:
        one.join(0)


@pytest.mark.parametrize("name", ["preferred_key_agreement", "ocsp"])
def test_a_property_that_is_not_understood_is_refused(ours_in_fastdds, labs, name):
    with (
        pytest.raises(RefusedError, match=f"{name} is unknown to pqsec's plugin"),
        participant(ours_in_fastdds, labs("pq").alice, **{name: "x"}),
    ):
        pass
